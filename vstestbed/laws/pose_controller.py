"""The pose controller: a vehicle that cannot move sideways drives to a place, told by its landmarks and its compass."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge, Gt

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array
from vstestbed.core.spec import spec
from vstestbed.features.depth import Depth, PnP
from vstestbed.features.observation import Goal, Observation
from vstestbed.laws.base import Command, LawBase, TwistLimits
from vstestbed.laws.polar_pose import PolarGains, direction_to, polar, polar_law

NO_PLACE = "the place cannot be told"


@dataclass(frozen=True, slots=True)
class PoseMemory:
    """Forward (1) or reverse (-1), chosen at the first place known (0 before), and whether the goal has been reached."""

    direction: int = 0
    arrived: bool = False


@spec
class PoseController(LawBase):
    """v = k_rho rho,  w = k_alpha alpha + k_beta beta, about the goal, both scaled together into the speed limit.

    The equations, their stability and their source are in `laws.polar_pose`. Forward or reverse is chosen at the start, by
    which of front and rear faces the goal, or told. Nearer than `rest_m` the vehicle stands still for good; also where it has
    just missed the goal and has it abeam within `pass_m`, since the law would take it round for another try.

    Args:
        k_rho, k_alpha, k_beta: gains [1/s]; the textbook's by default. 1, 4, -2.5 suit starts from anywhere better.
        direction: `auto`, `forward` or `reverse`.
        rest_m, pass_m: how near counts as there [m]; rest_m under `stop.converged.position_m`, which would not be reached.
        speed_mps: largest speed [m/s].
        depth: where the place comes from: `pnp` of three or more landmarks; `floor` of one or two as well.
        limits: largest speed and rate of the commanded camera twist.

    References: Astolfi 1999, doi:10.1115/1.2802429; Corke 2017, Robotics, Vision & Control, eqs 4.10-4.13 and section 16.4.2.
    """

    kind: Literal["pose_controller"] = "pose_controller"
    tasks = ("pose",)
    inputs = ("place",)
    k_rho: float = 1.0
    k_alpha: float = 5.0
    k_beta: float = -2.0
    direction: Literal["auto", "forward", "reverse"] = "auto"
    rest_m: Annotated[float, Gt(0)] = 0.02
    pass_m: Annotated[float, Ge(0)] = 0.1
    speed_mps: Annotated[float, Gt(0)] = 1.0
    depth: Depth = PnP()
    limits: TwistLimits = TwistLimits()

    def __post_init__(self) -> None:
        """Refuse gains with which the loop is unstable."""
        try:
            self.gains  # noqa: B018 - checks them
        except ParameterError as error:
            raise ParameterError(f"k_{error.field}", error.problem, error.found) from None

    @property
    def gains(self) -> PolarGains:
        """The three together."""
        return PolarGains(self.k_rho, self.k_alpha, self.k_beta)

    def markers_needed(self, basis: Array) -> int:
        """Three landmarks for a pose; with the floor known, two tell the place."""
        return 3 if isinstance(self.depth, PnP) else 2

    def init(self, goal: Goal) -> PoseMemory:
        """Nothing chosen yet."""
        return PoseMemory()

    def step(self, memory: PoseMemory, observation: Observation, goal: Goal, basis: Array) -> tuple[PoseMemory, Command]:
        """One frame; basis (6, n) has the speed ahead as its first column and the turn as its last."""
        place, there = observation.place, goal.place
        if place is None or there is None:
            return memory, Command.rest(basis, NO_PLACE)
        direction = memory.direction or self._direction(place, there)
        arrived = memory.arrived or self._there(place, there, direction)
        memory = PoseMemory(direction, arrived)
        u = np.zeros(basis.shape[1])
        if not arrived:
            u[0], u[-1] = polar_law(place, there, np.array(direction), self.gains, self.speed_mps, self.rest_m)
        return memory, self.limits.command(u, basis)

    def _direction(self, place: Array, there: Array) -> int:
        if self.direction == "auto":
            return int(direction_to(place, there))
        return 1 if self.direction == "forward" else -1

    def _there(self, place: Array, there: Array, direction: int) -> bool:
        rho, alpha, _ = polar(place, there, np.array(direction))
        return bool(rho < self.rest_m or (rho < self.pass_m and abs(alpha) > np.pi / 2))
