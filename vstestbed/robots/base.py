"""The contract of a robot: which camera twists it can make, and how a command becomes a setpoint
within its limits.

What only some robots have is a capability: a body in MuJoCo (`BodyFile`), an `Onboard` controller,
the joint space of an `arm.Arm`, the wheels of a `vehicle.Vehicle`.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array
from vstestbed.core.outcome import Outcome, Verdict
from vstestbed.effects.base import Effect, Sensors
from vstestbed.effects.body import Change
from vstestbed.robots.allocation import Actuation, Allocation, Mount, Order
from vstestbed.robots.own_model import CAMERA, OwnModel


@dataclass(frozen=True, slots=True)
class Reading:
    """Proprioception: joint encoders, and the two quantities of orientation that an observer can
    use.

    A robot with more sensors has a subclass with more fields (`FlightReading`).

    Attributes:
        q, qd: joint positions and velocities [rad, rad/s], shape (n,) each.
        heading: by a compass, from the world's x axis, counter-clockwise [rad]; None without one.
        tilt: estimated roll and pitch, shape (2,) [rad]; None where the robot estimates none.
        wrench: force and moment (6,) on what the flange carries, at its origin in its frame [N,
            Nm]; None without a sensor at the wrist.
    """

    q: Array
    qd: Array
    heading: float | None = None
    tilt: Array | None = None
    wrench: Array | None = None


# Supervisor: may override the law's order for the robot's safety, from proprioception alone.
#
#     follow --no measurement--> hold --lost_after_s, lost_after_m--> stop
#     follow, hold --the law fails--> stop
#
# While it holds, the law rests, or drives on by what it knew.
#
# Every robot has one. How a robot stops is its own matter (`Robot.stopping`); when it must is
# decided here, and for a craft that must set down besides in `failsafe`.
FOLLOWS, HOLDS, STOPS = range(3)  # modes, as numbered in the log's column `supervisor`
# a robot whose joints are all slower stands [rad/s; m/s for slides]: the rim of a car's wheel makes
# 3 mm/s
STANDS_RADPS = 0.02


@dataclass
class Supervisor:
    """Passes the law's order on, until the target has been out of sight for too long, or the law
    has failed: then it stops the robot.

    lost_after_s, lost_after_m: longest time [s], and longest way of the camera by the robot's own
    sensors [m], without a measurement.
    aborted: why the task was aborted; None while it goes on. mode: see FOLLOWS, ...
    """

    # The end of an aborted task, in words: brought to rest, or not in time.
    DOWN: ClassVar[tuple[str, str]] = (
        "the robot stands",
        "the robot was still moving when the time ran out",
    )
    lost_after_s: float = math.inf
    lost_after_m: float = math.inf
    aborted: Verdict | None = None
    mode: int = FOLLOWS
    _lost_at: float = math.nan
    _blind_m: float = 0.0
    _seen_once: bool = False
    _stands: bool = False

    def filter(
        self,
        t: float,
        blind: str,
        reading: Reading,
        order: Order,
        basis: Array,
        moved_m: float = 0.0,
    ) -> Order:
        """The order that goes to the robot.

        Args:
            t: time of exposure [s].
            blind: why the law has no measurement ("" while it has one). Without one it may command
                motion by what it knew.
            reading: the robot's sensor reading. order: the law's, after allocation. basis: camera
                twists (6, n) of the robot's motions.
            moved_m: way of the camera since the last frame, by the robot's own sensors [m]; it
                counts while blind.
        """
        lost = self._look(t, blind, moved_m)
        if lost and not self.aborted:
            if not self._seen_once:
                lost += ", from the start on"
            self.abort(t, Outcome.target_lost, lost)
        if not self.aborted:
            self.mode = HOLDS if blind else FOLLOWS
            return order
        self.mode = STOPS
        self._stands = bool(np.abs(reading.qd).max(initial=0.0) < STANDS_RADPS)
        return order.halted(self.aborted[1], latched=True)

    def abort(self, t: float, outcome: Outcome, reason: str) -> None:
        """Give the task up at a time [s]."""
        self.aborted = outcome, reason

    @property
    def may_touch(self) -> bool:
        """Whether ground contact of the robot's feet is allowed now."""
        return True

    def down(self, t: float) -> bool:
        """Whether the robot has come to rest for good, by its own sensors."""
        return self.aborted is not None and self._stands

    def _look(self, t: float, blind: str, moved_m: float) -> str:
        """Note whether there is a measurement; once it has been missing for too long, why (""
        before).
        """
        if not blind:
            self._lost_at = math.nan
            self._blind_m = 0.0
            self._seen_once = True
            return ""
        if math.isnan(self._lost_at):
            self._lost_at = t  # the way to here was commanded by a picture that showed the target
        else:
            self._blind_m += moved_m
        # Times are sums of steps: without 1e-9 a rounding would cost a frame.
        if t - self._lost_at + 1e-9 >= self.lost_after_s:
            return f"{blind} for {self.lost_after_s:g} s"
        if self._blind_m >= self.lost_after_m:
            return f"{blind} for {self.lost_after_m:g} m of the way"
        return ""


