"""What all textures are drawn with: noise at many scales, shading of heights, blending,
lettering.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.float32]
"""Colours (H, W, 3), or one channel (H, W), in 0..1."""
FONT, PLAIN = cv2.FONT_HERSHEY_TRIPLEX, cv2.FONT_HERSHEY_DUPLEX
SHIFT = 4
"""Fractional bits of the corners of shapes."""


def rgb(text: str) -> Image:
    """A colour (3,) by its six hexadecimal digits."""
    return np.array([int(text[i : i + 2], 16) for i in (0, 2, 4)], np.float32) / np.float32(255)


def noise(
    rng: np.random.Generator, height: int, width: int, coarse: float, fine: float, fall: float = 0.5
) -> Image:
    """Fractal noise (H, W), about 0 and of unit standard deviation: octaves from `coarse` to `fine`
    [px], each `fall` times the last.
    """
    total, weight, size = np.zeros((height, width), np.float32), 1.0, coarse
    while size >= fine:
        grid = rng.standard_normal(
            (max(4, round(height / size) + 3), max(4, round(width / size) + 3))
        ).astype(np.float32)
        total += np.float32(weight) * np.asarray(
            cv2.resize(grid, (width, height), interpolation=cv2.INTER_CUBIC)
        )
        weight, size = weight * fall, size / 2
    return (total - total.mean()) / max(float(total.std()), 1e-6)


def ramp(stops: list[tuple[float, str]], at: Image) -> Image:
    """Colours (..., 3) between stops (place, colour), at places (...)."""
    places, colours = [p for p, _ in stops], np.array([rgb(c) for _, c in stops])
    return np.stack([np.interp(at, places, colours[:, i]) for i in range(3)], axis=-1).astype(
        np.float32
    )


def relief(height: Image, strength: float, azimuth_deg: float = 225.0) -> Image:
    """Brightness (H, W), 1 where it is level, of a surface of heights (H, W) [px] lit from an
    azimuth.
    """
    dx, dy = (
        cv2.Sobel(height, cv2.CV_32F, 1, 0, scale=0.125),
        cv2.Sobel(height, cv2.CV_32F, 0, 1, scale=0.125),
    )
    a = np.radians(azimuth_deg)
    towards = np.float32(strength) * (dx * np.cos(a) + dy * np.sin(a))
    return (1 + towards / np.sqrt(1 + towards * towards)).astype(np.float32)


def blend(image: Image, colour: Image, share: Image | float) -> None:
    """Paint over an image (H, W, 3) in place, by shares (H, W) or one for all."""
    part = np.asarray(share, np.float32)
    part = part[..., None] if part.ndim == 2 else part
    image += (colour - image) * part


def polygon(height: int, width: int, corners: NDArray[np.float64]) -> Image:
    """Coverage (H, W) of a polygon with corners (N, 2) [px]."""
    mask = np.zeros((height, width), np.uint8)
    cv2.fillPoly(mask, [np.round(corners * 2**SHIFT).astype(np.int32)], 255, cv2.LINE_AA, SHIFT)
    return mask.astype(np.float32) / np.float32(255)


def disc(
    height: int, width: int, centre: tuple[float, float], radius: float, soft: float = 1.0
) -> Image:
    """Coverage (H, W) of a disc with an edge `soft` [px] wide."""
    v, u = np.mgrid[:height, :width].astype(np.float32)
    return np.clip((radius - np.hypot(u - centre[0], v - centre[1])) / soft + 0.5, 0, 1).astype(
        np.float32
    )


def letters(
    image: Image,
    words: str,
    left: float,
    base: float,
    size: float,
    colour: Image,
    bold: float = 0.1,
    font: int = FONT,
) -> float:
    """Write words in place, their capitals `size` [px] high, from `left` on a line at `base`; where
    they end [px].

    Drawn four times as large and reduced, so that strokes have fractions of a pixel.
    """
    big = 4
    unit = cv2.getTextSize("H", font, 1.0, 1)[0][1]
    scale, thick = big * size / unit, max(1, round(big * size * bold))
    (wide, tall), below = cv2.getTextSize(words, font, scale, thick)
    mask = np.zeros((tall + below + 2 * thick + big, wide + 2 * thick + big), np.uint8)
    cv2.putText(mask, words, (thick, tall + thick), font, scale, 255, thick, cv2.LINE_AA)
    small = (
        np.asarray(
            cv2.resize(
                mask, (mask.shape[1] // big, mask.shape[0] // big), interpolation=cv2.INTER_AREA
            ),
            np.float32,
        )
        / 255
    )
    top, start = round(base - (tall + thick) / big), round(left - thick / big)
    here = image[max(top, 0) : top + small.shape[0], max(start, 0) : start + small.shape[1]]
    cut = small[max(-top, 0) :, max(-start, 0) :]
    blend(here, colour, cut[: here.shape[0], : here.shape[1]])
    return left + wide / big


def width_of(words: str, size: float, font: int = FONT) -> float:
    """How long `letters` would make words [px], without their strokes' thickness."""
    unit = cv2.getTextSize("H", font, 1.0, 1)[0][1]
    return cv2.getTextSize(words, font, 4 * size / unit, 1)[0][0] / 4
