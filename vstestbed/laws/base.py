"""The contract of a law, its Command, and what laws share: gains, limits on the twist."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal, Protocol, TypeVar

import numpy as np
from annotated_types import Gt

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array
from vstestbed.core.spec import OneOf, spec
from vstestbed.features.observation import Goal, Observation

M = TypeVar("M")


@dataclass(frozen=True, slots=True)
class Command:
    """What a law orders: u (n,) in the robot's motion space, the camera twist (6,) = basis @ u it stands for.

    `held` is why a law orders rest although the goal is not reached ("" while it works); `scale` is the factor by which
    the law's own limits on the twist shortened it. `free` (6, k) are unit twists that change nothing of what the law looks at,
    where there are such: the robot may use them for ends of its own.
    """

    u: Array
    twist: Array
    held: str = ""
    scale: float = 1.0
    free: Array | None = None

    @classmethod
    def rest(cls, basis: Array, why: str) -> Command:
        """Stand still, for the reason `why`."""
        return cls(u=np.zeros(basis.shape[1]), twist=np.zeros(6), held=why)


class Law(Protocol[M]):
    """A control law: parameters frozen in the object, memory passed through."""

    @property
    def kind(self) -> str:
        """The law's word in a scenario."""
        ...

    tasks: ClassVar[tuple[str, ...]]
    """What it may be asked for: `view`, `pose` (of a vehicle), `gap`, `line`."""

    @property
    def inputs(self) -> tuple[str, ...]:
        """The fields of an Observation that it looks at."""
        ...

    def markers_needed(self, basis: Array) -> int:
        """How many markers must be seen at least for the robot's motions, basis (6, n)."""
        ...

    def check(self, points: Array, goal: Goal) -> None:
        """Refuse markers (N, 3) in the target frame [m], or a goal view of them, that it cannot work with.

        Raises:
            ParameterError: it names a field of the scenario (`target`, `law.visibility`, ...).
        """
        ...

    def init(self, goal: Goal) -> M:
        """The memory before the first frame."""
        ...

    def step(self, memory: M, observation: Observation, goal: Goal, basis: Array) -> tuple[M, Command]:
        """One frame: the next memory and the command. basis (6, n): the camera twists that the robot can make."""
        ...


@spec
class ConstantGain:
    """lambda = value [1/s], whatever the error."""

    kind: Literal["constant"] = "constant"
    value: Annotated[float, Gt(0)] = 0.5

    def at(self, error: Array) -> float:
        """The gain [1/s] at error vectors (..., n)."""
        return self.value


@spec
class AdaptiveGain:
    """High near the goal, low far away: lambda(x) = (l0 - linf) exp(-slope x / (l0 - linf)) + linf, x = |error|_inf.

    The error is the motion still to be made, pinv(L B) e in metres and radians, so that one set of numbers serves every
    feature.

    Args:
        at_zero: l0, gain at zero error [1/s].
        at_infinity: linf, gain at large error [1/s], under at_zero.
        slope_at_zero: how steeply it falls at x = 0 [1/s per m or rad].

    Reference: Marchand, Spindler & Chaumette 2005, doi:10.1109/MRA.2005.1577023 (adaptive gain of their library).
    """

    kind: Literal["adaptive"] = "adaptive"
    at_zero: Annotated[float, Gt(0)] = 4.0
    at_infinity: Annotated[float, Gt(0)] = 0.4
    slope_at_zero: Annotated[float, Gt(0)] = 30.0

    def __post_init__(self) -> None:
        """Refuse a gain that would rise with the error."""
        if self.at_infinity >= self.at_zero:
            raise ParameterError("at_infinity", f"must be under at_zero = {self.at_zero}", self.at_infinity)

    def at(self, error: Array) -> Array:
        """The gains (..., 1) [1/s] at error vectors (..., n) in motion space."""
        span = self.at_zero - self.at_infinity
        return span * np.exp(-self.slope_at_zero / span * np.abs(error).max(axis=-1, keepdims=True)) + self.at_infinity


GAINS = OneOf("gain", ConstantGain, AdaptiveGain, number=("constant", "value"))
Gain = Annotated[ConstantGain | AdaptiveGain, GAINS]


@spec
class TwistLimits:
    """Largest commanded camera speed [m/s] and rate [rad/s]; the whole twist is scaled, so its direction is kept."""

    speed_mps: Annotated[float, Gt(0)] | None = None
    rate_radps: Annotated[float, Gt(0)] | None = None

    def scale(self, twist: Array) -> float:
        """Factor in (0, 1] that brings a twist (6,) within the limits."""
        if self.speed_mps is None and self.rate_radps is None:
            return 1.0
        factor = 1.0
        for limit, part in ((self.speed_mps, twist[:3]), (self.rate_radps, twist[3:])):
            size = float(np.sqrt(part @ part))
            if limit is not None and size > limit:
                factor = min(factor, limit / size)
        return factor

    def within(self, twist: Array) -> Array:
        """Twists (M, 6), each as a whole shortened to within the limits."""
        factor = np.ones((len(twist), 1))
        for limit, part in ((self.speed_mps, twist[:, :3]), (self.rate_radps, twist[:, 3:])):
            if limit is not None:
                size = np.linalg.norm(part, axis=1, keepdims=True)
                factor = np.minimum(factor, limit / np.maximum(size, np.finfo(float).tiny))
        return twist * factor

    def command(self, u: Array, basis: Array) -> Command:
        """The order for a motion u (n,) of a robot whose motions are `basis` (6, n), within the limits."""
        twist = basis @ u
        factor = self.scale(twist)
        return Command(u=u * factor, twist=twist * factor, scale=factor)
