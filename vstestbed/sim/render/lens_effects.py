"""The errors of a lens in a rendered picture: defocus by layers of depth, lateral colour, vignetting."""

from __future__ import annotations

import math
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from vstestbed.camera import Camera, DepthImage, Perspective
from vstestbed.camera.optics import Optics
from vstestbed.sim.render.cube_map import pixel_grid

Floats = NDArray[np.float32]
FINE_PX, COARSE = 0.5, 0.1
"""Discs of one layer differ by at most FINE_PX + COARSE of their diameter [px]."""
SHARP_PX = 0.3
"""A disc of this diameter is one pixel [px]."""
SUBPIXELS = 8
"""Points along a pixel's side by which its share of a disc is measured."""
MOST = 0.25
"""Largest disc, as a share of the picture's height."""


class LensEffects:
    """Applies a lens's errors to pictures.

    Args:
        camera: with the size, the principal point and the rays of the picture. optics: its errors.
    """

    def __init__(self, camera: Camera, optics: Optics):
        self._camera, self._optics = camera, optics
        self._focal_length_m = 0.0
        if optics.defocus is not None:
            self._focal_length_m = optics.defocus.focal_length_m or getattr(camera, "focal_length_m", None) or 0.0

    @property
    def needs_depth(self) -> bool:
        """Whether the true depth of each pixel is asked for."""
        return self._optics.defocus is not None

    def of(self, image: NDArray[np.uint8], depth: DepthImage | None) -> Floats:
        """The light (H, W, 3) behind the lens of a rendered picture (H, W, 3) with the depths (H, W) [m] along the axis."""
        light, camera, optics = image.astype(np.float32), self._camera, self._optics
        if optics.defocus is not None and isinstance(camera, Perspective) and depth is not None:
            most = np.float32(MOST * camera.height)
            light = defocused(light, np.clip(optics.defocus.circle_px(depth, camera.f, self._focal_length_m), -most, most))
        for channel, px in ((0, optics.red_px), (2, optics.blue_px)):
            if px:
                light[..., channel] = self._magnified(np.ascontiguousarray(light[..., channel]), px)
        if optics.shades:
            light *= self._shading
        return light

    @cached_property
    def _grid(self) -> Floats:
        """All pixels (H, W, 2), from the principal point [px]."""
        return np.asarray(pixel_grid(self._camera) - self._camera.centre, np.float32)

    @cached_property
    def _corner_px(self) -> float:
        """Distance of the farthest corner from the principal point [px]."""
        return float(np.hypot(self._grid[..., 0], self._grid[..., 1]).max())

    @cached_property
    def _shading(self) -> Floats:
        """Brightness of each pixel (H, W, 1) [1]."""
        r = np.hypot(self._grid[..., 0], self._grid[..., 1]) / self._corner_px
        cosine = self._camera.ray(pixel_grid(self._camera).reshape(-1, 2))[:, 2].reshape(r.shape) if self._optics.cos4 else np.ones_like(r)
        return self._optics.shading(r, cosine)[..., None]

    def _magnified(self, channel: Floats, px: float) -> Floats:
        """A colour (H, W) magnified about the principal point, so that the farthest corner moves out by `px`."""
        scale, (cx, cy) = 1 + px / self._corner_px, self._camera.centre
        inverse = np.array([[1 / scale, 0, cx - cx / scale], [0, 1 / scale, cy - cy / scale]])
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        size = channel.shape[1], channel.shape[0]
        return np.asarray(cv2.warpAffine(channel, inverse, size, flags=flags, borderMode=cv2.BORDER_REPLICATE), np.float32)


def defocused(light: Floats, circle_px: Floats) -> Floats:
    """A picture (H, W, 3) with each point as a disc of a diameter (H, W) [px], negative beyond the focus.

    Layers of similar discs, from far to near, are blurred with their masks, and laid one over the other:
    (C, A) <- (C (1 - a) + c, A (1 - a) + a); the picture is C / A.
    """
    step = COARSE / FINE_PX
    layer = np.rint(np.sign(circle_px) * np.log1p(step * np.abs(circle_px)) / COARSE).astype(np.int32)
    lowest = int(layer.min())
    flat = (layer - lowest).ravel()
    count = np.bincount(flat)
    size = np.bincount(flat, weights=np.abs(circle_px).ravel()) / np.maximum(count, 1)
    if len(np.flatnonzero(count)) == 1:
        return _blurred(light, disc(float(size[count > 0][0])))
    height, width = layer.shape
    # The mask is a fourth colour: picture and mask are blurred in one go.
    laid, masked = np.zeros((height, width, 4), np.float32), np.ones((height, width, 4), np.float32)
    masked[..., :3] = light
    for i in np.flatnonzero(count):
        kernel = disc(float(size[i]))
        rows, columns = _window(layer == i + lowest, kernel.shape[0] // 2)
        own = (layer[rows, columns] == i + lowest)[..., None]
        part = _blurred(masked[rows, columns] * own, kernel)
        laid[rows, columns] *= 1 - part[..., 3:]
        laid[rows, columns] += part
    return laid[..., :3] / laid[..., 3:]


def disc(diameter_px: float) -> Floats:
    """A disc as a kernel (n, n) with sum 1: each pixel has the share of its area that the disc covers."""
    if diameter_px <= SHARP_PX:
        return np.ones((1, 1), np.float32)
    n = 2 * math.ceil((diameter_px - 1) / 2) + 1
    at = (np.arange(n * SUBPIXELS) + 0.5) / SUBPIXELS - n / 2
    inside = at * at + (at * at)[:, None] <= diameter_px**2 / 4
    shares = inside.reshape(n, SUBPIXELS, n, SUBPIXELS).sum(axis=(1, 3)).astype(np.float32)
    return shares / shares.sum()


def _blurred(image: Floats, kernel: Floats) -> Floats:
    """An image (H, W, ...) convolved with a kernel, continued beyond its border as it ends there."""
    if kernel.size == 1:
        return image
    # Of large kernels OpenCV multiplies Fourier transforms, which leaves -1e-20 where nothing shines.
    return np.asarray(np.maximum(cv2.filter2D(image, -1, kernel, borderType=cv2.BORDER_REPLICATE), 0), np.float32)


def _window(mask: NDArray[np.bool_], reach: int) -> tuple[slice, slice]:
    """The rows and columns round a mask (H, W), `reach` more on each side."""
    return tuple(  # pyright: ignore[reportReturnType] - of two axes
        slice(max(0, int(at[0]) - reach), min(n, int(at[-1]) + 1 + reach))
        for at, n in ((np.flatnonzero(mask.any(axis=1 - axis)), mask.shape[axis]) for axis in (0, 1))
    )
