"""The interface of a control law, its Command, and the parts that laws share: gains, limits on the
twist, views of a batch.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import cached_property
from types import MappingProxyType
from typing import Annotated, Any, ClassVar, Generic, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from vstestbed.core.errors import VstestbedError
from vstestbed.core.geometry import Array
from vstestbed.core.quantity import PositiveGain, PositiveRate, PositiveSpeed, check_ordered
from vstestbed.core.registry import Contract, Registry
from vstestbed.core.spec import spec
from vstestbed.features.depth import AtGoal, Constant, Depth, PnP
from vstestbed.features.observation import Goal, Observation
from vstestbed.laws.feedforward import Estimator, NoFeedforward
from vstestbed.laws.points import Visibility
from vstestbed.laws.solve import load_lapack
from vstestbed.robots.own_model import OwnModel

__all__ = [
    "LAW_CONTRACT",
    "OBSERVATION_FIELDS",
    "AdaptiveGain",
    "Command",
    "ConstantGain",
    "Gain",
    "Law",
    "LawBase",
    "LawFailedError",
    "Motions",
    "TwistLimits",
    "Views",
    "has_batch",
    "held",
    "inputs_of",
]

M = TypeVar("M")
Motions = tuple[tuple[float, Array], ...]
"""Motions left to a secondary task, as pairs of a share and camera twists (6, k); see
`Command.free`.
"""


@dataclass(frozen=True, slots=True)
class Command:
    """The output of a law: u (n,) in the robot's motion space, and the camera twist (6,) = basis @
    u for which it stands.

    Attributes:
        u: velocities along the robot's motions (n,) [m/s, rad/s].
        twist: the camera twist (6,), (v, w) in the camera frame [m/s, rad/s].
        rest_reason: why the law orders rest although the goal is not reached; "" while it works.
            With a motion beside it, the law cannot measure, and holds its last command.
        scale: factor in (0, 1] by which the law's own limits shortened the twist.
        free: motions left to a secondary task of the robot, as pairs of a share and camera twists
            (6, k), which span them as columns; the share is the weight of the task projected on
            them, and all shares together are 1. None where the law does not compute them.
        rates: the robot's own velocities (m,) (`Observation.robot`) that the law orders, whose
            camera twist `twist` is; None: the robot finds its own for the twist.
        mode: number of the word in `Law.modes` for what the law did.
        error_grey: RMS of the difference between picture and goal picture, of a law that works on
            grey levels; NaN else.
        row: values of the law's own columns in the log (`Law.columns`); (): none are known in this
            frame.
        wrench: force and moment (6,) that the tool is to exert at the camera's origin, in the
            camera's frame [N, Nm], by an arm with `controller: impedance`; None for none.
    """

    u: Array
    twist: Array
    rest_reason: str = ""
    scale: float = 1.0
    free: Motions = ()
    rates: Array | None = None
    mode: int = 0
    error_grey: float = math.nan
    row: tuple[float, ...] = ()
    wrench: Array | None = None

    @classmethod
    def rest(cls, basis: Array, why: str) -> Command:
        """Zero motion, with the reason."""
        return cls(u=np.zeros(basis.shape[1]), twist=np.zeros(6), rest_reason=why)


@spec
class ConstantGain:
    """lambda = value [1/s], whatever the error.

    Args:
        value: lambda [1/s].
    """

    kind: Literal["constant"] = "constant"
    value: PositiveGain = 0.5

    def at(self, error: Array) -> float:
        """The gain [1/s] at error vectors (..., n)."""
        return self.value


@spec
class AdaptiveGain:
    """High near the goal, low far away: lambda(x) = (l0 - linf) exp(-slope x / (l0 - linf)) + linf,
    x = |error|_inf.

    The error is the remaining motion pinv(L B) e in metres and radians, so that one set of numbers
    suits all features.

    Args:
        at_zero: l0, gain at zero error [1/s].
        at_infinity: linf, gain at large error [1/s], under at_zero.
        slope_at_zero: descent of the gain at x = 0 [1/s per m or rad].

    Reference: Marchand, Spindler & Chaumette 2005, doi:10.1109/MRA.2005.1577023 (adaptive gain of
    their library).
    """

    kind: Literal["adaptive"] = "adaptive"
    at_zero: PositiveGain = 4.0
    at_infinity: PositiveGain = 0.4
    slope_at_zero: PositiveGain = 30.0

    def __post_init__(self) -> None:
        """Refuse a gain that would increase with the error."""
        check_ordered(self, "at_infinity", "at_zero", equal=False)

    def at(self, error: Array) -> Array:
        """The gains (..., 1) [1/s] at error vectors (..., n) in motion space."""
        span = self.at_zero - self.at_infinity
        x = np.abs(error).max(axis=-1, keepdims=True)
        return span * np.exp(-self.slope_at_zero / span * x) + self.at_infinity


GAINS = Registry("gain", ConstantGain, AdaptiveGain, number=("constant", "value"))
Gain = Annotated[ConstantGain | AdaptiveGain, GAINS]


@spec
class TwistLimits:
    """Limits of the commanded camera twist, which is scaled as a whole: that keeps its direction.

    Args:
        speed_mps: largest speed [m/s]; None: no limit.
        rate_radps: largest angular rate [rad/s]; None: no limit.
    """

    speed_mps: PositiveSpeed | None = None
    rate_radps: PositiveRate | None = None

    def scale(self, twist: Array) -> float:
        """Factor in (0, 1] that brings a twist (6,) within the limits."""
        if self.speed_mps is None and self.rate_radps is None:  # the usual case, in every frame
            return 1.0
        factor = 1.0
        for limit, part in ((self.speed_mps, twist[:3]), (self.rate_radps, twist[3:])):
            size = float(np.sqrt(part @ part))
            if limit is not None and size > limit:
                factor = min(factor, limit / size)
        return factor

    def within(self, twist: Array) -> Array:
        """Twists (M, 6), each scaled as a whole to within the limits."""
        factor = np.ones((len(twist), 1))
        for limit, part in ((self.speed_mps, twist[:, :3]), (self.rate_radps, twist[:, 3:])):
            if limit is not None:
                size = np.linalg.norm(part, axis=1, keepdims=True)
                factor = np.minimum(factor, limit / np.maximum(size, limit))
        return twist * factor

    def reached(self, twist: Array) -> NDArray[np.bool_]:
        """Which twists (M, 6) are at a limit, as those are that were shortened."""
        sizes = np.linalg.norm(twist.reshape(-1, 2, 3), axis=2)
        limits = np.array([self.speed_mps or math.inf, self.rate_radps or math.inf])
        return (sizes > limits * (1 - 1e-9)).any(axis=1)

    def command(self, u: Array, basis: Array) -> Command:
        """The command for velocities u (n,) along the robot's motions, basis (6, n), scaled to
        within the limits.
        """
        twist = basis @ u
        factor = self.scale(twist)
        if factor == 1.0:
            return Command(u, twist)
        return Command(u=u * factor, twist=twist * factor, scale=factor)


class Law(Generic[M]):
    """A control law: parameters frozen in the object, state passed through; with defaults for all
    but `kind` and `step`.

        class Mine(Law):  # with @LAWS.add and @spec
            kind: Literal["mine"] = "mine"

            def step(self, state, observation, goal, basis): ...

    In a spec, an annotated attribute is a parameter in YAML, and one without annotation is a
    constant of the class: a law with `depth = PnP()` has a fixed source of depth, one with
    `depth: Depth = PnP()` leaves it to the scenario. A law of an error and its Jacobian derives
    from `ErrorLaw`, and gives these alone.

    Attributes:
        kind: the law's word in a scenario, a field of each law.
        tasks: the kinds of goals that it can be given: `view`, `path`, `landing`, `pose` (of a
            vehicle), `gap`, `line`.
        inputs: the fields of an Observation that it reads, without those of its feedforward and
            visibility field (`inputs_of`); the costly ones are computed only for laws that name
            them.
        depth: the source of the markers' depth (`Depth`), and with it of the target's pose.
        feature: the image feature (`Feature`) whose error is regulated, for reports; None for a law
            that has no single one.
        limits: largest speed and rate of the commanded twist (`TwistLimits`).
        visibility: the field at the border of the image (`Visibility`).
        feedforward: the term for a moving target (`Feedforward`).
        cruise_mps: the constant speed at which the law drives a vehicle along a line [m/s]; None
            for a law that sets none.
        rest_m: distance from the goal under which the law stands still for good [m]; 0 for a law
            that never stops.
        modes: words for what the law may do in a frame; `Command.mode` is the number of one, the
            log's `law_mode`.
        columns: names of the law's own columns in the log, such as `law_energy`; `Command.row` has
            their values in each frame.
        cameras: further cameras whose equations the law stacks below its own, by name, with their
            weights.
        stacks: whether a scenario may give it `cameras`.
        needs_same_markers: whether each row must show the same marker in every picture, in the
            target's order.
        idle: names of its gains that do nothing with the values of its other fields, and need no
            tuning.
    """

    # it is a @spec: `dataclasses.replace` makes variants of it
    __dataclass_fields__: ClassVar[dict[str, Any]]
    kind: Any
    # Any, so that a kind may have a field or a property in their place.
    tasks: Any = ("view",)
    inputs: Any = ("xy", "depth")
    depth: Any = PnP()
    feature: Any = None
    limits: Any = TwistLimits()
    visibility: Any = Visibility()
    feedforward: Any = NoFeedforward()
    cruise_mps: Any = None
    rest_m: Any = 0.0
    modes: Any = ()
    columns: Any = ()
    cameras: Any = MappingProxyType({})
    stacks: Any = False
    needs_same_markers: Any = False
    idle: Any = ()

    def markers_needed(self, basis: Array) -> int:
        """The least number of visible markers with which `step` can control the robot's motions,
        basis (6, n).

        By default as many as give an equation for each motion, two each.
        """
        return math.ceil(basis.shape[1] / 2)

    def check(self, points: Array, goal: Goal) -> None:
        """Refuse markers (N, 3) in the target frame [m], or a goal view of them, with which the law
        cannot work, by a ParameterError.
        """

    def check_view(
        self, goal: Goal, marker_radius_m: float, called: Callable[[int], str] = str
    ) -> None:
        """Refuse a goal view whose markers are too near to the picture's border: by default for the
        visibility field.

        called: what messages call a marker. Raises ParameterError: it names a field of the law.
        """
        self.visibility.check(goal, marker_radius_m, called)

    def init(self, goal: Goal) -> Any:
        """The state before the first frame: by default none."""
        return None

    def prepare(self) -> None:
        """Import what the first `step` needs: it must not take longer than the others, for which a
        robot waits as well.
        """
        load_lapack()

    @abstractmethod
    def step(
        self, state: M, observation: Observation, goal: Goal, basis: Array
    ) -> tuple[M, Command]:
        """One frame: the next state and the command. basis (6, n): camera twists of the robot's n
        motions, as columns.
        """
        ...


class LawFailedError(VstestbedError):
    """A law failed in a process of its own, which cannot pass its exception on: what happened, in a
    sentence.
    """


LawBase = Law  # the name from which plugins derive


def held(limits: TwistLimits, u: Array | None, basis: Array, why: str) -> Command:
    """A frame without a measurement: the last command u (n,) again, or rest where there was none.

    why: the law has no measurement, in words.
    """
    if u is None:
        return Command.rest(basis, why)
    return replace(limits.command(u, basis), rest_reason=why)


def inputs_of(law: Law[Any]) -> tuple[str, ...]:
    """The fields of an Observation that a law reads, with what its feedforward and its repulsive
    field need.
    """
    motion = ("motion",) if isinstance(law.feedforward, Estimator) else ()
    cameras = ("cameras",) if law.cameras else ()
    return tuple(dict.fromkeys((*law.inputs, *motion, *cameras, *law.visibility.inputs)))


OBSERVATION_FIELDS = tuple(f.name for f in fields(Observation))
LAW_CONTRACT = Contract(Law, base=Law, words={"inputs": (*OBSERVATION_FIELDS, "xyw")})


@dataclass(frozen=True)
class Views:
    """M views of the same N markers at one instant, by a batch of ideal cameras that see all of
    them; with the field names of an Observation.

    Attributes:
        t: time [s].
        p: the markers in the camera frame (M, N, 3) [m].
        T_camera_target: poses (M, 4, 4).
        goal: the goal view of these markers.
        depth_from: the source of depth; `pnp` and `oracle` give the true depth.
        marker_radius_m: of every marker [m].
    """

    t: float
    p: Array
    T_camera_target: Array
    goal: Goal
    depth_from: Depth
    marker_radius_m: float = 0.0
    relative = None  # exact pixels: what a homography tells, the pose tells as well

    @cached_property
    def xy(self) -> Array:
        """Normalised coordinates (M, N, 2)."""
        return self.p[..., :2] / self.p[..., 2:]

    @cached_property
    def depth(self) -> Array:
        """Depth z of each marker as known to the law (M, N) [m]."""
        return self._known(self.p[..., 2], self.goal.depth)

    @property
    def xyw(self) -> Array:
        """Normalised coordinates and inverse depths as known to the law (M, N, 3)."""
        return np.concatenate([self.xy, 1 / self.depth[..., None]], axis=-1)

    @cached_property
    def ray(self) -> Array:
        """Unit rays (M, N, 3)."""
        return self.p / self._reach[..., None]

    @cached_property
    def range(self) -> Array:
        """Distance of each marker as known to the law (M, N) [m]."""
        return self._known(self._reach, self.goal.range)

    @cached_property
    def radius_px(self) -> Array:
        """Apparent radius of each marker by its depth as known to the law (M, N) [px]."""
        p = (self.ray * self.range[..., None]).reshape(-1, 3)
        sizes = self.goal.camera.half_size(p, self.marker_radius_m)
        return sizes.max(axis=1).reshape(self.range.shape)

    @cached_property
    def _reach(self) -> Array:
        # the true distance, whatever `depth_from` says
        return np.sqrt(np.einsum("mni,mni->mn", self.p, self.p))

    def _known(self, true: Array, at_goal: Array) -> Array:
        match self.depth_from:
            case Constant(depth_m=depth):
                return np.full(true.shape, depth)
            case AtGoal():
                return np.broadcast_to(at_goal, true.shape)
            case _:
                return true

    @cached_property
    def uv(self) -> Array:
        """Pixels (M, N, 2)."""
        return self.goal.camera.project(self.p)

    def of_run(self, i: int, inputs: tuple[str, ...], moved: Array | None = None) -> Observation:
        """What the law of run i is shown: of the costly fields those that it names. moved: its last
        motion (6,); None: none.
        """
        seen = Observation(self.t, self.uv[i], self.xy[i], self.depth[i], self.T_camera_target[i])
        if {"ray", "range"} & set(inputs):
            seen = replace(seen, ray=self.ray[i], range=self.range[i])
        if "radius_px" in inputs:
            seen = replace(seen, radius_px=self.radius_px[i])
        if "robot" in inputs:
            robot = OwnModel.of_ideal_camera(self.goal.camera.period, moved)
            seen = replace(seen, robot=robot)
        return seen


def has_batch(law: Any) -> bool:
    """Whether a law controls a batch by the equations of its own `step`: a class that overrides
    `step` alone inherits another law's.
    """
    for c in type(law).__mro__:
        if {"step", "step_batch"} & vars(c).keys():
            return "step_batch" in vars(c)
    return False
