"""The error by which a task is judged: its value at the end of a run, its limit, who measured it,
and what a step is worth by it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, get_args

import numpy as np

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array
from vstestbed.tasks.stop import Converged, Stop

__all__ = [
    "MEASURED_BY",
    "JudgedError",
    "Log",
    "Reward",
    "RewardKind",
    "at_the_end",
    "at_worst",
    "by_convergence",
    "in_a_frame",
    "in_words_unit",
    "largest",
    "nearness",
    "potential",
]

Log = Mapping[str, Array]  # the columns of a log by name, shape (frames,) each
By = Literal["pixels", "level pixels", "grey levels", "estimate", "truth"]
MEASURED_BY: dict[By, str] = {
    "pixels": "measured pixels",
    "level pixels": "measured pixels after derotation",
    "grey levels": "the difference of the pictures",
    "estimate": "the robot's own estimate",
    "truth": "the simulator's truth",
}
"""The same in words; level pixels are those of a craft that tilts."""


def in_words_unit(value: float, unit: str) -> tuple[float, str]:
    """A value and its unit as people read it: angles in degrees, as in scenarios."""
    return (math.degrees(value), "deg") if unit == "rad" else (value, unit)


Unit = Literal["px", "grey levels", "m", "rad", "m/s"]


class JudgedError(NamedTuple):
    """The error that decides a task.

    Attributes:
        value: at the end of the run, in `unit`; NaN where it is unknown.
        unit: px, grey levels, m, rad, or m/s (the speed of a touch-down).
        limit: the task is reached under it.
        by: who measured it.
    """

    value: float
    unit: Unit
    limit: float
    by: By

    def summary(self) -> dict[str, object]:
        """Its entries in `summary.json`."""
        value = self.value if math.isfinite(self.value) else None
        return {
            "judged_error": value,
            "judged_unit": self.unit,
            "judged_limit": self.limit,
            "judged_by": self.by,
        }


def by_convergence(log: Log, converged: Converged) -> JudgedError:
    """The error that `stop.converged` tests at the end of a run; of several, the one that is
    largest compared with its limit.
    """
    angle = converged.rotation_deg
    conditions: list[tuple[float | None, str, Unit, By]] = [
        (converged.error_grey, "error_grey", "grey levels", "grey levels"),
        (converged.position_m, "est_position_m", "m", "estimate"),
        (None if angle is None else math.radians(angle), "est_rotation_rad", "rad", "estimate"),
    ]
    if "level_error_px" in log:
        conditions.insert(0, (converged.error_px, "level_error_px", "px", "level pixels"))
    else:
        conditions.insert(0, (converged.error_px, "error_px", "px", "pixels"))
    found = []
    for limit, column, unit, by in conditions:
        if limit is not None:
            found.append(JudgedError(_last(log, column), unit, limit, by))
    return largest(found)


def largest(errors: Iterable[JudgedError]) -> JudgedError:
    """The error that is largest compared with its limit; an unknown one comes first: no task is
    done with it.
    """
    return max(errors, key=lambda e: math.inf if math.isnan(e.value) else e.value / e.limit)


def at_worst(log: Log, column: str, limit: float, settle_s: float) -> JudgedError:
    """The largest magnitude of a true error [m] from settle_s [s] on."""
    settled = np.abs(log[column][log["t"] >= settle_s])
    return JudgedError(float(settled.max()) if len(settled) else math.nan, "m", limit, "truth")


def at_the_end(log: Log, column: str, limit: float, unit: Literal["m", "m/s"] = "m") -> JudgedError:
    """A true error in the last frame."""
    return JudgedError(_last(log, column), unit, limit, "truth")


def in_a_frame(
    judged: Callable[[Log, Stop], JudgedError],
    stop: Stop,
    values: Mapping[str, float],
) -> JudgedError:
    """The error by which a task is judged, in one frame; judged: `Task.judged`. values: `error_px`
    and the task's own columns.
    """
    # A continuing task is judged by its error once settled: at t = inf it is that of this frame.
    frame = {name: np.array([value]) for name, value in values.items()}
    return judged(frame | {"t": np.array([np.inf])}, stop)


def _last(log: Log, column: str) -> float:
    return float(log[column][-1]) if len(log["t"]) else math.nan


# What a step of a run is worth to a learner: potentials by the judged error, and rewards by their
# differences.
RewardKind = Literal["potential", "negative_error", "sparse"]
# an error of so many times its limit, or more, or unknown, is the worst (2000 px where .2 px are
# the goal)
WORST = 1e4


def potential(error: JudgedError, view: int = 0, views: int = 1) -> float:
    """How near a task is to its goal, phi in [0, 1]: 1 at no error, 0 at the worst, or where the
    error is unknown (markers lost).

        nearness = 1 - ln(1 + |error| / limit) / ln(1 + WORST),  phi = (view + nearness) / views

    Logarithmic: to halve the error has the same worth at 100 px as at 1 px, and pixels, metres and
    radians are on one scale.
    """
    return float(view + nearness(error.value, error.limit)) / views


def nearness(error: Any, limit: float) -> Any:
    """1 at no error, 0 at the worst, or where it is unknown (NaN); errors may be an array."""
    ratio = np.fmin(np.abs(error) / limit, WORST)  # the other one of NaN and a number
    return 1.0 - np.log1p(ratio) / math.log1p(WORST)


@dataclass(frozen=True)
class Reward:
    """What a step is worth.

    `potential`: discount phi' - phi, and `success_bonus` at a success. After the end (termination,
    not truncation) phi' is 0, so that the sum of the differences depends on the start alone, and
    the best policy is that of the bonus alone, at a learner's discount equal to this one.
    `negative_error`: phi' - 1 in [-1, 0] at every step, and the bonus. An end that is no success is
    charged with the worst error in all n steps that were left, -(discount + ... + discount^n):
    without this, to give up would cost less than to go to the goal. `sparse`: the bonus alone.

    kind: which of them. discount: gamma, in (0, 1]. success_bonus: reward of a success.
    Raises ParameterError: another kind, a discount out of its range, a bonus that is not finite.

    Reference: Ng, Harada & Russell 1999, "Policy invariance under reward transformations: theory
    and application to reward shaping", ICML, pp. 278-287; that phi must be 0 after the end: Grzes
    2017, "Reward shaping in episodic reinforcement learning", AAMAS, pp. 565-573; that an end must
    be worth what an absorbing state in its place would be: Kostrikov, Agrawal, Dwibedi, Levine &
    Tompson 2019, "Discriminator-actor-critic: addressing sample inefficiency and reward bias in
    adversarial imitation learning", ICLR.
    """

    kind: RewardKind
    discount: float = 0.99
    success_bonus: float = 10.0

    def __post_init__(self) -> None:
        if self.kind not in get_args(RewardKind):
            raise ParameterError.choice("reward", get_args(RewardKind), self.kind)
        if not 0 < self.discount <= 1:
            raise ParameterError.bound("discount", "over", "0 and at most 1", self.discount)
        if not math.isfinite(self.success_bonus):
            raise ParameterError.infinite("success_bonus", self.success_bonus)

    def of_step(self, before: Any, after: Any, terminated: Any, success: Any, left: Any = 0) -> Any:
        """The reward of a step between two potentials; of many steps by arrays.
        terminated: the episode has ended, and not by the clock. left: how many steps the episode
        would still have had.
        """
        bonus = self.success_bonus * np.asarray(success)
        if self.kind == "sparse":
            return bonus
        if self.kind == "negative_error":
            # the sum g + ... + g^left: a reward of 1 in each of the steps that are left
            g = self.discount
            lost = 1.0 * left if g == 1 else g * -np.expm1(left * math.log(g)) / (1.0 - g)
            failed = np.logical_and(terminated, np.logical_not(success))
            return after - 1.0 + bonus - np.where(failed, lost, 0.0)
        return np.where(terminated, 0.0, self.discount * after) - before + bonus
