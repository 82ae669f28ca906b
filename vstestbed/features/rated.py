"""A quantity together with its rate under a camera twist, so that a formula gives both s and its row of L."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class Rated:
    """A real or complex quantity and its derivative to the six velocities of the camera.

    With +, -, *, /, powers, `real`, `imag` and `conj()` as numpy arrays have them, a formula written for arrays also takes these, and gives
    the derivative by the rules of calculus (forward differentiation): exact, and never in disagreement with the formula.

    Attributes:
        value: of any shape (...).
        rate: q with value_dot = q v, shape (..., 6).
    """

    value: NDArray[Any]
    rate: NDArray[Any]
    __array_ufunc__ = None  # `array * rated` comes to __rmul__, not to numpy

    def __add__(self, other: Any) -> Rated:
        """The sum with a Rated, or with a constant."""
        if isinstance(other, Rated):
            return Rated(self.value + other.value, self.rate + other.rate)
        return Rated(self.value + other, self.rate)

    __radd__ = __add__

    def __neg__(self) -> Rated:
        """The quantity with the other sign."""
        return Rated(-self.value, -self.rate)

    def __sub__(self, other: Any) -> Rated:
        """The difference from a Rated, or from a constant."""
        return self + -other

    def __mul__(self, other: Any) -> Rated:
        """The product with a Rated, or with a constant."""
        if isinstance(other, Rated):
            return Rated(self.value * other.value, self.rate * other.value[..., None] + self.value[..., None] * other.rate)
        return Rated(self.value * other, self.rate * other)

    __rmul__ = __mul__

    def __truediv__(self, other: Any) -> Rated:
        """The ratio to a Rated, or to a constant."""
        if isinstance(other, Rated):
            value = self.value / other.value
            return Rated(value, (self.rate - value[..., None] * other.rate) / other.value[..., None])
        return Rated(self.value / other, self.rate / other)

    def __pow__(self, power: float) -> Rated:
        """The power with a constant exponent."""
        return Rated(self.value**power, (power * self.value ** (power - 1))[..., None] * self.rate)

    @property
    def real(self) -> Rated:
        """The real part."""
        return Rated(np.real(self.value), np.real(self.rate))

    @property
    def imag(self) -> Rated:
        """The imaginary part."""
        return Rated(np.imag(self.value), np.imag(self.rate))

    def conj(self) -> Rated:
        """The complex conjugate."""
        return Rated(self.value.conj(), self.rate.conj())


def square(z: Any) -> Any:
    """|z|^2 of a complex array or Rated, real."""
    return z.real * z.real + z.imag * z.imag


def angle(z: Any, floor: Any = 0.0) -> Any:
    """The angle of z in (-pi, pi] rad, a complex array or Rated; its rate fades to zero with |z| where that is under `floor`."""
    if not isinstance(z, Rated):
        return np.angle(z)
    size, least = np.abs(z.value), np.maximum(floor, np.finfo(float).tiny)
    share = np.minimum(size / least, 1)  # once for the fading, and 1/|z| is bounded by it too
    across = (z.value.conj() / np.maximum(size, least) * share)[..., None] * z.rate
    return Rated(np.angle(z.value), across.imag / np.maximum(size, least)[..., None])


def at_least(x: Any, least: float) -> Any:
    """The larger of x, a real array or Rated, and a constant, whose rate is zero."""
    if not isinstance(x, Rated):
        return np.maximum(x, least)
    return Rated(np.maximum(x.value, least), np.where((x.value > least)[..., None], x.rate, 0.0))
