"""What a person does to a scene while it is simulated: pushes the robot, moves the target, holds a plate into the view."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array, inverse, quaternion_wxyz
from vstestbed.sim.scene.compose import Parts
from vstestbed.sim.scene.stage import Stage
from vstestbed.sim.scene.world import AWAY
from vstestbed.targets.motion import Path

LONGEST_PUSH_S = 10.0


def moved_path(path: Path | None, parts: Parts, t: float, T_world_target: Array) -> Path:
    """The target's path, displaced as a whole so that at time t [s] it is at T_world_target (4, 4).

    path: the path so far; None for a target that stands still. parts: of the scene. Raises ParameterError: a vehicle or the robot's gripper
    carries the target.
    """
    if parts.target.on_gripper or parts.leader is not None:
        raise ParameterError("target", "is carried, and goes where its carrier goes")
    own = path.own if isinstance(path, Displaced) else path or (lambda _: parts.T_world_target)
    return Displaced(own, T_world_target @ inverse(own(t)))


@dataclass(frozen=True)
class Displaced:
    """A path that is moved as a whole: shift (4, 4) times its own pose."""

    own: Path
    shift: Array

    def __call__(self, t: float) -> Array:
        """The pose (4, 4) at a time [s]."""
        return self.shift @ self.own(t)


def hold_plate(stage: Stage | None, T_world_plate: Array | None) -> None:
    """Put the plate in reserve at a pose (4, 4), or away. Raises ParameterError: the scene has none."""
    if stage is None or stage.hand_plate is None:
        raise ParameterError("plate", "is not in this scene; a session has one with plate_m=0.1")
    T = np.eye(4) if T_world_plate is None else T_world_plate
    stage.data.mocap_pos[stage.hand_plate] = AWAY if T_world_plate is None else T[:3, 3]
    stage.data.mocap_quat[stage.hand_plate] = quaternion_wxyz(T[:3, :3])


class Push:
    """A force on the body that carries the camera, or the target in the gripper, for a while.

    stage: the scene of a robot that has a mass.
    """

    def __init__(self, stage: Stage):
        self._force = stage.data.xfrc_applied[stage.flange_body]
        self._until = 0
        self.acts = False

    def begin(self, force: Array, step: int, duration_s: float, step_s: float) -> None:
        """Push with a force (3,) along world axes [N] from a physics step on; it replaces one that still acts.

        Raises ParameterError: a force that is not three finite numbers, a duration that is not positive or more than 10 s.
        """
        given = np.asarray(force, dtype=float)
        if given.shape != (3,) or not np.isfinite(given).all():
            raise ParameterError("force", "must be three finite numbers [N]", force)
        if not (math.isfinite(duration_s) and 0 < duration_s <= LONGEST_PUSH_S):
            raise ParameterError("duration_s", f"must be more than 0 and at most {LONGEST_PUSH_S:g} s", duration_s)
        self._force[:3] = given
        self._until, self.acts = step + max(1, round(duration_s / step_s)), True

    def ahead(self, step: int, steps: int) -> int:
        """Of so many physics steps, those until it ends; it ends when its time is over."""
        if step >= self._until:
            self._force[:3], self.acts = 0.0, False
            return steps
        return min(steps, self._until - step)
