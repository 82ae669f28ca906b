"""The servo camera's pictures of a recorded run, taken again at its own size, without physics."""

from __future__ import annotations

import numpy as np

from vstestbed.camera import Camera, Image
from vstestbed.core.geometry import Array
from vstestbed.robots import Robot
from vstestbed.sim.render.image_sensor import ImageSensor
from vstestbed.sim.render.imaging import imaging_of
from vstestbed.sim.render.noise import NO_DRIFT, Drift, ImageNoise
from vstestbed.sim.render.pictures import servo_renderer
from vstestbed.sim.scene.compose import Parts
from vstestbed.sim.scene.stage import Stage
from vstestbed.sim.scene.world import World
from vstestbed.targets.base import Target


class Retake:
    """Takes the servo camera's pictures of a recorded run again, each drawn anew, in the order in which the run took them.

    A picture is of the instant of its time stamp: it lacks the motion blur of an exposure (`timing.exposure_s`), the skew of a rolling
    shutter (`camera.readout_s`) and the flicker of the light. Noise and drift are those of the run, whose generator draws once for each
    picture; lens, exposure, sensor and stream likewise.

    Args:
        robot, camera, target, world: the scene.
        image_sigma, rng: noise of the pictures [grey levels] and its generator as at the beginning of the run. drift: of its gains.
        imaging_rng: generator of the image sensor's noise, likewise.

    Raises:
        EnvironmentLackError: a picture is needed that only OpenGL can draw, and it does not work here.
    """

    def __init__(
        self,
        robot: Robot,
        camera: Camera,
        target: Target,
        world: World,
        image_sigma: float = 0.0,
        rng: np.random.Generator | None = None,
        drift: Drift = NO_DRIFT,
        imaging_rng: np.random.Generator | None = None,
    ):
        self._stage = Stage(Parts(robot, camera, target, world, step=camera.period), samples=camera.multisampling)
        drawn_by, noise = servo_renderer(self._stage, camera, image_sigma > 0), ImageNoise(image_sigma, rng)
        self._sensor = ImageSensor(self._stage, drawn_by, noise, drift, imaging=imaging_of(camera, imaging_rng))

    def picture(self, t: float, T_world_target: Array, q: Array, T_world_camera: Array) -> Image:
        """The picture of a state at a time [s], (H, W, 3) uint8 RGB; a copy."""
        self._stage.place(t, T_world_target, q, T_world_camera)
        image = self._sensor.with_own(self._sensor.capture(t)).image
        assert image is not None  # whole, and with the own image of a lens that has panels
        return image.copy()

    @property
    def body_names(self) -> list[str]:
        """Names of all bodies, by number."""
        return self._stage.body_names

    @property
    def body_poses(self) -> tuple[Array, Array]:
        """Positions (B, 3) [m] and quaternions (B, 4), wxyz, of all bodies in the last picture; valid until the next one."""
        return self._stage.body_poses

    def close(self) -> None:
        """Free the OpenGL context."""
        self._stage.close()
