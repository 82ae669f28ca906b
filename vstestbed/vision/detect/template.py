"""A picture on a plane as a template to track: its grey levels in several sizes, each with all that its alignment needs of it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from vstestbed.camera import Image
from vstestbed.core.geometry import Array
from vstestbed.targets.picture_file import decoded
from vstestbed.vision.match.features import Descriptors, Sift

Grey = NDArray[np.float32]

LEAST_SIDE = 20
"""Shortest side of the smallest copy of a template [texel]."""
BLOCKS = 6
"""Blocks along a template's longer side, each of which is compared with the picture by itself."""
FLAT = 6.0
"""Standard deviation of a block's grey levels below which its correlation would be one of noise alone."""
BLUR = 0.8
"""Standard deviation of the filter over template and picture [texel], [px], without which sampling between pixels shifts fine detail."""
NOISE = 4.0
"""Grey levels by which a flat texel may differ from the picture, ..."""
SHIFT = 0.3
"""... and texels by which an edge may seem to be shifted in it."""
EDGE = 2
"""Outermost texels that are left out: what the picture shows there mixes with what is behind the template."""


@dataclass(frozen=True, slots=True, eq=False)
class TemplateSize:
    """A template in one size, (h, w) texels; n = h w.

    Attributes:
        grey: grey levels (h, w).
        x, y: texel centres in units of half the template's longer side, from its middle, right and down, (n,).
        to_plane: (3, 3), from (column, row, 1) to (x, y, 1).
        slopes: derivatives of the grey levels by x and y, (2, n).
        texel: width and height of a texel, in the same units.
        inner: which texels count, (n,); those at the border do not.
        spread: what a residual is measured by at each texel (n,), in grey levels: at edges two samplings differ more.
        block: number of each texel's block, (n,). textured: which blocks are not flat, (B,).
        blocks: how many there are along x and y.
    """

    grey: Grey
    x: Grey
    y: Grey
    to_plane: Array
    slopes: Grey
    texel: tuple[float, float]
    inner: NDArray[np.bool_]
    spread: Grey
    block: NDArray[np.intp]
    textured: NDArray[np.bool_]
    blocks: tuple[int, int]

    def by_block(self, values: Grey) -> Grey:
        """Means of values (n,) over each block, (B,)."""
        return np.asarray(cv2.resize(values.reshape(self.grey.shape), self.blocks, interpolation=cv2.INTER_AREA), np.float32).ravel()


@dataclass(frozen=True, slots=True, eq=False)
class Template:
    """A picture file as a template: from its largest copy to its smallest, each about half as large as the one before.

    Attributes:
        levels: the copies. unit_m: half the longer side of the picture [m]. half: half its sides in that unit.
        features: its keypoints' places in that unit (K, 2) and their SIFT descriptors (K, 128).
    """

    levels: tuple[TemplateSize, ...]
    unit_m: float
    half: tuple[float, float]
    features: tuple[Array, Descriptors]

    @property
    def corners(self) -> Array:
        """(-, -), (+, -), (+, +), (-, +), homogeneous, shape (4, 3)."""
        a, b = self.half
        return np.array([[-a, -b, 1], [a, -b, 1], [a, b, 1], [-a, b, 1]])


def template_of(path: Path, width_m: float, most_texels: int) -> Template:
    """The template of a picture file that is printed `width_m` wide; its largest copy has `most_texels` or a few less.

    Raises:
        ParameterError: `file` is no picture, or too large.
    """
    return _template(path, path.stat().st_mtime_ns, width_m, most_texels)


@lru_cache(maxsize=8)
def _template(path: Path, changed: int, width_m: float, most_texels: int) -> Template:
    image = decoded(path)
    grey = np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.float32)
    height, width = grey.shape
    longer = max(height, width)
    half = width / longer, height / longer
    share = min(1.0, (most_texels / grey.size) ** 0.5)
    levels: list[TemplateSize] = []
    while min(height, width) * share >= LEAST_SIDE or not levels:
        levels.append(_level(grey, (max(4, round(width * share)), max(4, round(height * share))), half))
        share /= 2
    return Template(tuple(levels), width_m / 2 / half[0], half, _features(image, half))


def _level(grey: Grey, size: tuple[int, int], half: tuple[float, float]) -> TemplateSize:
    """The template reduced to a size (w, h) by averaging, so that its texels' places stay where they are."""
    small = grey if size == grey.shape[::-1] else np.asarray(cv2.resize(grey, size, interpolation=cv2.INTER_AREA), np.float32)
    small = np.asarray(cv2.GaussianBlur(small, (0, 0), BLUR), np.float32)
    w, h = size
    texel = 2 * half[0] / w, 2 * half[1] / h
    u, v = np.meshgrid(np.arange(w), np.arange(h))
    x, y = ((u - (w - 1) / 2) * texel[0]).ravel(), ((v - (h - 1) / 2) * texel[1]).ravel()
    inner = ((np.minimum(u, w - 1 - u) >= EDGE) & (np.minimum(v, h - 1 - v) >= EDGE)).ravel()
    across, down = (max(1, round(BLOCKS * side)) for side in half)  # the same blocks in every size
    block = (v * down // h * across + u * across // w).ravel()
    n = np.bincount(block)
    mean = np.bincount(block, small.ravel()) / n
    spread = np.sqrt(np.maximum(np.bincount(block, small.ravel() ** 2) / n - mean**2, 0))
    to_plane = np.array([[texel[0], 0, x[0]], [0, texel[1], y[0]], [0, 0, 1]])
    slope = slopes(small, texel)
    sampled = np.hypot(NOISE, SHIFT * np.hypot(slope[0] * texel[0], slope[1] * texel[1])).astype(np.float32)
    x, y = x.astype(np.float32), y.astype(np.float32)
    return TemplateSize(small, x, y, to_plane, slope, texel, inner, sampled, block, spread > FLAT, (across, down))


def slopes(grey: Grey, texel: tuple[float, float]) -> Grey:
    """Derivatives of grey levels (h, w) by the template's x and y, by central differences, (2, n)."""
    out = np.empty((2, *grey.shape), np.float32)
    cv2.Sobel(grey, cv2.CV_32F, 1, 0, dst=out[0], ksize=1, scale=0.5 / texel[0])
    cv2.Sobel(grey, cv2.CV_32F, 0, 1, dst=out[1], ksize=1, scale=0.5 / texel[1])
    return out.reshape(2, -1)


LONGEST_PX = 640
"""Longest side of the template in which keypoints are detected [px]: a picture shows no finer ones."""
SIFT = Sift(most=800, contrast=0.01)
"""Its contrast is a quarter of what is usual: a picture may be in shadow, and wrong matches are found out."""


def _features(image: Image, half: tuple[float, float]) -> tuple[Array, Descriptors]:
    """Places (K, 2) in the template's unit and SIFT descriptors (K, 128) of a picture (H, W, 3), blue first."""
    height, width = image.shape[:2]
    share = min(1.0, LONGEST_PX / max(height, width))
    w, h = round(width * share), round(height * share)
    small = cv2.cvtColor(cv2.resize(image, (w, h), interpolation=cv2.INTER_AREA), cv2.COLOR_BGR2RGB)
    px, descriptors = SIFT.extract(np.asarray(small, np.uint8))
    return ((px + 0.5) / [w, h] * 2 - 1) * half, descriptors
