"""Differences of angles, and a bounded inverse for angular rates where an angle is undefined."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vstestbed.core.geometry import Array

FLOOR = 1e-3
"""Radius, in normalised coordinates or as the sine of a colatitude, under which a bearing is noise: about one pixel of a usual
camera."""
ROUNDING = 1e-12
"""Radius, or sine of a colatitude, below which a bearing is undefined: pi has a sine of 1.2e-16."""
CENTRE = 1e-2
"""Radius, or sine of a colatitude, within which the weight of a marker's bearing decreases to zero: some 4 to 8 pixels."""


def wrap(angle: Array) -> Array:
    """The same angle in (-pi, pi] rad, any shape; angles in the interval are returned unchanged, bit by bit."""
    angle = np.asarray(angle, dtype=float)
    # A plain modulo would also round angles that need no wrapping, and with them small errors.
    inside = (angle > -np.pi) & (angle <= np.pi)
    if inside.all():
        return angle.copy()
    turned = angle - 2 * np.pi * np.ceil((angle - np.pi) / (2 * np.pi))
    turned = np.where(turned <= -np.pi, np.pi, np.minimum(turned, np.pi))  # rounding errors next to odd multiples of pi
    return np.where(inside, angle, turned)


def wrap_together(angle: Array, votes: NDArray[np.bool_] | None = None) -> Array:
    """Errors of N angles (..., N) [rad], each wrapped to (-pi, pi], near a half turn all with one sign.

    If all exceed 90 degrees in size, those with the sign of the minority are shifted by 2 pi (both equal: to positive). Otherwise
    rounding would decide for each point whether it moves clockwise or not. NaN stays NaN and does not count, nor does an angle
    where `votes` (..., N) is False; one of those under 90 degrees is not shifted.
    """
    e = wrap(angle)
    heard = e if votes is None else np.where(votes, e, np.nan)
    some_small = (np.abs(heard) <= np.pi / 2).any(axis=-1, keepdims=True)
    if some_small.all():
        return e
    positive = np.nansum(np.sign(heard), axis=-1, keepdims=True) >= 0
    half_turn = ~some_small & (np.abs(e) > np.pi / 2)
    return np.where(half_turn & ((e > 0) != positive), e + np.where(positive, 2, -2) * np.pi, e)


def bearing_weight(radius: Array, less_at_centre: bool) -> Array:
    """Weight of a bearing at a radius (or sine of a colatitude), any shape: 1, and 0 at the centre itself, where it is undefined.

    With `less_at_centre` it is r/1e-2 up to r = 1e-2: close to the centre any error of position may turn a bearing by up to half a
    turn.
    """
    radius = np.asarray(radius, dtype=float)
    return np.minimum(radius / CENTRE, 1.0) if less_at_centre else np.where(radius > ROUNDING, 1.0, 0.0)


def bearing_error(s: Array, s_star: Array, weight: Array, weight_star: Array, together: bool) -> Array:
    """Error of bearings w w* wrap(phi - phi*), of s and s* (..., N) [rad], with their weights w and w* (..., N) (`bearing_weight`).

    With `together`, all have one sign near a half turn (`wrap_together`), that of the markers of full weight in both views. At
    s* = s its derivative is w^2 phi_dot.
    """
    weight = weight * weight_star
    e = np.subtract(s, s_star, dtype=float)
    return weight * (wrap_together(e, weight >= 1) if together else wrap(e))


def bounded_inverse(x: Array) -> Array:
    """1/x for x > 1e-3, else x/1e-6: continuous, at most 1e3, zero at zero; x >= 0, any shape."""
    x = np.asarray(x, dtype=float)
    return np.where(x > FLOOR, 1 / np.maximum(x, FLOOR), x / FLOOR / FLOOR)
