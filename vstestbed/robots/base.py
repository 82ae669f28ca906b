"""The contract of a robot: which camera twists it can make, and how a command becomes a setpoint within its limits."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array
from vstestbed.core.outcome import Outcome, Verdict
from vstestbed.effects.base import Effect
from vstestbed.effects.body import Change
from vstestbed.robots.allocation import Actuation, Allocation, Mount, Order
from vstestbed.robots.own_model import CAMERA, OwnModel


@dataclass(frozen=True, slots=True)
class Reading:
    """Proprioception: joint encoders, and the two quantities of orientation that an observer can use.

    A robot with more sensors has a subclass with more fields (`FlightReading`).

    Attributes:
        q, qd: joint positions and velocities [rad, rad/s], shape (n,) each.
        heading: by a compass, from the world's x axis, counter-clockwise [rad]; None without one.
        tilt: estimated roll and pitch, shape (2,) [rad]; None where the robot estimates none.
    """

    q: Array
    qd: Array
    heading: float | None = None
    tilt: Array | None = None


# Supervisor: may override the law's order for the robot's safety, from proprioception alone.
#
#     follow --no measurement--> hold (the law rests, or drives on by what it knew) --lost_after_s, lost_after_m--> stop
#     follow, hold --the law fails--> stop
#
# Every robot has one. How a robot stops is its own matter (`Robot.stopping`); when it must is decided here, and for a craft that must
# set down besides in `failsafe`.
FOLLOWS, HOLDS, STOPS = range(3)  # modes, as numbered in the log's column `supervisor`
STANDS_RADPS = 0.02
"""A robot whose joints are all slower than this stands [rad/s; m/s for joints that slide]: the rim of a car's wheel makes 3 mm/s."""


@dataclass
class Supervisor:
    """Passes the law's order on, until the target has been out of sight for too long, or the law has failed: then it stops the robot.

    lost_after_s, lost_after_m: longest time [s], and longest way of the camera by the robot's own sensors [m], without a measurement.
    aborted: why the task was aborted; None while it goes on. mode: see FOLLOWS, ...
    """

    DOWN: ClassVar[tuple[str, str]] = "the robot stands", "the robot was still moving when the time ran out"
    """The end of an aborted task, in words: brought to rest, or not in time."""
    lost_after_s: float = math.inf
    lost_after_m: float = math.inf
    aborted: Verdict | None = None
    mode: int = FOLLOWS
    _lost_at: float = math.nan
    _blind_m: float = 0.0
    _seen_once: bool = False
    _stands: bool = False

    def filter(self, t: float, blind: str, reading: Reading, order: Order, basis: Array, moved_m: float = 0.0) -> Order:
        """The order that goes to the robot.

        Args:
            t: time of exposure [s].
            blind: why the law has no measurement ("" while it has one). Without one it may command motion by what it knew.
            reading: the robot's sensor reading. order: the law's, after allocation. basis: camera twists (6, n) of the robot's motions.
            moved_m: way of the camera since the last frame, by the robot's own sensors [m]; it counts while blind.
        """
        if (why := self._look(t, blind, moved_m)) and not self.aborted:
            self.abort(t, Outcome.target_lost, why if self._seen_once else f"{why}, from the start on")
        if not self.aborted:
            self.mode = HOLDS if blind else FOLLOWS
            return order
        self.mode, self._stands = STOPS, bool(np.abs(reading.qd).max(initial=0.0) < STANDS_RADPS)
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
        """Note whether there is a measurement; once it has been missing for too long, why ("" before)."""
        if not blind:
            self._lost_at, self._blind_m, self._seen_once = math.nan, 0.0, True
            return ""
        if math.isnan(self._lost_at):
            self._lost_at = t  # the way to here was commanded by a picture that showed the target
        else:
            self._blind_m += moved_m
        # Times are sums of steps: without 1e-9 a rounding would cost a frame.
        if t - self._lost_at + 1e-9 >= self.lost_after_s:
            return f"{blind} for {self.lost_after_s:g} s"
        return f"{blind} for {self.lost_after_m:g} m of the way" if self._blind_m >= self.lost_after_m else ""


