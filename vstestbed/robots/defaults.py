"""Defaults of a robot: what `base.Robot` asks for and most robots have alike."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, Protocol

import numpy as np
from numpy.typing import ArrayLike

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array
from vstestbed.effects.base import Effect
from vstestbed.effects.body import Change
from vstestbed.robots.allocation import Actuation, Allocation, Mount
from vstestbed.robots.base import Base, Reading, RobotLog, Supervisor
from vstestbed.robots.own_model import CAMERA, OwnModel


class _Moves(Protocol):
    """What the defaults below need of the robot itself."""

    motion_names: ClassVar[tuple[str, ...]]
    lag_s: ClassVar[float]

    @property
    def motion_limits(self) -> tuple[Array, Array]: ...
    def motion_basis(self, mount: Mount, q: Array) -> Array: ...
    def measured_twist(self, before: Reading, now: Reading, duration: float, commanded: Array, mount: Mount) -> Array: ...
    def allocate(self, twist: Array, reading: Reading, mount: Mount, period: float) -> Allocation: ...


class RobotBase:
    """Defaults: a robot on a fixed base whose setpoint is its actuators' controls and whose instruments are exact."""

    actuators: ClassVar[tuple[str, ...]] = ()
    sensors: ClassVar[tuple[str, ...]] = ()
    reading: ClassVar[type[Reading]] = Reading
    base: ClassVar[Base] = "fixed"
    feet: ClassVar[tuple[str, ...]] = ()
    standing_m: ClassVar[float] = 0.0
    flange = "flange"
    gripper: ClassVar[bool] = False
    control_period_s: ClassVar[float | None] = None
    # The servo gains in puma560.xml and the contacts of the vehicles' wheels were measured at 2 ms.
    largest_step_s: ClassVar[float] = 0.002
    stop_s: ClassVar[float] = 0.25
    """How long it takes to stop [s], from any speed: at most a speed limit over it is the deceleration."""

    lag_s: ClassVar[float] = 0.0
    """Time constant with which its velocities follow their orders [s]."""
    motion_names: ClassVar[tuple[str, ...]] = CAMERA
    """Names of the columns of `motion_basis`."""

    @property
    def model(self) -> str | None:
        """No body."""
        return None

    @property
    def joints(self) -> tuple[str, ...]:
        """None that it measures."""
        return ()

    @property
    def joint_limits(self) -> Array:
        """None."""
        return np.tile([-np.inf, np.inf], (len(self.joints), 1))

    @property
    def proprioception_names(self) -> tuple[str, ...]:
        """The joints."""
        return self.joints

    @property
    def actuator_set(self) -> Actuation | None:
        """All actuators of its file."""
        return None

    @property
    def body_changes(self) -> tuple[Change, ...]:
        """None."""
        return ()

    @property
    def needed_step_s(self) -> float:
        """Any will do."""
        return np.inf

    @property
    def acting(self) -> tuple[Effect, ...]:
        """None."""
        return ()

    def drawn(self, rng: np.random.Generator) -> Any:
        """Itself."""
        return self

    @property
    def draws(self) -> bool:
        """No."""
        return False

    @property
    def draws_heading(self) -> bool:
        """No."""
        return False

    @property
    def ends_m(self) -> tuple[float, float]:
        """Its origin."""
        return 0.0, 0.0

    @property
    def turning_radius_m(self) -> float:
        """0: it is not limited [m]."""
        return 0.0

    @property
    def top_speed_mps(self) -> float:
        """No limit of its own."""
        return np.inf

    @property
    def slips(self) -> bool:
        """Yes, for whatever of it touches the floor."""
        return True

    def start_joints(self) -> Array:
        """All at zero."""
        return np.zeros(len(self.joints))

    def configuration_at(self, T_world_flange: Array, near: Array) -> Array:
        """None: refused."""
        raise ParameterError("robot.kind", "must be an arm or the free camera: only they start where a view of the target asks for")

    def idealised(self) -> Any:
        """Itself."""
        return self

    def check_mount(self, xyz: tuple[float, ...]) -> None:
        """Any place will do."""

    def noise(self, rng: np.random.Generator) -> Any:
        """The generator itself."""
        return rng

    def measured(self, q: Array, qd: Array, sensors: Mapping[str, list[float]], noise: Any) -> Any:
        """The joints as they are."""
        return Reading(q, qd)

    def proprioception(self, reading: Any, odometry: Array | None) -> Array:
        """The joints' positions [rad, m]."""
        return reading.q

    @property
    def motion_limits(self) -> tuple[Array, Array]:
        """Largest speeds and accelerations along the columns of `motion_basis`, (n,) each [m/s, rad/s; per s]: none."""
        endless = np.full(len(self.motion_names), np.inf)
        return endless, endless

    def own_model(self: _Moves, reading: Any, mount: Mount) -> OwnModel:
        """Its motions, with their speeds and accelerations."""
        return OwnModel.of_motions(self.motion_names, self.motion_basis(mount, reading.q), *self.motion_limits, lag_s=self.lag_s)

    def displacement(self: _Moves, before: Reading, now: Reading, duration: float, commanded: Array, mount: Mount) -> Array:
        """That of its measured camera twist."""
        twist = self.measured_twist(before, now, duration, commanded, mount)
        return np.asarray(np.linalg.lstsq(self.motion_basis(mount, now.q), twist * duration, rcond=None)[0], dtype=float)

    def allocate_rates(self: _Moves, rates: Array, reading: Reading, mount: Mount, period: float) -> Allocation:
        """The setpoint of their camera twist."""
        return self.allocate(self.motion_basis(mount, reading.q) @ rates, reading, mount, period)

    def secondary_task(self, null_space: Array, reading: Reading, mount: Mount) -> Array:
        """None."""
        return np.zeros(6)

    def supervisor(self, lands: bool, lost_after_s: float, lost_after_m: float) -> Supervisor:
        """One that stops it."""
        return Supervisor(lost_after_s, lost_after_m)

    def log(self, supervisor: Supervisor) -> RobotLog:
        """The supervisor's mode."""
        return RobotLog(supervisor)

    def begin(self) -> Any:
        """No memory."""
        return None

    def actuate(self, memory: Any, setpoint: Array, reading: Any, dt: float) -> tuple[Any, ArrayLike]:
        """The setpoint itself."""
        return memory, setpoint

    def reported(self, memory: Any, reading: Any) -> Any:
        """Nothing more."""
        return reading

    def rest_ctrl(self) -> Array | None:
        """Those of the file."""
        return None

    def hold_setpoint(self) -> Array | None:
        """None."""
        return None

    def stopping(self, setpoint: Array, elapsed_s: float) -> Array:
        """Velocities that fall to zero within `stop_s`, all by the same factor: the motion keeps its direction."""
        return setpoint * max(0.0, 1.0 - elapsed_s / self.stop_s) if self.stop_s > 0 else np.zeros_like(setpoint)
