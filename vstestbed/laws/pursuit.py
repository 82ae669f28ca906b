"""Pure pursuit: a vehicle keeps a gap to a target on another vehicle."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from vstestbed.core.geometry import Array
from vstestbed.core.planar import relative
from vstestbed.core.quantity import PositiveGain, PositiveTime, Time
from vstestbed.core.spec import spec
from vstestbed.features.depth import Depth, OnFloor, PnP
from vstestbed.features.observation import Goal, Observation
from vstestbed.laws.base import Command, Law, TwistLimits, held
from vstestbed.laws.points import NO_POSE, TOO_FEW


@dataclass(frozen=True, slots=True)
class PursuitState:
    """State at the last frame in which the target was visible.

    Attributes:
        t: time of exposure [s].
        gap: distance of the target [m].
        odometry: (x, y, heading) by the encoders (3,) [m, rad].
        u: the command (n,).
        speed: filtered speed of the target along the line of sight [m/s].
    """

    t: float = math.nan
    gap: float = math.nan
    odometry: Array | None = None
    u: Array | None = None
    speed: float = 0.0


@spec
class Pursuit(Law[PursuitState]):
    """v = v_target + lambda (d - d*),  w = v kappa,  kappa = 2 y / d^2,  with (x, y) the target on
    the floor and d its distance.

    kappa is the curvature of the arc from the vehicle, tangential to its heading, to the target.
    The target's speed along the line of sight is estimated from the change of the gap and from the
    vehicle's encoders, v_target = d_dot + v cos(alpha), filtered with the time constant `filter_s`:
    so behind a leader of constant speed the gap has no steady error. While the target is not
    visible for less than `coast_s`, the last command is held. The vehicle does not reverse: where
    it is too near, it waits.

    Args:
        gain: lambda [1/s].
        filter_s: time constant of the estimate of the target's speed [s].
        coast_s: how long the last command is held without a visible target [s].
        depth: source of the target's distance; `floor` needs one or two points of known height,
            `pnp` three or more. The target's origin is pursued; a single point gives its own place
            but no heading, and so must lie above the origin.
        limits: largest speed and rate of the commanded twist.

    References: Coulter 1992, Implementation of the pure pursuit path tracking algorithm,
    CMU-RI-TR-92-01; Corke 2017, Robotics, Vision & Control, section 4.2.3.
    """

    kind: Literal["pursuit"] = "pursuit"
    tasks = ("gap",)
    inputs = ("T_camera_target", "odometry")
    gain: PositiveGain = 1.0
    filter_s: PositiveTime = 0.5
    coast_s: Time = 0.5
    depth: Depth = OnFloor()
    limits: TwistLimits = TwistLimits()

    def markers_needed(self, basis: Array) -> int:
        """On a known floor one marker determines its own place; a pose without the floor needs
        three.
        """
        return 3 if isinstance(self.depth, PnP) else 1

    def init(self, goal: Goal) -> PursuitState:
        return PursuitState()

    def step(
        self, state: PursuitState, observation: Observation, goal: Goal, basis: Array
    ) -> tuple[PursuitState, Command]:
        """One frame; the first column of basis (6, n) is the forward motion, the last one the
        rotation.
        """
        T = observation.T_camera_target
        way = observation.odometry
        if T is None or way is None or goal.gap_m is None or not observation.seen.any():
            u = state.u if observation.t - state.t <= self.coast_s else None
            why = NO_POSE if observation.seen.any() else TOO_FEW
            return state, held(self.limits, u, basis, why)
        x, y = (goal.T_base_camera @ T)[:2, 3].tolist()
        gap = math.hypot(x, y)
        # the first frame has no difference: the leader is taken to stand, which is the safe side
        dt = observation.t - state.t
        speed = 0.0
        if state.odometry is not None and dt > 0:
            own = float(relative(state.odometry, way)[0]) / dt
            measured = (gap - state.gap) / dt + own * math.cos(math.atan2(y, x))
            # First-order low-pass, discretised exactly, so that a frame that comes late weighs
            # more.
            speed = state.speed + (1 - math.exp(-dt / self.filter_s)) * (measured - state.speed)
        v = max(speed + self.gain * (gap - goal.gap_m), 0.0)
        u = np.zeros(basis.shape[1])
        # the bound: at the target itself the curvature is infinite
        u[0] = v
        u[-1] = v * 2 * y / max(gap, 1e-3) ** 2
        return PursuitState(observation.t, gap, way, u, speed), self.limits.command(u, basis)