@dataclass(frozen=True, slots=True)
class RobotState:
    """Input of a robot's own log columns at one exposure. It holds truth, which goes to the log and
    nowhere else.

    Attributes:
        t: time [s].
        T_world_base: true pose of the base (4, 4).
        place, odometry: (x, y, heading) [m, m, rad] as the observer estimates them, NaN where it
            has none.
        reading: the robot's sensor reading.
        act: true activations of its actuators (nu,).
        wind: true velocity of the air in the world (3,) [m/s].
    """

    t: float
    T_world_base: Array
    place: Array
    odometry: Array
    reading: Reading
    act: Array
    wind: Array


class RobotLog:
    """The columns that only this robot has in a log, and their values frame by frame.

    Here `supervisor` alone: 0 follows the law, 1 holds (the law has no measurement: it rests, or
    goes on by what it knew), 2 stops for good. Each run makes its own: it may hold the last frame's
    state.

    supervisor: the robot's.
    """

    columns: tuple[str, ...] = ("supervisor",)

    def __init__(self, supervisor: Supervisor):
        self.supervisor = supervisor

    def row(self, state: RobotState) -> Array:
        """Values of the columns at one exposure, shape (len(columns),)."""
        return np.array([self.supervisor.mode])

    def proprioception(self, log: Mapping[str, Array]) -> dict[str, Array]:
        """Entries of `Robot.proprioception` by name, shape (frames,) each, as far as the robot's
        own columns of a log tell them.
        """
        return {}


LARGEST_STEP_S = 0.002  # the largest default physics step of a robot that names no other [s]
# default time in which a robot stops from any speed [s]: it decelerates by its speed limits over
# this time at most
STOP_S = 0.25


@dataclass(frozen=True, slots=True, eq=False)
class BodyFile:
    """A robot's body in MuJoCo: its MJCF file, and what of it is used.

    Attributes:
        file: a name in models/, or a whole path.
        actuators: in the order of their controls.
        sensors: those of the file that `Robot.instruments` turns into the reading.
        flange: the site, or the body, in the file that carries the camera.
        actuation: which of the file's actuators are used, and what is added to them; None: all, as
            they are.
        changes: what the robot's parameters change in the file.
        limits: lowest and highest position of each of `Robot.joints`, (n, 2) [rad, m]; None where
            no joint has any.
        rest_ctrl: controls and activations (nu,) that hold the robot at its start; None where the
            defaults of the file do.
        feet: geoms that may touch the ground while nothing else of the body may.
        standing_m: height of the base frame over what the feet stand on [m].
        gripper: whether it can hold the target in front of a camera that stands in the room.
        slips: whether the robot feels the floor's friction (`world.floor_friction`).
        largest_step_s: the largest physics step at which its actuators were tested [s]: servo gains
            of puma560.xml, contacts of wheels.
    """

    file: str
    actuators: tuple[str, ...] = ()
    sensors: tuple[str, ...] = ()
    flange: str = "flange"
    actuation: Actuation | None = None
    changes: tuple[Change, ...] = ()
    limits: Array | None = None
    rest_ctrl: Array | None = None
    feet: tuple[str, ...] = ()
    standing_m: float = 0.0
    gripper: bool = False
    slips: bool = True
    largest_step_s: float = LARGEST_STEP_S


