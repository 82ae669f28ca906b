"""Images of a recorded run from any camera, without physics: the log has all poses."""

from __future__ import annotations

import math

from vstestbed.camera import Camera, Image
from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array
from vstestbed.robots import Robot
from vstestbed.sim.render.pictures import outside_view, servo_renderer
from vstestbed.sim.render.still import StillView, pixels_per_radian
from vstestbed.sim.scene.compose import Parts
from vstestbed.sim.scene.stage import Stage
from vstestbed.sim.scene.world import World
from vstestbed.targets.base import Target

FILM_SHADOW_PX = 2048
"""Shadow map of the outside view: half of MuJoCo's default."""

FILM_SLICES, FILM_STACKS, FILM_QUADS = 20, 12, 2
"""Facets of round geoms in it: a cylinder of 40 px deviates from its circle by .25 px. MuJoCo's 28, 16 and 4 make twice the work,
which for a base with 36 rollers was a third of an image's time."""


class Replay:
    """Renders a recorded run on a stage of its own, so that filming does not affect the run.

    Args:
        robot, camera, target, world: the scene.
        shadows: render shadows in the outside views (three times the work).
        sights: points that the outside view must show [m].
        samples: multisampling of the outside views, for smooth edges.
        thin: where rays draw, the servo camera's images are smaller by this factor.

    Raises:
        EnvironmentLackError: OpenGL is asked for, and does not work here.
    """

    def __init__(
        self,
        robot: Robot,
        camera: Camera,
        target: Target,
        world: World,
        shadows: bool = True,
        sights: tuple[tuple[float, float, float], ...] = (),
        samples: int = 0,
        thin: int = 1,
    ):
        self._parts = Parts(robot, camera, target, world, step=camera.period, sights=sights)
        self._stage = Stage(self._parts, samples=samples)
        quality = self._stage.model.vis.quality
        quality.shadowsize = FILM_SHADOW_PX
        quality.numslices, quality.numstacks, quality.numquads = FILM_SLICES, FILM_STACKS, FILM_QUADS
        self._shadows, self._thin = shadows, thin
        self._own: tuple[Stage, StillView] | None = None
        self._views: dict[str, StillView] = {}

    @property
    def cameras(self) -> list[str]:
        """Names of the cameras that pictures can be taken from."""
        return [self._stage.model.camera(i).name for i in range(self._stage.model.ncam)]

    def picture(self, camera: str, width: int, height: int, t: float, T_world_target: Array, q: Array, T_world_camera: Array) -> Image:
        """One picture (H, W, 3) uint8; the servo camera `eye` has its own size and lens, whatever width and height say.

        Raises:
            ParameterError: there is no such camera.
        """
        if camera not in self.cameras:
            raise ParameterError("--camera", f"must be one of {', '.join(self.cameras)}", camera)
        if camera == "eye":
            stage, view = self._servo_camera()
            stage.place(t, T_world_target, q, T_world_camera)
            return view.full_image()
        if camera not in self._views:
            view = outside_view(self._stage, camera, width, height, self._parts.camera, self._shadows)
            model, data = self._stage.model, self._stage.data
            f = height / (2 * math.tan(math.radians(float(model.camera(camera).fovy[0])) / 2))
            self._views[camera] = StillView(view, model, data, camera, f)
        self._stage.place(t, T_world_target, q, T_world_camera)
        return self._views[camera].full_image()

    def _servo_camera(self) -> tuple[Stage, StillView]:
        """A second stage with the servo camera's own quality, built when first asked for."""
        if self._own is None:
            lens = self._parts.camera
            stage = Stage(self._parts, samples=lens.multisampling)
            view = StillView(servo_renderer(stage, lens, thin=self._thin), stage.model, stage.data, "eye", pixels_per_radian(lens))
            self._own = stage, view
        return self._own

    def close(self) -> None:
        """Free the OpenGL contexts."""
        self._stage.close()
        if self._own is not None:
            self._own[0].close()
