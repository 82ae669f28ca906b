"""The ideal plant: a camera that follows its twist exactly. It needs MuJoCo only for pictures and occlusion."""

from __future__ import annotations

import math

import numpy as np

from vstestbed.camera import Look, Picture
from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array, adjoint, exp, inverse
from vstestbed.imaging.shutter import Contribution
from vstestbed.robots.base import Reading
from vstestbed.sim.base import Truth
from vstestbed.sim.gl_probe import may_end_here
from vstestbed.sim.hands import hold_plate, moved_path
from vstestbed.sim.render.image_sensor import ImageSensor
from vstestbed.sim.scene.compose import Parts
from vstestbed.sim.scene.stage import Stage
from vstestbed.targets.motion import Path
from vstestbed.timing.setpoints import Interpolation, Orders, Stop

NONE, STILL_AIR = np.zeros(0), np.zeros(3)
NO_JOINTS = Reading(NONE, NONE)


class IdealPlant:
    """T_world_camera <- T_world_camera exp([v] dt), v the camera's twist for the flange twist in force, the setpoint.

    Args:
        parts: of the scene. steps_per_frame: physics steps between pictures.
        stage: for pictures and occlusion; None without both. eye: takes the pictures; None where no detector needs them.
        path: the target's pose as a function of time; None for one that stands still.
        order_s: how long a setpoint lasts before the camera stops [s]. led: how it goes from one setpoint to the next; None: at once.
    """

    def __init__(
        self,
        parts: Parts,
        steps_per_frame: int,
        stage: Stage | None = None,
        eye: ImageSensor | None = None,
        path: Path | None = None,
        order_s: float = math.inf,
        led: Interpolation | None = None,
    ):
        self._path, self._parts = path, parts
        self.step_s, self.steps_per_frame = parts.step, steps_per_frame
        self._T = parts.start[1]
        self._to_camera = adjoint(inverse(parts.camera.mount.T))
        self._T_world_target = parts.target.pose.T
        self._T_target_world = inverse(self._T_world_target)
        self._target = parts.target
        self._stage, self._eye = stage, eye
        self._twist = np.zeros(6)
        self._followed: Array | None = None
        self._steps = 0
        self._orders = Orders(parts.robot.stopping, None, order_s / parts.step, parts.step, led)
        self._hidden = np.zeros(len(self._target.points), dtype=bool)

    @property
    def render_s(self) -> float:
        """Wall time spent on pictures so far [s]."""
        return self._eye.spent_s if self._eye else 0.0

    def capture(self, look: Look | None = None) -> tuple[Picture | None, Truth]:
        """The picture, where a detector needs one, and the truth."""
        truth = self.truth()
        return self._eye.capture(self._t, look) if self._eye else None, truth

    @property
    def _t(self) -> float:
        return self._steps * self.step_s

    def _move_target(self) -> None:
        if self._path is not None:
            self._T_world_target = self._path(self._t)
            self._T_target_world = inverse(self._T_world_target)

    def truth(self) -> Truth:
        """The truth, now; it also updates the stage, from which pictures are taken."""
        T = self._T  # never written to: `advance` makes a new one
        self._move_target()
        p_camera = self._target.seen_from(self._T_target_world @ T)
        hidden = self._hidden
        if self._stage is not None:
            # Before the cast of rays, and before the picture that `capture` takes next.
            self._stage.place(self._t, self._T_world_target, NONE, T)
            hidden = self._stage.hidden(T, p_camera)
        return Truth(
            T, self._T_world_target, self._twist, NONE, NONE, NONE, p_camera, hidden, contact="", feet="", act=NONE, wind=STILL_AIR
        )

    def names_before(self, T_world_camera: Array, p_camera: Array) -> tuple[str, ...]:
        """What stands now before each of points (N, 3); nothing where there is no scene."""
        return self._stage.names_before(T_world_camera, p_camera) if self._stage else ("",) * len(p_camera)

    def with_own(self, picture: Picture) -> Picture:
        """A picture just taken with the camera's own image, where it has none."""
        return self._eye.with_own(picture) if self._eye else picture

    def picture_from(self, T_world_flange: Array, q: Array | None = None) -> Picture:
        """A whole picture without noise with the flange at another pose (4, 4)."""
        assert self._stage is not None and self._eye is not None
        with self._stage.kept():
            self._stage.place(self._t, self._T_world_target, NONE, T_world_flange @ self._parts.camera.mount.T)
            return self._eye.clean(self._t)

    def exposure_s(self) -> float | None:
        """Exposure time of the next picture [s], as the camera will have it; None where no detector needs pictures."""
        self._show()
        return self._eye.exposure_s(self._t) if self._eye else None

    def _show(self) -> None:
        """Bring the stage, from which pictures are taken, to the present time."""
        self._move_target()
        if self._stage is not None:
            self._stage.place(self._t, self._T_world_target, NONE, self._T)

    def expose(self, weight: float | Contribution, look: Look | None = None, middle: bool = False) -> None:
        """Add an image of the exposure, where a detector needs pictures."""
        self._show()
        if self._eye is not None:
            self._eye.expose(weight, look, middle)

    def developed(self, t: float) -> Picture | None:
        """The picture of all images added since the last one."""
        return self._eye.developed(t) if self._eye else None

    def reading(self) -> Reading:
        """No joints."""
        return NO_JOINTS

    def apply(self, setpoint: Array, stop: Stop = "") -> None:
        """Set the twist (6,) of the flange, or a stop in its place."""
        self._orders.give(self._steps, setpoint, stop)
        self._actuate()

    def _actuate(self) -> None:
        """The setpoint in force becomes the camera's twist."""
        setpoint = self._orders.at(self._steps)
        if setpoint is not None and setpoint is not self._followed:
            self._followed, self._twist = setpoint, self._to_camera @ setpoint

    def advance(self, steps: int) -> bool:
        """Advance by exact exponentials: no integration error, however many steps each stands for. False beyond all numbers."""
        may_end_here()
        end = self._steps + steps
        while self._steps < end:
            ahead = self._orders.unchanged(self._steps, end - self._steps)
            try:
                self._T = self._T @ exp(self._twist * (ahead * self.step_s))
            except (ValueError, OverflowError):  # a twist so large that its square overflows
                return False
            self._steps += ahead
            self._actuate()
        return True

    @property
    def weight_n(self) -> float:
        """An ideal camera has no mass."""
        return 0.0

    def push(self, force: Array, duration_s: float) -> None:
        """Refused: an ideal camera has no mass."""
        raise ParameterError("push", "needs a robot with a mass; this camera follows its twist exactly")

    def move_target(self, T_world_target: Array) -> None:
        """Put the target at a pose (4, 4); one that moves goes on from there."""
        self._path = moved_path(self._path, self._parts, self._t, T_world_target)

    def hold_plate(self, T_world_plate: Array | None) -> None:
        """Put the plate in reserve at a pose (4, 4), or away."""
        hold_plate(self._stage, T_world_plate)

    def close(self) -> None:
        """Free the pictures."""
        if self._stage is not None:
            self._stage.close()
