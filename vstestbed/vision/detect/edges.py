"""The border of a region, to a fraction of a pixel, from how much of each pixel the region covers."""

from __future__ import annotations

import math

import cv2
import numpy as np
from cv2.typing import MatLike
from numpy.typing import NDArray

from vstestbed.camera import Image
from vstestbed.core.geometry import Array

FULL, NONE = 0.85, 0.15
"""Coverage of pixels inside and outside, two pixels from the border; where they are not, at corners and in slots, no border is
measured."""
REACH = 2
"""Pixels to each side of the border that are added up."""
NEIGHBOURS = np.ones((3, 3), np.uint8)
NEAR = (7, 7)
"""A pixel's neighbours whose mean gives the colours that meet at a border: of those wholly covered, and of those not covered at all."""


def coverage(part: Image, alone: NDArray[np.uint8]) -> NDArray[np.float32]:
    """How much of each pixel a region covers, shape (H, W), 0 to 1 but for noise.

    A pixel at the border has the colour c = f F + (1 - f) B of what meets there, so that f = (c - B) . (F - B) / |F - B|^2. F and B are
    the mean colours of the pixels near it that are wholly inside and wholly outside, which follow shading and background.

    Args:
        part: RGB (H, W, 3), the region's box and a few pixels round it. alone: 255 in the region's pixels, shape (H, W).

    Reference: Smith & Blinn 1996, Blue screen matting, doi:10.1145/237170.237263 (the mixture at a border).
    """
    near, inner = cv2.dilate(alone, NEIGHBOURS), cv2.erode(alone, NEIGHBOURS)
    out = (inner > 0).astype(np.float32)
    border = (near > 0) & (inner == 0)  # the colours are worked out there alone: most of a region is its inside
    F, B = _mean_near(part, inner, border), _mean_near(part, cv2.bitwise_not(near), border)
    span = F - B
    out[border] = ((part[border] - B) * span).sum(axis=1) / np.maximum((span * span).sum(axis=1), 1.0)
    return out


def _mean_near(part: Image, which: MatLike, at: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Mean colours (K, 3) of the pixels of `which` (255 there) near each of K pixels `at`; where there are none, of all of them."""
    total = cv2.boxFilter(cv2.bitwise_and(part, part, mask=which), cv2.CV_32F, NEAR, normalize=False, borderType=cv2.BORDER_CONSTANT)
    count = cv2.boxFilter(which, cv2.CV_32F, NEAR, normalize=False, borderType=cv2.BORDER_CONSTANT)[at][:, None] / 255
    overall = np.array(cv2.mean(part, which)[:3], np.float32)
    return np.where(count > 0, total[at] / np.maximum(count, 1), overall).astype(np.float32)


def edge_points(cover: NDArray[np.floating]) -> Array:
    """Points (K, 2) [px] on the border of a region, from the coverage (H, W) of each pixel, 0 to 1.

    Along a row, between two pixels of which one is covered by more than half and the other is not, the coverages of four pixels, from
    inside to outside, add up to the way from the beginning of the first to the border. That is exact for straight borders that are
    steeper than 45 degrees, since a pixel's coverage is the mean over its height; flatter ones are measured along columns.
    """
    c = np.pad(cover.astype(np.float32), REACH)
    du, dv = (np.abs(cv2.Sobel(c, cv2.CV_32F, *order, ksize=3)) for order in ((1, 0), (0, 1)))
    along_rows = _crossings(c, du >= dv)
    along_columns = _crossings(np.ascontiguousarray(c.T), np.ascontiguousarray((dv > du).T))
    return np.concatenate([along_rows, along_columns[:, ::-1]]) - REACH


def bare_share(uv: Array, alone: NDArray[np.uint8], reach_px: float) -> float:
    """Share of points uv (S, 2) [px] that no pixel at a region's border is within `reach_px` of; NaN counts as such a point.

    Pixels are at the border whether or not it is sharp enough there to be measured (`edge_points`), also at corners and under blur.

    Args:
        uv: in coordinates of `alone`. alone: 255 in the region's pixels, shape (H, W).
    """
    pad = math.ceil(reach_px) + 1  # beyond it nothing is within reach
    region = cv2.copyMakeBorder(alone, pad, pad, pad, pad, cv2.BORDER_CONSTANT, value=0)
    inner = cv2.erode(region, NEIGHBOURS)
    away = cv2.distanceTransform(cv2.bitwise_not(region - inner), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    height, width = away.shape
    with np.errstate(invalid="ignore"):
        at = np.rint(uv + pad)
        u, v = at[((at >= 0) & (at < [width, height])).all(axis=1)].astype(int).T
    return 1 - np.count_nonzero(away[v, u] <= reach_px) / len(uv)


def _crossings(c: NDArray[np.float32], steep: NDArray[np.bool_]) -> Array:
    """Borders (K, 2) [px] (u, v) along the rows of a coverage (H, W), where `steep` (H, W) says that the border runs across them."""
    inside = c > 0.5
    v, u = np.nonzero((inside[:, 1:-2] != inside[:, 2:-1]) & (steep[:, 1:-2] | steep[:, 2:-1]))
    four = np.stack([c[v, u + k] for k in range(4)], axis=1)  # pixels u .. u + 3; the border is between the middle two
    leaves = inside[v, u + 1]
    four = np.where(leaves[:, None], four, four[:, ::-1])
    clear = (four[:, 0] > FULL) & (four[:, 3] < NONE)
    way = four.sum(axis=1)
    at = np.where(leaves, u - 0.5 + way, u + 3.5 - way)
    return np.column_stack([at, v])[clear].astype(float)