@dataclass(frozen=True, slots=True)
class RobotState:
    """Input of a robot's own log columns at one exposure. It holds truth, which goes to the log and nowhere else.

    Attributes:
        t: time [s]. T_world_base: true pose of the base (4, 4).
        place, odometry: (x, y, heading) [m, m, rad] as the observer estimates them, NaN where it has none.
        reading: the robot's sensor reading.
        act: true activations of its actuators (nu,). wind: true velocity of the air in the world (3,) [m/s].
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

    Here `supervisor` alone: 0 follows the law, 1 holds (the law has no measurement: it rests, or goes on by what it knew), 2 stops for
    good. Each run makes its own: it may hold the last frame's state.

    supervisor: the robot's.
    """

    columns: tuple[str, ...] = ("supervisor",)

    def __init__(self, supervisor: Supervisor):
        self.supervisor = supervisor

    def row(self, state: RobotState) -> Array:
        """Values of the columns at one exposure, shape (len(columns),)."""
        return np.array([self.supervisor.mode])

    def proprioception(self, log: Mapping[str, Array]) -> dict[str, Array]:
        """Entries of `Robot.proprioception` by name, shape (frames,) each, as far as the robot's own columns of a log tell them."""
        return {}


Base = Literal["fixed", "planar", "floating"]


