"""Cycle: one control step, from the picture to the order. Frame: the same with the truth, for the
log, the task's monitor and watchers.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from vstestbed.camera import DepthImage, Image
from vstestbed.core.geometry import Array
from vstestbed.core.outcome import Outcome, Verdict
from vstestbed.features.observation import Goal, Observation
from vstestbed.laws import Command
from vstestbed.robots import Allocation
from vstestbed.robots.allocation import Order
from vstestbed.sim.base import Truth

__all__ = ["CameraRecord", "Cycle", "Frame", "FrameTiming", "ImageError"]


class FrameTiming(NamedTuple):
    """Times of one frame.

    Attributes:
        number: counts frames from 0.
        t: time of exposure [s]; in a cycle by the picture's stamp, in a frame the true one.
        t_cmd: when its command reaches the robot [s].
        own: values of the columns that only runs with errors of stamps and links have
            (`Timing.columns`); None without them.
    """

    number: int
    t: float
    t_cmd: float
    own: Mapping[str, float] | None = None


class ImageError(NamedTuple):
    """The image error of one frame.

    Attributes:
        lost: the law had no measurement to work with.
        all_seen: every marker that counts is seen.
        rms_px: RMS of goal minus measured over the coordinates seen [px], NaN when lost, and
            without markers.
    """

    lost: bool
    all_seen: bool
    rms_px: float

    @classmethod
    def of(
        cls, seen: Observation, goal: Goal, rest_reason: str, by_others: bool = False
    ) -> ImageError:
        """The error of what a picture itself shows against the goal; rest_reason: why the law
        commands rest ("" while it works). by_others: further cameras tell where markers are that
        the picture lacks, so that the law has a measurement.
        """
        error = seen.uv - goal.uv
        squares = float(np.vdot(error, error))
        all_seen = math.isfinite(squares)
        # the costlier masks only where something is missing: this runs for every frame
        if not all_seen:
            error = error[seen.seen]
            squares = float(np.vdot(error, error))
            all_seen = goal.counted is not None and bool(seen.seen[goal.counted].all())
        # A law may command motion although it sees nothing (coasting), and one that works on whole
        # pictures needs no marker.
        lost = bool(rest_reason) or not (error.size or seen.image is not None or by_others)
        if lost or not error.size:
            return cls(lost, all_seen, math.nan)
        return cls(lost, all_seen, math.sqrt(squares / error.size))


@dataclass(frozen=True, slots=True)
class Cycle:
    """One control step of a robot: measurement, reference, command. It holds what a real robot
    knows, and nothing else.

    Attributes:
        timing: number and times.
        observation: the law's measurement.
        goal: its reference.
        error: in the image.
        command: of the law.
        allocation: the command within the robot's limits, whatever is ordered.
        order: what the robot is ordered: that, or what its supervisor has put in its place.
        notes: what was unusual about the picture's time, or that pictures do not change, in words
            (`Controller.step`).
    """

    timing: FrameTiming
    observation: Observation
    goal: Goal
    error: ImageError
    command: Command
    allocation: Allocation
    order: Order = field(kw_only=True)
    notes: tuple[str, ...] = field(default=(), kw_only=True)

    @property
    def t(self) -> float:
        """Time of exposure [s]."""
        return self.timing.t

    @property
    def twist(self) -> Array:
        """The camera twist (6,) that is ordered, (v, w) in the camera frame, within the robot's
        limits [m/s, rad/s]; of a stop zero.
        """
        return self.order.twist

    @property
    def setpoint(self) -> Array:
        """What goes to the actuators or the onboard controller (joint velocities [rad/s], a twist);
        of a stop the robot's rest.
        """
        return self.order.setpoint

    @property
    def stopped(self) -> bool:
        """Whether the order is a stop; why, `reason` says."""
        return self.order.stopped

    @property
    def reason(self) -> str:
        """Why the robot stops, or has another velocity than the law's;
        "" while it follows the law.
        """
        return self.order.reason

    @property
    def latched(self) -> bool:
        """Whether nothing but `Controller.reset` gives the robot back to the law."""
        return self.order.latched


class CameraRecord(NamedTuple):
    """What a further camera showed last, for the log and for films.

    Attributes:
        t: time of its exposure [s].
        uv, depth: markers as measured (N, 2) [px], (N,) [m].
        goal_uv: where the law wants them in its picture (N, 2) [px], NaN where it wants them
            nowhere.
        p_camera: true markers in its frame then (N, 3) [m].
        T_world_camera: its true pose then (4, 4).
        image: its picture (H, W, 3) uint8 RGB, valid until its next one; None where none was taken,
            or only part of it drawn.
    """

    t: float
    uv: Array
    depth: Array
    goal_uv: Array
    p_camera: Array
    T_world_camera: Array
    image: Image | None


@dataclass(frozen=True, slots=True)
class Frame(Cycle):
    """One control step with the truth at the time of exposure.

    Attributes:
        truth: for the log, the judge and the oracle, and for nothing else.
        image: the servo camera's own picture, (H, W, 3) uint8 RGB, valid until the next frame; None
            where none was taken, or only part of it drawn.
        row: values of the columns that only this robot and this task have (`Scenario.own_columns`).
        verdict: how the run ended with this frame, and why; None while it goes on.
        depth_image: what the depth camera measured (H, W) [m], NaN in its holes; None without one.
        cameras: what each further camera showed last, by name; none of one that has not taken a
            picture yet.
    """

    truth: Truth
    image: Image | None
    row: Array
    verdict: Verdict | None = field(default=None, kw_only=True)
    depth_image: DepthImage | None = field(default=None, kw_only=True)
    cameras: Mapping[str, CameraRecord] = field(
        default_factory=dict[str, CameraRecord], kw_only=True
    )

    def protected(self) -> Frame:
        """The same frame with its arrays read-only, but for the picture: the log keeps them, and
        who wrote to one would change a row.
        """
        values = [*self.order, *self.truth, self.row]
        for part in (self.observation, self.goal, self.command, self.allocation):
            values += [getattr(part, name) for name in part.__dataclass_fields__]
        for value in values:
            if isinstance(value, np.ndarray):
                value.setflags(write=False)
        return self

    @property
    def outcome(self) -> Outcome | None:
        """How the run ended with this frame; None while it goes on."""
        return self.verdict[0] if self.verdict else None

    def T_world_base(self, mount_inverse: Array) -> Array:
        """True pose (4, 4) of the base that carries the camera; mount_inverse: T_camera_base (4,
        4).
        """
        return self.truth.T_world_camera @ mount_inverse
