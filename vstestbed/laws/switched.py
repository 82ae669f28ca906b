"""Switching between laws: each works until one of its conditions holds."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Annotated, Any, Literal

import numpy as np
from annotated_types import Len

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array, inverse, rotation_angle
from vstestbed.core.quantity import (
    Bounded,
    PositiveAngle,
    PositiveLength,
    PositivePixels,
    TighterBounds,
    Time,
)
from vstestbed.core.registry import Registry
from vstestbed.core.spec import Shorthand, spec
from vstestbed.features.base import Feature
from vstestbed.features.depth import Depth
from vstestbed.features.observation import Goal, Observation
from vstestbed.laws.base import LAW_CONTRACT, Command, Law, TwistLimits, inputs_of
from vstestbed.laws.feedforward import Feedforward
from vstestbed.laws.hybrid import Hybrid
from vstestbed.laws.ibvs import IBVS
from vstestbed.laws.line_following import LineFollowing
from vstestbed.laws.partitioned import Partitioned
from vstestbed.laws.pbvs import PBVS
from vstestbed.laws.photometric import Photometric
from vstestbed.laws.points import Visibility
from vstestbed.laws.policy import Policy
from vstestbed.laws.pose_controller import PoseController
from vstestbed.laws.predictive import Predictive
from vstestbed.laws.pursuit import Pursuit
from vstestbed.laws.qp import QP
from vstestbed.laws.uncalibrated import Uncalibrated


@spec
class SwitchCondition:
    """A law is left when one of these holds; none: it is never left.

    Args:
        error_over_px, error_under_px: RMS of the image error over the coordinates seen [px]; e.g.
            `20`.
        position_over_m, position_under_m: distance of the camera from its goal, by the estimated
            pose [m]; e.g. `0.5`.
        rotation_over_deg, rotation_under_deg: angle of the camera from its goal, by the estimated
            pose [deg]; e.g. `40`.
        retreat_over_m: distance from the target's origin beyond that at the start and that at the
            goal, by the estimated pose [m].
        border_under_px: distance of the nearest marker's edge from the image border, 0 where a
            marker is not seen [px].
        joint_margin_under_deg: distance of the nearest joint from its limit, a joint that slides
            counting a radian a metre; infinite for a robot whose joints have no limits [deg]; e.g.
            `10`.
    """

    error_over_px: PositivePixels | None = None
    error_under_px: PositivePixels | None = None
    position_over_m: PositiveLength | None = None
    position_under_m: PositiveLength | None = None
    rotation_over_deg: PositiveAngle | None = None
    rotation_under_deg: PositiveAngle | None = None
    retreat_over_m: PositiveLength | None = None
    border_under_px: PositivePixels | None = None
    joint_margin_under_deg: PositiveAngle | None = None

    @cached_property
    def limits(self) -> tuple[tuple[str, int, float], ...]:
        """Of each condition the quantity, 1 for `over` or -1 for `under`, and the limit."""
        found = []
        for field in fields(self):
            quantity, side, _ = field.name.rsplit("_", 2)  # as in `joint_margin_under_deg`
            limit = getattr(self, field.name)
            if limit is not None:
                found.append((quantity, 1 if side == "over" else -1, limit))
        return tuple(found)

    def holds(self, values: Mapping[str, float]) -> bool:
        """Whether a quantity is beyond its limit; one that is unknown (NaN) is not."""
        return any(side * values[name] > side * limit for name, side, limit in self.limits)

    def receded(self, values: Mapping[str, float], hysteresis: float) -> bool:
        """Whether all quantities are back by this share of their limits; one that is unknown (NaN)
        is not.
        """
        return all(
            side * values[name] <= side * limit * (1 - side * hysteresis)
            for name, side, limit in self.limits
        )


def target_distance(observation: Observation) -> float:
    """Distance of the camera from the target's origin by the estimated pose [m]; NaN where it is
    unknown.
    """
    T = observation.T_camera_target
    return math.nan if T is None else float(np.linalg.norm(T[:3, 3]))


def _error_px(observation: Observation, goal: Goal, start_m: float) -> float:
    error = (observation.uv - goal.uv)[observation.seen]
    return math.sqrt(float(np.mean(error**2))) if error.size else math.nan


def _T_goal_camera(observation: Observation, goal: Goal) -> Array:
    T = observation.T_camera_target
    return np.full((4, 4), np.nan) if T is None else goal.T_camera_target @ inverse(T)


def _position_m(observation: Observation, goal: Goal, start_m: float) -> float:
    return float(np.linalg.norm(_T_goal_camera(observation, goal)[:3, 3]))


def _rotation_deg(observation: Observation, goal: Goal, start_m: float) -> float:
    return math.degrees(float(rotation_angle(_T_goal_camera(observation, goal)[:3, :3])))


def _retreat_m(observation: Observation, goal: Goal, start_m: float) -> float:
    at_goal = float(np.linalg.norm(goal.T_camera_target[:3, 3]))
    return target_distance(observation) - max(start_m, at_goal)


def _border_px(observation: Observation, goal: Goal, start_m: float) -> float:
    seen = observation.seen
    if not (seen if goal.counted is None else seen[goal.counted]).all():
        return 0.0
    distance = goal.camera.borders(observation.uv[seen])[0].min(axis=1)
    radius = 0.0 if observation.radius_px is None else np.nan_to_num(observation.radius_px[seen])
    return float(np.min(distance - radius, initial=np.inf))


def _joint_margin_deg(observation: Observation, goal: Goal, start_m: float) -> float:
    robot = observation.robot
    if robot is None:
        return math.nan
    margins = np.minimum(robot.q - robot.low, robot.high - robot.q)
    return math.degrees(float(margins.min(initial=np.inf)))


QUANTITIES: dict[str, tuple[Callable[[Observation, Goal, float], float], tuple[str, ...]]] = {
    "error": (_error_px, ()),
    "position": (_position_m, ("T_camera_target",)),
    "rotation": (_rotation_deg, ("T_camera_target",)),
    "retreat": (_retreat_m, ("T_camera_target",)),
    "border": (_border_px, ("radius_px",)),
    "joint_margin": (_joint_margin_deg, ("robot",)),
}
"""By name a quantity in the unit of its fields, NaN where it is unknown, as a function of the
observation, the goal and the distance of the camera from the target at the start [m]; and the
fields of an Observation that it needs besides the pixels.
"""


# The laws that work alone; `switched`, which is made of them, joins them in the package.
LAWS = Registry(
    "law",
    IBVS,
    Partitioned,
    PBVS,
    Hybrid,
    QP,
    Predictive,
    Uncalibrated,
    PoseController,
    Pursuit,
    LineFollowing,
    Photometric,
    Policy,
    contract=LAW_CONTRACT,
)


@spec
class Stage:
    """One of the laws, and when it is left.

    Args:
        law: a law of a goal view, with its parameters.
        until: the conditions, any of which bars it; none: it is never left.
    """

    law: Annotated[Law[Any], LAWS.without("switched")]
    until: SwitchCondition = SwitchCondition()


@dataclass(frozen=True, slots=True)
class SwitchedState:
    """What `switched` keeps from one frame to the next.

    Attributes:
        inner: state of the active law.
        active: its number.
        since: when it took over [s]; NaN before the first frame.
        barred: of each law, whether its conditions keep it from working.
        start_m: distance of the camera from the target at the start [m]; NaN where it is unknown,
            or not needed.
        last: time [s] and command of the last frame.
        left: the same of the last frame before the switch.
    """

    inner: Any
    active: int = 0
    since: float = math.nan
    barred: tuple[bool, ...] = ()
    start_m: float = math.nan
    last: tuple[float, Command] | None = None
    left: tuple[float, Command] | None = None


@spec
class Switched(Law[SwitchedState]):
    """Several laws of which one works at a time: u = u_i, with i the active law.

    A law is barred as soon as a quantity is beyond one of its limits (`until`). It is free again
    when all its quantities are back by the share `hysteresis` of their limits: under (1 -
    hysteresis) times an `over`, above (1 + hysteresis) times an `under`. A quantity that is unknown
    in a frame bars and frees nothing.

    When the active law is barred, the first law of the list that is free takes over. While none is
    free, the active one goes on. With `prefer: first` a law that stands earlier in the list also
    takes over as soon as it is free. The first free law of the list begins.

    A law takes over with the state of its first frame (`init`). What it knew in an earlier stage,
    such as the start of its smooth start or the views from which its feedforward estimates a
    velocity, is of another time. For `blend_s` the command crosses over from the last one of the
    law before:

    u = a u_i + (1 - a) u_before,  a = (t - t_before) / blend_s.

    It is then ordered as a camera twist, also where the law orders joint velocities. A law that
    orders rest rests at once.

    State-based switching between an image-based and a position-based law, as in the reference, is
    the list
    `[{law: ibvs, until: {retreat_over_m: 0.5}}, {law: pbvs, until: {border_under_px: 30}}]`: the
    camera's retreat bounds the first, and the image border the second. Switching at random, the
    other scheme of that literature, is not offered, since a law has no random numbers.

    Stability is not a property of this law. Two laws that are both stable may still not be so
    together: each may undo the progress of the other for ever. The reference proves it for one
    scheme and its thresholds. Here it is measured: `law_switches` and `law_shortest_stay_s` of a
    run tell of chattering, the metric `error_growth` of the frames in which an error grew.

    Args:
        laws: in the order of preference, the first being the one to begin with; e.g.
            `[{law: ibvs, until: {border_under_px: 30}}, pbvs]`.
        prefer: what works when several laws are free: the `active` one, or the `first` of the list.
        hysteresis: share of a limit by which a quantity must be back before it frees a law [1].
        dwell_s: least time between two switches [s].
        blend_s: time in which the command crosses over after a switch [s]; 0: it jumps.

    Reference: Gans & Hutchinson 2007, Stable visual servoing through hybrid switched-system
    control, doi:10.1109/TRO.2007.895067.
    """

    kind: Literal["switched"] = "switched"
    laws: Annotated[tuple[Annotated[Stage, Shorthand("law")], ...], Len(2, 16)]
    prefer: Literal["active", "first"] = "active"
    hysteresis: Annotated[
        float, Bounded(0.0, 0.99, "", "a share of the limit"), TighterBounds(ge=0)
    ] = 0.2
    dwell_s: Time = 0.2
    blend_s: Time = 0.0

    def __post_init__(self) -> None:
        """Refuse laws that cannot work in turn."""
        for i, part in enumerate(self.laws):
            if "view" not in part.law.tasks:
                words = f"{part.law.kind}, which takes {' or '.join(part.law.tasks)}"
                raise ParameterError.excluded(
                    f"laws.{i}.law.kind", words, why="laws that are switched take a view"
                )
            if not part.until.limits and i < len(self.laws) - 1:
                words = (
                    "needs a condition, such as {border_under_px: 30}:"
                    " without one no law after it in the list ever works"
                )
                raise ParameterError(f"laws.{i}.until", words)
        readers = [i for i, law in enumerate(self._each) if _reads_depth(law)]
        for i in readers[1:]:
            first = self._each[readers[0]].depth
            depth = self._each[i].depth
            if depth != first:
                words = (
                    f"must be the same as that of laws.{readers[0]} ({first.kind}):"
                    " a frame has one source of depth"
                )
                raise ParameterError(f"laws.{i}.law.depth", words, depth.kind)

    @property
    def _each(self) -> tuple[Law[Any], ...]:
        return tuple(part.law for part in self.laws)

    @property
    def tasks(self) -> tuple[str, ...]:
        """The goals that all laws take."""
        first, *others = self._each
        return tuple(task for task in first.tasks if all(task in law.tasks for law in others))

    @property
    def inputs(self) -> tuple[str, ...]:
        """What any of the laws and of the conditions reads."""
        read = list[str]()
        for law in self._each:
            read += inputs_of(law)
        for quantity in self._quantities:
            read += QUANTITIES[quantity][1]
        return tuple(dict.fromkeys(read))

    @property
    def depth(self) -> Depth:
        """The source of depth of the laws that read it."""
        readers = [law for law in self._each if _reads_depth(law)]
        return (readers or self._each)[0].depth

    @property
    def feature(self) -> Feature | None:
        """The feature of all laws that have one; None where they differ."""
        found = [law.feature for law in self._each if law.feature is not None]
        return found[0] if found and all(feature == found[0] for feature in found) else None

    @cached_property
    def limits(self) -> TwistLimits:
        """The loosest of the laws' limits; each law keeps its own."""
        speeds = [law.limits.speed_mps for law in self._each]
        rates = [law.limits.rate_radps for law in self._each]
        return TwistLimits(
            speed_mps=None if None in speeds else max(speeds),
            rate_radps=None if None in rates else max(rates),
        )

    @property
    def visibility(self) -> Visibility:
        """The field with the largest margin: it keeps the goal from the border for all."""
        return max((law.visibility for law in self._each), key=lambda field: field.margin_px)

    @property
    def feedforward(self) -> Feedforward:
        """That of the first law that has one, else none."""
        found = [law.feedforward for law in self._each]
        return next((feedforward for feedforward in found if feedforward.kind != "none"), found[0])

    @cached_property
    def modes(self) -> tuple[str, ...]:
        """The laws' words, numbered where a word is there twice; of a law with modes of its own
        each of them behind its word.
        """
        kinds = [law.kind for law in self._each]
        words = list[str]()
        for i, law in enumerate(self._each):
            word = law.kind
            if kinds.count(word) > 1:
                word = f"{word} {kinds[: i + 1].count(word)}"
            words += [f"{word} {mode}" for mode in law.modes] or [word]
        return tuple(words)

    @property
    def needs_same_markers(self) -> bool:
        """Whether one of the laws does."""
        return any(law.needs_same_markers for law in self._each)

    def markers_needed(self, basis: Array) -> int:
        """As many as the law that needs the most."""
        return max(law.markers_needed(basis) for law in self._each)

    def check(self, points: Array, goal: Goal) -> None:
        """Refuse what one of the laws refuses, and a border where the image has none."""
        for i, part in enumerate(self.laws):
            part.law.check(points, goal)
            if part.until.border_under_px is not None and len(goal.camera.panels) > 1:
                raise ParameterError.fixed(
                    f"law.laws.{i}.until.border_under_px",
                    "left out",
                    part.until.border_under_px,
                    where="with a camera that sees all round",
                    why="its image has no border",
                )

    def init(self, goal: Goal) -> SwitchedState:
        return SwitchedState(self._each[0].init(goal), barred=(False,) * len(self.laws))

    def prepare(self) -> None:
        for law in self._each:
            law.prepare()

    def step(
        self, state: SwitchedState, observation: Observation, goal: Goal, basis: Array
    ) -> tuple[SwitchedState, Command]:
        """One frame of the active law, which the conditions choose first."""
        state = self._chosen(state, observation, goal)
        inner, command = self._each[state.active].step(state.inner, observation, goal, basis)
        if state.left is not None and not command.rest_reason:
            t, last = state.left
            since = observation.t - t
            if since < self.blend_s:
                a = since / self.blend_s
                u = a * command.u + (1 - a) * last.u
                command = replace(command, u=u, twist=basis @ u, rates=None)
        modes_before = sum(len(law.modes) or 1 for law in self._each[: state.active])
        command = replace(command, mode=modes_before + command.mode)
        return replace(state, inner=inner, last=(observation.t, command)), command

    @cached_property
    def _quantities(self) -> tuple[str, ...]:
        compared = []
        for part in self.laws:
            compared += [name for name, _, _ in part.until.limits]
        return tuple(dict.fromkeys(compared))

    def _chosen(self, state: SwitchedState, observation: Observation, goal: Goal) -> SwitchedState:
        """The state with the law that is to work in this frame."""
        t = observation.t
        first = math.isnan(state.since)
        since = t if first else state.since
        start_m = state.start_m
        if math.isnan(start_m) and "retreat" in self._quantities:
            start_m = target_distance(observation)
        values = {
            name: QUANTITIES[name][0](observation, goal, start_m) for name in self._quantities
        }
        barred = self._barred(state.barred, values)
        state = replace(state, since=since, barred=barred, start_m=start_m)
        wanted = self._wanted(state.active, barred)
        # times are sums of floating-point numbers
        if wanted == state.active or not (first or t - state.since >= self.dwell_s - 1e-9):
            return state
        inner = self._each[wanted].init(goal)
        return replace(state, inner=inner, active=wanted, since=t, left=state.last)

    def _wanted(self, active: int, barred: tuple[bool, ...]) -> int:
        if self.prefer != "first" and not barred[active]:
            return active
        return next((i for i, out in enumerate(barred) if not out), active)

    def _barred(self, before: tuple[bool, ...], values: dict[str, float]) -> tuple[bool, ...]:
        """Which laws may not work: those whose condition to end holds, until it has receded."""
        return tuple(
            part.until.holds(values) or (was and not part.until.receded(values, self.hysteresis))
            for part, was in zip(self.laws, before, strict=True)
        )


def _reads_depth(law: Law[Any]) -> bool:
    """Whether a law uses the markers' depths or ranges."""
    return bool({"depth", "range"} & set(law.inputs)) or law.visibility.margin_px > 0
