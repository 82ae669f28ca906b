"""How a command becomes a setpoint: the camera's mount, the allocation, the actuators chosen."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from vstestbed.core.geometry import Array, adjoint, inverse

Limit = Literal["", "speed", "joint_limit", "singular"]


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
class Actuation:
    """Which of the actuators in a robot's MJCF file a scenario uses, and what its joints feel.

    Attributes:
        prefix: actuators named `<prefix>_<joint>` are kept, the others left out.
        friction: joints keep their damping and Coulomb friction.
        gravity_compensated: links are weightless to the joints (MuJoCo's gravcomp).
    """

    prefix: str
    friction: bool
    gravity_compensated: bool
