"""Cascaded flight control: velocity to acceleration, acceleration to tilt and thrust, tilt to rates, rates to torques.

In the level frame (x the heading, z up) and in body axes:

    a      = k_v (v* - v) + k_vi int(v_m - v) + r* z x v*      (x and y; z with gains of its own)
    F      = m (a + g z),  the tilt cut to its limit; thrust = F_z / cos(tilt): feedforward of the weight
    w*     = k_R (rotation that takes the body's z to F) + r* up
    torque = J (k_w (w* - w) + k_wi int(w* - w))

v_m is a reference model, the velocity that the setpoint should give in still air, a_m' = k_R (k_v (v* - v_m) - a_m), v_m' = a_m.
The integral acts on v_m - v, thus on wind and trim errors alone, and can be quick without overshoot after a step of the setpoint.

Reference: the cascade of Mahony, Kumar & Corke 2012, doi:10.1109/MRA.2012.2206474, with the reduced attitude of
Brescianini & D'Andrea 2020, doi:10.1016/j.automatica.2019.108703 (tilt first, heading by its rate alone).
"""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

from vstestbed.core.quantity import GainOrZero, Narrower, PositiveAngle, PositiveGain, PositiveTime
from vstestbed.core.spec import spec
from vstestbed.robots.attitude import GRAVITY, Level, Vector
from vstestbed.robots.rotors import INERTIA, LAG_S, MASS, MAX_YAW_TORQUE

RECOVER_RAD, RECOVERED_RAD = math.radians(60), math.radians(15)
"""Tilted by more than the first, the craft ignores its setpoint and levels; under the second it takes setpoints again."""
MAX_TILT_RATE = 4.0
"""Largest rate that the attitude loop commands [rad/s]. The rotors' torque at hover, 2.2 Nm, stops it in .15 s."""
MAX_YAW_ACCELERATION = 0.4
"""Slope of the yaw-rate command [rad/s^2], a little under the .45 that the rotors' share of yaw can realise."""
MAX_TRIM = 3.0
"""Bound of the velocity loop's integral [m/s^2]; a wind of 10 m/s takes 1.5."""
MAX_RATE_TRIM = 3.0
"""Bound of the rate loop's integral [rad/s^2]."""
STILL: Vector = (0.0, 0.0, 0.0)
Model = tuple[float, float, float, float, float]


@spec
class Gains:
    """Gains of the flight loops; each outer loop is two to three times as slow as the next inner one.

    Args:
        rate, rate_integral: k_w [1/s], k_wi [1/s^2] of roll and pitch rates.
        yaw: of the yaw rate [1/s].
        attitude: k_R [1/s].
        velocity, velocity_integral: k_v [1/s], k_vi [1/s^2] along x and y of the level frame.
        climb, climb_integral: the same along z.
        tilt_deg: largest commanded tilt [deg].
        rotor_s: time constant that the speed controllers give the rotors [s]; without them it is .117.
    """

    rate: PositiveGain = 14.0
    rate_integral: GainOrZero = 3.0
    yaw: PositiveGain = 5.0
    attitude: PositiveGain = 5.0
    velocity: PositiveGain = 2.0
    velocity_integral: GainOrZero = 1.2
    climb: PositiveGain = 2.5
    climb_integral: GainOrZero = 1.0
    tilt_deg: Annotated[PositiveAngle, Narrower(le=50)] = 30.0
    rotor_s: Annotated[PositiveTime, Narrower(le=LAG_S)] = 0.03


class Loops(NamedTuple):
    """State of the loops.

    Attributes:
        trim: the velocity loop's integral (3,) in the level frame [m/s^2].
        model: v_m (3,) [m/s] and a_m along x and y (2,) [m/s^2].
        rate_trim: the rate loop's integral (2,) [rad/s^2].
        yaw_rate: the yaw-rate command, its slope limited [rad/s].
        levelling: whether the craft ignores its setpoint until it is level.
        force: reference of the attitude loop: the thrust's direction (3,) in the level frame, unit.
        ref_rates: reference of the rate loop: body rates (3,) [rad/s].
    """

    trim: Vector = STILL
    model: Model = (0.0, 0.0, 0.0, 0.0, 0.0)
    rate_trim: tuple[float, float] = (0.0, 0.0)
    yaw_rate: float = 0.0
    levelling: bool = False
    force: Vector = (0.0, 0.0, 1.0)
    ref_rates: Vector = STILL

    @property
    def tilt(self) -> tuple[float, float]:
        """Reference roll and pitch [rad]: those of a craft whose z is along `force`."""
        x, y, z = self.force
        return -math.asin(max(-1.0, min(1.0, y))), math.atan2(x, z)


class Push(NamedTuple):
    """Commanded thrust [N] along the body's z and torque (3,) [Nm] in body axes."""

    thrust: float
    torque: Vector


