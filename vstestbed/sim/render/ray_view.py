"""The outside views of a scene without OpenGL."""

from __future__ import annotations

import numpy as np

from vstestbed.camera import Image, Perspective, Window
from vstestbed.core.geometry import FLIP, Array
from vstestbed.sim.render.cones import cone_of, meets
from vstestbed.sim.render.rays import Caster, Raster, tiles_of
from vstestbed.sim.render.still import Lamp
from vstestbed.sim.scene.stage import Stage


class RaySceneCamera:
    """A camera of a stage that films from outside, by rays, without shadows; while it is at rest, only changed tiles are cast.

    Args:
        stage: the scene.
        camera: name in the scene.
        width, height: size of the image [px].
        samples: antialiasing, see `Raster`.
    """

    def __init__(self, stage: Stage, camera: str, width: int, height: int, samples: int = 0):
        self._stage, self._camera, self._caster = stage, camera, Caster(stage, outside=True)
        lens = Perspective(width=width, height=height, fovy_deg=float(stage.model.camera(camera).fovy[0]))
        self._raster = Raster(lens, np.eye(3), samples)
        self._tiles = [(tile, cone_of(self._raster.rays(tile).reshape(-1, 3))) for tile in tiles_of((0, 0, width, height))]
        self._pixel = 2 / lens.f if samples else 0.0
        """Angle by which antialiasing looks beyond a tile [rad]."""
        self._image = np.empty((height, width, 3), np.uint8)
        self._before: tuple[Array, Array, Array] | None = None
        self._lamp = Lamp(stage.model, stage.data)

    def full_image(self) -> Image:
        """The image now, shape (H, W, 3) uint8 RGB, as a copy."""
        data = self._stage.data
        seen_from, T = data.camera(self._camera), np.eye(4)
        T[:3, :3], T[:3, 3] = seen_from.xmat.reshape(3, 3) @ FLIP[:3, :3], seen_from.xpos
        if self._lamp.has_moved():
            self._before = None
        stale = tuple(tile for tile, cone in self._tiles if self._changed(T, cone))
        self._raster.draw(self._image, stale, self._caster, T)
        self._before = T, data.geom_xpos.copy(), data.geom_xmat.copy()
        return self._image.copy()

    def part(self, window: Window) -> Image | None:
        """None: the whole image is drawn where it has changed alone."""
        return None

    def _changed(self, T: Array, cone: tuple[Array, float]) -> bool:
        """Whether a geom within a cone of the camera (axis in its frame) has moved since the last image."""
        if self._before is None or not np.array_equal(self._before[0], T):
            return True
        data, bound = self._stage.data, self._stage.model.geom_rbound
        _, position, attitude = self._before
        moved = (data.geom_xpos != position).any(axis=1) | (data.geom_xmat != attitude).any(axis=1)
        # Where it was and where it is now: both tiles change.
        spheres = np.concatenate([position[moved], data.geom_xpos[moved]]) - T[:3, 3]
        radii = np.tile(np.where(bound > 0, bound, np.inf)[moved], 2)
        return bool(meets(spheres, radii, T[:3, :3] @ cone[0], cone[1] + self._pixel).any())
