"""Differences of angles, and the inverse that keeps angular rates bounded where an angle is not defined."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vstestbed.core.geometry import Array

FLOOR = 1e-3
"""Radius, in normalised coordinates or as the sine of a colatitude, under which a bearing is not trusted: about one
pixel of a usual camera, so that what the angle tells there is noise."""
CENTRE = 1e-2
"""Radius, or sine of a colatitude, within which a marker's bearing counts less and less: some 4 to 8 pixels."""


def wrap(angle: Array) -> Array:
    """The same angle in (-pi, pi] rad, any shape; what lies there already is returned as it is, bit by bit."""
    angle = np.asarray(angle, dtype=float)
    inside = (angle > -np.pi) & (angle <= np.pi)
    if inside.all():
        return angle.copy()
    turned = angle - 2 * np.pi * np.ceil((angle - np.pi) / (2 * np.pi))
    turned = np.where(turned <= -np.pi, np.pi, np.minimum(turned, np.pi))  # rounding, just past an odd multiple of pi
    return np.where(inside, angle, turned)


def wrap_together(angle: Array, votes: NDArray[np.bool_] | None = None) -> Array:
    """Errors of N angles (..., N) [rad], each wrapped to (-pi, pi], near a half turn all with one sign.

    Only where every one exceeds 90 degrees in size, those of the minority's sign are carried over to the majority's by
    2 pi (to positive where both are as many): rounding else sends some points clockwise and others against it. NaN
    stays NaN and has no vote, nor has an angle where `votes` (..., N) is False; one under 90 degrees that has none stays.
    """
    e = wrap(angle)
    heard = e if votes is None else np.where(votes, e, np.nan)
    some_small = (np.abs(heard) <= np.pi / 2).any(axis=-1, keepdims=True)
    if some_small.all():
        return e
    positive = np.nansum(np.sign(heard), axis=-1, keepdims=True) >= 0
    half_turn = ~some_small & (np.abs(e) > np.pi / 2)
    return np.where(half_turn & ((e > 0) != positive), e + np.where(positive, 2, -2) * np.pi, e)


def bearing_weight(radius: Array) -> Array:
    """How much a bearing at a radius (or sine of a colatitude) counts, any shape: 1 from 1e-2 on, r/1e-2 below, 0 at the centre.

    There the bearing itself is not defined: however near the marker, it may be off by half a turn.
    """
    return np.minimum(np.asarray(radius, dtype=float) / CENTRE, 1.0)


def bearing_error(s: Array, s_star: Array, radius: Array, radius_star: Array, together: bool) -> Array:
    """Error of bearings w(r) w(r*) wrap(phi - phi*), of s and s* (..., N) [rad] at radii (..., N), w being `bearing_weight`.

    With `together`, all have one sign near a half turn (`wrap_together`), as those tell that are not near the centre in
    either view. Next to s* = s its derivative is w(r)^2 phi_dot.
    """
    weight = bearing_weight(radius) * bearing_weight(radius_star)
    e = np.subtract(s, s_star, dtype=float)
    return weight * (wrap_together(e, weight >= 1) if together else wrap(e))


def bounded_inverse(x: Array) -> Array:
    """1/x for x > 1e-3, below that x/1e-6: continuous, never above 1e3, zero at zero; x >= 0, any shape."""
    x = np.asarray(x, dtype=float)
    return np.where(x > FLOOR, 1 / np.maximum(x, FLOOR), x / FLOOR / FLOOR)