Base = Literal["fixed", "planar", "floating"]
SensorModel = Callable[[Array, Array, Sensors], Any]
"""From true joint positions and speeds, (n,) each, and MuJoCo's perfect sensors by name to what the
robot's sensors read.
"""


class Robot:
    """A robot that carries (or is) the camera. Its configuration: joint angles, a flattened pose,
    or (x, y, heading).

    The defaults are those of a robot on a fixed base whose setpoint is its actuators' controls and
    whose instruments are exact. A robot of one's own gives at least `kind`, `start` and the
    abstract methods.
    """

    # it is a @spec: `dataclasses.replace` makes variants of it
    __dataclass_fields__: ClassVar[dict[str, Any]]

    kind: Any  # Its word in a scenario, a field of each robot
    # The start block: `nominal`, and `random` (None without one) from which starts are drawn
    start: Any
    base: ClassVar[Base] = "fixed"
    """`fixed` in the world (an arm; the ideal camera), `planar` (a vehicle on the floor, whose
    configuration is (x, y, heading)) or `floating` (a craft that flies). A base that moves is joint
    `root` (or `root_x`, `root_y`, `root_yaw`) in its file.
    """
    joints: ClassVar[tuple[str, ...]] = ()  # Joints that it measures, in the order of its reading
    body: ClassVar[BodyFile | None] = None  # Its body in MuJoCo; None for the ideal camera
    # Its onboard controller; None where the setpoint is the actuators' controls
    onboard: ClassVar[Onboard | None] = None
    # Its imperfections, in the order in which they change its model and act
    acting: ClassVar[tuple[Effect, ...]] = ()
    # Whether the scenario's seed makes a difference to its body or its sensors, besides the start
    draws: ClassVar[bool] = False

    @property
    def proprioception_names(self) -> tuple[str, ...]:
        """Names of the entries of `proprioception`."""
        return self.joints

    @abstractmethod
    def configuration(self) -> Array:
        """The nominal start."""
        ...

    def start_joints(self) -> Array:
        """What its joints read at the nominal start, shape (len(joints),) [rad]."""
        return np.zeros(len(self.joints))

    def drawn(self, rng: np.random.Generator) -> Any:
        """The same robot, with what differs from one to the next of its kind drawn from `rng`;
        itself where that is listed already.
        """
        return self

    @abstractmethod
    def randomised(self, rng: np.random.Generator) -> Robot:
        """The same robot, its nominal start drawn from the random block. ParameterError when it has
        none.
        """
        ...

    @abstractmethod
    def started_at(self, configuration: Array) -> Robot:
        """The same robot with this nominal start."""
        ...

    def configuration_at(self, T_world_flange: Array, near: Array) -> Array:
        """The configuration nearest to another one, `near`, in which its flange is at a pose (4,
        4), by the robot's own model.

        UnreachableError where it does not get there, ParameterError where it has no such inverse.
        """
        words = (
            "must be an arm or the free camera: only they start where a view of the target asks for"
        )
        raise ParameterError("robot.kind", words)

    @abstractmethod
    def flange_pose(self, configuration: Array) -> Array:
        """Pose (4, 4) of the flange in the world, by the robot's own model."""
        ...

    @abstractmethod
    def motion_basis(self, mount: Mount, q: Array) -> Array:
        """Camera twists that the robot can make with its joints at q (len(joints),), shape (6, n):
        twist = basis @ u.

        The columns are independent: n is at most six, also for an arm of seven joints, whose
        `allocate` resolves the redundancy.
        """
        ...

    def instruments(self, rng: np.random.Generator) -> SensorModel:
        """Its sensors in one run, with noise and bias; rng: draws the noise."""
        return lambda q, qd, sensors: Reading(q, qd)

    @abstractmethod
    def measured_twist(
        self, before: Reading, now: Reading, duration: float, commanded: Array, mount: Mount
    ) -> Array:
        """Mean camera twist (6,) between two readings; the commanded one, `commanded`, where the
        robot cannot measure it.
        """
        ...

    def proprioception(self, reading: Any, odometry: Array | None) -> Array:
        """What its sensors tell a learned policy (k,), `agent_pos`; odometry: a vehicle's way since
        its start (x, y, heading) [m, rad].
        """
        return reading.q

    @abstractmethod
    def allocate(self, twist: Array, reading: Reading, mount: Mount, period: float) -> Allocation:
        """The setpoint for a camera twist (6,), within the robot's limits for one period [s]."""
        ...

    def own_model(self, reading: Any, mount: Mount) -> OwnModel:
        """What its controller knows of it: its own velocities, their limits, the camera twist that
        they make.
        """
        J = self.motion_basis(mount, reading.q)
        n = J.shape[1]
        if n == 6:
            names = CAMERA
        elif len(self.joints) == n:
            names = self.joints
        else:
            names = tuple(f"u_{i}" for i in range(n))
        return OwnModel.of_motions(names, J, np.full(n, np.inf), np.full(n, np.inf))

    def supervisor(self, lands: bool, lost_after_s: float, lost_after_m: float) -> Supervisor:
        """What may override the law.

        lands: the task ends on the ground; lost_after_s, lost_after_m: for how long and how far to
            go on without a measurement [s, m].
        """
        return Supervisor(lost_after_s, lost_after_m)

    def log(self, supervisor: Supervisor) -> RobotLog:
        """The columns that only this robot has in a log."""
        return RobotLog(supervisor)

    def stopping(self, setpoint: Array, elapsed_s: float) -> Array:
        """Its own way to stop: the setpoint `elapsed_s` [s] after the last one, `setpoint`, has
        lost its force.

        By default all velocities fall to zero within STOP_S by the same factor: the motion keeps
        its direction.
        """
        return setpoint * max(0.0, 1.0 - elapsed_s / STOP_S)


