"""Inverse kinematics of an arm by Newton steps: the joint positions that put its flange somewhere, near those that it has."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from vstestbed.core.errors import UnreachableError
from vstestbed.core.geometry import Array, inverse, log, rigid_error
from vstestbed.robots.resolved_rate import resolved_rate

MOST_STEPS = 200
LARGEST_STEP = 0.3
"""Largest change of a joint in one step [rad, m]: within it the Jacobian is a fair guess."""
NEAR_M, NEAR_RAD = 1e-7, 1e-7
"""Distance from the wanted pose at which the joints count as found: a ten-thousandth of what a camera can tell."""


def joints_at(
    kinematics: Callable[[Array], tuple[Array, Array]],
    T_world_flange: Array,
    near: Array,
    limits: Array,
    unit_m: float,
    inward: Callable[[Array], Array] = np.zeros_like,
) -> Array:
    """Joint positions (n,) [rad, m] of a flange pose (4, 4).

    q <- clip(q + J^+ log(T(q)^-1 T) + N inward(q)), with the damped inverse J^+ of `resolved_rate`, without the columns of joints that
    stand at a limit and would move beyond it, and N the null space of J for more than six joints.

    Args:
        kinematics: T_world_flange (4, 4) and the flange's Jacobian (6, n) of joints (n,). T_world_flange: the pose that is wanted.
        near: joints to begin at: of several postures the one that Newton's steps reach from there is found.
        limits: lowest and highest position of each joint (n, 2). unit_m: length that makes metres and radians comparable [m].
        inward: motion of the joints (n,) away from their limits, in the null space of a seventh joint.

    Raises:
        UnreachableError: the arm does not get there; with how near it comes.

    Reference: Siciliano, Sciavicco, Villani & Oriolo 2009, Robotics, section 3.7, doi:10.1007/978-1-84628-642-1.
    """
    q, away_m, away_rad = np.clip(near, *limits.T), np.inf, np.inf
    for _ in range(MOST_STEPS):
        T, J = kinematics(q)
        away_m, away_rad = rigid_error(T, T_world_flange)
        if away_m < NEAR_M and away_rad < NEAR_RAD:
            return q
        step = _step(J, log(inverse(T) @ T_world_flange), q, limits, unit_m)
        if len(q) > 6:
            free = inward(q) * min(1.0, away_rad + away_m / unit_m)  # it fades: with the damped inverse it moves the flange a little
            step = step + free - resolved_rate(J, J @ free, unit_m)
        q = np.clip(q + step * min(1.0, LARGEST_STEP / max(float(np.abs(step).max()), 1e-12)), *limits.T)
    words = f"is out of its reach: it stays {1000 * away_m:.0f} mm and {np.degrees(away_rad):.1f} deg away"
    raise UnreachableError("robot.start", words)


def _step(J: Array, twist: Array, q: Array, limits: Array, unit_m: float) -> Array:
    """Motion of the joints (n,) for a twist (6,) of the flange: joints at their limits stay, and the others make up for them."""
    low, high = limits.T
    step = resolved_rate(J, twist, unit_m)
    for _ in q:
        blocked = ((q <= low) & (step < 0)) | ((q >= high) & (step > 0))
        if not blocked.any():
            break
        J = np.where(blocked, 0.0, J)
        step = resolved_rate(J, twist, unit_m)
    return step
