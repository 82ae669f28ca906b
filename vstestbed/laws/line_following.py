"""Line following: a vehicle keeps over a line on the floor, or between two, at a constant speed."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge, Gt, Lt

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array
from vstestbed.core.spec import spec
from vstestbed.features.depth import AtGoal
from vstestbed.features.ground_line import floor_plane, floor_point, line_on_floor
from vstestbed.features.line import LineFeature, line_interaction
from vstestbed.features.observation import Goal, Observation
from vstestbed.laws.base import Command, LawBase, TwistLimits
from vstestbed.laws.select import TOO_FEW
from vstestbed.laws.solve import least_squares

LEAST_AHEAD_M = 0.05
"""The middle of both look distances must be this far before the vehicle's origin: its turn is a speed over that distance."""


@dataclass(frozen=True, slots=True)
class LineMemory:
    """Where each line shall be, `aim` (lines,) to the left [m]; of the last frame with a line in sight its time [s] and order u (n,)."""

    aim: Array
    t: float = math.nan
    u: Array | None = None


@spec
class LineFollowing(LawBase):
    """L B u = -e_dot* at a given speed ahead, with L the interaction matrix of the line seen, (rho, theta), through the floor's plane.

    The picture's line goes through the points where the painted one crosses the look distances, x_n and x_f ahead of the
    vehicle's origin. On the floor it is y(x) = y(m) + (x - m) tan(phi), with m = (x_n + x_f) / 2, and the rows of y(m) and phi
    are those of (rho, theta) by the chain rule. Two conditions, a straight line's and a bend's, one law:

        e = y(x_e) - y*,  x_e = x_n x_f / (x_n + x_f)       -lambda e  = J_y B u
        kappa = tan(phi) / (m + y* tan(phi))                -v kappa   = J_phi B u      (only for bases that can go sideways)

    J_y is that of the line moved sideways to where it shall be: by it a turn w changes y by -(m + y* tan(phi)) w. Of a line far
    beside the vehicle that lever, m + y tan(phi), passes zero.

    A painted arc of curvature k, tangent to the vehicle's way at its origin, crosses x at k x^2 / 2. Its chord is zero at x_e
    whatever k is: so e vanishes on every bend that is driven rightly, to second order. And while an arc is followed phi
    stays what it is, so that e changes as y(m) alone does: hence J_y is taken at m, and not at x_e, where a straight line's
    would be. Both together leave no error on a constant curvature. With a small offset y0 and heading error psi (kinematics):

        car:   y0_dot = v psi,  psi_dot = -(lambda x_e + v) psi / m - lambda y0 / m          (near and far close together and
               lambda = 2 v / m: pure pursuit of the point at m, damping .707)
        omni:  psi_dot = -v psi / m,  y0_dot = -lambda y0 + (v - lambda x_e) psi

    Far from the line lambda |e| is held to v tan(approach): with J_y for what e changes by, that is a straight approach under
    this angle.

    Where the curvature jumps, what lies ahead is steered for too early: a car's origin leaves the line by
    about k m^2 / 9, which speaks for a camera under the car and against one at its front. With two lines
    both count, in least squares; one is enough. While none is in sight for less than `coast_s` the last order stands.

    Args:
        gain: lambda [1/s].
        cruise_mps: v, the speed ahead of the vehicle's origin [m/s].
        approach_deg: the steepest angle at which the line is approached [deg].
        coast_s: how long the last order stands without sight [s].
        limits: largest speed and rate of the commanded twist.

    References: L of a line: Espiau, Chaumette & Rives 1992, doi:10.1109/70.143350. Following a curve on the ground by its
    image's shape: Ma, Kosecka & Sastry 1999, IEEE Transactions on Robotics and Automation 15(3), p. 521; with the speed given and
    the turn from the image: Cherubini, Chaumette & Oriolo 2011, doi:10.1017/S0263574711000221. Arc to a point ahead: Coulter 1992,
    CMU-RI-TR-92-01.
    """

    kind: Literal["line_following"] = "line_following"
    tasks = ("line",)
    inputs = ("xy",)
    depth = AtGoal()  # on the floor it depends on the look distance alone, for a camera without roll
    gain: Annotated[float, Gt(0)] = 3.0
    cruise_mps: Annotated[float, Gt(0)] = 0.8
    approach_deg: Annotated[float, Gt(0), Lt(80)] = 25.0
    coast_s: Annotated[float, Ge(0)] = 0.2
    limits: TwistLimits = TwistLimits()

    def markers_needed(self, basis: Array) -> int:
        """The two points of a line."""
        return 2

    def check(self, points: Array, goal: Goal) -> None:
        """Refuse look distances that are not ahead of the vehicle's origin, or not on the floor."""
        ahead = _on_floor(goal.xy, goal)[..., 0]
        if not ahead.mean() >= LEAST_AHEAD_M:
            words = f"must have its middle {LEAST_AHEAD_M:g} m or more before the vehicle's origin, in the camera's view of the floor"
            raise ParameterError("target.look_m", f"{words}; with this mount it is {ahead.mean():.3g} m")

    def init(self, goal: Goal) -> LineMemory:
        """Nothing seen yet."""
        return LineMemory(aim=_on_floor(goal.xy, goal)[..., 1].mean(axis=1))

    def step(self, memory: LineMemory, observation: Observation, goal: Goal, basis: Array) -> tuple[LineMemory, Command]:
        """One frame; basis (6, n) has the speed ahead as its first column and the turn as its last."""
        xy = observation.xy.reshape(-1, 2, 2)
        seen = np.isfinite(_on_floor(observation.xy, goal)).all(axis=(1, 2))
        if not seen.any():
            if memory.u is not None and observation.t - memory.t <= self.coast_s:
                return memory, replace(self.limits.command(memory.u, basis), rest_reason=TOO_FEW)
            return memory, Command.rest(basis, TOO_FEW)
        u = self._motion(xy[seen], memory.aim[seen], goal, basis)
        return LineMemory(memory.aim, observation.t, u), self.limits.command(u, basis)

    def _motion(self, xy: Array, aim: Array, goal: Goal, basis: Array) -> Array:
        """The order (n,) for lines through normalised points xy (lines, 2, 2) that shall be at `aim` (lines,) to the left."""
        mount, v = goal.T_base_camera, self.cruise_mps
        near, far = np.moveaxis(floor_point(xy, mount)[..., 0], -1, 0)
        middle, exact = (near + far) / 2, near * far / (near + far)
        rho, theta = np.moveaxis(LineFeature().measure(xy), -1, 0)
        L = line_interaction(rho, theta, floor_plane(mount)) @ basis
        (e, _), (s, J) = line_on_floor(rho, theta, mount, exact)[0].T, line_on_floor(rho, theta, mount, middle)
        rows, slope = J @ L, np.tan(s[:, 1])  # (lines, 2, n): of y at the middle, and of phi
        rows[:, 0, -1] += (s[:, 0] - aim) * slope  # of the turn: m + y* tan(phi)
        steepest = v * math.tan(math.radians(self.approach_deg))
        A, b = rows[:, 0], -np.clip(self.gain * (e - aim), -steepest, steepest)
        if basis.shape[1] > 2:
            A, b = np.concatenate([A, rows[:, 1]]), np.concatenate([b, -v * slope / (middle + aim * slope)])
        return np.concatenate([[v], least_squares(A[:, 1:], b - v * A[:, 0])])


def _on_floor(xy: Array, goal: Goal) -> Array:
    """The lines' points xy (N, 2) on the floor of the vehicle: (lines, 2, 2) [m]."""
    return floor_point(xy, goal.T_base_camera).reshape(-1, 2, 2)
