"""The pinhole picture that OpenGL draws, from which the picture of a distorted lens is resampled."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vstestbed.camera import Perspective


@dataclass(frozen=True)
class Pinhole:
    """Size and principal point of the drawn picture [px], with the camera's own focal length."""

    width: int
    height: int
    centre: tuple[float, float]

    @property
    def mujoco_principal(self) -> tuple[float, float]:
        """MuJoCo's principalpixel: cx = W/2 - 0.5 - principalpixel_x, and y alike."""
        return self.width / 2 - 0.5 - self.centre[0], self.height / 2 - 0.5 - self.centre[1]


def pinhole_of(camera: Perspective) -> Pinhole:
    """The camera's own picture without distortion; with it, a pinhole picture that covers all that the lens sees."""
    if camera.distortion is None:
        return Pinhole(camera.width, camera.height, (float(camera.centre[0]), float(camera.centre[1])))
    grid = np.stack(np.meshgrid(np.arange(camera.width), np.arange(camera.height)), axis=-1).astype(float)
    border = np.concatenate([grid[0], grid[-1], grid[:, 0], grid[:, -1]])
    px = camera.normalise(border) * camera.f
    low, high = np.floor(px.min(axis=0)) - 1, np.ceil(px.max(axis=0)) + 1
    return Pinhole(int(high[0] - low[0]) + 1, int(high[1] - low[1]) + 1, (float(-low[0]), float(-low[1])))


def resampling_maps(camera: Perspective, pinhole: Pinhole) -> tuple[NDArray[np.float32], NDArray[np.float32]] | None:
    """For cv2.remap: where in the drawn picture each pixel of the camera's picture lies; None for an undistorted lens."""
    if camera.distortion is None:
        return None
    grid = np.stack(np.meshgrid(np.arange(camera.width), np.arange(camera.height)), axis=-1).astype(float)
    px = camera.normalise(grid.reshape(-1, 2)).reshape(grid.shape) * camera.f + pinhole.centre
    return px[..., 0].astype(np.float32), px[..., 1].astype(np.float32)
