"""The pose controller: a vehicle that cannot move sideways drives to a goal pose, localised by landmarks and a compass."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array
from vstestbed.core.quantity import Distance, PositiveLength, PositiveSpeed, SignedGain
from vstestbed.core.spec import spec
from vstestbed.features.depth import Depth, PnP
from vstestbed.features.observation import Goal, Observation
from vstestbed.laws.base import Command, LawBase, TwistLimits
from vstestbed.laws.polar_pose import PolarGains, direction_to, polar, polar_law

NO_PLACE = "the vehicle's place cannot be estimated"


@dataclass(frozen=True, slots=True)
class PoseMemory:
    """Forward (1) or reverse (-1), chosen at the first known place (0 before), and whether the goal has been reached."""

    direction: int = 0
    arrived: bool = False


@spec
class PoseController(LawBase):
    """v = k_rho rho,  w = k_alpha alpha + k_beta beta, about the goal, both scaled together into the speed limit.

    The equations, their stability and their source are in `laws.polar_pose`. With `direction: auto` the vehicle drives forward or in
    reverse, depending on which end faces the goal at the start. Nearer than `rest_m` it stands still for good; also within
    `pass_m` once the goal is abeam or behind, where it has just been missed and the law would drive round for another attempt.

    Args:
        k_rho, k_alpha, k_beta: gains [1/s]; the textbook's by default. 1, 4, -2.5 suit starts from anywhere better.
        direction: `auto`, `forward` or `reverse`.
        rest_m: distance from the goal at which the vehicle stops [m]; must be under `stop.converged.position_m`.
        pass_m: distance within which a goal that is not ahead counts as reached [m].
        speed_mps: largest speed [m/s].
        depth: source of the vehicle's place: `pnp` of three or more landmarks, or `floor`, for which two suffice.
        limits: largest speed and rate of the commanded camera twist.

    References: Astolfi 1999, doi:10.1115/1.2802429; Corke 2017, Robotics, Vision & Control, eqs 4.10-4.13 and section 16.4.2.
    """

    kind: Literal["pose_controller"] = "pose_controller"
    tasks = ("pose",)
    inputs = ("place",)
    k_rho: SignedGain = 1.0
    k_alpha: SignedGain = 5.0
    k_beta: SignedGain = -2.0
    direction: Literal["auto", "forward", "reverse"] = "auto"
    rest_m: PositiveLength = 0.02
    pass_m: Distance = 0.1
    speed_mps: PositiveSpeed = 1.0
    depth: Depth = PnP()
    limits: TwistLimits = TwistLimits()

    def __post_init__(self) -> None:
        """Refuse gains that make the loop unstable."""
        try:
            self.gains  # noqa: B018 - the constructor of PolarGains checks them
        except ParameterError as error:
            raise ParameterError(f"k_{error.field}", error.problem, error.found) from None

    @property
    def gains(self) -> PolarGains:
        """The gains of the polar law."""
        return PolarGains(self.k_rho, self.k_alpha, self.k_beta)

    def markers_needed(self, basis: Array) -> int:
        """Three landmarks for a pose; on a known floor two determine the place."""
        return 3 if isinstance(self.depth, PnP) else 2

    def init(self, goal: Goal) -> PoseMemory:
        """No direction chosen so far."""
        return PoseMemory()

    def step(self, memory: PoseMemory, observation: Observation, goal: Goal, basis: Array) -> tuple[PoseMemory, Command]:
        """One frame; the first column of basis (6, n) is the forward motion, the last one the rotation."""
        place, there = observation.place, goal.place
        if place is None or there is None:
            return memory, Command.rest(basis, NO_PLACE)
        direction = memory.direction or self._direction(place, there)  # kept: a new choice near the goal could alternate
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
        # |alpha| > 90 degrees: the goal is no longer ahead in the driving direction.
        return bool(rho < self.rest_m or (rho < self.pass_m and abs(alpha) > np.pi / 2))
