"""Line following: a vehicle drives along a line on the floor, or between two,
at a constant speed.
"""

from __future__ import annotations

import math
from typing import Annotated, Literal

import numpy as np

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array
from vstestbed.core.quantity import PositiveAngle, PositiveGain, PositiveSpeed, TighterBounds, Time
from vstestbed.core.spec import spec
from vstestbed.features.depth import AtGoal
from vstestbed.features.line import (
    LineFeature,
    floor_plane,
    floor_point,
    line_interaction,
    line_on_floor,
)
from vstestbed.features.observation import Goal, Observation
from vstestbed.laws.base import Command, Law, TwistLimits, held
from vstestbed.laws.points import TOO_FEW
from vstestbed.laws.solve import Solve

_LINE = LineFeature()
# least distance of the mean look distance from the vehicle's origin: the turn rate is a speed
# divided by it
LEAST_AHEAD_M = 0.05
# time [s] and command u (n,) of the last frame with a visible line; None before the first
LineState = tuple[float, Array] | None


@spec
class LineFollowing(Law[LineState]):
    """L B u = -e_dot* at a given forward speed, with L the interaction matrix of the observed line
    (rho, theta) in the floor plane.

    The line in the image is the chord through the points where the painted line crosses the look
    distances, x_n and x_f ahead of the vehicle's origin. On the floor it is y(x) = y(m) + (x - m)
    tan(phi), with m = (x_n + x_f) / 2, and the rows of y(m) and phi follow from those of (rho,
    theta) by the chain rule. The law has two conditions, for straight lines and for bends:

        e = y(x_e) - y*,  x_e = x_n x_f / (x_n + x_f)    -lambda e  = J_y B u
        kappa = tan(phi) / (m + y* tan(phi))             -v kappa   = J_phi B u
                                                         (only for bases with lateral motion)

    J_y is evaluated for the line moved sideways to its desired position: there a turn w changes y
    by -(m + y* tan(phi)) w. For the observed line, far beside the vehicle, that lever, m + y
    tan(phi), would pass through zero.

    A painted arc of curvature k, tangent to the vehicle's path at its origin, crosses x at
    k x^2 / 2. Its chord is zero at x_e for every k: so e vanishes, to second order, in every bend
    that is followed exactly. And while an arc is followed, phi is constant, so that e changes as
    y(m) does: hence J_y is taken at m, and not at x_e, where that of a straight line would be. Both
    together leave no error at constant curvature. With a small offset y0 and heading error psi
    (kinematics):

        car:   y0_dot = v psi,  psi_dot = -(lambda x_e + v) psi / m - lambda y0 / m
               (near and far close together and lambda = 2 v / m: pure pursuit of the point at m,
               damping .707)
        omni:  psi_dot = -v psi / m,  y0_dot = -lambda y0 + (v - lambda x_e) psi

    Far from the line lambda |e| is limited to v tan(approach), which gives a straight approach at
    this angle.

    Where the curvature jumps, the vehicle steers too early, because the camera looks ahead: a car's
    origin leaves the line by about k m^2 / 9, which speaks for a camera under the car and against
    one at its front. Of two lines both count, in least squares; one is enough. While none is
    visible for less than `coast_s`, the last command is held.

    Args:
        gain: lambda [1/s].
        cruise_mps: v, the forward speed of the vehicle's origin [m/s].
        approach_deg: the steepest angle of approach to the line [deg].
        coast_s: how long the last command is held without a visible line [s].
        solve: inversion of the matrix of the motions other than the forward one (`Solve`).
        limits: largest speed and rate of the commanded twist.

    References: L of a line: Espiau, Chaumette & Rives 1992, doi:10.1109/70.143350. Following a
    curve on the ground by its image's shape: Ma, Kosecka & Sastry 1999, IEEE Transactions on
    Robotics and Automation 15(3), p. 521; with the speed given and the turn from the image:
    Cherubini, Chaumette & Oriolo 2011, doi:10.1017/S0263574711000221. Arc to a point ahead: Coulter
    1992, CMU-RI-TR-92-01.
    """

    kind: Literal["line_following"] = "line_following"
    tasks = ("line",)
    inputs = ("xy",)
    # points at one look distance on the floor have one depth, for a camera without roll
    depth = AtGoal()
    gain: PositiveGain = 3.0
    cruise_mps: PositiveSpeed = 0.8
    approach_deg: Annotated[PositiveAngle, TighterBounds(lt=80)] = 25.0
    coast_s: Time = 0.2
    solve: Solve = Solve()
    limits: TwistLimits = TwistLimits()

    def markers_needed(self, basis: Array) -> int:
        """The two points of a line."""
        return 2

    def check(self, points: Array, goal: Goal) -> None:
        """Refuse look distances that are not ahead of the vehicle's origin, or not on the floor in
        the camera's view.
        """
        ahead = _on_floor(goal.xy, goal)[..., 0]
        # also where it is NaN: a ray that does not meet the floor
        if not ahead.mean() >= LEAST_AHEAD_M:
            words = (
                f"must have its middle {LEAST_AHEAD_M:g} m or more before the vehicle's origin,"
                f" in the camera's view of the floor; with this mount it is {ahead.mean():.3g} m"
            )
            raise ParameterError("target.look_m", words)

    def step(
        self, state: LineState, observation: Observation, goal: Goal, basis: Array
    ) -> tuple[LineState, Command]:
        """One frame; the first column of basis (6, n) is the forward motion, the last one the
        rotation.
        """
        # NaN where a point is not detected, and where its ray does not meet the floor; a line needs
        # both points.
        seen = np.isfinite(_on_floor(observation.xy, goal)).all(axis=(1, 2))
        if not seen.any():
            u = state[1] if state is not None and observation.t - state[0] <= self.coast_s else None
            return state, held(self.limits, u, basis, TOO_FEW)
        # the desired lateral position of each line, to the left [m]
        aim = _on_floor(goal.xy, goal)[seen, :, 1].mean(axis=1)
        xy = observation.xy.reshape(-1, 2, 2)[seen]
        mount = goal.T_base_camera
        v = self.cruise_mps
        near, far = np.moveaxis(floor_point(xy, mount)[..., 0], -1, 0)
        middle = (near + far) / 2
        exact = near * far / (near + far)
        rho, theta = np.moveaxis(_LINE.measure(xy), -1, 0)
        L = line_interaction(rho, theta, floor_plane(mount)) @ basis
        # One chord, evaluated at two distances: the error at x_e, its derivative at m (see the
        # class).
        e, _ = line_on_floor(rho, theta, mount, exact)[0].T
        s, J = line_on_floor(rho, theta, mount, middle)
        rows = J @ L  # (lines, 2, n): of y at the middle, and of phi
        slope = np.tan(s[:, 1])
        # the lever of the turn at the desired position, m + y* tan(phi)
        rows[:, 0, -1] += (s[:, 0] - aim) * slope
        steepest = v * math.tan(math.radians(self.approach_deg))
        A = rows[:, 0]
        b = -np.clip(self.gain * (e - aim), -steepest, steepest)
        if basis.shape[1] > 2:  # a car's two motions are determined by the speed and by e
            A = np.concatenate([A, rows[:, 1]])
            b = np.concatenate([b, -v * slope / (middle + aim * slope)])
        # the given speed, moved to the right side
        u = np.concatenate([[v], self.solve.least_squares(A[:, 1:], b - v * A[:, 0])])
        return (observation.t, u), self.limits.command(u, basis)


def _on_floor(xy: Array, goal: Goal) -> Array:
    """The points xy (N, 2) of the lines on the floor, in the vehicle frame: (lines, 2, 2) [m]."""
    return floor_point(xy, goal.T_base_camera).reshape(-1, 2, 2)
