"""The interface of a feature: three functions that accept leading axes, no state."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array, homogeneous

MOST_CONDITION = 500.0
"""Condition of L, its largest over its smallest singular value in units of the goal, over which its
rows count as dependent. With 1300 the camera went three to five times as far as on the straight
way, or did not arrive; with 300 it went straight.
"""


class Feature(ABC):
    """A feature s(x) of N markers, with e_dot = L v for a static target and v the camera twist in
    the camera frame.

    s may have more numbers than e has rows (a polygon's s has all segments, for example). L is the
    derivative of e: of error(s(t), s*) at s* = s. It may also have `check_goal(x, distance)`, which
    raises a ParameterError for both inputs in a goal view at which it cannot work.

    Attributes:
        inputs: the two fields of an observation and of a goal that it takes; for features of wide
            lenses ("ray", "range").
        rows_per_marker: rows k of L and e for each marker, in the markers' order; 0 if the rows
            describe the set as a whole.
        least_markers: the least number of markers for which it is defined.
    """

    kind: Any  # the word in a scenario: a field of each feature
    inputs: ClassVar[tuple[str, ...]] = ("xy", "depth")
    rows_per_marker: ClassVar[int] = 0
    least_markers: ClassVar[int] = 1

    @abstractmethod
    def measure(self, x: Array, /) -> Array:
        """Feature vector s of the first input, e.g. xy (..., N, 2); ParameterError for too few
        markers.
        """

    @abstractmethod
    def interaction(self, x: Array, distance: Array, /) -> Array:
        """Interaction matrix L (..., rows, 6) of both inputs, e.g. xy (..., N, 2) and depth (...,
        N) [m].

        ParameterError where the shapes do not match, the markers are too few, or a distance is not
        positive (`checked`).
        """

    def error(self, s: Array, s_star: Array, /) -> Array:
        """Error e (..., rows): s - s*; of features with angles, these wrapped."""
        return np.subtract(s, s_star, dtype=float)

    def _checked(self, x: Array, distance: Array) -> tuple[Array, Array]:
        return checked(x, distance, self.inputs, self.least_markers)


def in_one(s: Array) -> Array:
    """The k numbers of N markers (..., N, k), one marker after the other, (..., N k)."""
    return s.reshape(*s.shape[:-2], s.shape[-2] * s.shape[-1])


def rows_in_one(L: Array) -> Array:
    """The k rows of N markers (..., N, k, 6), one marker below the other, (..., N k, 6)."""
    return L.reshape(*L.shape[:-3], L.shape[-3] * L.shape[-2], 6)


def checked(x: Array, distance: Array, inputs: tuple[str, ...], least: int) -> tuple[Array, Array]:
    """Both inputs of a feature as floating-point arrays, validated: xy (..., N, 2) or ray (..., N,
    3), and distances (..., N) [m].

    Raises ParameterError: the shapes do not match, the markers are fewer than `least`, or a
    distance is not positive.
    """
    x = np.asarray(x, dtype=float)
    distance = np.asarray(distance, dtype=float)
    name, of = inputs
    size = 3 if name == "ray" else 2
    if x.shape[-1:] != (size,) or x.shape[:-1] != distance.shape:
        raise ParameterError.count(
            of, "of the shape (..., N)", f"of {name} (..., N, {size}) = {x.shape}", distance.shape
        )
    if x.ndim < 2 or x.shape[-2] < least:
        raise ParameterError.count(
            name, f"of the shape (..., N, {size})", f"with at least {least} markers", x.shape
        )
    if not np.minimum.reduce(distance, axis=None, initial=np.inf) > 0:  # also where one is NaN
        behind = ": a point at or behind the lens has no image" if of == "depth" else ""
        raise ParameterError.bound(of, ">", f"0 m for every point{behind}")
    return x, distance


def require_plane(xy: Array, depth: Array, kind: str) -> None:
    """Refuse points xy (N, 2) at depths (N,) [m] that do not lie in one plane, for a feature of
    this kind, by a ParameterError.
    """
    p = homogeneous(xy) * np.asarray(depth)[:, None]
    spread = np.linalg.svd(p - p.mean(axis=0), compute_uv=False)
    if spread[-1] > 0.01 * spread[0]:  # the scatter off the plane against the largest in it
        words = f"must have its markers in one plane for the feature {kind};"
        raise ParameterError("target", f"{words} use point, or another target")


def condition(L: Array, scale: Array, depth: Array) -> float:
    """Condition of an L (rows, 6) at the goal view: its largest over its smallest singular value,
    inf where that is 0.

    Rows are in units of their quantities `scale` (rows,), translations in units of the mean depth.
    Of more than six rows, six count.
    """
    A = L / np.asarray(scale)[:, None] * np.repeat([float(np.mean(depth)), 1.0], 3)
    if not np.isfinite(A).all():
        return np.inf
    singular = np.linalg.svd(A, compute_uv=False)
    return float(singular[0] / singular[-1]) if singular[-1] > 0 else np.inf


# Differences of angles, and a bounded inverse for angular rates where an angle is undefined.
FLOOR = 1e-3
"""Radius, in normalised coordinates or as the sine of a colatitude, under which a bearing is noise:
about one pixel of a usual camera.
"""
# radius, or sine of a colatitude, below which a bearing is undefined: pi has a sine of 1.2e-16
ROUNDING = 1e-12
# radius, or sine of a colatitude, within which the weight of a marker's bearing decreases to zero:
# some 4 to 8 pixels
CENTRE = 1e-2


def wrap(angle: Array) -> Array:
    """The same angle in (-pi, pi] rad, any shape; angles in the interval are returned unchanged,
    bit by bit.
    """
    angle = np.asarray(angle, dtype=float)
    # A plain modulo would also round angles that need no wrapping, and with them small errors.
    inside = (angle > -np.pi) & (angle <= np.pi)
    if inside.all():
        return angle.copy()
    turned = angle - 2 * np.pi * np.ceil((angle - np.pi) / (2 * np.pi))
    # rounding errors next to odd multiples of pi
    turned = np.where(turned <= -np.pi, np.pi, np.minimum(turned, np.pi))
    return np.where(inside, angle, turned)


def wrap_together(angle: Array, votes: NDArray[np.bool_] | None = None) -> Array:
    """Errors of N angles (..., N) [rad], each wrapped to (-pi, pi], near a half turn all with one
    sign, lest rounding decides for each.

    If all exceed 90 degrees in size, those with the sign of the minority are shifted by 2 pi (both
    equal: to positive). NaN stays NaN and does not count, nor does an angle where `votes` (..., N)
    is False; one of those under 90 degrees is not shifted.
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
    """Weight of a bearing at a radius (or sine of a colatitude), any shape: 1, and 0 at the centre
    itself, where it is undefined.

    With `less_at_centre` it is r/1e-2 up to r = 1e-2: close to the centre any error of position may
    turn a bearing by up to half a turn.
    """
    if less_at_centre:
        return np.minimum(radius / CENTRE, 1.0)
    return np.where(radius > ROUNDING, 1.0, 0.0)


def bounded_inverse(x: Array) -> Array:
    """1/x for x > 1e-3, else x/1e-6: continuous, at most 1e3, zero at zero; x >= 0, any shape."""
    return np.where(x > FLOOR, 1 / np.maximum(x, FLOOR), x / FLOOR / FLOOR)


@dataclass(frozen=True, slots=True)
class Dual:
    """A dual number: a real or complex quantity (...) and its derivative to the six velocities of
    the camera, value_dot = rate v, (..., 6).

    With +, -, *, /, powers, `real`, `imag` and `conj()` as numpy arrays have them, a formula
    written for arrays also takes these, and gives the derivative by the rules of calculus (forward
    differentiation): exact, and never in disagreement with the formula.
    """

    value: NDArray[Any]
    rate: NDArray[Any]
    __array_ufunc__ = None  # `array * dual` comes to __rmul__, not to numpy

    def __add__(self, other: Any) -> Dual:
        if isinstance(other, Dual):
            return Dual(self.value + other.value, self.rate + other.rate)
        return Dual(self.value + other, self.rate)

    __radd__ = __add__

    def __neg__(self) -> Dual:
        return Dual(-self.value, -self.rate)

    def __sub__(self, other: Any) -> Dual:
        return self + -other

    def __mul__(self, other: Any) -> Dual:
        if isinstance(other, Dual):
            return Dual(
                self.value * other.value,
                self.rate * other.value[..., None] + self.value[..., None] * other.rate,
            )
        return Dual(self.value * other, self.rate * other)

    __rmul__ = __mul__

    def __truediv__(self, other: Any) -> Dual:
        if isinstance(other, Dual):
            value = self.value / other.value
            return Dual(value, (self.rate - value[..., None] * other.rate) / other.value[..., None])
        return Dual(self.value / other, self.rate / other)

    def __pow__(self, power: float) -> Dual:
        return Dual(self.value**power, (power * self.value ** (power - 1))[..., None] * self.rate)

    @property
    def real(self) -> Dual:
        """The real part."""
        return Dual(np.real(self.value), np.real(self.rate))

    @property
    def imag(self) -> Dual:
        """The imaginary part."""
        return Dual(np.imag(self.value), np.imag(self.rate))

    def conj(self) -> Dual:
        """The complex conjugate."""
        return Dual(self.value.conj(), self.rate.conj())


def square(z: Any) -> Any:
    """|z|^2 of a complex array or Dual, real."""
    return z.real * z.real + z.imag * z.imag


def angle(z: Any, floor: Any = 0.0) -> Any:
    """The angle of z in (-pi, pi] rad, a complex array or Dual; its rate fades to zero with |z|
    where that is under `floor`.
    """
    if not isinstance(z, Dual):
        return np.angle(z)
    size = np.abs(z.value)
    least = np.maximum(floor, np.finfo(float).tiny)
    share = np.minimum(size / least, 1)  # once for the fading, and 1/|z| is bounded by it too
    across = (z.value.conj() / np.maximum(size, least) * share)[..., None] * z.rate
    return Dual(np.angle(z.value), across.imag / np.maximum(size, least)[..., None])


def at_least(x: Any, least: float) -> Any:
    """The larger of x, a real array or Dual, and a constant, whose rate is zero."""
    if not isinstance(x, Dual):
        return np.maximum(x, least)
    return Dual(np.maximum(x.value, least), np.where((x.value > least)[..., None], x.rate, 0.0))
