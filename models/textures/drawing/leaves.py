"""Dead leaves: surfaces of all sizes that cover each other, whose statistics are those of
photographs, and no part of which comes twice.

Lee, Mumford & Huang 2001, "Occlusion models for natural images", doi:10.1023/A:1011109015675: with
a density of sizes that falls as r^-3 a picture of occluding shapes is scale invariant, as
photographs are.
"""

from __future__ import annotations

import cv2
import numpy as np

from drawing.canvas import Image, noise

HEIGHT, WIDTH = 1200, 1600
LEAST, MOST, COUNT = 34.0, 400.0, 1800
"""Radii of the shapes [px], and how many are laid down."""
SHARP = 4
"""Bits of a pixel's fraction in which corners are given to OpenCV."""


def draw(rng: np.random.Generator) -> Image:
    """The picture (1200, 1600, 3)."""
    image = np.full((HEIGHT, WIDTH, 3), 0.5, np.float32)
    grain = np.stack([noise(rng, HEIGHT, WIDTH, 80, 10, 0.6) for _ in range(3)], axis=-1)
    light = noise(rng, HEIGHT, WIDTH, 500, 2, 0.5)
    # Radii by the inverse of the distribution of r^-3 between both ends; the last ones laid down
    # are on top.
    radius = (LEAST**-2 - rng.random(COUNT) * (LEAST**-2 - MOST**-2)) ** -0.5
    for r in radius:
        _lay(rng, image, float(r), grain)
    image *= (1 + 0.12 * light)[..., None]
    return np.clip(image, 0, 1)


def _lay(rng: np.random.Generator, image: Image, r: float, grain: Image) -> None:
    """One shape over the picture: a rounded or an angular outline, a colour with a gradient across
    it, and grain of its own strength.
    """
    middle = rng.uniform((-r, -r), (WIDTH + r, HEIGHT + r))
    corners = int(rng.integers(3, 9)) if rng.random() < 0.5 else 40
    angle = (
        np.sort(rng.uniform(0, 2 * np.pi, corners))
        if corners < 40
        else np.linspace(0, 2 * np.pi, 41)[:-1]
    )
    swell = 1 + 0.25 * np.cos(rng.integers(1, 4) * angle + rng.uniform(0, 6.3)) * (corners == 40)
    at = r * swell[:, None] * np.column_stack([np.cos(angle), rng.uniform(0.35, 1) * np.sin(angle)])
    c, s = np.cos(turn := rng.uniform(0, np.pi)), np.sin(turn)
    at = middle + at @ np.array([[c, s], [-s, c]])
    (left, top), (right, bottom) = (
        np.floor(at.min(axis=0)).astype(int) - 1,
        np.ceil(at.max(axis=0)).astype(int) + 2,
    )
    left, top, right, bottom = max(left, 0), max(top, 0), min(right, WIDTH), min(bottom, HEIGHT)
    if left >= right or top >= bottom:
        return
    mask = np.zeros((bottom - top, right - left), np.uint8)
    cv2.fillPoly(
        mask, [np.rint((at - (left, top)) * 2**SHARP).astype(np.int32)], 255, cv2.LINE_AA, SHARP
    )
    v, u = np.mgrid[top:bottom, left:right].astype(np.float32)
    along = ((u - middle[0]) * np.cos(turn) + (v - middle[1]) * np.sin(turn)) / max(r, 1.0)
    base = rng.uniform(0.08, 0.92) + rng.normal(0, 0.07, 3)
    colour = (
        base
        + rng.normal(0, 0.12) * along[..., None]
        + rng.uniform(0, 0.09) * grain[top:bottom, left:right]
    )
    share = (mask / np.float32(255))[..., None]
    part = image[top:bottom, left:right]
    part += share * (colour.astype(np.float32) - part)
