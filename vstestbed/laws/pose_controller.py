"""The pose controller: a vehicle that cannot move sideways drives to a goal pose, localised by
landmarks and a compass.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array
from vstestbed.core.planar import wrapped
from vstestbed.core.quantity import Distance, PositiveLength, PositiveSpeed, SignedGain
from vstestbed.core.spec import spec
from vstestbed.features.depth import Depth, PnP
from vstestbed.features.observation import Goal, Observation
from vstestbed.laws.base import Command, Law, TwistLimits

# Driving to a pose in polar coordinates about the goal: the mathematics of the pose controller.
#
# A vehicle that cannot move sideways cannot be stabilised at a pose by any smooth feedback of its
# pose (Brockett 1983). A linear law in polar coordinates about the goal, which are singular there,
# can. With rho the distance and theta the heading, driving forward:
#
#     alpha = angle to the goal - theta           beta = heading of the goal - theta - alpha
#     rho_dot   = -v cos(alpha)
#     alpha_dot = v sin(alpha) / rho - w
#     beta_dot  = -v sin(alpha) / rho
#     v = k_rho rho,  w = k_alpha alpha + k_beta beta
#
# is stable for k_rho > 0, k_beta < 0, k_alpha > k_rho. In reverse the vehicle's rear is taken as
# its front: headings plus pi, v negative. v and w are scaled together to the speed limit, which
# keeps the curvature w / v of the path, and with it the proof.
#
# A car has a least turning radius. Near the goal alpha and beta decay with the roots of s^2 +
# (k_alpha - k_rho) s - k_rho k_beta, rho with -k_rho: where a root is slower, the curvature,
# proportional to alpha / rho, grows without bound. It does not for k_alpha >= 3 k_rho and
# -k_beta >= k_alpha - 2 k_rho. The textbook's gains 1, 5, -2 (root -.59) violate this and suit
# starts that face the goal. From anywhere in 10 m by 10 m, with any heading, a car with 1 rad of
# steering arrives in a third of the cases; with 1, 4, -2.5 in 93 %.
#
# The singularity multiplies the noise of a measured place. An error n across the line to the goal
# turns the bearing by n / rho; beta has the opposite, and v is k_rho rho, so that curvature and
# steering are off by
#
#     (k_alpha - k_beta) n / (k_rho rho^2),   tan(gamma) of a car with the wheelbase L by L times
#                                             that,
#
# with 1, 4, -2.5 and L = 1 m by 2.6 for n = 1 mm at rho = 5 cm. Near the goal the curvature
# therefore follows that of a frame, w / v, the more slowly, the nearer it is:
#
#     curvature += (rho / average_m)^3 (w / v - curvature),
#
# the first one within average_m as it is.
#
# The noise that a frame adds, n rho, then vanishes towards the goal, and the car arrives on an arc.
# With the square it would add the same everywhere; with the fourth power, or the mean of all frames
# there, the feedback is gone where play, a slippery floor or small gains still need it.
#
# Reference: Aicardi, Casalino, Bicchi & Balestrino 1995, doi:10.1109/100.388294 (the coordinates);
# Astolfi 1999, doi:10.1115/1.2802429; Corke 2017, Robotics, Vision & Control, section 4.1.4, eqs
# 4.10 to 4.13, doi:10.1007/978-3-319-54413-7; Brockett 1983, in Differential Geometric Control
# Theory, pp. 181-191.


# gains k_rho, k_alpha, k_beta of distance, bearing and heading at the goal [1/s]
Gains = tuple[float, float, float]


def polar(place: Array, goal: Array, direction: Array) -> tuple[Array, Array, Array]:
    """Polar coordinates (rho, alpha, beta) of a place about the goal.

    place, goal: (x, y, heading) of the vehicle (..., 3) and of the goal, (..., 3) or (3,) [m, m,
    rad]. direction: 1 forward, -1 in reverse (...). Returns rho [m], alpha and beta [rad] in [-pi,
    pi), (...) each. At rho = 0 the bearing is set to 0.
    """
    d = goal - place
    reverse = np.where(direction < 0, np.pi, 0.0)
    alpha = wrapped(np.arctan2(d[..., 1], d[..., 0]) - place[..., 2] - reverse)
    return np.hypot(d[..., 0], d[..., 1]), alpha, wrapped(d[..., 2] - alpha)


def direction_to(place: Array, goal: Array) -> Array:
    """1 where the goal lies ahead of the vehicle (|alpha| <= 90 degrees), -1 behind it; shape
    (...). To be called once, at the start.
    """
    return np.where(np.abs(polar(place, goal, np.array(1))[1]) <= np.pi / 2, 1, -1)


def polar_law(
    place: Array,
    goal: Array,
    direction: Array,
    gains: Gains,
    speed_limit: float,
    rest_m: float = 0.02,
) -> tuple[Array, Array]:
    """Speed and yaw rate towards the goal, scaled together to the speed limit.

    v = direction k_rho rho,  w = k_alpha alpha + k_beta beta,
    both times min(1, speed_limit / |v|); rest where rho < rest_m.

    The speed never changes its sign: a vehicle that misses the goal passes it and comes round
    again.

    place, goal, direction: as of `polar`; the direction is kept from the start (`direction_to`).
    speed_limit: largest speed [m/s].
    rest_m: distance from the goal under which both are 0 [m]. Returns v [m/s], w [rad/s], (...)
    each; the vehicle limits arcs that are tighter than its own.
    """
    k_rho, k_alpha, k_beta = gains
    rho, alpha, beta = polar(place, goal, direction)
    v = k_rho * rho
    # v is proportional to rho, so that 1e-12 only avoids 0/0 at the goal.
    scale = np.where(rho < rest_m, 0.0, np.minimum(1.0, speed_limit / np.maximum(v, 1e-12)))
    return direction * v * scale, (k_alpha * alpha + k_beta * beta) * scale


PoseState = tuple[int, bool, float | None]
"""Forward (1) or reverse (-1), chosen at the first known place (0 before); whether the goal has
been reached; the smoothed curvature within `average_m` [1/m], None farther off.
"""


@spec
class PoseController(Law[PoseState]):
    """v = k_rho rho,  w = k_alpha alpha + k_beta beta, about the goal, both scaled together into
    the speed limit.

    The equations and their stability are at the head of `laws.pose_controller`. With
    `direction: auto` the vehicle drives forward or in reverse, depending on which end faces the
    goal at the start. Nearer than `rest_m` it stands still for good; also within `pass_m` once the
    goal is abeam or behind, where it has just been missed and the law would drive round for another
    attempt. Within `average_m` the curvature follows w / v with the weight (rho / average_m)^3 of a
    frame, since the law multiplies the noise of the place by (k_alpha - k_beta) / (k_rho rho^2).

    Args:
        k_rho, k_alpha, k_beta: gains [1/s]; the textbook's by default. 1, 4, -2.5 suit starts from
            anywhere better.
        direction: `auto`, `forward` or `reverse`.
        rest_m: distance from the goal at which the vehicle stops [m]; must be under
            `stop.converged.position_m`.
        pass_m: distance within which a goal that is not ahead counts as reached [m].
        average_m: distance from the goal within which the curvature is smoothed [m]; 0: it never
            is.
        speed_mps: largest speed [m/s].
        depth: source of the vehicle's place: `pnp` of three or more landmarks, or `floor`, for
            which two suffice.
        limits: largest speed and rate of the commanded camera twist.

    References: Aicardi et al. 1995, doi:10.1109/100.388294; Astolfi 1999, doi:10.1115/1.2802429;
    Corke 2017, Robotics, Vision & Control, eqs 4.10-4.13 and section 16.4.2.
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
    average_m: Distance = 0.3
    speed_mps: PositiveSpeed = 1.0
    depth: Depth = PnP()
    limits: TwistLimits = TwistLimits()

    def __post_init__(self) -> None:
        """Refuse gains that make the loop unstable."""
        if not self.k_rho > 0:
            raise ParameterError.bound(
                "k_rho",
                ">",
                "0 [1/s]",
                self.k_rho,
                why="otherwise the vehicle drives away from the goal",
            )
        if not self.k_beta < 0:
            raise ParameterError.bound(
                "k_beta",
                "<",
                "0 [1/s]",
                self.k_beta,
                why="otherwise it turns away from the goal's heading",
            )
        if not self.k_alpha > self.k_rho:
            raise ParameterError.bound(
                "k_alpha",
                ">",
                f"rho = {self.k_rho:g} [1/s]",
                self.k_alpha,
                why="otherwise it circles the goal",
            )

    def markers_needed(self, basis: Array) -> int:
        """Three landmarks for a pose; on a known floor two determine the place."""
        return 3 if isinstance(self.depth, PnP) else 2

    def init(self, goal: Goal) -> PoseState:
        return 0, False, None

    def step(
        self, state: PoseState, observation: Observation, goal: Goal, basis: Array
    ) -> tuple[PoseState, Command]:
        """One frame; the first column of basis (6, n) is the forward motion, the last one the
        rotation.
        """
        place = observation.place
        there = goal.place
        if place is None or there is None:
            return state, Command.rest(basis, "the vehicle's place cannot be estimated")
        u = np.zeros(basis.shape[1])
        state, u[0], u[-1] = self.toward(state, place, there)
        return state, self.limits.command(u, basis)

    def toward(
        self, state: PoseState, place: Array, there: Array
    ) -> tuple[PoseState, float, float]:
        """The next state, speed [m/s] and yaw rate [rad/s], of a vehicle at a place (3,) with the
        goal `there` (3,) [m, m, rad].
        """
        directions = {"auto": int(direction_to(place, there)), "forward": 1, "reverse": -1}
        # kept: a new choice near the goal could alternate
        direction = state[0] or directions[self.direction]
        rho, alpha, _ = polar(place, there, np.array(direction))
        # |alpha| > 90 degrees: the goal is no longer ahead in the driving direction.
        if state[1] or rho < self.rest_m or (rho < self.pass_m and abs(alpha) > np.pi / 2):
            return (direction, True, None), 0.0, 0.0
        gains = (self.k_rho, self.k_alpha, self.k_beta)
        ordered = polar_law(place, there, np.array(direction), gains, self.speed_mps, self.rest_m)
        v, w = map(float, ordered)
        if rho >= self.average_m:
            return (direction, False, None), v, w
        curvature = w / v
        if state[2] is not None:
            weight = (float(rho) / self.average_m) ** 3
            curvature = state[2] + weight * (curvature - state[2])
        return (direction, False, curvature), v, v * curvature
