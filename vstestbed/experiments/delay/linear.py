"""Linear model of the visual servo loop of an arm: gain limit with its servos, its coupled inertia and its elastic joints.

Near the goal, with the joints' positions as the error, the law commands the speeds v(k) = -g / T q(k - d), held for a period T, and
the arm answers as `sim.linear.LinearArm`, whose links the camera sees and whose rotors the servos turn. It is sampled exactly; the
poles are those of the loop over x = (z, z', r) and the d positions that are under way. Of a delay of d + f frames with 0 < f < 1 a command
begins at f of a frame, before which the last one holds. Coulomb friction, which damps small motions, is left out.

References: Spong 1987, doi:10.1115/1.3143860 (the plant); Franklin, Powell & Workman, Digital Control of Dynamic Systems
(zero-order hold; a delay of part of a period).
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import expm

from vstestbed.core.geometry import Array
from vstestbed.sim.linear import LinearArm

FIRST, FACTOR, FINE = 1e-3, 1.02, 1e-6
"""The first crossing is sought upwards from this g in steps of this factor, then by bisection to this share."""


def sampled(arm: LinearArm, period_s: float) -> tuple[Array, Array]:
    """(A, B) of x(k+1) = A x(k) + B v(k), x = (z, z', r), with v held over a period."""
    N, n = arm.motors.shape
    b, inverse = arm.motors, np.linalg.inv(arm.mass)
    states = 2 * N + n
    A, B = np.zeros((states, states)), np.zeros((states, n))
    A[:N, N : 2 * N] = np.eye(N)
    A[N : 2 * N, :N] = -inverse @ (arm.spring + b @ np.diag(arm.kp) @ b.T)
    A[N : 2 * N, N : 2 * N] = -inverse @ (arm.damper + b @ np.diag(arm.kv) @ b.T)
    A[N : 2 * N, 2 * N :] = inverse @ b @ np.diag(arm.kp)
    B[N : 2 * N] = inverse @ b @ np.diag(np.where(arm.integrates, 0.0, arm.kv))
    B[2 * N :] = np.diag(np.where(arm.integrates, 1.0, 0.0))
    both = np.asarray(expm(np.block([[A, B], [np.zeros((n, states + n))]]) * period_s), dtype=float)
    return both[:states, :states], both[:states, states:]


def linear_gain_limit(arm: LinearArm, delay_frames: float, period_s: float) -> float:
    """The g = gain * period at which a pole first leaves the unit circle; delay_frames: also a part of a frame."""
    F, G = _loop(arm, delay_frames, period_s)

    def unstable(g: float) -> bool:
        return bool(np.abs(np.linalg.eigvals(F + g * G)).max() > 1 + 1e-9)

    high = FIRST
    while not unstable(high):
        high *= FACTOR
    low = high / FACTOR
    while high - low > FINE * high:
        middle = (low + high) / 2
        low, high = (low, middle) if unstable(middle) else (middle, high)
    return (low + high) / 2


def _loop(arm: LinearArm, delay_frames: float, period_s: float) -> tuple[Array, Array]:
    """(F, G): the loop's matrix is F + g G, over x and the last positions q (n,) that are under way."""
    whole, part = divmod(delay_frames, 1.0)
    delay = int(whole)
    A, B = sampled(arm, period_s)
    states, n = B.shape
    kept = delay + (part > 0)
    F = np.zeros((states + kept * n,) * 2)
    G = np.zeros_like(F)
    F[:states, :states] = A
    if kept:
        F[states : states + n, :n] = np.eye(n)
        F[states + n :, states:-n] = np.eye((kept - 1) * n)
    late = np.zeros_like(B)
    if part:  # the last command holds until this one comes: x(k+1) = A x(k) + late v(k-1) + (B - late) v(k)
        early = sampled(arm, part * period_s)[1]
        late = sampled(arm, (1 - part) * period_s)[0] @ early
        G[:states, _seen(delay + 1, states, n)] = -late / period_s
    G[:states, _seen(delay, states, n)] += -(B - late) / period_s
    return F, G


def _seen(age: int, states: int, n: int) -> slice:
    """Where the loop's vector has the positions (n,) of `age` frames ago."""
    return slice(states + (age - 1) * n, states + age * n) if age else slice(0, n)
