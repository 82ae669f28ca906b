"""Outcome monitors that a scenario adds to the loop's own (`monitors: [...]`): the referee's rules,
which may read the truth.
"""

from __future__ import annotations

import math
from collections import deque
from typing import Annotated, Literal, Protocol

import numpy as np
from annotated_types import Ge, Gt, Le

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import inverse, rigid_error
from vstestbed.core.outcome import Outcome, Verdict
from vstestbed.core.quantity import (
    Position,
    PositiveAngle,
    PositiveLength,
    PositivePixels,
    PositiveRateDeg,
    PositiveSpeed,
    PositiveTime,
    check_ordered,
)
from vstestbed.core.registry import Contract, Registry
from vstestbed.core.spec import spec
from vstestbed.endings.base import Ending
from vstestbed.tasks.frame import Frame
from vstestbed.tasks.monitor import Setup

Pictures = Annotated[int, Ge(1), Le(1_000_000)]
Share = Annotated[float, Gt(0), Le(1)]
Away = tuple[float, float]  # distance [m] and angle [rad] of the camera from its goal
EARLY_PICTURES = 10
"""In so many pictures in turn both errors must be under `early` of their limits: one alone may be
there on its way through.
"""

REST_PX = 0.3  # by which an error may grow while the camera rests [px]: noise
# a run comes nearer where the larger of both errors falls under this share of its smallest value so
# far
NEARER = 0.98


def away_from_goal(frame: Frame) -> Away:
    """True distance [m] and angle [rad] between the camera and its goal, the law's goal view of the
    target as it truly stands.
    """
    T_world_goal = frame.truth.T_world_target @ inverse(frame.goal.T_camera_target)
    return rigid_error(frame.truth.T_world_camera, T_world_goal)


def near_in_turn(share: float | None, near: float, before: int) -> int:
    """For how many pictures in turn both errors have been under a share of their limits; near: the
    larger one over its limit.
    """
    return before + 1 if share is not None and near < share else 0


@spec
class Settles:
    """The run ends when the commanded motion has died down, and has converged where both errors
    fell to a share of the start's.

    It has settled when, of the last two windows of pictures, the mean speed and the mean rate of
    the first are under their limits, and those of the second are no smaller. It has converged where
    distance and angle from the goal are both under `share` of the start's, or under `or_position_m`
    and `or_rotation_deg`. It has diverged beyond `diverged` times the start's distance. Where
    `stop.rest_after_s` is None, a run that rests elsewhere, or that is stuck, goes on.

    The defaults are the rule of ViT-VS (Scherl et al. 2025, arXiv:2503.04545) in the units of its
    paper, where a step takes a second: at R pictures a second, multiply `speed_mps` and
    `rate_degps` by R.

    Args:
        window: number of pictures in each of the two windows [1].
        speed_mps: mean speed under which the camera counts as still [m/s].
        rate_degps: mean rate under which the camera counts as still [deg/s].
        least: number of pictures before which no run has settled [1].
        most: number of pictures after which a run is judged as it is [1].
        share: of the start's distance and angle, within which the run has converged [1].
        or_position_m: distance from the goal that is near enough from any start, with
            or_rotation_deg [m]; None: none is; e.g. `0.01`.
        or_rotation_deg: the angle that goes with it [deg]; e.g. `1`.
        diverged: how many times the start's distance is too far [1].
        early: end a run as converged once both errors have been under this share of their limits
            for EARLY_PICTURES pictures in turn, also before it has settled [1]; None: never. It
            saves two thirds of their pictures; the errors at the end are then larger; e.g. `0.1`.
        stuck: end a run as not converged once the larger error, over its limit, has not been
            smaller than before for so many pictures [1]; None: never. A run that would have found
            its way later counts as lost then, so that it must be long; e.g. `400`.
    """

    kind: Literal["settles"] = "settles"
    window: Pictures = 100
    speed_mps: PositiveSpeed = 1e-3
    rate_degps: PositiveRateDeg = 0.1
    least: Pictures = 300
    most: Pictures = 1500
    share: Share = 0.1
    or_position_m: PositiveLength | None = None
    or_rotation_deg: PositiveAngle | None = None
    diverged: Annotated[float, Gt(1), Le(1000)] = 5.0
    early: Share | None = None
    stuck: Pictures | None = None

    def __post_init__(self) -> None:
        """Refuse half of the alternative, and an end before the beginning."""
        if (self.or_position_m is None) != (self.or_rotation_deg is None):
            lacking = "or_position_m" if self.or_position_m is None else "or_rotation_deg"
            why = "the alternative has a distance and an angle; give both, or neither"
            raise ParameterError.missing(lacking, why)
        check_ordered(self, "least", "most")

    def monitor(self, setup: Setup) -> _Settles:
        """By the true place of the camera and the commanded twist."""
        return _Settles(self, rest_ends=math.isfinite(setup.stop.rest_after))

    def near(self, away: Away, start: Away) -> float:
        """The larger of both errors, each over its limit; under 1 the run has converged."""
        shares = max(
            error / (self.share * max(first, 1e-12))
            for error, first in zip(away, start, strict=True)
        )
        if self.or_position_m is None or self.or_rotation_deg is None:
            return shares
        distance, angle = away
        other = max(distance / self.or_position_m, math.degrees(angle) / self.or_rotation_deg)
        return min(shares, other)


