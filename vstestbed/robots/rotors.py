"""Four rotors in a plus: the craft's figures, what thrust and torque ask of each rotor, what is given up at their limits.

With squared speeds W = w^2 of front, right, back and left, arm d, thrust b W and drag torque k W:

    thrust = b (W_f + W_r + W_b + W_l)      torque x = d b (W_l - W_r)
    torque z = k (W_r + W_l - W_f - W_b)    torque y = d b (W_b - W_f)

Solved with a mean t, halves p (pitch) and r (roll) of the pairs' differences and a share y of yaw:
W_f, W_b = t -+ p - y,  W_r, W_l = t -+ r + y.

Figures: Pounds 2007 (models/quadrotor.xml has the sources; a test holds the two files together).
"""

from __future__ import annotations

from typing import NamedTuple

from vstestbed.robots.attitude import GRAVITY, Vector

MASS, INERTIA = 4.0, (0.082, 0.082, 0.149)
"""[kg], [kg m^2] about x, y, z."""
ARM, THRUST, DRAG = 0.315, 1.3234e-5, 1.0697e-7
"""Centre to rotor [m]; b [N s^2]; k [Nm s^2]."""
LAG_S = 0.117
"""Of w^2 behind its order [s]."""
LIMIT = 1000.0**2
"""Largest w^2 [(rad/s)^2]."""
HOVER = MASS * GRAVITY / (4 * THRUST)
"""w^2 that carries the weight: 861 rad/s."""
YAW_SHARE = 0.6
"""The part of the rotors' room at hover that yaw may ask for: the rest is for attitude and thrust."""
MAX_YAW_TORQUE = YAW_SHARE * 4 * DRAG * (LIMIT - HOVER)
"""[Nm]: .066, .45 rad/s^2. Yaw is weak: drag torques are all it has."""

Four = tuple[float, float, float, float]


class Mixed(NamedTuple):
    """What the rotors are asked for: W (4,) within limits, and whether attitude, thrust or yaw had to be cut for it."""

    W: Four
    cut: bool


def mix(thrust: float, torque: Vector) -> Mixed:
    """Squared rotor speeds (front, right, back, left) for a thrust [N] and a torque (3,) [Nm].

    At the limits roll and pitch come first, then thrust, then yaw: the mean is moved until the pairs' differences fit (a craft
    that is level can climb later; one that is not level falls sideways), and yaw gets the room that is left. Differences beyond
    the whole range are cut to it.
    """
    half = 0.5 * LIMIT
    r0, p0, t0 = torque[0] / (2 * ARM * THRUST), torque[1] / (2 * ARM * THRUST), thrust / (4 * THRUST)
    y0 = torque[2] / (4 * DRAG)
    r, p = max(-half, min(half, r0)), max(-half, min(half, p0))
    ar, ap = abs(r), abs(p)
    widest = max(ar, ap)
    t = max(widest, min(LIMIT - widest, t0))
    above, below = LIMIT - t, t
    y = max(-min(above - ap, below - ar), min(min(above - ar, below - ap), y0))
    cut = r != r0 or p != p0 or t != t0 or y != y0
    return Mixed((t - p - y, t - r + y, t + p - y, t + r + y), cut)


def speed_control(turning: Four, wanted: Four, response_s: float, dt: float) -> tuple[Four, Four]:
    """The speed controllers' orders that make rotors reach `wanted` with a time constant of `response_s`, not of LAG_S.

    u = W + (LAG_S / response_s) (W_wanted - W), within 0 and LIMIT: a lead, which full voltage bounds. A controller knows its
    rotor's speed from the commutation; here it carries W with the lag's own equation.

    Args:
        turning, wanted: W of the rotors now and as ordered, (4,).
        response_s: [s], up to LAG_S.
        dt: [s] until the next order.

    Returns:
        W after dt, and the orders u (4,).
    """
    lead, ahead = LAG_S / response_s, dt / (LAG_S + 0.5 * dt)  # (1, 1) Pade of 1 - exp(-dt / LAG_S): 1e-7 at 1 ms
    a, b, c, d = turning
    A, B, C, D = wanted
    u = (
        max(0.0, min(LIMIT, a + lead * (A - a))),
        max(0.0, min(LIMIT, b + lead * (B - b))),
        max(0.0, min(LIMIT, c + lead * (C - c))),
        max(0.0, min(LIMIT, d + lead * (D - d))),
    )
    return (a + ahead * (u[0] - a), b + ahead * (u[1] - b), c + ahead * (u[2] - c), d + ahead * (u[3] - d)), u
