"""Pinhole images as OpenGL renders them, from which the image of any other lens is resampled."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vstestbed.camera import Camera, Perspective
from vstestbed.camera.cube import CUBE
from vstestbed.core.geometry import Array


@dataclass(frozen=True)
class Pinhole:
    """A rendered pinhole image: size, focal length, principal point [px], and the face of the cube that it shows."""

    width: int
    height: int
    f: float
    centre: tuple[float, float]
    face: str = "front"

    @property
    def name(self) -> str:
        """The camera's name in the scene: `eye` ahead, `eye_right`, ... elsewhere."""
        return "eye" if self.face == "front" else f"eye_{self.face}"

    @property
    def R_camera_face(self) -> Array:
        """Its orientation in the camera's frame, (3, 3)."""
        return CUBE[self.face]

    @property
    def mujoco_principal(self) -> tuple[float, float]:
        """MuJoCo's principalpixel: cx = W/2 - 0.5 - principalpixel_x, and y alike."""
        # MuJoCo counts from the image's middle, and pixel centres are at whole numbers here: hence the half pixel.
        return self.width / 2 - 0.5 - self.centre[0], self.height / 2 - 0.5 - self.centre[1]

    def holds(self, p_camera: Array) -> bool:
        """Whether one of the points (N, 3) lies in the middle part of its face of the cube, |x|, |y| <= z in its axes."""
        p = p_camera @ self.R_camera_face
        return bool((np.abs(p[:, :2]).max(axis=1) <= p[:, 2]).any())


def covering(px: Array, f: float, face: str = "front") -> Pinhole:
    """The smallest image that holds all of px (..., 2), relative to its principal point [px]."""
    px = px.reshape(-1, 2)
    # One pixel more on each side: bilinear resampling reads the four pixels round a point.
    low, high = np.floor(px.min(axis=0)) - 1, np.ceil(px.max(axis=0)) + 1
    return Pinhole(int(high[0] - low[0]) + 1, int(high[1] - low[1]) + 1, f, (float(-low[0]), float(-low[1])), face)


def pinhole_of(camera: Perspective) -> Pinhole:
    """The camera's own image; of a distorted lens, a pinhole image that covers its whole field of view."""
    if camera.distortion is None:
        return Pinhole(camera.width, camera.height, camera.f, (float(camera.centre[0]), float(camera.centre[1])))
    grid = pixel_grid(camera)
    # The border is enough: distortion maps the inside of the image to the inside of its border.
    border = np.concatenate([grid[0], grid[-1], grid[:, 0], grid[:, -1]])
    return covering(camera.normalise(border) * camera.f, camera.f)


def resampling_maps(camera: Perspective, pinhole: Pinhole) -> tuple[NDArray[np.float32], NDArray[np.float32]] | None:
    """Maps for cv2.remap: the place in the rendered image of each pixel of the camera; None for an undistorted lens."""
    if camera.distortion is None:
        return None
    grid = pixel_grid(camera)
    px = camera.normalise(grid.reshape(-1, 2)).reshape(grid.shape) * camera.f + pinhole.centre
    return px[..., 0].astype(np.float32), px[..., 1].astype(np.float32)


def pixel_grid(camera: Camera | Pinhole) -> Array:
    """The pixels (u, v) of a camera's image, shape (H, W, 2)."""
    return np.stack(np.meshgrid(np.arange(camera.width), np.arange(camera.height)), axis=-1).astype(float)