class _Settles:
    def __init__(self, rule: Settles, rest_ends: bool = True):
        self._rule = rule
        self._rest_ends = rest_ends
        self._early = 0
        self._nearest = math.inf
        self._since_nearer = 0
        self._speeds: deque[tuple[float, float]] = deque(maxlen=2 * rule.window)
        self._start: Away | None = None
        self._pictures = 0

    def update(self, frame: Frame) -> Verdict | None:
        rule = self._rule
        away = away_from_goal(frame)
        start = self._start = self._start or away
        self._pictures += 1
        v = frame.command.twist
        rate = math.degrees(float(np.linalg.norm(v[3:])))
        self._speeds.append((float(np.linalg.norm(v[:3])), rate))
        if away[0] > rule.diverged * start[0]:
            times = away[0] / max(start[0], 1e-12)
            return Outcome.diverged, f"{times:.1f} times as far from the goal as at the start"
        near = rule.near(away, start)
        self._early = near_in_turn(rule.early, near, self._early)
        if self._early >= EARLY_PICTURES:
            return Outcome.converged, self._words("within", near, "before it settled")
        if self._is_stuck(near):
            when = f"no nearer for {rule.stuck} pictures"
            return Outcome.timed_out, self._words("not within", near, when)
        if self._pictures >= rule.most or self._settled():
            return self._judged(near)
        return None

    def _is_stuck(self, near: float) -> bool:
        if near < NEARER * self._nearest:
            self._nearest = near
            self._since_nearer = 0
        else:
            self._since_nearer += 1
        stuck = self._rule.stuck
        return self._rest_ends and stuck is not None and self._since_nearer >= stuck and near > 1

    def _judged(self, near: float) -> Verdict | None:
        """The verdict on a run that has settled, or that has had its pictures."""
        ended = self._pictures >= self._rule.most
        if near < 1:
            when = "at the end" if ended else "when it settled"
            return Outcome.converged, self._words("within", near, when)
        if not (ended or self._rest_ends):
            return None
        outcome = Outcome.timed_out if ended else Outcome.local_minimum
        return outcome, self._words("not within", near, "when it settled")

    def _settled(self) -> bool:
        rule = self._rule
        n = rule.window
        if self._pictures < rule.least or len(self._speeds) < 2 * n:
            return False
        speeds = np.array(self._speeds)
        first = speeds[:n].mean(axis=0)
        second = speeds[n:].mean(axis=0)
        return bool((first < (rule.speed_mps, rule.rate_degps)).all() and (second >= first).all())

    def _words(self, within: str, near: float, when: str) -> str:
        rule = self._rule
        limit = f"{100 * rule.share:g} % of the start's distance and angle"
        if rule.or_position_m is not None:
            limit += f", or {rule.or_position_m:g} m and {rule.or_rotation_deg:g} deg"
        return (
            f"{within} {limit}, at {near:.3g} of the limit, {when}, after {self._pictures} pictures"
        )


@spec
class AfterPictures:
    """The run ends after a number of pictures, and has converged where the camera is near its goal.

    The defaults are the rule of CNS (Chen et al. 2023, arXiv:2309.09047).

    Args:
        pictures: after how many pictures the run is judged [1].
        share: of the distance between camera and target at the goal, within which the camera must
            be from its goal [1].
        rotation_deg: angle within which it must be [deg].
        early: as of `settles` [1]; e.g. `0.1`.
        rest_px: the run is judged before, once the RMS error of the points that the law sees has
            been under this for `rest_s`, and not above 1.1 times its least since then, plus 0.3 px
            [px]; None: it is not; e.g. `5.4`.
        rest_s: for how long [s].
    """

    kind: Literal["after_pictures"] = "after_pictures"
    pictures: Pictures = 600
    share: Share = 0.1
    rotation_deg: PositiveAngle = 10.0
    early: Share | None = None
    rest_px: PositivePixels | None = None
    rest_s: PositiveTime = 0.5

    def monitor(self, setup: Setup) -> _AfterPictures:
        """By the true place of the camera."""
        return _AfterPictures(self)


