"""Pure pursuit: a vehicle keeps a gap behind a point that another one carries."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge, Gt

from vstestbed.core.geometry import Array
from vstestbed.core.planar import relative
from vstestbed.core.spec import spec
from vstestbed.features.depth import Depth, OnFloor, PnP
from vstestbed.features.observation import Goal, Observation
from vstestbed.laws.base import Command, LawBase, TwistLimits
from vstestbed.laws.select import NO_POSE, TOO_FEW


@dataclass(frozen=True, slots=True)
class PursuitMemory:
    """Of the last frame with the target in sight: its time [s], the gap [m], the way by odometry (3,), the order u (n,), and
    the target's speed along the line of sight [m/s], filtered.
    """

    t: float = math.nan
    gap: float = math.nan
    odometry: Array | None = None
    u: Array | None = None
    speed: float = 0.0


@spec
class Pursuit(LawBase):
    """v = v_target + lambda (d - d*),  w = v kappa,  kappa = 2 y / d^2,  with (x, y) the target on the floor and d its distance.

    kappa is the curvature of the arc that leads from the vehicle, tangentially, to the target. The target's own speed along
    the line of sight is told by how the gap changes and by the vehicle's encoders, v_target = d_dot + v cos(alpha), filtered
    with the time constant `filter_s`: so the gap has no steady error behind a steady leader. While the target is out of sight
    for less than `coast_s` the last order stands. The vehicle does not reverse: too near, it waits.

    Args:
        gain: lambda [1/s].
        filter_s: time constant of the estimate of the target's speed [s].
        coast_s: how long the last order stands without sight [s].
        depth: where the target's distance comes from; `floor` needs one or two points of known height, `pnp` three or more. What is
            pursued is the target's origin; a single point tells its own place and no heading, and so must be over the origin.
        limits: largest speed and rate of the commanded twist.

    References: Coulter 1992, Implementation of the pure pursuit path tracking algorithm, CMU-RI-TR-92-01; Corke 2017,
    Robotics, Vision & Control, section 4.2.3.
    """

    kind: Literal["pursuit"] = "pursuit"
    tasks = ("gap",)
    inputs = ("T_camera_target", "odometry")
    gain: Annotated[float, Gt(0)] = 1.0
    filter_s: Annotated[float, Gt(0)] = 0.5
    coast_s: Annotated[float, Ge(0)] = 0.5
    depth: Depth = OnFloor()
    limits: TwistLimits = TwistLimits()

    def markers_needed(self, basis: Array) -> int:
        """With the floor known one tells where it is; a pose without it needs three."""
        return 3 if isinstance(self.depth, PnP) else 1

    def init(self, goal: Goal) -> PursuitMemory:
        """Nothing seen yet."""
        return PursuitMemory()

    def step(self, memory: PursuitMemory, observation: Observation, goal: Goal, basis: Array) -> tuple[PursuitMemory, Command]:
        """One frame; basis (6, n) has the speed ahead as its first column and the turn as its last."""
        T, way = observation.T_camera_target, observation.odometry
        if T is None or way is None or goal.gap_m is None or not observation.seen.any():
            why = NO_POSE if observation.seen.any() else TOO_FEW
            if memory.u is not None and observation.t - memory.t <= self.coast_s:
                return memory, replace(self.limits.command(memory.u, basis), rest_reason=why)
            return memory, Command.rest(basis, why)
        x, y = (goal.T_base_camera @ T)[:2, 3].tolist()
        gap = math.hypot(x, y)
        speed = self._target_speed(memory, observation.t, gap, way, math.atan2(y, x))
        v = max(speed + self.gain * (gap - goal.gap_m), 0.0)
        u = np.zeros(basis.shape[1])
        u[0], u[-1] = v, v * 2 * y / max(gap, 1e-3) ** 2
        return PursuitMemory(observation.t, gap, way, u, speed), self.limits.command(u, basis)

    def _target_speed(self, memory: PursuitMemory, t: float, gap: float, way: Array, bearing: float) -> float:
        if memory.odometry is None or t <= memory.t:
            return 0.0
        dt = t - memory.t
        own = float(relative(memory.odometry, way)[0]) / dt
        measured = (gap - memory.gap) / dt + own * math.cos(bearing)
        return memory.speed + (1 - math.exp(-dt / self.filter_s)) * (measured - memory.speed)