RobotBase = Robot


class Onboard(Robot):
    """A robot with an onboard controller between its setpoint and the controls of its actuators."""

    reading: ClassVar[type[Reading]] = Reading  # the class of the reading that the loop sees
    control_period_s: float  # its period [s]
    # Before the first command; None where the controls stay those of the start until then
    first_setpoint: ClassVar[Array | None] = None

    @property
    def onboard(self) -> Onboard | None:
        """It has one."""
        return self

    def begin(self) -> Any:
        """The controller's initial state."""
        return None

    @abstractmethod
    def actuate(
        self, state: Any, setpoint: Array, reading: Any, dt: float
    ) -> tuple[Any, ArrayLike]:
        """One step of dt [s]: the next state, and the actuators' controls (nu,). reading: of the
        instruments.
        """
        ...

    def reported(self, state: Any, reading: Any) -> Any:
        """The reading that the loop sees: what the instruments read, with the controller's
        estimates.
        """
        return reading


def random_of(start: Any, example: str) -> Any:
    """The block of random starts. ParameterError where a robot has none."""
    if start.random is None:
        raise ParameterError.missing(
            "robot.start.random", f"a seed draws the start from it, e.g. {example}"
        )
    return start.random


def needed_step(robot: Robot) -> float:
    """The longest physics step that a robot's vibrations and drives allow [s]; infinite where they
    allow any.
    """
    return min((effect.longest_step_s for effect in robot.acting), default=math.inf)


def longest_step(robot: Robot) -> float:
    """The longest default physics step of a robot [s]."""
    return min(robot.body.largest_step_s if robot.body else LARGEST_STEP_S, needed_step(robot))
