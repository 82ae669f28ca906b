"""Frame: what one turn of the loop leaves, for the log, the task's monitor and whoever looks on."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from vstestbed.camera import Image
from vstestbed.core.geometry import Array, all_finite
from vstestbed.features.observation import Goal, Observation
from vstestbed.laws import Command
from vstestbed.robots import Allocation
from vstestbed.sim.base import Truth


@dataclass(frozen=True, slots=True)
class FrameTiming:
    """When things happened.

    Attributes:
        number: counts frames from 0. t: time of exposure [s]. t_cmd: when the command made of it reaches the robot [s].
    """

    number: int
    t: float
    t_cmd: float


@dataclass(frozen=True, slots=True)
class ImageError:
    """The error in the image.

    Attributes:
        lost: the law had nothing to go by. all_seen: every marker that counts is seen.
        rms_px: RMS over the coordinates seen of goal minus measured [px], NaN when lost.
    """

    lost: bool
    all_seen: bool
    rms_px: float

    @classmethod
    def of(cls, seen: Observation, goal: Goal, rest_reason: str) -> ImageError:
        """The error of an observation against the goal; rest_reason: why the law orders rest ("" while it works)."""
        error = seen.uv - goal.uv
        all_seen = all_finite(error)
        if not all_seen:
            error = error[seen.seen]
            all_seen = goal.counted is not None and bool(seen.seen[goal.counted].all())
        lost = bool(rest_reason) or not error.size  # a law may order motion although it sees nothing
        return cls(lost, all_seen, math.nan if lost else math.sqrt(float(np.vdot(error, error)) / error.size))


@dataclass(frozen=True, slots=True)
class Frame:
    """One frame: what was seen and measured, what was ordered, what was true at the time of exposure.

    Attributes:
        timing: number and times. observation: what the law was given. goal: what it was asked for (the reference).
        error: in the image. command: of the law. allocation: what the robot made of it.
        truth: for the log, the judge and the oracle, and for nothing else.
        image: the servo camera's own picture, (H, W, 3) uint8 RGB (it holds until the next frame); None where none was taken,
            or not the whole of it.
        row: values of the columns that only this robot and this task have (`Scenario.own_columns`).
    """

    timing: FrameTiming
    observation: Observation
    goal: Goal
    error: ImageError
    command: Command
    allocation: Allocation
    truth: Truth
    image: Image | None
    row: Array

    @property
    def t(self) -> float:
        """Time of exposure [s]."""
        return self.timing.t

    def T_world_base(self, mount_inverse: Array) -> Array:
        """True pose of what carries the camera (4, 4), by the inverse of the camera's mount on it."""
        return self.truth.T_world_camera @ mount_inverse
