"""The contract of a term that may end a run, frame by frame or as arrays over many ideal runs."""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vstestbed.core.geometry import Array
from vstestbed.core.outcome import Outcome, Verdict
from vstestbed.tasks.frame import Frame
from vstestbed.tasks.monitor import Setup

NEVER = sys.maxsize // 2  # more frames than any run has


class Ending:
    """A term. Every frame is given to it, whichever term decides: some measure durations.

    Each run makes its own. One that also judges arrays of runs names its `outcome`, and overrides
    `over`.
    """

    outcome: ClassVar[Outcome | None] = None

    def update(self, frame: Frame) -> Verdict | None:
        """The outcome with its reason, if this frame ends the run; None to go on."""
        return None

    @staticmethod
    def over(runs: IdealRuns, limits: FrameLimits) -> NDArray[np.bool_]:
        """Which of m runs end so with this frame (m,)."""
        raise NotImplementedError


class FrameLimits(NamedTuple):
    """The limits of a run, counted in frames.

    Attributes:
        last: number of the last frame. hold, rest, lost: how many frames in turn at the goal reach
            it, how many at rest elsewhere are a local minimum, and how many without a measurement
            lose the target. lost_m: way [m] without one that loses it.
        one_sided: whether a camera behind its target has lost it.
    """

    last: int
    hold: int
    rest: int
    lost: int
    lost_m: float
    one_sided: bool

    @classmethod
    def of(cls, setup: Setup) -> FrameLimits:
        """Those of an experiment."""
        stop = setup.stop
        rate_hz = setup.camera.rate_hz
        lost_s, lost_m = stop.lost_after
        return cls(
            last=frames(stop.duration_s, rate_hz),
            hold=frames(stop.converged.hold_s, rate_hz),
            rest=frames(stop.rest_after, rate_hz),
            lost=frames(lost_s, rate_hz),
            lost_m=lost_m,
            one_sided=face_can_be_lost(setup),
        )


@dataclass
class IdealRuns:
    """m ideal runs side by side, in one frame.

    Attributes:
        frame: its number (m,). near, rest, blind: for how many frames in turn they have been at the
            goal, at rest elsewhere, and without a measurement (m,). blind_m: way of the camera
            without one (m,) [m].
        T_camera_target: poses (m, 4, 4). failed: whether the law has failed (m,).
    """

    frame: NDArray[np.int_]
    near: NDArray[np.int_]
    rest: NDArray[np.int_]
    blind: NDArray[np.int_]
    blind_m: Array
    T_camera_target: Array
    failed: NDArray[np.bool_]


def frames(duration_s: float, rate_hz: float) -> int:
    """Number of frames after which a time [s] has passed, as single runs compare times."""
    if math.isinf(duration_s):
        return NEVER
    # 1 ns as of single runs; and a product of times and rates may miss a whole number by a rounding
    return max(0, math.ceil((duration_s - 1e-9) * rate_hz - 1e-9))


def face_can_be_lost(setup: Setup) -> bool:
    """Whether a camera behind its target has lost it. Where no loss ends a run it may go there."""
    return setup.target.one_sided and setup.stop.loss_ends
