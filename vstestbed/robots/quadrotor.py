"""Quadrotor: a craft, of 4 kg by default, with velocity setpoints in its level frame, flown by its
onboard sensors.

A setpoint is (vx, vy, vz, wz) of the level frame: x the heading, z up, wz the heading's rate. On
board, at 1 kHz: attitude from the IMU (`attitude`), velocity from its sensor (`flight_sensors`),
the control loops and the failsafe (`flight`), the rotors (`rotors`). All of it reads `Instruments`
alone, after `instruments` has added noise and bias. Its body and sensors are in
`models/quadrotor.xml`, which `parameters` changes (`rotors.QuadrotorParameters`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, ClassVar, Literal, NamedTuple

import numpy as np
from pydantic import model_validator

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array
from vstestbed.core.quantity import (
    GRAVITY,
    Angle,
    AngleWidth,
    Position,
    PositiveRate,
    PositiveSpeed,
    Sigma,
)
from vstestbed.core.spatial import is_matrix, upright
from vstestbed.core.spec import spec
from vstestbed.effects.airframe import FIELD, LAB, FlightBlocks, FlightEffects
from vstestbed.effects.base import Effect, Four
from vstestbed.effects.rotors import hover_squares
from vstestbed.robots import flight_sensors
from vstestbed.robots.allocation import Allocation, Mount
from vstestbed.robots.attitude import Attitude, Filter, Imu, heading_rate, level, to_body, to_level
from vstestbed.robots.attitude import step as attitude_step
from vstestbed.robots.base import (
    BodyFile,
    Onboard,
    Reading,
    RobotLog,
    RobotState,
    SensorModel,
    Supervisor,
    random_of,
)
from vstestbed.robots.flight import (
    HOLD,
    MAX_TRIM,
    RECOVER_RAD,
    STILL,
    Failsafe,
    FlightEstimate,
    FlightReading,
    Gains,
    Instruments,
    Loops,
    fly,
)
from vstestbed.robots.flight_sensors import (
    AT_REST,
    Flow,
    Groundspeed,
    VelocitySource,
    drawn_noise,
    instruments,
)
from vstestbed.robots.own_model import OwnModel
from vstestbed.robots.realism import Presets, Realistic
from vstestbed.robots.rotors import X4, QuadrotorParameters, mix, speed_control

ROTORS = ("front", "right", "back", "left")
LOWEST_M = 0.2  # the lowest start: it hovers there, its feet 3 cm above the ground [m]


@spec
class FlightPose:
    """Where the craft hovers at the start; in Python also an upright SE3.

    Args:
        xyz: its centre in the world [m].
        yaw_deg: its heading [deg].
    """

    xyz: Position = (0.0, 0.0, 2.0)
    yaw_deg: Angle = 0.0

    @model_validator(mode="before")
    @classmethod
    def _from_matrix(cls, given: Any) -> Any:
        if not is_matrix(given):
            return given
        xyz, yaw_deg = upright(given)
        return {"xyz": xyz, "yaw_deg": yaw_deg}


@spec
class FlightBox:
    """A box from which random starts are drawn.

    Args:
        xyz: half widths along world axes [m].
        yaw_deg: half width in heading [deg].
        about: the middle of the box; None: the nominal start.
    """

    xyz: Position = (0.0, 0.0, 0.0)
    yaw_deg: AngleWidth = 0.0
    about: FlightPose | None = None


@spec
class FlightStart:
    """Where the craft hovers at the start: `nominal`, and the box from which `random` starts are
    drawn.

    Args:
        nominal: place and heading at the start of a run without a seed.
        random: the box; None: a seed cannot draw a start.
    """

    nominal: FlightPose = FlightPose()
    random: FlightBox | None = None


class FlightLog(RobotLog):
    """Estimates, references and rotor speeds of a flight.

    `est_roll`, `est_pitch` [rad], `est_vx`, `est_vy`, `est_vz` (level frame) [m/s], `est_wx`,
    `est_wy`, `est_wz` (body) [rad/s]: the craft's own estimate; `ref_roll`, ..., `ref_wz`:
    references from its velocity loop and its attitude loop; `wind_x`, ... true, in the world [m/s];
    `speed_NAME`: true, of each rotor [rad/s]; `supervisor`: mode of the failsafe, 0 follows the
    law, 1 holds, 2 sinks, 3 rotors off; of a craft with a battery `battery_v`, its voltage as
    measured [V].

    supervisor: the craft's. battery: whether it has one.
    """

    def __init__(self, supervisor: Supervisor, battery: bool = False):
        super().__init__(supervisor)
        estimate = (f"est_{name}" for name in ("roll", "pitch", "vx", "vy", "vz", "wx", "wy", "wz"))
        reference = (f"ref_{name}" for name in ("roll", "pitch", "wx", "wy", "wz"))
        wind = ("wind_x", "wind_y", "wind_z")
        speeds = (f"speed_rotor_{name}" for name in ROTORS)
        self.columns = (*estimate, *reference, *wind, *speeds, "supervisor")
        if battery:
            self.columns += ("battery_v",)

    def row(self, state: RobotState) -> Array:
        reading = state.reading
        assert isinstance(reading, FlightReading) and reading.tilt is not None
        roll, pitch = reading.tilt.tolist()
        # The level frame is the estimate's own: with the true tilt, an error of tilt would show as
        # one of velocity, too.
        up = (-math.sin(pitch), math.cos(pitch) * math.sin(roll), math.cos(pitch) * math.cos(roll))
        estimate = reading.estimate
        velocity = to_level(level(up), tuple(estimate.velocity.tolist()))
        loops = (*estimate.rates, *estimate.ref_tilt, *estimate.ref_rates)
        speeds = np.sqrt(np.maximum(state.act, 0.0))  # activations are squared speeds
        row = [roll, pitch, *velocity, *loops, *state.wind, *speeds, self.supervisor.mode]
        row.append(reading.voltage_v)  # the last column, where there is a battery
        return np.array(row[: len(self.columns)])

    def proprioception(self, log: Mapping[str, Array]) -> dict[str, Array]:
        """Tilt and body twist; the velocity back from the estimate's level frame into body axes.
        The range is not in the log.
        """
        roll = log["est_roll"]
        pitch = log["est_pitch"]
        up = zip(
            (-np.sin(pitch)).tolist(),
            (np.cos(pitch) * np.sin(roll)).tolist(),
            (np.cos(pitch) * np.cos(roll)).tolist(),
            strict=True,
        )
        velocities = zip(*(log[f"est_v{axis}"].tolist() for axis in "xyz"), strict=True)
        body = [to_body(level(z), v) for z, v in zip(up, velocities, strict=True)]
        vx, vy, vz = np.array(body).reshape(-1, 3).T
        rates = {f"w{axis}": log[f"est_w{axis}"] for axis in "xyz"}
        return {"roll": roll, "pitch": pitch, "vx": vx, "vy": vy, "vz": vz, **rates}


# period of the flight loops, and the largest physics step, at which the rate loop is tuned [s]
STEP_S = 0.001
STANDING_M = 0.172  # height of the centre over what the feet stand on, by models/quadrotor.xml [m]
# the range that a learned policy is given where the measured one is larger, or there is none [m]
FAR_M = 100.0
NO_JOINTS = np.zeros(0)
# of vx, vy, vz and wz in a twist: the four velocities that a level craft can track
LEVEL_AXES = [0, 1, 2, 5]


class Flight(NamedTuple):
    """Onboard state: estimates, flight loops, squared rotor speeds W, `armed`, and for how long a
    rotor has been at its limit [s].
    """

    attitude: Attitude = Attitude()
    ground: Groundspeed = AT_REST
    loops: Loops = Loops()
    W: Four = (X4.hover, X4.hover, X4.hover, X4.hover)
    rates: tuple[float, float, float] = (0.0, 0.0, 0.0)
    armed: bool = True
    limited_s: float = 0.0

    @property
    def overturned(self) -> bool:
        """Tilted beyond 60 degrees by its own estimate, or still levelling after that."""
        return self.attitude.tilt > RECOVER_RAD or self.loops.levelling


@spec
class Quadrotor(FlightBlocks, Realistic, Onboard):
    """A quadrotor with four simulated rotors; the camera is mounted relative to its centre (x
    forward, y left, z up).

    Args:
        parameters: its mass, arms and rotors, which its flight loops know.
        start: where it hovers at the start.
        imu: noise and bias of gyro and accelerometer.
        velocity: velocity sensor and filter, `flow` or `filtered`, and its noise.
        range_sigma_m: noise of the downward range finder [m].
        attitude: gains of the attitude filter.
        gains: gains of the flight loops.
        max_speed_mps, max_climb_mps, max_yaw_rate_radps: largest value in a setpoint; a setpoint
            beyond a limit is scaled as a whole.
    """

    kind: Literal["quadrotor"] = "quadrotor"
    parameters: QuadrotorParameters = X4
    start: FlightStart = FlightStart()
    imu: Imu = Imu()
    velocity: VelocitySource = Flow()
    range_sigma_m: Sigma = 0.01
    attitude: Filter = Filter()
    gains: Gains = Gains()
    max_speed_mps: PositiveSpeed = 2.0
    max_climb_mps: PositiveSpeed = 1.0
    max_yaw_rate_radps: PositiveRate = 0.8

    presets: ClassVar[Presets] = {"lab": LAB, "field": FIELD}
    proprioception_names: ClassVar[tuple[str, ...]] = (  # pyright: ignore[reportIncompatibleMethodOverride] - a constant
        "roll",
        "pitch",
        "range",
        "vx",
        "vy",
        "vz",
        "wx",
        "wy",
        "wz",
    )
    base = "floating"
    reading = FlightReading
    control_period_s = STEP_S
    first_setpoint = HOLD

    def __post_init__(self) -> None:
        low = self.start.nominal.xyz[2]
        if low < LOWEST_M:
            raise ParameterError.bound(
                "start.nominal.xyz.2", "at least", f"{LOWEST_M:g} m above the ground", low
            )
        lag = self.parameters.rotor_lag_s
        if self.gains.rotor_s > lag:
            words = f"{lag:g} s, the rotors' own lag (parameters.rotor_lag_s)"
            raise ParameterError.bound("gains.rotor_s", "at most", words, self.gains.rotor_s)
        self._check_hover()

    def _check_hover(self) -> None:
        """Refuse a battery or listed motors with which it cannot hover at its start; motors that
        are drawn are not known yet.
        """
        craft = self.parameters
        share = self.battery.share_at_start(craft) if self.battery else 1.0
        least = max(GRAVITY / (GRAVITY + MAX_TRIM), craft.hover / craft.limit)
        if self.battery and share < least:
            words = (
                f"leaves {share:.2g} of the ordered thrust at the start;"
                f" the flight loops make up for {least:.2g} at least."
                " Works: more charge, or a lower reference_charge"
            )
            raise ParameterError("battery.charge", words, self.battery.charge)
        motors = self.motors
        if motors is None or motors.thrust is None:
            return
        front, right, back, left = motors.thrust
        squares = hover_squares((front, right, back, left), craft)
        factors = motors.limit or (1.0,) * 4
        for name, W, factor in zip(ROTORS, squares, factors, strict=True):
            most = share * factor * craft.limit
            if most < W:
                words = (
                    f"makes the {name} rotor turn at {W**0.5:.4g} rad/s to hover,"
                    f" beyond its {most**0.5:.4g}; works: factors nearer to 1"
                )
                raise ParameterError("motors.thrust", words, list(motors.thrust))

    @property
    def body(self) -> BodyFile:
        """Its rotors, which carry the weight at the start; the drag that `rotor_drag` models is
        taken from the air drag.
        """
        return BodyFile(
            "quadrotor.xml",
            tuple(f"rotor_{name}" for name in ROTORS),
            sensors=("gyro", "accelerometer", "velocity", "range"),
            changes=self.parameters.changes(self.rotor_drag.body_share if self.rotor_drag else 1.0),
            # With activations of 0 the craft would fall while its rotors spin up.
            rest_ctrl=np.full(4, self.parameters.hover),
            feet=tuple(f"foot_{name}" for name in ROTORS),
            standing_m=STANDING_M,
            largest_step_s=STEP_S,
        )

    @property
    def acting(self) -> tuple[Effect, ...]:
        """Its blocks together, and further ones."""
        if all(getattr(self, name) is None for name in LAB):
            return self.effects
        return FlightEffects(self.parameters, self), *self.effects

    def configuration(self) -> Array:
        """The nominal start (x, y, z, yaw), [m, rad]."""
        return np.array([*self.start.nominal.xyz, math.radians(self.start.nominal.yaw_deg)])

    def randomised(self, rng: np.random.Generator) -> Quadrotor:
        """The same craft with a start drawn from the box, not so low that it would stand."""
        box = random_of(self.start, "{xyz: [2, 2, 1], yaw_deg: 180}")
        middle = box.about or self.start.nominal
        xyz = np.array(middle.xyz) + rng.uniform(-1, 1, 3) * box.xyz
        yaw = middle.yaw_deg + float(rng.uniform(-1, 1)) * box.yaw_deg
        x, y, z = xyz.tolist()
        nominal = FlightPose(xyz=(x, y, max(z, LOWEST_M)), yaw_deg=yaw)
        return replace(self, start=FlightStart(nominal=nominal, random=box))

    def started_at(self, configuration: Array) -> Quadrotor:
        """The same craft from another (x, y, z, yaw)."""
        x, y, z, yaw = configuration.tolist()
        nominal = FlightPose(xyz=(x, y, z), yaw_deg=math.degrees(yaw))
        return replace(self, start=replace(self.start, nominal=nominal))

    def supervisor(self, lands: bool, lost_after_s: float, lost_after_m: float) -> Failsafe:
        return Failsafe(lost_after_s, lost_after_m, lands=lands)

    def log(self, supervisor: Supervisor) -> RobotLog:
        return FlightLog(supervisor, battery=self.battery is not None)

    def stopping(self, setpoint: Array, elapsed_s: float) -> Array:
        """Level, where it is: its flight loops slow it down within the limits of its tilt."""
        return HOLD

    def flange_pose(self, configuration: Array) -> Array:
        """T_world_base (4, 4) of a level craft at (x, y, z, yaw)."""
        c = math.cos(configuration[3])
        s = math.sin(configuration[3])
        x, y, z = configuration[:3].tolist()
        return np.array([(c, -s, 0, x), (s, c, 0, y), (0, 0, 1, z), (0, 0, 0, 1.0)])

    def motion_basis(self, mount: Mount, q: Array) -> Array:
        """Camera twists (6, 4) of vx, vy, vz and wz of the level craft."""
        return mount.to_camera[:, LEVEL_AXES]

    def own_model(self, reading: Reading, mount: Mount) -> OwnModel:
        """(vx, vy, vz, wz) up to its largest setpoints, with its tilt; a lag of first order would
        not describe its flight loops.

        Accelerations are those of its largest tilt, g tan(tilt), and of its rotors: down it has its
        weight alone.
        """
        level = GRAVITY * self.gains.slope
        climb = GRAVITY * min(1.0, self.parameters.limit / self.parameters.hover - 1)
        speeds = np.array(
            [self.max_speed_mps, self.max_speed_mps, self.max_climb_mps, self.max_yaw_rate_radps]
        )
        return OwnModel.of_motions(
            ("vx", "vy", "vz", "wz"),
            self.motion_basis(mount, reading.q),
            speeds,
            np.array([level, level, climb, np.inf]),
            tilt=reading.tilt,
            most_tilt_rad=math.radians(self.gains.tilt_deg),
        )

    @property
    def draws(self) -> bool:
        """Motors that are not listed, a wake that fluctuates, vibration, and the noise of its
        instruments.
        """
        if self.downwash is not None or self.vibration is not None:
            return True
        if self.motors is not None and self.motors.draws:
            return True
        imu = self.imu
        sigmas = imu.gyro_sigma_radps, imu.accel_sigma_mps2, self.velocity.sigma_mps
        return any(sigmas) or self.range_sigma_m > 0

    def instruments(self, rng: np.random.Generator) -> SensorModel:
        """MuJoCo's perfect sensors with noise and bias (10,) of gyro, accelerometer, velocity and
        range, and the velocity's scale error.
        """
        noise = drawn_noise(self.imu, self.velocity, self.range_sigma_m, rng)
        scale_error = self.velocity.scale_error
        return lambda q, qd, sensors: instruments(sensors, next(noise), scale_error)

    def measured_twist(
        self, before: Reading, now: Reading, duration: float, commanded: Array, mount: Mount
    ) -> Array:
        """Mean camera twist (6,) between two readings: the mean of velocity and body rates at both,
        through the mount.
        """
        assert isinstance(before, FlightReading) and isinstance(now, FlightReading)
        return mount.to_camera @ (0.5 * (before.body_twist + now.body_twist))

    def proprioception(self, reading: FlightReading, odometry: Array | None) -> Array:
        """Estimated roll and pitch [rad], measured range [m] (FAR_M over nothing), estimated body
        twist [m/s, rad/s]: shape (9,).
        """
        assert reading.tilt is not None
        return np.concatenate([reading.tilt, [min(reading.range_m, FAR_M)], reading.body_twist])

    def allocate(self, twist: Array, reading: Reading, mount: Mount, period: float) -> Allocation:
        """The setpoint (vx, vy, vz, wz) in the level frame for a camera twist (6,), scaled as a
        whole into the speed limits.

        Roll and pitch rates are dropped: the craft needs its tilt to accelerate.
        """
        u = (mount.to_flange @ twist)[LEVEL_AXES]
        vx, vy, vz, wz = u.tolist()
        over = max(
            math.hypot(vx, vy) / self.max_speed_mps,
            abs(vz) / self.max_climb_mps,
            abs(wz) / self.max_yaw_rate_radps,
            1.0,
        )
        u /= over
        return Allocation(
            setpoint=u,
            twist=mount.to_camera[:, LEVEL_AXES] @ u,
            scale=1.0 / over,
            limit="speed" if over > 1.0 else "",
        )

    def begin(self) -> Flight:
        """The state of a craft that hovers, level and at rest; its climb loop knows its battery's
        voltage by its trim.
        """
        share = self.battery.share_at_start(self.parameters) if self.battery else 1.0
        hover = self.parameters.hover / share
        trim = 0.0, 0.0, GRAVITY * (1.0 / share - 1.0)
        return Flight(loops=Loops(trim), W=(hover, hover, hover, hover))

    def actuate(
        self, state: Flight, setpoint: Array, reading: Instruments, dt: float
    ) -> tuple[Flight, Four]:
        """One control step: commanded squared rotor speeds (4,) for a setpoint (vx, vy, vz, wz).

        A setpoint that is not finite means hover; the stop `off` (a climb rate of -inf) disarms the
        craft for good: its rotors run out.
        """
        attitude, ground, loops, W, _, armed, limited_s = state
        gains = self.gains
        craft = self.parameters
        vx, vy, vz, wz = setpoint.tolist()
        armed = armed and vz != -math.inf
        if not math.isfinite(vx + vy + vz + wz):
            vx = vy = vz = wz = 0.0
        # The filters in turn: the last velocity estimate's rate levels the accelerometer, and the
        # new attitude the new velocity.
        known = STILL if self.attitude.acceleration == "imu" else ground[2]
        attitude = attitude_step(attitude, reading.gyro, reading.force, known, self.attitude, dt)
        R = level(attitude.up)
        gx, gy, gz = reading.gyro
        bx, by, bz = attitude.bias
        rates = gx - bx, gy - by, gz - bz
        yaw_rate = heading_rate(R, rates)
        ground = flight_sensors.step(ground, R, reading, yaw_rate, self.velocity, dt)
        if not armed:  # for good: nothing sets `armed` again
            W, orders = speed_control(W, (0.0, 0.0, 0.0, 0.0), gains.rotor_s, dt, craft)
            return Flight(attitude, ground, Loops(), W, rates, False), orders
        motion = ground[0], R, rates
        loops, thrust, torque = fly(loops, (vx, vy, vz, wz), motion, gains, craft, dt)
        reference, cut = mix(thrust, torque, craft)
        W, orders = speed_control(W, reference, gains.rotor_s, dt, craft)
        limited_s = limited_s + dt if cut else 0.0
        return Flight(attitude, ground, loops, W, rates, True, limited_s), orders

    def stands(self, state: Flight, reading: Instruments) -> bool:
        """Whether the ground carries the craft, by its own sensors: upright, near the ground, and
        it does not sink as commanded.

        Either its climb rate stays above the one that its setpoints should give (`Loops.model`),
        which shows at once; or, in a slow descent, the climb loop has taken thrust away, to under
        .9 of the weight.
        """
        attitude = state.attitude
        cosine = math.cos(attitude.roll) * math.cos(attitude.pitch)  # of the tilt
        upright = cosine > math.cos(math.radians(30))
        # a margin for the range finder's noise and a few degrees of tilt
        near = reading.range_m < STANDING_M + 0.05
        # The estimate's noise is .02 m/s. By the rotors alone it takes .5 s and more; on a deck
        # that moves, in wind, a craft light on its feet slides off meanwhile.
        stopped = state.armed and state.ground[0][2] - state.loops.model[2] > 0.12
        return upright and near and (stopped or sum(state.W) < 4 * 0.9 * self.parameters.hover)

    def reported(self, state: Flight, reading: Instruments) -> FlightReading:
        attitude = state.attitude
        tilt = np.array([attitude.roll, attitude.pitch])
        estimate = FlightEstimate(
            velocity=np.array(to_body(level(attitude.up), state.ground[0])),
            rates=np.array(state.rates),
            ref_tilt=np.array(state.loops.tilt),
            ref_rates=np.array(state.loops.ref_rates),
            rotor_limit_s=state.limited_s,
            overturned=state.overturned,
            stands=self.stands(state, reading),
        )
        return FlightReading(
            NO_JOINTS,
            NO_JOINTS,
            tilt=tilt,
            range_m=reading.range_m,
            voltage_v=reading.voltage_v,
            estimate=estimate,
        )
