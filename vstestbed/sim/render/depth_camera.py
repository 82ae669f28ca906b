"""The depth camera of a run: the true depth of a rendered picture, as the scenario's sensor measures it."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from vstestbed.camera import Camera, DepthImage, DepthSensor, Perspective
from vstestbed.core.geometry import Array
from vstestbed.sim.lens.pinhole import pixel_grid


class DepthCamera:
    """Draws one number from its generator for each picture; the noise is a function of that number and of the true depth alone.

    Args:
        camera: the lens. sensor: what it measures. rng: source of the noise.
    """

    def __init__(self, camera: Perspective, sensor: DepthSensor, rng: np.random.Generator):
        self._camera, self._sensor, self._rng = camera, sensor, rng

    @cached_property
    def _xy(self) -> Array:
        """Normalised coordinates of all pixels (H, W, 2)."""
        grid = pixel_grid(self._camera)
        return self._camera.normalise(grid.reshape(-1, 2)).reshape(grid.shape)

    def measured(self, true: DepthImage | None) -> DepthImage | None:
        """The depth picture (H, W) [m] of the true depths (H, W) [m] of the next picture, NaN in holes."""
        seed = int(self._rng.integers(2**63))
        return None if true is None else self._sensor.measured(true, self._xy, self._camera.f, np.random.default_rng(seed))

    def clean(self, true: DepthImage | None) -> DepthImage | None:
        """The same without noise, as the mean of many pictures at rest would be; nothing is drawn for it."""
        return None if true is None else self._sensor.measured(true, self._xy, self._camera.f, None)


def depth_camera(camera: Camera, rng: np.random.Generator | None) -> DepthCamera | None:
    """The depth camera of a lens that has a sensor of depth; None for any other."""
    if camera.depth_sensor is None or not isinstance(camera, Perspective):
        return None
    return DepthCamera(camera, camera.depth_sensor, rng or np.random.default_rng(0))
