"""Discrete-time model of the visual servo loop with dead time and actuator lag: poles and gain limit.

Near the goal the loop decouples into one scalar loop per direction of the error, whatever the feature: L cancels against its
pseudo-inverse. With the error s, g = gain * period and d frames of dead time

    s(k+1) = s(k) - g sum_j b_j s(k - d - j),

where b_j is the share of a one-frame command that the robot executes in the j-th frame after it (its impulse response):
b = (1) is a robot without lag, b = (1 - a, a) lags by a frames. The characteristic polynomial is
z^(n+1) - z^n + g sum_j b_j z^(n-d-j), n = d + len(b) - 1.
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

NO_LAG = (1.0,)
"""Impulse response of a robot without lag."""


def closed_form(delay_frames: float) -> float:
    """The largest stable g = gain * period of a robot without lag: 2 sin(pi / (2 (2 d + 1))).

    There a pair of poles crosses the unit circle at the angle pi / (2 d + 1): the loop oscillates with a period of
    2 (2 d + 1) frames.

    Reference: Levin & May 1976, A note on difference-delay equations, doi:10.1016/0040-5809(76)90043-5.
    """
    return 2 * math.sin(math.pi / (2 * (2 * delay_frames + 1)))


def led_form(delay_frames: int) -> float:
    """The same for commands that are led to, by a ramp or smoothly (`timing.interpolation`): 2 tan(pi / (4 (d + 1))).

    A led command is executed half in its own frame and half in the next one, b = (1/2, 1/2), and the poles cross the unit circle at the
    angle pi / (2 (d + 1)). For small angles both limits are (pi / 2) / delay, with a delay of d + 1/2 frames for commands that are held,
    of which 1/2 is that of the hold itself, and of d + 1 here: to lead costs half a period.
    """
    return 2 * math.tan(math.pi / (4 * (delay_frames + 1)))


def loop_shares(led: bool, late_frames: float) -> tuple[float, ...]:
    """Impulse response of a loop without lag of the robot, whose commands are led to (see `led_form`) and whose pictures are old.

    late_frames: age of a picture when it is complete, beside the delay [frames]: half its exposure and half its readout, as its time
    stamp is their middle. A command for a picture e frames older acts as one in 1 - e of the frame, and e of the next.
    """
    whole, part = divmod(late_frames, 1.0)
    late = [0.0] * int(whole) + ([1 - part, part] if part else [1.0])
    return tuple(np.convolve(late, (0.5, 0.5) if led else (1.0,)).tolist())


def swing_frames(delay_frames: float) -> int:
    """Period of the oscillation at the gain limit of a robot without lag [frames]; about that, of a part of a frame."""
    return math.ceil(2 * (2 * delay_frames + 1))


def polynomial(g: float, delay_frames: float, shares: Sequence[float] = NO_LAG) -> Array:
    """Coefficients of the characteristic polynomial, highest power first, shape (n + 2,).

    Of a delay of d + f frames with 0 < f < 1 a command begins at f of a frame: it is executed with 1 - f of each share in that frame, and
    with f in the next one.
    """
    whole, part = divmod(delay_frames, 1.0)
    d = int(whole)
    b = np.convolve(shares, (1 - part, part)) if part else np.asarray(shares, dtype=float)
    out = np.zeros(d + len(b) + 1)
    out[0], out[1] = 1.0, -1.0
    out[1 + d :] += g * b
    return out


def roots(g: float, delay_frames: float, shares: Sequence[float] = NO_LAG) -> Poles:
    """Poles of the loop in the z plane, complex, shape (n + 1,), by decreasing magnitude."""
    found = np.roots(polynomial(g, delay_frames, shares)).astype(complex)
    return found[np.argsort(-np.abs(found))]


def gain_limit(delay_frames: float, shares: Sequence[float] = NO_LAG) -> float:
    """The g at which a pole first leaves the unit circle, to 1e-9; equals `closed_form` for a robot without lag.

    Raises:
        ParameterError: the loop is stable at no gain, since the shares do not add up to more than 0.
    """
    if sum(shares) <= 0:
        raise ParameterError("shares", "must add up to more than 0: else no gain makes the error smaller", list(shares))

    def unstable(g: float) -> bool:
        return bool(np.abs(roots(g, delay_frames, shares)[0]) > 1)

    # upwards in steps of 5 %, since only the first crossing counts; then bisection
    high = 1e-3
    while not unstable(high):
        high *= 1.05
    low = high / 1.05
    while high - low > 1e-10:
        middle = (low + high) / 2
        low, high = (low, middle) if unstable(middle) else (middle, high)
    return (low + high) / 2


def locus(delay_frames: float, gains: Array, shares: Sequence[float] = NO_LAG) -> Poles:
    """The poles for each g of `gains` (m,), complex, shape (m, n + 1), each branch continued from one gain to the next."""
    out = np.array([roots(float(g), delay_frames, shares) for g in gains])
    for before, now in itertools.pairwise(out):
        left = list(now)  # greedy assignment to the nearest pole
        for i, pole in enumerate(before):
            now[i] = left.pop(int(np.argmin(np.abs(np.array(left) - pole))))
    return out
