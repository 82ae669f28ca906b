"""Four rotors in a plus: mixer with priorities at the rotors' limits, speed controllers, the craft's parameters.

With squared speeds W = w^2 of front, right, back and left, arm d, thrust b W and drag torque k W:

    thrust = b (W_f + W_r + W_b + W_l)      torque x = d b (W_l - W_r)
    torque z = k (W_r + W_l - W_f - W_b)    torque y = d b (W_b - W_f)

Solved with a mean t, halves p (pitch) and r (roll) of the pairs' differences and a share y of yaw:
W_f, W_b = t -+ p - y,  W_r, W_l = t -+ r + y.

Parameters: Pounds 2007 (models/quadrotor.xml has the sources; a test compares the two files).
"""

from __future__ import annotations

from vstestbed.core.geometry import clip
from vstestbed.robots.attitude import GRAVITY, Vector

MASS, INERTIA = 4.0, (0.082, 0.082, 0.149)
"""[kg], [kg m^2] about x, y, z."""
ARM, THRUST, DRAG = 0.315, 1.3234e-5, 1.0697e-7
"""Centre to rotor [m]; b [N s^2]; k [Nm s^2]."""
LAG_S = 0.117
"""Time constant of w^2 behind its command, without a speed controller [s]."""
LIMIT = 1000.0**2
"""Largest w^2 [(rad/s)^2]."""
HOVER = MASS * GRAVITY / (4 * THRUST)
"""w^2 at hover, of 861 rad/s [(rad/s)^2]."""
YAW_SHARE = 0.6
"""Share of the rotors' margin at hover that yaw may use: the rest is for attitude and thrust."""
MAX_YAW_TORQUE = YAW_SHARE * 4 * DRAG * (LIMIT - HOVER)
"""[Nm]: .066, which is .45 rad/s^2. Yaw is weak, since only the rotors' drag torques turn the craft about z."""
PER_PAIR, PER_FOUR, PER_YAW = 2 * ARM * THRUST, 4 * THRUST, 4 * DRAG
"""Roll or pitch torque [Nm s^2], thrust [N s^2] and yaw torque [Nm s^2] of a unit of r or p, of t and of y."""

Four = tuple[float, float, float, float]


def mix(thrust: float, torque: Vector) -> tuple[Four, bool]:
    """W (4,) of front, right, back and left within limits, for a thrust [N] and a torque (3,) [Nm]; and whether any of these was cut.

    At the limits roll and pitch come first, then thrust, then yaw: the mean is moved until the pairs' differences fit, and yaw gets
    the margin that is left. Differences beyond the whole range are cut to it.
    """
    # Attitude before thrust: a craft that is level can climb later; one that is not level accelerates sideways. Clipping each rotor
    # by itself would lose roll and pitch torque whenever the thrust is high.
    half = 0.5 * LIMIT
    x, y, z = torque
    r, p, t, y = x / PER_PAIR, y / PER_PAIR, thrust / PER_FOUR, z / PER_YAW
    cut = False
    if not (-half <= r <= half and -half <= p <= half):  # here and below: such a case is rare, and calls take time
        r, p, cut = clip(r, -half, half), clip(p, -half, half), True
    ar, ap = abs(r), abs(p)
    widest = ar if ar > ap else ap
    if not widest <= t <= LIMIT - widest:
        t, cut = clip(t, widest, LIMIT - widest), True
    above, below = LIMIT - t, t
    if not (ap - above <= y <= above - ar and ar - below <= y <= below - ap):
        y, cut = clip(y, max(ap - above, ar - below), min(above - ar, below - ap)), True
    return (t - p - y, t - r + y, t + p - y, t + r + y), cut


def speed_control(turning: Four, reference: Four, response_s: float, dt: float) -> tuple[Four, Four]:
    """Speed controllers: commands that make the rotors reach `reference` with the time constant `response_s` instead of LAG_S.

    u = W + (LAG_S / response_s) (W_wanted - W), within 0 and LIMIT: lead compensation, bounded by full voltage. A real controller
    measures its rotor's speed by commutation; this one predicts W by the lag's own equation.

    Args:
        turning, reference: W of the rotors now and as commanded, (4,).
        response_s: [s], up to LAG_S.
        dt: [s] until the next command.

    Returns:
        W after dt, and the commands u (4,).
    """
    lead, ahead = LAG_S / response_s, dt / (LAG_S + 0.5 * dt)  # (1, 1) Pade of 1 - exp(-dt / LAG_S): 1e-7 at 1 ms
    a, b, c, d = turning
    A, B, C, D = reference
    ua, ub, uc, ud = a + lead * (A - a), b + lead * (B - b), c + lead * (C - c), d + lead * (D - d)
    if not (0.0 <= ua <= LIMIT and 0.0 <= ub <= LIMIT and 0.0 <= uc <= LIMIT and 0.0 <= ud <= LIMIT):  # as in `mix`
        ua, ub, uc, ud = clip(ua, 0.0, LIMIT), clip(ub, 0.0, LIMIT), clip(uc, 0.0, LIMIT), clip(ud, 0.0, LIMIT)
    return (a + ahead * (ua - a), b + ahead * (ub - b), c + ahead * (uc - c), d + ahead * (ud - d)), (ua, ub, uc, ud)
