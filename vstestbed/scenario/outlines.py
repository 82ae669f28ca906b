"""Outlines that run along a body as the camera moves, those of a ball and of a disc: what they tell."""

from __future__ import annotations

import numpy as np

from vstestbed.core.geometry import Array, exp, lengths
from vstestbed.targets import Target

STEP = 1e-4
"""Motions to both sides by which an outline's directions are differentiated [m, rad]."""
LEAST_TOLD = 1e-6
"""Share of the largest singular value from which a motion counts as told: the differences are exact to some 1e-8."""


def runs_along(target: Target) -> bool:
    """Whether the points are on an outline that lies elsewhere on the target for each place of the camera: they tell no pose."""
    return target.outlined and not len(target.places)


def is_sized(target: Target) -> bool:
    """Whether the size of the target's outline tells its place: of a ball, not of a disc."""
    return target.by_size(np.zeros((len(target.points), 3))) is not None


def called(target: Target) -> str:
    """A target whose outline runs along it, in words."""
    return "a ball" if is_sized(target) else "a disc"


def motions_told(target: Target, T_camera_target: Array, basis: Array) -> int:
    """How many of a camera's motions the picture of the target's points tells at most, at a pose (4, 4): the rank of d directions / d u.

    A feature is a function of that picture, whatever its own interaction matrix says: that of points takes each for fixed to the
    target. All motions where the points have places of their own, as far as their features tell them.

    Args:
        basis: the robot's motions as twists of the camera in its own frame, (6, n).
    """
    if not runs_along(target):
        return basis.shape[1]
    before, after = (target.points_at(exp(way * STEP * basis.T) @ T_camera_target) for way in (1, -1))  # the camera moves the other way
    rates = (after / lengths(after) - before / lengths(before)) / (2 * STEP)
    if not np.isfinite(rates).all():  # from inside a ball; the goal view is refused elsewhere
        return basis.shape[1]
    return int(np.linalg.matrix_rank(rates.reshape(len(rates), -1), rtol=LEAST_TOLD))
