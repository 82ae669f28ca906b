"""Grey pictures in several sizes, sampled where a plane is projected by any lens."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from vstestbed.camera import Camera, Perspective, Picture, Window
from vstestbed.core.geometry import Array
from vstestbed.vision.detect.template import BLUR

Grey = NDArray[np.float32]

OUTSIDE = -1e4
"""A pixel far outside of every picture."""
GRID = np.linspace(-1, 1, 9)
"""Places along a template's sides at which its size in the picture is measured."""


@dataclass(frozen=True, slots=True)
class _Part:
    """A rectangle of one panel's image in several sizes, each half of the one before (`cv2.pyrDown`), and where it begins [px]."""

    panel: int
    sizes: list[Grey]
    smooth: dict[int, Grey]
    begin: Array


class GreyPicture:
    """A picture's grey levels, in the camera's panels, or in one rectangle of its image alone.

    Args:
        picture: the exposure. camera: its calibrated lens. window: the rectangle that counts; None for everything.
    """

    def __init__(self, picture: Picture, camera: Camera, window: Window | None = None):
        self.camera = camera
        self._parts: list[_Part] = []
        for k, image in enumerate(picture.images):
            if image is None:
                continue
            left, top, right, bottom = window or (0, 0, image.shape[1], image.shape[0])
            grey = np.asarray(cv2.cvtColor(np.ascontiguousarray(image[top:bottom, left:right]), cv2.COLOR_RGB2GRAY), np.uint8)
            self._parts.append(_Part(k, [grey.astype(np.float32)], {}, np.array([left, top], float)))

    def sampled(self, rays: Array, shape: tuple[int, int], halvings: int) -> Grey:
        """Grey levels (h, w) of a grid in a plane, from the picture halved so many times; NaN where it shows nothing.

        rays: (3, 3), from a grid's place (column, row, 1) to its direction in the camera's frame. shape: h and w of the grid.
        """
        parts = [self._sampled(part, rays, shape, halvings) for part in self._parts]
        out = parts[0]
        for more in parts[1:]:
            np.copyto(out, more, where=np.isnan(out))
        return out

    def _sampled(self, part: _Part, rays: Array, shape: tuple[int, int], halvings: int) -> Grey:
        """The same from one panel's image."""
        panel, image = self.camera.panels[part.panel], self._size(part, halvings)
        turned, lens = panel.R_camera_panel.T @ rays, panel.lens
        h, w = shape
        ahead = turned[2] @ [[0, w - 1, 0, w - 1], [0, 0, h - 1, h - 1], [1, 1, 1, 1]]
        if isinstance(lens, Perspective) and lens.distortion is None and ahead.min() > 0:
            to_part = np.array([[1, 0, -part.begin[0]], [0, 1, -part.begin[1]], [0, 0, 2**halvings]]) @ lens.K @ turned
            flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
            found = cv2.warpPerspective(image, to_part, (w, h), flags=flags, borderMode=cv2.BORDER_CONSTANT, borderValue=np.nan)
            return np.asarray(found, np.float32)
        u, v = np.moveaxis(lens.project(_grid(shape) @ turned.T), -1, 0)
        u, v = ((at - begin) / 2**halvings for at, begin in ((u, part.begin[0]), (v, part.begin[1])))
        u, v = (np.nan_to_num(at.astype(np.float32), nan=OUTSIDE) for at in (u, v))
        found = cv2.remap(image, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=np.nan)
        return np.asarray(found, np.float32)

    def _size(self, part: _Part, halvings: int) -> Grey:
        while len(part.sizes) <= halvings:
            part.sizes.append(np.asarray(cv2.pyrDown(part.sizes[-1]), np.float32))
        if halvings not in part.smooth:
            part.smooth[halvings] = np.asarray(cv2.GaussianBlur(part.sizes[halvings], (0, 0), BLUR), np.float32)
        return part.smooth[halvings]


@lru_cache(maxsize=16)
def _grid(shape: tuple[int, int]) -> Array:
    """(column, row, 1) of a grid, (h, w, 3)."""
    v, u = np.mgrid[: shape[0], : shape[1]].astype(float)
    grid = np.stack([u, v, np.ones(shape)], axis=-1)
    grid.setflags(write=False)  # kept
    return grid


def pixels_per_unit(camera: Camera, G: Array, half: tuple[float, float]) -> float:
    """Pixels of a camera's image (of its panels) along the unit of a template: the root of the ratio of areas; NaN where it is not seen."""
    x, y = np.meshgrid(GRID * half[0], GRID * half[1])
    rays = np.stack([x, y, np.ones_like(x)], axis=-1).reshape(-1, 3) @ G.T
    areas: list[float] = []
    for panel in camera.panels:
        uv = panel.lens.project(rays @ panel.R_camera_panel).reshape(len(GRID), len(GRID), 2)
        a, b = uv[1:, 1:] - uv[:-1, :-1], uv[1:, :-1] - uv[:-1, 1:]
        area = np.abs(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]) / 2
        area = area[np.isfinite(area) & panel.lens.inside(uv[1:, 1:])]
        areas.extend(area.tolist())
    cell = (GRID[1] - GRID[0]) ** 2 * half[0] * half[1]
    return float(np.sqrt(np.median(areas) / cell)) if areas else float("nan")