def fly(
    memory: Loops, order: Vector, yaw_order: float, velocity: Vector, R: Level, rates: Vector, gains: Gains, dt: float
) -> tuple[Loops, Push]:
    """One step of all loops.

    A craft tilted beyond 60 degrees levels first: it ignores its setpoint until it is within 15 degrees.

    Args:
        order, velocity: commanded and estimated velocity in the level frame, (3,) [m/s].
        yaw_order: commanded rate of the heading [rad/s].
        R: R_level_body, estimated.
        rates: body rates, (3,) [rad/s].
        dt: [s].
    """
    # Two thresholds (hysteresis): with one, a craft that swings about it would alternate between levelling and its setpoint.
    levelling = R.zz < math.cos(RECOVERED_RAD if memory.levelling else RECOVER_RAD)
    most = MAX_YAW_ACCELERATION * dt
    yaw_rate = memory.yaw_rate + max(-most, min(most, (0.0 if levelling else yaw_order) - memory.yaw_rate))
    if levelling:
        # Trim and model start anew: integrated upside down, or from the fall, they would throw the craft off again.
        trim, model, acceleration = STILL, (*velocity, 0.0, 0.0), STILL
    else:
        model = respond(memory.model, order, gains, dt)
        trim = retrim(memory.trim, model, velocity, yaw_rate, gains, dt)
        acceleration = velocity_loop(trim, order, velocity, yaw_rate, gains)
    force, thrust = aim(acceleration, R, gains.tilt_deg)
    wx, wy = attitude_loop(R.to_body(force), gains)
    ref_rates = (wx + yaw_rate * R.zx, wy + yaw_rate * R.zy, yaw_rate * R.zz)
    rate_trim, torque = rate_loop(memory.rate_trim, ref_rates, rates, gains, dt)
    return Loops(trim, model, rate_trim, yaw_rate, levelling, force, ref_rates), Push(thrust, torque)


def respond(model: Model, order: Vector, gains: Gains, dt: float) -> Model:
    """The reference model v_m, a_m after one step, for a setpoint (3,) [m/s]; along z, without tilt in between, v_m' = k_c (v* - v_m)."""
    x, y, z, ax, ay = model
    k, lag = gains.velocity, gains.attitude * dt
    ax, ay = ax + lag * (k * (order[0] - x) - ax), ay + lag * (k * (order[1] - y) - ay)
    return x + ax * dt, y + ay * dt, z + gains.climb * (order[2] - z) * dt, ax, ay


def retrim(trim: Vector, model: Model, velocity: Vector, yaw_rate: float, gains: Gains, dt: float) -> Vector:
    """The velocity loop's integral (3,) [m/s^2] after one step, within bounds."""
    x, y, z = trim
    # The level frame turns with the heading, the wind does not: its compensation must turn back by as much.
    i, j, turn = gains.velocity_integral * dt, gains.climb_integral * dt, yaw_rate * dt
    x, y = x + turn * y + i * (model[0] - velocity[0]), y - turn * x + i * (model[1] - velocity[1])
    z += j * (model[2] - velocity[2])
    return max(-MAX_TRIM, min(MAX_TRIM, x)), max(-MAX_TRIM, min(MAX_TRIM, y)), max(-MAX_TRIM, min(MAX_TRIM, z))


def velocity_loop(trim: Vector, order: Vector, velocity: Vector, yaw_rate: float, gains: Gains) -> Vector:
    """Commanded acceleration (3,) in the level frame [m/s^2], for velocities (3,) [m/s]."""
    k = gains.velocity
    # The last terms are r* z x v*: to keep a velocity in a frame that turns, the craft must accelerate sideways.
    return (
        k * (order[0] - velocity[0]) + trim[0] - yaw_rate * order[1],
        k * (order[1] - velocity[1]) + trim[1] + yaw_rate * order[0],
        gains.climb * (order[2] - velocity[2]) + trim[2],
    )


def aim(acceleration: Vector, R: Level, tilt_deg: float) -> tuple[Vector, float]:
    """The force's direction (3,) in the level frame, unit, and the thrust [N], for a commanded acceleration (3,) [m/s^2].

    The vertical part is kept, the horizontal part cut to the tilt limit. The thrust grows with 1 / cos(tilt), to twice at most;
    upside down it is 0, and the rotors make only the torque that turns the craft over.
    """
    ax, ay, az = acceleration
    # Upward in any dive: a thrust of 0 would have no direction, and its tilt limit would be 0, too.
    up = max(0.3 * GRAVITY, GRAVITY + az)
    most, size = up * math.tan(math.radians(tilt_deg)), math.hypot(ax, ay)
    if size > most:
        ax, ay = ax * most / size, ay * most / size
    n = 1.0 / math.sqrt(ax * ax + ay * ay + up * up)
    thrust = MASS * up / max(0.5, R.zz) if R.zz > 0 else 0.0
    return (ax * n, ay * n, up * n), thrust


def attitude_loop(force: Vector, gains: Gains) -> tuple[float, float]:
    """Commanded roll and pitch rates [rad/s] that turn the body's z to `force` (3,), unit, in body axes.

    The rotation is by atan2(|(F_x, F_y)|, F_z) about (-F_y, F_x, 0).
    """
    x, y, z = force
    sine = math.hypot(x, y)
    if sine < 1e-9:
        return (0.0, 0.0) if z > 0 else (MAX_TILT_RATE, 0.0)  # upside down: any axis is as good
    rate = min(MAX_TILT_RATE, gains.attitude * math.atan2(sine, z)) / sine
    return -rate * y, rate * x


def rate_loop(trim: tuple[float, float], ref_rates: Vector, rates: Vector, gains: Gains, dt: float) -> tuple[tuple[float, float], Vector]:
    """Integrals [rad/s^2] and torque (3,) [Nm], for body rates (3,) [rad/s]; the yaw torque stays within its share."""
    ex, ey, ez = ref_rates[0] - rates[0], ref_rates[1] - rates[1], ref_rates[2] - rates[2]
    k, i = gains.rate, gains.rate_integral * dt
    tx = max(-MAX_RATE_TRIM, min(MAX_RATE_TRIM, trim[0] + i * ex))
    ty = max(-MAX_RATE_TRIM, min(MAX_RATE_TRIM, trim[1] + i * ey))
    z = max(-MAX_YAW_TORQUE, min(MAX_YAW_TORQUE, INERTIA[2] * gains.yaw * ez))
    return (tx, ty), (INERTIA[0] * (k * ex + tx), INERTIA[1] * (k * ey + ty), z)
