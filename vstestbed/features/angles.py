"""Differences of angles, and the inverse that keeps angular rates bounded where an angle is not defined."""

from __future__ import annotations

import numpy as np

from vstestbed.geometry import Array

FLOOR = 1e-3
"""Radius, in normalised coordinates or as the sine of a colatitude, under which a bearing is not trusted: about one
pixel of a usual camera, so that what the angle tells there is noise."""


def wrap(angle: Array) -> Array:
    """The same angle in (-pi, pi] rad, any shape; what lies there already is returned as it is, bit by bit."""
    angle = np.asarray(angle, dtype=float)
    turned = angle - 2 * np.pi * np.ceil((angle - np.pi) / (2 * np.pi))
    turned = np.where(turned <= -np.pi, np.pi, np.minimum(turned, np.pi))  # rounding, just past an odd multiple of pi
    return np.where((angle > -np.pi) & (angle <= np.pi), angle, turned)


def wrap_together(angle: Array) -> Array:
    """Errors of N angles (..., N) [rad], each wrapped to (-pi, pi], near a half turn all with one sign.

    Only where every one exceeds 90 degrees in size, those of the minority's sign are carried over to the majority's by
    2 pi (to positive where both are as many): rounding else sends some points clockwise and others against it. NaN
    stays NaN and has no vote.
    """
    e = wrap(angle)
    positive = np.nansum(np.sign(e), axis=-1, keepdims=True) >= 0
    half_turn = ~(np.abs(e) <= np.pi / 2).any(axis=-1, keepdims=True)
    return np.where(half_turn & ((e > 0) != positive), e + np.where(positive, 2, -2) * np.pi, e)


def bounded_inverse(x: Array) -> Array:
    """1/x for x > 1e-3, below that x/1e-6: continuous, never above 1e3, zero at zero; x >= 0, any shape."""
    x = np.asarray(x, dtype=float)
    return np.where(x > FLOOR, 1 / np.maximum(x, FLOOR), x / FLOOR / FLOOR)
