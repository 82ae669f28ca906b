"""Numbers along an axis: where they stand, and as text."""

from __future__ import annotations

from math import ceil, floor, log10

import numpy as np

from vstestbed.core.geometry import Array

RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def ticks(low: float, high: float, most: int) -> Array:
    """At most so many intervals of 1, 2, 2.5 or 5 times a power of ten: their ends from `low` to `high`."""
    raw = (high - low) / max(most, 1)
    step = next(s for s in (f * 10.0 ** floor(log10(raw)) for f in (1, 2, 2.5, 5, 10)) if s >= raw * (1 - 1e-9))
    return step * np.arange(ceil(low / step - 1e-9), floor(high / step + 1e-9) + 1, dtype=float)


def log_ticks(low: float, high: float, most: int) -> Array:
    """Powers of ten; of less than two of them also twice and five times, and of less than two of these as on a linear axis."""
    powers = range(floor(log10(low)), ceil(log10(high)) + 1)
    for factors in ((1.0,), (1.0, 2.0, 5.0)):
        at = np.array([f * 10.0**k for k in powers for f in factors])
        at = at[(at >= low * (1 - 1e-9)) & (at <= high * (1 + 1e-9))]
        if len(at) > 1:
            return at[:: -(-len(at) // (most + 1))]
    return ticks(low, high, most)


def numerals(at: Array, powers: bool = False) -> list[str]:
    """The numbers of ticks, with the same number of decimals, or with powers of ten where these are shorter (or asked for)."""
    if powers or (decimals := _decimals(at)) is None:
        return [_power(float(v)) for v in at]
    return [f"{v + 0.0:.{decimals}f}".replace("-", "\N{MINUS SIGN}") for v in at]


def _decimals(at: Array) -> int | None:
    """Decimals of the number that needs most of them, to a thousandth of the distance of two; None for more than four or huge numbers."""
    step = float(np.ptp(at)) / (len(at) - 1) if len(at) > 1 else float(np.abs(at).sum()) or 1.0
    if np.abs(at).max(initial=0) >= 1e5:
        return None
    return next((d for d in range(5) if (np.abs(at - np.round(at, d)) < 1e-3 * step).all()), None)


def _power(value: float) -> str:
    """`2×10⁻³`, `10²`, `1.25×10⁶`."""
    if value == 0:
        return "0"
    digits, exponent = f"{value:.6e}".split("e")
    digits = digits.rstrip("0").rstrip(".").replace("-", "\N{MINUS SIGN}")
    ten = "10" + str(int(exponent)).translate(RAISED)
    return ten if digits == "1" else f"{digits}×{ten}"
