"""From a camera twist to an actuator setpoint: the camera's mount, the allocation, the choice of
actuators.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np

from vstestbed.core.geometry import Array, adjoint, inverse
from vstestbed.timing.setpoints import Stop

Limit = Literal["", "speed", "joint_limit", "singular", "motion"]
LIMITS: dict[Limit, str] = {
    "": "",
    "speed": "a speed limit shortens the twist",
    "joint_limit": "a joint near its limit shortens the twist",
    "singular": "the robot is near a singular configuration, and leaves out a part of the twist",
    "motion": "the robot has no motion for a part of the twist, and leaves it out",
}
"""What each limit does to a commanded twist, in words; their order gives the numbers of the log's
column `limit`.
"""
# a twist that differs by less than this share of it, or by 1e-9 m/s or rad/s, is the one that was
# commanded
ROUNDING = 1e-6
# The motion basis of a robot that can make any camera twist; read-only, since all frames share it
ALL_SIX = np.eye(6)
ALL_SIX.flags.writeable = False


@dataclass(frozen=True, slots=True)
class Allocation:
    """A commanded camera twist, allocated to the actuators.

    Attributes:
        setpoint: of the actuators or the onboard controller (joint velocities [rad/s], or a twist).
        twist: the camera twist (6,) that the setpoint realises by the robot's own model.
        scale: factor in [0, 1] by which the whole command was scaled to stay within limits, or the
            share of it that is realised.
        limit: what makes `twist` another one than was commanded; "" where it is that one.
        rates: the robot's own velocities (n,) that the setpoint orders (`OwnModel`); None: those of
            `twist`.
        turned_rad: the angle between `twist` and the commanded one as vectors of six numbers in m/s
            and rad/s, pi for one against the command [rad].
    """

    setpoint: Array
    twist: Array
    scale: float = 1.0
    limit: Limit = ""
    rates: Array | None = None
    turned_rad: float = 0.0

    def told(self, wanted: Array) -> Allocation:
        """The same, with what makes it differ from the commanded twist (6,), whatever the robot
        says of it.
        """
        if not differs(self.twist, wanted):
            return self
        sizes = float(np.linalg.norm(self.twist) * np.linalg.norm(wanted))
        cosine = float(self.twist @ wanted) / sizes if sizes > 0 else 1.0
        turned = math.acos(max(-1.0, min(1.0, cosine)))
        if turned <= ROUNDING:
            turned = 0.0
        return replace(self, limit=self.limit or "motion", turned_rad=turned)


def differs(made: Array, wanted: Array) -> bool:
    """Whether a twist (6,) is another one than was wanted, by more than rounding."""
    return float(np.abs(made - wanted).max()) > 1e-9 + ROUNDING * float(np.abs(wanted).max())


@dataclass(frozen=True, slots=True)
class Mount:
    """Where the camera sits on the robot, with the twist transforms between flange and camera,
    computed once.

    T_flange_camera: pose (4, 4). to_flange, to_camera: adjoints (6, 6), twist_flange = to_flange @
    twist_camera and back.
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
        """The mount of an eye-to-hand camera, now at a pose (4, 4) in the flange's frame.

        v_camera = -Ad(T_camera_flange) v_flange, the camera's twist relative to the target in the
        gripper.
        """
        # The camera stands still in the room: moving the flange is, for the pictures, the opposite
        # motion of the camera. With this sign, a law needs no eye-to-hand variant.
        return cls(T_flange_camera, -adjoint(T_flange_camera), -adjoint(inverse(T_flange_camera)))


@dataclass(frozen=True, slots=True)
class Servo:
    """The servo of one joint, told its speed.

    joint: its name. speed: largest one it is told [rad/s, m/s]. torque: largest one [Nm, N]; None
    for the file's own servo.
    kp: position gain, of a servo that integrates the speed to a position [Nm/rad, N/m]; 0 for none.
    kv: velocity gain; with neither it is a motor that is told its torque.
    """

    joint: str
    speed: float
    torque: float | None
    kp: float = 0.0
    kv: float = 0.0


@dataclass(frozen=True, slots=True)
class Actuation:
    """Which actuators a scenario uses, and which forces act on its joints.

    Attributes:
        prefix: actuators named `<prefix>_<joint>` in the robot's MJCF file are kept, the others
            deleted; None: all are kept.
        friction: joints keep their damping and Coulomb friction.
        gravity_compensated: links are weightless to the joints (MuJoCo's gravcomp).
        servos: take the place of the file's actuators on their joints.
        gravity_error: share of the weight that a gravity compensation leaves uncarried, which the
            servos do not know; None: no error.
    """

    prefix: str | None
    friction: bool
    gravity_compensated: bool
    servos: tuple[Servo, ...] = ()
    gravity_error: float | None = None

    @property
    def carried(self) -> float:
        """The share of a body's weight that the drives' gravity compensation carries; 0 for drives
        without one.
        """
        if self.gravity_error is not None:
            return 1.0 - self.gravity_error
        return 1.0 if self.gravity_compensated else 0.0

    def gains(self) -> dict[str, dict[str, float | None]]:
        """Of the servos that take the file's place, by joint: `servo_kp` [Nm/rad, N/m], `servo_kv`
        [Nm s/rad, N s/m], `servo_torque`.

        The largest torque [Nm, N] is None without a limit. Empty where all servos are the file's
        own.
        """
        kp: dict[str, float | None] = {}
        kv: dict[str, float | None] = {}
        most: dict[str, float | None] = {}
        for servo in self.servos:
            if servo.torque is not None:
                kp[servo.joint] = servo.kp
                kv[servo.joint] = servo.kv
                most[servo.joint] = servo.torque if math.isfinite(servo.torque) else None
        return {"servo_kp": kp, "servo_kv": kv, "servo_torque": most} if kp else {}


class Order(NamedTuple):
    """What the robot is to do: a velocity, or a stop with its reason. All numbers are finite, and
    those of a stop are at rest.

    Attributes:
        setpoint: of the actuators or the onboard controller (joint velocities [rad/s], or a twist);
            of a stop the one at which the robot comes to rest (of a car: no speed, the steering as
            it was).
        twist: the camera twist (6,) that the setpoint realises by the robot's own model [m/s,
            rad/s]; of a stop zero.
        rates: the robot's own velocities (n,) that it orders (`OwnModel`); None: those of `twist`.
        stop: "" for a velocity, `stop`, or `off`: see `Stop`.
        reason: why the robot stops, or has another velocity than the law's; "" while it follows the
            law.
        latched: the supervisor has taken the robot from the law for good: nothing but
            `Controller.reset` gives it back.
    """

    setpoint: Array
    twist: Array
    rates: Array | None = None
    stop: Stop = ""
    reason: str = ""
    latched: bool = False

    @property
    def stopped(self) -> bool:
        """Whether it is a stop."""
        return bool(self.stop)

    @classmethod
    def of(cls, allocation: Allocation) -> Order:
        """The law's own, within the robot's limits; `reason` names the one that changes it."""
        words = LIMITS[allocation.limit]
        if allocation.turned_rad:
            words += "; it moves another way than was commanded"
        return cls(allocation.setpoint, allocation.twist, allocation.rates, reason=words)

    def halted(self, reason: str, latched: bool = False, stop: Stop = "stop") -> Order:
        """A stop in its place."""
        return Order(np.zeros_like(self.setpoint), np.zeros(6), None, stop, reason, latched)
