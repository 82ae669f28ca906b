"""The loop of a visual servo in discrete time, with dead time and a servo's lag: its roots, and the gain at which it goes unstable.

Near the goal each direction of the error is a loop of its own, whatever the feature: L cancels against its pseudo-inverse.
With s the error, g = gain * period and d frames of dead time

    s(k+1) = s(k) - g sum_j b_j s(k - d - j),

where b_j is the share of a one-frame command that the robot makes in the j-th frame after it: b = (1) moves as told,
b = (1 - a, a) lags by a frames. Its characteristic polynomial is z^(n+1) - z^n + g sum_j b_j z^(n-d-j), n = d + len(b) - 1.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array

Poles = NDArray[np.complexfloating]

AS_TOLD = (1.0,)
"""Shares of a robot that moves as told."""


def closed_form(delay_frames: int) -> float:
    """The largest stable g = gain * period of a robot that moves as told: 2 sin(pi / (2 (2 d + 1))).

    There a pair of roots crosses the unit circle at the angle pi / (2 d + 1): the loop swings with a period of
    2 (2 d + 1) frames.

    Reference: Levin & May 1976, A note on difference-delay equations, doi:10.1016/0040-5809(76)90043-5.
    """
    return 2 * math.sin(math.pi / (2 * (2 * delay_frames + 1)))


def swing_frames(delay_frames: int) -> int:
    """The period of the swing at the limit of a robot that moves as told [frames]."""
    return 2 * (2 * delay_frames + 1)


def polynomial(g: float, delay_frames: int, shares: Sequence[float] = AS_TOLD) -> Array:
    """Coefficients of the characteristic polynomial, highest power first, shape (n + 2,)."""
    n = delay_frames + len(shares) - 1
    out = np.zeros(n + 2)
    out[0], out[1] = 1.0, -1.0
    out[1 + delay_frames :] += g * np.asarray(shares, dtype=float)
    return out


def roots(g: float, delay_frames: int, shares: Sequence[float] = AS_TOLD) -> Poles:
    """The loop's poles in the z plane, complex, shape (n + 1,), the largest first."""
    found = np.roots(polynomial(g, delay_frames, shares)).astype(complex)
    return found[np.argsort(-np.abs(found))]


def gain_limit(delay_frames: int, shares: Sequence[float] = AS_TOLD) -> float:
    """The g at which a pole first leaves the unit circle, to 1e-9; the closed form where the robot moves as told.

    Raises:
        ParameterError: the loop is stable at no gain (the shares do not add up to something positive).
    """
    if sum(shares) <= 0:
        raise ParameterError("shares", "must add up to more than 0: else no gain makes the error smaller", list(shares))

    def unstable(g: float) -> bool:
        return bool(np.abs(roots(g, delay_frames, shares)[0]) > 1)

    high = 1e-3
    while not unstable(high):
        high *= 1.05
    low = high / 1.05
    while high - low > 1e-10:
        middle = (low + high) / 2
        low, high = (low, middle) if unstable(middle) else (middle, high)
    return (low + high) / 2


def locus(delay_frames: int, gains: Array, shares: Sequence[float] = AS_TOLD) -> Poles:
    """The poles for each g of `gains` (m,), complex, shape (m, n + 1), each branch followed from one gain to the next."""
    out = np.array([roots(float(g), delay_frames, shares) for g in gains])
    for before, now in itertools.pairwise(out):
        left = list(now)
        for i, pole in enumerate(before):
            now[i] = left.pop(int(np.argmin(np.abs(np.array(left) - pole))))
    return out