class _AfterPictures:
    def __init__(self, rule: AfterPictures):
        self._rule = rule
        self._early = 0
        self._pictures = 0
        self._least_px = math.inf
        self._since = 0.0

    def _at_rest(self, t: float, error_px: float) -> bool:
        """Whether the error in the image has stayed small, and fallen no further, for `rest_s`."""
        # also where it is not known
        if self._rule.rest_px is None or not error_px <= self._rule.rest_px:
            self._least_px = math.inf
        elif error_px < 0.9 * self._least_px or error_px > 1.1 * self._least_px + REST_PX:
            self._least_px = min(error_px, self._least_px)
            self._since = t
        return math.isfinite(self._least_px) and t - self._since > self._rule.rest_s

    def update(self, frame: Frame) -> Verdict | None:
        rule = self._rule
        (distance, angle) = away_from_goal(frame)
        self._pictures += 1
        limit = rule.share * float(np.linalg.norm(frame.goal.T_camera_target[:3, 3]))
        near = max(distance / limit, math.degrees(angle) / rule.rotation_deg)
        self._early = near_in_turn(rule.early, near, self._early)
        rests = self._at_rest(frame.t, frame.error.rms_px)
        if self._early < EARLY_PICTURES and self._pictures < rule.pictures and not rests:
            return None
        limits = f"{limit:.3g} m and {rule.rotation_deg:g} deg"
        words = (
            f"{distance:.3g} m and {math.degrees(angle):.3g} deg from the goal after"
            f" {self._pictures} pictures; the limits are {limits}"
        )
        return (Outcome.converged if near < 1 else Outcome.timed_out), words


class Monitor(Protocol):
    """Tests every frame of one run."""

    def update(self, frame: Frame) -> Verdict | None:
        """The verdict, if this frame ends the run; None to go on."""
        ...


class MonitorContract(Protocol):
    """A rule of when a run ends: its parameters are frozen in the object, and each run has a
    `Monitor` of its own.
    """

    @property
    def kind(self) -> str:
        """The word in a scenario."""
        ...

    def monitor(self, setup: Setup) -> Monitor:
        """What tests each frame of one run, by measurements, commands and truth. It must not write
        into a frame.
        """
        ...


@spec
class KeepOut:
    """The run ends as `collided` when the camera's centre enters a box with sides along the world's
    axes.

    Contacts of the robot's body with what stands in the scene end a run anyway; this box is of no
    substance.

    Args:
        corner: a corner of the box in the world [m]; e.g. `[0.4, -0.3, 0.5]`.
        opposite: the corner opposite to it [m]; e.g. `[0.8, 0.3, 1.2]`.
    """

    kind: Literal["keep_out"] = "keep_out"
    corner: Position
    opposite: Position

    def __post_init__(self) -> None:
        """Refuse a box without volume."""
        if any(a == b for a, b in zip(self.corner, self.opposite, strict=True)):
            words = "must differ from `corner` in x, y and z"
            raise ParameterError("opposite", words, list(self.opposite))

    def monitor(self, setup: Setup) -> Monitor:
        """The rule itself, which keeps nothing from frame to frame."""
        return self

    def update(self, frame: Frame) -> Verdict | None:
        """By the true place of the camera."""
        low, high = np.sort([self.corner, self.opposite], axis=0)
        xyz = frame.truth.T_world_camera[:3, 3]
        if not ((xyz >= low) & (xyz <= high)).all():
            return None
        x, y, z = xyz.tolist()
        words = f"the camera entered the forbidden box at x {x:.3f}, y {y:.3f}, z {z:.3f} m"
        return Outcome.collided, words


MONITORS = Registry("monitor", KeepOut, Settles, AfterPictures, contract=Contract(MonitorContract))


class Ruled(Ending):
    """A monitor of this kind. Raises ParameterError: what it returns is neither None nor an outcome
    with its reason.
    """

    def __init__(self, kind: str, monitor: Monitor):
        self._kind = kind
        self._monitor = monitor

    def update(self, frame: Frame) -> Verdict | None:
        verdict = self._monitor.update(frame)
        match verdict:
            case None | (Outcome(), str()):
                return verdict
        raise ParameterError.returned(
            f"monitors: {self._kind}", "update", "None or (Outcome, reason)", repr(verdict)
        )
