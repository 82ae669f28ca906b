"""Frame: the record of one cycle of the loop, for the log, the task's monitor and watchers."""

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
    """Times of one frame.

    Attributes:
        number: counts frames from 0. t: time of exposure [s]. t_cmd: when its command reaches the robot [s].
    """

    number: int
    t: float
    t_cmd: float


@dataclass(frozen=True, slots=True)
class ImageError:
    """The image error of one frame.

    Attributes:
        lost: the law had no measurement to work with. all_seen: every marker that counts is seen.
        rms_px: RMS of goal minus measured over the coordinates seen [px], NaN when lost.
    """

    lost: bool
    all_seen: bool
    rms_px: float

    @classmethod
    def of(cls, seen: Observation, goal: Goal, rest_reason: str) -> ImageError:
        """The error of an observation against the goal; rest_reason: why the law commands rest ("" while it works)."""
        error = seen.uv - goal.uv
        all_seen = all_finite(error)
        if not all_seen:  # the costlier masks only where something is missing: this runs for every frame
            error = error[seen.seen]
            all_seen = goal.counted is not None and bool(seen.seen[goal.counted].all())
        lost = bool(rest_reason) or not error.size  # a law may command motion although it sees nothing (coasting)
        return cls(lost, all_seen, math.nan if lost else math.sqrt(float(np.vdot(error, error)) / error.size))


@dataclass(frozen=True, slots=True)
class Frame:
    """One frame: measurement, reference, command, and the truth at the time of exposure.

    Attributes:
        timing: number and times. observation: the law's measurement. goal: its reference.
        error: in the image. command: of the law. allocation: the command within the robot's limits.
        truth: for the log, the judge and the oracle, and for nothing else.
        image: the servo camera's own picture, (H, W, 3) uint8 RGB, valid until the next frame; None where none was taken, or only
            part of it drawn.
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
        """True pose (4, 4) of the base that carries the camera; mount_inverse: T_camera_base (4, 4)."""
        return self.truth.T_world_camera @ mount_inverse
