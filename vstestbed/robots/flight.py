"""Cascaded flight control: velocity to acceleration, acceleration to tilt and thrust, tilt to
rates, rates to torques.

In the level frame (x the heading, z up) and in body axes:

    a      = k_v (v* - v) + k_vi int(v_m - v) + r* z x v*      (x and y; z with gains of its own)
    F      = m (a + g z),  the tilt cut to its limit; thrust = F_z / cos(tilt): feedforward of the
                           weight
    w*     = k_R (rotation that takes the body's z to F) + r* up
    torque = J (k_w (w* - w) + k_wi int(w* - w))

v_m is a reference model, the velocity that the setpoint should give in still air, a_m' = k_R (k_v
(v* - v_m) - a_m), v_m' = a_m. The integral acts on v_m - v, thus on wind and trim errors alone, and
can be quick without overshoot after a step of the setpoint.

Reference: the cascade of Mahony, Kumar & Corke 2012, doi:10.1109/MRA.2012.2206474, with the reduced
attitude of Brescianini & D'Andrea 2020, doi:10.1016/j.automatica.2019.108703 (tilt first, heading
by its rate alone).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, NamedTuple

import numpy as np

from vstestbed.core.geometry import Array, clip
from vstestbed.core.outcome import Outcome, Verdict
from vstestbed.core.quantity import (
    GRAVITY,
    GainOrZero,
    PositiveAngle,
    PositiveGain,
    PositiveTime,
    TighterBounds,
)
from vstestbed.core.spec import spec
from vstestbed.effects.base import Vector
from vstestbed.robots.allocation import Order
from vstestbed.robots.attitude import Level, to_body
from vstestbed.robots.base import FOLLOWS, HOLDS, Reading, Supervisor
from vstestbed.robots.rotors import X4, QuadrotorParameters

__all__ = [
    "HOLD",
    "MAX_TRIM",
    "RECOVER_RAD",
    "STILL",
    "Failsafe",
    "FlightEstimate",
    "FlightReading",
    "Gains",
    "Instruments",
    "Loops",
    "fly",
]

RECOVER_RAD = math.radians(60)  # tilted by more, the craft ignores its setpoint and levels
RECOVERED_RAD = math.radians(15)  # under it it takes setpoints again
RECOVER_COSINE = math.cos(RECOVER_RAD)
RECOVERED_COSINE = math.cos(RECOVERED_RAD)
# largest rate that the attitude loop commands [rad/s]. The rotors' torque at hover, 2.2 Nm, stops
# it in .15 s
MAX_TILT_RATE = 4.0
LEAST_LIFT = 0.3 * GRAVITY  # least upward part of the commanded force, by mass [m/s^2]
MAX_TRIM = 3.0  # bound of the velocity loop's integral [m/s^2]; a wind of 10 m/s takes 1.5
MAX_RATE_TRIM = 3.0  # bound of the rate loop's integral [rad/s^2]
STILL: Vector = (0.0, 0.0, 0.0)
Model = tuple[float, float, float, float, float]


@spec
class Gains:
    """Gains of the flight loops; each outer loop is two to three times as slow as the next inner
    one.

    Args:
        rate, rate_integral: gains k_w and k_wi of the roll and pitch rates [1/s, 1/s^2].
        yaw: gain of the yaw rate [1/s].
        attitude: gain k_R of the tilt [1/s].
        velocity, velocity_integral: gains k_v and k_vi of the velocity along x and y of the level
            frame [1/s, 1/s^2].
        climb, climb_integral: gains k_v and k_vi of the velocity along z [1/s, 1/s^2].
        tilt_deg: largest commanded tilt [deg].
        rotor_s: time constant that the speed controllers give the rotors [s]; without them it is
            `rotor_lag_s`, the X-4's .117.
    """

    rate: PositiveGain = 14.0
    rate_integral: GainOrZero = 3.0
    yaw: PositiveGain = 5.0
    attitude: PositiveGain = 5.0
    velocity: PositiveGain = 2.0
    velocity_integral: GainOrZero = 1.2
    climb: PositiveGain = 2.5
    climb_integral: GainOrZero = 1.0
    tilt_deg: Annotated[PositiveAngle, TighterBounds(le=50)] = 30.0
    rotor_s: Annotated[PositiveTime, TighterBounds(le=X4.rotor_lag_s)] = 0.03

    @cached_property
    def slope(self) -> float:
        """Tangent of the largest tilt."""
        return math.tan(math.radians(self.tilt_deg))


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


Setpoint = tuple[float, float, float, float]
"""Commanded velocity in the level frame [m/s], and rate of the heading [rad/s]."""
Motion = tuple[Vector, Level, Vector]
"""How the craft moves, as estimated: its velocity in the level frame (3,) [m/s], R_level_body, and
body rates (3,) [rad/s].
"""


def fly(
    state: Loops,
    setpoint: Setpoint,
    motion: Motion,
    gains: Gains,
    craft: QuadrotorParameters,
    dt: float,
) -> tuple[Loops, float, Vector]:
    """One step of all loops: their state, the commanded thrust [N] along the body's z and torque
    (3,) [Nm] in body axes.

    A craft tilted beyond 60 degrees levels first: it ignores its setpoint until it is within 15
    degrees. craft: what is flown. dt: [s].
    """
    velocity, R, rates = motion
    vx, vy, vz, yaw_order = setpoint
    # Two thresholds (hysteresis): with one, a craft that swings about it would alternate between
    # levelling and its setpoint.
    trim, model, rate_trim, yaw_rate, levelling, _, _ = state
    _, _, _, _, _, _, zx, zy, zz = R
    levelling = zz < (RECOVERED_COSINE if levelling else RECOVER_COSINE)
    most = craft.yaw_slope * dt
    if levelling:
        # Trim and model start anew: integrated upside down, or from the fall, they would throw the
        # craft off again.
        yaw_rate += clip(0.0 - yaw_rate, -most, most)
        trim = acceleration = STILL
        model = (*velocity, 0.0, 0.0)
    else:
        yaw_rate += clip(yaw_order - yaw_rate, -most, most)
        turned = vx, vy, vz, yaw_rate
        model = respond(model, turned, gains, dt)
        trim, acceleration = velocity_loop(trim, model, turned, velocity, gains, dt)
    force, thrust = aim(acceleration, zz, gains, craft.mass_kg)
    wx, wy = attitude_loop(to_body(R, force), gains)
    ref_rates = wx + yaw_rate * zx, wy + yaw_rate * zy, yaw_rate * zz
    rate_trim, torque = rate_loop(rate_trim, ref_rates, rates, gains, craft, dt)
    return Loops(trim, model, rate_trim, yaw_rate, levelling, force, ref_rates), thrust, torque


def respond(model: Model, setpoint: Setpoint, gains: Gains, dt: float) -> Model:
    """The reference model v_m, a_m after one step, for a setpoint; along z, without tilt in
    between, v_m' = k_c (v* - v_m).
    """
    x, y, z, ax, ay = model
    vx, vy, vz, _ = setpoint
    k = gains.velocity
    lag = gains.attitude * dt
    ax += lag * (k * (vx - x) - ax)
    ay += lag * (k * (vy - y) - ay)
    return x + ax * dt, y + ay * dt, z + gains.climb * (vz - z) * dt, ax, ay


def velocity_loop(
    trim: Vector, model: Model, setpoint: Setpoint, velocity: Vector, gains: Gains, dt: float
) -> tuple[Vector, Vector]:
    """The integral (3,) [m/s^2] after one step, within bounds, and the commanded acceleration (3,)
    in the level frame [m/s^2].
    """
    x, y, z = trim
    mx, my, mz, _, _ = model
    ox, oy, oz, yaw_rate = setpoint
    vx, vy, vz = velocity
    i = gains.velocity_integral * dt
    j = gains.climb_integral * dt
    k = gains.velocity
    # The level frame turns with the heading, the wind does not: its compensation must turn back by
    # as much.
    turn = yaw_rate * dt
    x, y = x + turn * y + i * (mx - vx), y - turn * x + i * (my - vy)
    z = z + j * (mz - vz)
    most = MAX_TRIM
    # rare, and calls take time
    if not (-most <= x <= most and -most <= y <= most and -most <= z <= most):
        x = clip(x, -most, most)
        y = clip(y, -most, most)
        z = clip(z, -most, most)
    # The last terms are r* z x v*: to keep a velocity in a frame that turns, the craft must
    # accelerate sideways.
    acceleration = (
        k * (ox - vx) + x - yaw_rate * oy,
        k * (oy - vy) + y + yaw_rate * ox,
        gains.climb * (oz - vz) + z,
    )
    return (x, y, z), acceleration


def aim(acceleration: Vector, upright: float, gains: Gains, mass: float) -> tuple[Vector, float]:
    """The force's direction (3,) in the level frame, unit, and the thrust [N], for a commanded
    acceleration (3,) [m/s^2].

    The vertical part is kept, the horizontal part cut to the tilt limit. The thrust grows with 1 /
    cos(tilt), to twice at most; upside down it is 0, and the rotors make only the torque that turns
    the craft over. upright: cos(tilt); mass: of the craft [kg].
    """
    ax, ay, az = acceleration
    # Upward in any dive: a thrust of 0 would have no direction, and its tilt limit would be 0, too.
    up = GRAVITY + az if GRAVITY + az > LEAST_LIFT else LEAST_LIFT
    most = up * gains.slope
    size = math.hypot(ax, ay)
    if size > most:
        ax = ax * most / size
        ay = ay * most / size
    n = 1.0 / math.sqrt(ax * ax + ay * ay + up * up)
    thrust = 0.0
    if upright > 0:
        thrust = mass * up / (upright if upright > 0.5 else 0.5)
    return (ax * n, ay * n, up * n), thrust


def attitude_loop(force: Vector, gains: Gains) -> tuple[float, float]:
    """Commanded roll and pitch rates [rad/s] that turn the body's z to `force` (3,), unit, in body
    axes.

    The rotation is by atan2(|(F_x, F_y)|, F_z) about (-F_y, F_x, 0).
    """
    x, y, z = force
    sine = math.hypot(x, y)
    if sine < 1e-9:
        return (0.0, 0.0) if z > 0 else (MAX_TILT_RATE, 0.0)  # upside down: any axis is as good
    rate = gains.attitude * math.atan2(sine, z)
    share = (rate if rate < MAX_TILT_RATE else MAX_TILT_RATE) / sine
    return -share * y, share * x


def rate_loop(
    trim: tuple[float, float],
    ref_rates: Vector,
    rates: Vector,
    gains: Gains,
    craft: QuadrotorParameters,
    dt: float,
) -> tuple[tuple[float, float], Vector]:
    """Integrals [rad/s^2] and torque (3,) [Nm], for body rates (3,) [rad/s]; the yaw torque stays
    within its share.
    """
    tx, ty = trim
    rx, ry, rz = ref_rates
    wx, wy, wz = rates
    Jx, Jy, Jz = craft.inertia
    ex = rx - wx
    ey = ry - wy
    k = gains.rate
    i = gains.rate_integral * dt
    tx += i * ex
    ty += i * ey
    z = Jz * gains.yaw * (rz - wz)
    most = MAX_RATE_TRIM
    most_z = craft.yaw_torque
    if not (-most <= tx <= most and -most <= ty <= most and -most_z <= z <= most_z):
        tx = clip(tx, -most, most)
        ty = clip(ty, -most, most)
        z = clip(z, -most_z, most_z)
    return (tx, ty), (Jx * (k * ex + tx), Jy * (k * ey + ty), z)


HOLD = np.zeros(4)  # the setpoint that levels the craft and holds it where it is


def descend(speed_mps: float) -> Array:
    """The setpoint (4,) of a level vertical descent at a speed [m/s]."""
    return np.array([0.0, 0.0, -speed_mps, 0.0])


class Instruments(NamedTuple):
    """What the instruments read at one instant; plain floats, since the flight loops read them at 1
    kHz.

    Attributes:
        gyro: body rates (3,) [rad/s].
        force: specific force of the accelerometer, body axes (3,) [m/s^2].
        velocity: of the optical-flow instrument, body axes (3,) [m/s].
        range_m: of the range finder that looks down, inf over nothing [m].
        voltage_v: of the battery, NaN where none is modelled [V].
    """

    gyro: Vector
    force: Vector
    velocity: Vector
    range_m: float
    voltage_v: float = math.nan


@dataclass(frozen=True, slots=True)
class FlightEstimate:
    """State of the flight loops at one instant: estimates, and the references that each loop gives
    to the next.

    Attributes:
        velocity: in body axes (3,) [m/s].
        rates: body rates without the gyro's bias (3,) [rad/s].
        ref_tilt: reference roll and pitch, from the velocity loop (2,) [rad].
        ref_rates: reference body rates, from the attitude loop (3,) [rad/s].
        rotor_limit_s: for how long a rotor has been at its limit [s].
        overturned: tilted beyond 60 degrees, or still levelling after that.
        stands: its feet carry its weight.
    """

    velocity: Array
    rates: Array
    ref_tilt: Array
    ref_rates: Array
    rotor_limit_s: float
    overturned: bool
    stands: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class FlightReading(Reading):
    """A quadrotor's reading at one instant: its range finder, and what its flight loops estimate
    from all instruments.

    range_m: of the range finder that looks down, inf over nothing [m]. estimate: of the flight
    loops.
    voltage_v: of the battery, NaN where none is modelled [V].
    """

    range_m: float
    estimate: FlightEstimate
    voltage_v: float = math.nan

    @property
    def body_twist(self) -> Array:
        """(v, w) of the base in body axes (6,), estimated."""
        return np.concatenate([self.estimate.velocity, self.estimate.rates])


# The quadrotor's failsafe: a state machine that overrides the law's setpoint, from onboard
# estimates alone.
#
#     follow --target lost--> hold --lost_after_s, lost_after_m--> sink --feet down--> off
#     follow --overturned, a rotor at its limit, or the law fails--> hold --HOLD_S--> sink
#
# While it holds, the law rests, or coasts after a moving target.
#
# A lost target that is seen again brings it back to `follow`, unless the craft is already near the
# ground. An overturned craft is levelled by its flight loops, which ignore setpoints meanwhile; a
# rotor that stays at its limit means that setpoints cannot be tracked. These end the task for good,
# since none of them is cured by seeing the target.
HOLD_S = 2.0  # how long the craft holds after an abort before it sinks [s]
RESUME_M = 0.5  # below this height the descent goes on even when the target is seen again [m]
# a rotor at its limit for longer aborts the task [s]; a step of the setpoint may saturate one for a
# moment
LIMIT_S = 1.0
# how long the rotors must be off before the craft counts as down [s]; they spin down with a time
# constant of .117 s
DOWN_S = 0.5
# modes beside FOLLOWS and HOLDS, as numbered in the log's column `supervisor`
SINKS = 2
OFF = 3


@dataclass
class Failsafe(Supervisor):
    """The failsafe of one flight: where other robots stop, it holds the craft, and then sets it
    down.

    lands: the task ends on the ground. off_at: when the rotors went off [s]. mode: see FOLLOWS, ...
    """

    DOWN = (
        "the craft set down",
        "the craft was still on its way down when the time ran out",
    )
    lands: bool = False
    off_at: float = math.nan
    _since: float = math.nan

    def filter(
        self,
        t: float,
        blind: str,
        reading: Reading,
        order: Order,
        basis: Array,
        moved_m: float = 0.0,
    ) -> Order:
        """The order that the flight loops get: the law's, or a stop (hold, rotors off), or the
        velocity of the descent.
        """
        assert isinstance(reading, FlightReading)
        lost = self._look(t, blind, moved_m)
        # A task whose target was lost goes on where it is seen again, unless the craft is near the
        # ground.
        seen_again = not blind and reading.range_m > RESUME_M
        if math.isnan(self.off_at) and not self._final:
            if seen_again:
                self.aborted = None
            if cause := self._cause(lost, reading.estimate):
                self.abort(t, *cause)
        self.mode = self._next_mode(t, blind, reading.estimate)
        if self.mode == OFF:
            reason = f"{self._why}the craft stands: rotors off"
            return order.halted(reason, latched=True, stop="off")
        if self.mode == SINKS:
            # under the .5 m/s at which a touch-down counts as a landing (`GoalLanding.touch_mps`)
            down = descend(0.4)
            reason = f"{self._why}the craft sinks"
            return Order(down, basis @ down, reason=reason, latched=self._final)
        if self.aborted:
            return order.halted(f"{self._why}the craft holds", latched=self._final)
        return order

    @property
    def _why(self) -> str:
        return f"{self.aborted[1]}: " if self.aborted else ""

    @property
    def may_touch(self) -> bool:
        """Whether ground contact of the feet is allowed: in a landing, or once it sinks."""
        return self.lands or self.mode in (SINKS, OFF)

    def down(self, t: float) -> bool:
        # NaN while they are on: the comparison is False then.
        return t - self.off_at >= DOWN_S

    def abort(self, t: float, outcome: Outcome, reason: str) -> None:
        """Give the task up at a time [s], which a reason names: the craft is down much later."""
        self.aborted = outcome, f"{reason} at {t:.1f} s"
        self._since = t

    def _next_mode(self, t: float, blind: str, estimate: FlightEstimate) -> int:
        if math.isnan(self.off_at) and estimate.stands and (self.lands or self.aborted):
            self.off_at = t
        if not math.isnan(self.off_at):
            return OFF
        if not self.aborted:
            return HOLDS if blind else FOLLOWS
        # A lost target has already had its `lost_after_s` of holding before the task was given up.
        holds = t - self._since < HOLD_S and self._final
        return HOLDS if holds else SINKS

    @property
    def _final(self) -> bool:
        """Whether the task was given up for good: overturned, a rotor at its limit, or no law that
        works.
        """
        return self.aborted is not None and self.aborted[0] is not Outcome.target_lost

    def _cause(self, lost: str, estimate: FlightEstimate) -> Verdict | None:
        """Why the task must be given up in this frame, the most urgent cause first; None where it
        need not.

        lost: why the target counts as lost in this frame ("" while it does not).
        """
        if estimate.overturned:
            return Outcome.overturned, Outcome.overturned.value
        if estimate.rotor_limit_s > LIMIT_S:
            return Outcome.rotor_limit, f"a rotor stood at its limit for {LIMIT_S:g} s"
        if lost and not self.aborted:
            return Outcome.target_lost, lost
        return None
