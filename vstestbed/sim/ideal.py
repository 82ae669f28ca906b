"""The ideal plant: a camera that follows its twist exactly. It needs MuJoCo only for pictures and occlusion."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from vstestbed.camera import Picture
from vstestbed.core.geometry import Array, adjoint, exp, inverse
from vstestbed.robots.base import Reading
from vstestbed.sim.base import Plant, SceneDescription, Truth, Viewpoint
from vstestbed.targets.motion import Path
from vstestbed.timing.setpoints import Interpolator

if TYPE_CHECKING:
    from vstestbed.sim.render.image_sensor import ImageSensor
    from vstestbed.sim.scene.scene import Scene

NONE, STILL_AIR = np.zeros(0), np.zeros(3)
NO_JOINTS = Reading(NONE, NONE)


class IdealPlant(Plant):
    """T_world_camera <- T_world_camera exp([v] dt), v the camera's twist for the flange twist in force, the setpoint."""

    def __init__(
        self,
        parts: SceneDescription,
        steps_per_frame: int,
        stage: Scene | None,
        eye: ImageSensor | None,
        path: Path | None,
        order_s: float,
        interpolator: Interpolator | None,
    ):
        super().__init__(parts, steps_per_frame, stage, eye, path, order_s, interpolator)
        self._T = parts.start[1]
        self._T_camera_flange = inverse(parts.camera.mount.T)
        self._to_camera = adjoint(self._T_camera_flange)
        self._T_world_target = parts.target.pose.T
        self._T_target_world = inverse(self._T_world_target)
        self._twist = np.zeros(6)
        self._followed: Array | None = None
        self._hidden = np.zeros(len(self._target.points), dtype=bool)

    def truth(self) -> Truth:
        """The truth, now; it also updates the stage, from which pictures are taken."""
        T = self._T  # never written to: `advance` makes a new one
        self._show()  # before the cast of rays, and before the picture that `capture` takes next
        p_camera = self._target.seen_from(self._T_target_world @ T)
        hidden = self._hidden if self._stage is None else self._stage.hidden(T, p_camera)
        return Truth(
            T, self._T_world_target, self._twist, NONE, NONE, NONE, p_camera, hidden, contact="", feet="", act=NONE, wind=STILL_AIR
        )

    def picture_from(self, T_world_flange: Array, q: Array | None = None) -> Picture:
        """A whole picture without noise with the flange at another pose (4, 4)."""
        assert self._stage is not None and self._eye is not None
        with self._stage.kept():
            self._stage.place(self._t, self._T_world_target, NONE, T_world_flange @ self._parts.camera.mount.T)
            return self._eye.clean(self._t)

    def pose_of(self, viewpoint: Viewpoint) -> Array:
        """Pose (4, 4) of a further camera, now."""
        return viewpoint.pose(self._T @ self._T_camera_flange)

    def _show(self) -> None:
        if self._path is not None:
            self._T_world_target = self._path(self._t)
            self._T_target_world = inverse(self._T_world_target)
        if self._stage is not None:
            self._stage.place(self._t, self._T_world_target, NONE, self._T)

    def reading(self) -> Reading:
        return NO_JOINTS

    def _actuate(self) -> None:
        setpoint = self._setpoints.at(self._steps)
        if setpoint is not None and setpoint is not self._followed:
            self._followed, self._twist = setpoint, self._to_camera @ setpoint

    def advance(self, steps: int) -> bool:
        """Advance by exact exponentials: no integration error, however many steps each stands for. False beyond all numbers."""
        end = self._steps + steps
        while self._steps < end:
            ahead = self._setpoints.unchanged(self._steps, end - self._steps)
            try:
                self._T = self._T @ exp(self._twist * (ahead * self.step_s))
            except (ValueError, OverflowError):  # a twist so large that its square overflows
                return False
            self._steps += ahead
            self._actuate()
        return True