class Robot:
    """A robot that carries (or is) the camera. Its configuration: joint angles, a flattened pose, or (x, y, heading).

    The defaults are those of a robot on a fixed base whose setpoint is its actuators' controls and whose instruments are exact. A robot of
    one's own gives at least `kind`, `start` and the abstract methods.
    """

    __dataclass_fields__: ClassVar[dict[str, Any]]  # it is a @spec: `dataclasses.replace` makes variants of it

    kind: Any
    """Its word in a scenario, a field of each robot."""
    start: Any
    """The start block: `nominal`, and `random` (None without one) from which starts are drawn."""
    actuators: ClassVar[tuple[str, ...]] = ()
    """Actuators, in the order of their controls."""
    sensors: ClassVar[tuple[str, ...]] = ()
    """MJCF sensors that `measured` turns into its reading."""
    reading: ClassVar[type[Reading]] = Reading
    """The class of its reading."""
    base: ClassVar[Base] = "fixed"
    """`fixed` in the world (an arm; the ideal camera), `planar` (a vehicle on the floor, whose configuration is (x, y, heading)) or
    `floating` (a craft that flies). A base that moves is joint `root` (or `root_x`, `root_y`, `root_yaw`) in its file."""
    feet: ClassVar[tuple[str, ...]] = ()
    """Geoms in its file that may touch the ground while nothing else of it may."""
    standing_m: ClassVar[float] = 0.0
    """Height of its base frame over what its feet stand on [m]; 0 of a robot without feet."""
    flange: Any = "flange"
    """The name of the site, or the body, in its file that carries the camera."""
    gripper: ClassVar[bool] = False
    """Whether it can hold the target, in front of a camera that stands in the room."""
    largest_step_s: ClassVar[float] = 0.002
    """The largest physics step at which its actuators were tested [s]: servo gains in puma560.xml, contacts of the vehicles' wheels."""
    needed_step_s: ClassVar[float] = np.inf
    """The longest physics step that its vibrations and its drives allow [s]; infinite where they allow any."""
    control_period_s: ClassVar[float | None] = None
    """Period of its onboard controller, from setpoint to actuator controls [s]; None where the setpoint is the controls."""
    stop_s: ClassVar[float] = 0.25
    """How long it takes to stop [s], from any speed: at most a speed limit over it is the deceleration."""
    lag_s: ClassVar[float] = 0.0
    """Time constant with which its velocities follow their orders [s]."""
    motion_names: ClassVar[tuple[str, ...]] = CAMERA
    """Names of the columns of `motion_basis`."""
    model: ClassVar[str | None] = None
    """Its MJCF file: a name in models/, or a whole path. None for the ideal camera, which has no joints."""
    joints: ClassVar[tuple[str, ...]] = ()
    """Joints that it measures, in the order of its reading."""
    actuator_set: ClassVar[Actuation | None] = None
    """Which of the actuators in its file are used, and what is added to them; None: all."""
    body_changes: ClassVar[tuple[Change, ...]] = ()
    """What its parameters change in its file; () for the file as it is."""
    acting: ClassVar[tuple[Effect, ...]] = ()
    """Its imperfections, in the order in which they change its model and act."""
    ends_m: ClassVar[tuple[float, float]] = (0.0, 0.0)
    """Of a vehicle: x of its rear and of its front end in the base frame [m]."""
    turning_radius_m: ClassVar[float] = 0.0
    """Of a vehicle: the radius of its tightest circle [m]; 0: it is not limited."""
    top_speed_mps: ClassVar[float] = np.inf
    """Largest forward speed [m/s]; infinite where it has none of its own."""
    slips: ClassVar[bool] = True
    """Whether it may be given a floor of another friction (`world.floor_friction`)."""
    draws: ClassVar[bool] = False
    """Whether the scenario's seed makes a difference to its body or its sensors, besides the start and its heading."""
    draws_heading: ClassVar[bool] = False
    """Whether the seed makes a difference to its measured heading, which counts where landmarks tell its place."""

    @property
    def joint_limits(self) -> Array:
        """Lowest and highest position of each of its joints, (len(joints), 2) [rad, m]; infinite where there is none."""
        return np.tile([-np.inf, np.inf], (len(self.joints), 1))

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
        """The same robot, with what differs from one to the next of its kind drawn from `rng`; itself where that is listed already."""
        return self

    @abstractmethod
    def randomised(self, rng: np.random.Generator) -> Robot:
        """The same robot, its nominal start drawn from the random block. ParameterError when it has none."""
        ...

    @abstractmethod
    def started_at(self, configuration: Array) -> Robot:
        """The same robot with this nominal start."""
        ...

    def configuration_at(self, T_world_flange: Array, near: Array) -> Array:
        """The configuration nearest to another one, `near`, in which its flange is at a pose (4, 4), by the robot's own model.

        UnreachableError where it does not get there, ParameterError where it has no such inverse.
        """
        raise ParameterError("robot.kind", "must be an arm or the free camera: only they start where a view of the target asks for")

    def idealised(self) -> Any:
        """The same robot with actuators that follow their setpoint exactly, where it has such."""
        return self

    def check_mount(self, xyz: tuple[float, ...]) -> None:
        """Refuse an impossible place of the camera on the robot [m]. ParameterError names `camera.mount.xyz`."""

    @abstractmethod
    def flange_pose(self, configuration: Array) -> Array:
        """Pose (4, 4) of the flange in the world, by the robot's own model."""
        ...

    @abstractmethod
    def motion_basis(self, mount: Mount, q: Array) -> Array:
        """Camera twists that the robot can make with its joints at q (len(joints),), shape (6, n): twist = basis @ u.

        The columns are independent: n is at most six, also for an arm of seven joints, whose `allocate` resolves the redundancy.
        """
        ...

    @property
    def motion_limits(self) -> tuple[Array, Array]:
        """Largest speeds and accelerations along the columns of `motion_basis`, (n,) each [m/s, rad/s; per s]; infinite without one."""
        endless = np.full(len(self.motion_names), np.inf)
        return endless, endless

    def noise(self, rng: np.random.Generator) -> Any:
        """Where `measured` takes its sensors' noise from: `rng`, or what was drawn from it ahead."""
        return rng

    def measured(self, q: Array, qd: Array, sensors: Mapping[str, list[float]], noise: Any) -> Any:
        """What its sensors read: true joints and MuJoCo's perfect sensors, by name, with noise and bias added."""
        return Reading(q, qd)

    @abstractmethod
    def measured_twist(self, before: Reading, now: Reading, duration: float, commanded: Array, mount: Mount) -> Array:
        """Mean camera twist (6,) between two readings; the commanded one, `commanded`, where the robot cannot measure it."""
        ...

    def proprioception(self, reading: Any, odometry: Array | None) -> Array:
        """What its sensors tell a learned policy (k,), `agent_pos`; odometry: a vehicle's way since its start (x, y, heading) [m, rad]."""
        return reading.q

    @abstractmethod
    def allocate(self, twist: Array, reading: Reading, mount: Mount, period: float) -> Allocation:
        """The setpoint for a camera twist (6,), within the robot's limits for one period [s]."""
        ...

    def own_model(self, reading: Any, mount: Mount) -> OwnModel:
        """What its controller knows of it: its own velocities, their limits, the camera twist that they make."""
        return OwnModel.of_motions(self.motion_names, self.motion_basis(mount, reading.q), *self.motion_limits, lag_s=self.lag_s)

    def displacement(self, before: Reading, now: Reading, duration: float, commanded: Array, mount: Mount) -> Array:
        """How far its own velocities have led (n,) between two readings, of which `commanded` is the camera twist that was commanded."""
        twist = self.measured_twist(before, now, duration, commanded, mount)
        return np.asarray(np.linalg.lstsq(self.motion_basis(mount, now.q), twist * duration, rcond=None)[0], dtype=float)

    def allocate_rates(self, rates: Array, reading: Reading, mount: Mount, period: float) -> Allocation:
        """The setpoint for its own velocities (n,), within its limits for one period [s]."""
        return self.allocate(self.motion_basis(mount, reading.q) @ rates, reading, mount, period)

    def secondary_task(self, null_space: Array, reading: Reading, mount: Mount) -> Array:
        """Secondary task: a camera twist (6,) in the span of `null_space` (6, k), added to the law's."""
        return np.zeros(6)

    def supervisor(self, lands: bool, lost_after_s: float, lost_after_m: float) -> Supervisor:
        """What may override the law.

        lands: the task ends on the ground; lost_after_s, lost_after_m: for how long and how far to go on without a measurement [s, m].
        """
        return Supervisor(lost_after_s, lost_after_m)

    def log(self, supervisor: Supervisor) -> RobotLog:
        """The columns that only this robot has in a log."""
        return RobotLog(supervisor)

    def begin(self) -> Any:
        """The initial state of its onboard controller."""
        return None

    def actuate(self, memory: Any, setpoint: Array, reading: Any, dt: float) -> tuple[Any, ArrayLike]:
        """One step of its onboard controller: the next state and the actuators' controls (nu,)."""
        return memory, setpoint

    def reported(self, memory: Any, reading: Any) -> Any:
        """The reading that the loop sees: what the sensors read, with the onboard controller's estimates."""
        return reading

    def rest_ctrl(self) -> Array | None:
        """Controls and activations (nu,) that hold it at its start; None where the defaults of its file do."""
        return None

    def hold_setpoint(self) -> Array | None:
        """The setpoint before the first command; None where `rest_ctrl` does."""
        return None

    def stopping(self, setpoint: Array, elapsed_s: float) -> Array:
        """Its own way to stop: the setpoint `elapsed_s` [s] after the last one, `setpoint`, has lost its force.

        By default all velocities fall to zero within `stop_s` by the same factor: the motion keeps its direction.
        """
        return setpoint * max(0.0, 1.0 - elapsed_s / self.stop_s) if self.stop_s > 0 else np.zeros_like(setpoint)


RobotBase = Robot


def random_of(start: Any, example: str) -> Any:
    """The block of random starts. ParameterError where a robot has none."""
    if start.random is None:
        raise ParameterError("robot.start.random", f"is missing: a seed draws the start from it, e.g. {example}")
    return start.random


def longest_step(robot: Robot) -> float:
    """The longest default physics step of a robot [s]."""
    return min(robot.largest_step_s, robot.needed_step_s)
