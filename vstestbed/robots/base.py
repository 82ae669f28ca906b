"""The contract of a robot: which camera twists it can make, and how a command becomes a setpoint within its limits."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, ClassVar, Literal, Protocol, runtime_checkable

import numpy as np

from vstestbed.core.geometry import Array, adjoint, inverse

NOTHING: Mapping[str, Array] = MappingProxyType({})
Limit = Literal["", "speed", "joint_limit", "singular"]


@dataclass(frozen=True, slots=True)
class Encoders:
    """What a robot measures of itself at one instant.

    Attributes:
        q, qd: its joints [rad, rad/s], shape (n,) each.
        instruments: readings of what else it carries (compass, gyro, ...), by the name of the sensor.
    """

    q: Array
    qd: Array
    instruments: Mapping[str, Array] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Allocation:
    """A command made a setpoint.

    Attributes:
        setpoint: what the actuators are told (joint velocities [rad/s], or a twist).
        twist: the camera twist (6,) that the setpoint stands for by the robot's own model.
        scale: factor in [0, 1] by which the whole command was scaled to stay within limits.
        limit: which limit scaled it ("" for none).
    """

    setpoint: Array
    twist: Array
    scale: float = 1.0
    limit: Limit = ""


@dataclass(frozen=True, slots=True)
class Mount:
    """Where the camera sits on the robot: twist transforms between the flange and the camera, made once.

    Attributes:
        T_flange_camera: pose (4, 4).
        to_flange, to_camera: adjoints (6, 6), twist_flange = to_flange @ twist_camera and back.
    """

    T_flange_camera: Array
    to_flange: Array
    to_camera: Array

    @classmethod
    def of(cls, T_flange_camera: Array) -> Mount:
        """The mount of a camera at a pose (4, 4) in the flange frame."""
        return cls(T_flange_camera, adjoint(T_flange_camera), adjoint(inverse(T_flange_camera)))

    @classmethod
    def facing(cls, T_flange_camera: Array) -> Mount:
        """Of a camera in the room that watches the flange, now at a pose (4, 4) in its frame.

        The camera's twist against what the flange holds is minus the flange's own: v_camera = -Ad(T_camera_flange) v_flange.
        """
        return cls(T_flange_camera, -adjoint(T_flange_camera), -adjoint(inverse(T_flange_camera)))


@dataclass(frozen=True, slots=True)
class Servo:
    """Which of the actuators in a robot's MJCF file a scenario uses, and what its joints feel.

    Attributes:
        prefix: actuators named `<prefix>_<joint>` are kept, the others left out.
        friction: joints keep their damping and Coulomb friction.
        gravity_compensated: links are weightless to the joints (MuJoCo's gravcomp).
    """

    prefix: str
    friction: bool
    gravity_compensated: bool


class Robot(Protocol):
    """A robot that carries (or is) the camera. Its configuration tells where it stands: joint angles, a flat pose, (x, y, heading)."""

    actuators: ClassVar[tuple[str, ...]]
    """Actuators, in the order of their controls."""
    sensors: ClassVar[tuple[str, ...]]
    """MJCF sensors that become the instruments of its encoders."""
    rides: ClassVar[bool]
    """Whether its base is free to go anywhere: joint `root` (or `root_x`, `root_y`, `root_yaw`) in its file."""
    grounded: ClassVar[bool]
    """Whether it stands on the floor and moves in the plane: its configuration is (x, y, heading)."""
    feet: ClassVar[tuple[str, ...]]
    """Of a robot that flies: the geoms in its file that may touch the ground, and nothing else of it may. Others have none."""
    control_period_s: ClassVar[float | None]
    """How often its onboard controller turns the setpoint into controls [s]; None where the setpoint is the controls."""
    largest_step_s: ClassVar[float]
    """The largest physics step that its servos were tested at [s]."""

    @property
    def kind(self) -> str:
        """The robot's word in a scenario."""
        ...

    @property
    def model(self) -> str | None:
        """Name of its MJCF file in models/, None for the ideal camera."""
        ...

    @property
    def joints(self) -> tuple[str, ...]:
        """Joints that it measures, in the order of its encoders."""
        ...

    @property
    def servo(self) -> Servo | None:
        """The actuation chosen, None for the ideal camera."""
        ...

    def configuration(self) -> Array:
        """The nominal start."""
        ...

    def randomised(self, rng: np.random.Generator) -> Robot:
        """The same robot, its nominal start drawn from the random block. ParameterError when it has none."""
        ...

    def flange_pose(self, configuration: Array) -> Array:
        """Pose (4, 4) of the flange in the world, by the robot's own model."""
        ...

    def motion_basis(self, mount: Mount) -> Array:
        """Camera twists the robot can make, shape (6, n): twist = basis @ u."""
        ...

    def measured(self, raw: Encoders, rng: np.random.Generator) -> Encoders:
        """What its instruments make of perfect readings: with their noise and bias."""
        ...

    def measured_twist(self, before: Encoders, now: Encoders, duration: float, ordered: Array, mount: Mount) -> Array:
        """Mean camera twist (6,) between two readings of its encoders; `ordered` where it has none."""
        ...

    def allocate(self, twist: Array, encoders: Encoders, mount: Mount, period: float) -> Allocation:
        """A camera twist (6,) as a setpoint that keeps the limits for one period [s]."""
        ...

    def begin(self) -> Any:
        """The memory of its onboard controller before the start."""
        ...

    def actuate(self, memory: Any, setpoint: Array, encoders: Encoders, dt: float) -> tuple[Any, Array]:
        """One step of its onboard controller: the next memory and the actuators' controls (nu,)."""
        ...

    def rest_ctrl(self) -> Array | None:
        """Controls, and activations, with which it keeps its start (nu,); None where those of the file do."""
        ...

    def reported(self, memory: Any, encoders: Encoders) -> Mapping[str, Array]:
        """What its onboard controller tells of itself, to put beside the instruments' readings."""
        ...


@runtime_checkable
class Redundant(Protocol):
    """A robot that has ends of its own for the motions which a law leaves open."""

    def aside(self, free: Array, encoders: Encoders, mount: Mount) -> Array:
        """A camera twist (6,) in the span of `free` (6, k), which is added to the law's."""
        ...


class Earthbound:
    """What a robot has that does not fly."""

    feet: ClassVar[tuple[str, ...]] = ()

    def rest_ctrl(self) -> Array | None:
        """Those of the file."""
        return None

    def reported(self, memory: Any, encoders: Encoders) -> Mapping[str, Array]:
        """Nothing."""
        return NOTHING


class Direct(Earthbound):
    """What a robot has whose setpoint is its actuators' controls and whose instruments are exact."""

    sensors: ClassVar[tuple[str, ...]] = ()
    rides: ClassVar[bool] = False
    grounded: ClassVar[bool] = False
    control_period_s: ClassVar[float | None] = None
    largest_step_s: ClassVar[float] = 0.002

    def measured(self, raw: Encoders, rng: np.random.Generator) -> Encoders:
        """The readings as they are."""
        return raw

    def begin(self) -> None:
        """No memory."""
        return

    def actuate(self, memory: None, setpoint: Array, encoders: Encoders, dt: float) -> tuple[None, Array]:
        """The setpoint itself."""
        return memory, setpoint
