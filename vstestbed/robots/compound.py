"""A mobile manipulator: an arm on the deck of an omnidirectional platform,
as one chain of joints.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge, Le

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array
from vstestbed.core.registry import Registry
from vstestbed.core.spec import spec
from vstestbed.robots.allocation import Actuation, Servo
from vstestbed.robots.arm import Arm, ArmStart
from vstestbed.robots.chain import JointChain, reader
from vstestbed.robots.mjcf import Mjcf
from vstestbed.robots.omni import OmniParameters
from vstestbed.robots.puma560 import Puma560

PLATFORM = "omni_planar.xml"
DECK_M = 0.119  # height of the platform's deck over the floor [m]
# the platform's joints: along and across the world's axes, and about its own
WHEELS = "root_x", "root_y", "root_yaw"
UPPER = "arm_"  # what stands before the names of the arm's joints
# of the platform's servos, critically damped: they answer like the loops of its wheels [rad/s]
BANDWIDTH_RADPS = 30.0


ARMS = Registry("arm", Puma560, Mjcf, default="puma560")


@spec
class Compound(Arm):
    """An arm on an omnidirectional platform whose wheels do not slip: nine joints of a Puma's six,
    of which six are for the camera.

    A camera twist is shared by the least joint speeds, in metres and radians over the arm's longest
    link. What that leaves open keeps the arm in its middle: its joints are drawn to those of the
    start, in the null space of the camera's motion, and the platform drives where the arm would
    stretch. Of the platform there are mass, and its wheels' largest force and speed along each axis
    and in yaw; it neither slips nor tips over, and its odometry is exact.

    Args:
        platform: its parameters, of an `omni` base.
        arm: a `puma560` or an `mjcf` arm, with its servos and its own parameters; its `start` is
            not used.
        start: the platform's x and y [m] and heading, then the arm's joints [m, m, deg, deg, ...].
        posture_gain: of the pull of the arm's joints to those of the start, in the null space
            [1/s].
    """

    kind: Literal["compound"] = "compound"
    platform: OmniParameters = OmniParameters(mass_kg=60.0, motor_torque_nm=15.0)
    arm: Annotated[Puma560 | Mjcf, ARMS] = Puma560()
    start: ArmStart
    posture_gain: Annotated[float, Ge(0), Le(10)] = 0.5
    avoid_limits = 0.0

    def __post_init__(self) -> None:
        """Refuse what belongs to the arm's own block."""
        for field in ("gears", "strain_wave", "ripple", "encoders", "drives", "geometry_error"):
            given = getattr(self, field)
            if given is not None:
                raise ParameterError.only_for(field, "an arm on a base that stands", given)
        object.__setattr__(self, "joints", self.chain.names)  # frozen: those of both
        self._check()

    @cached_property
    def chain(self) -> JointChain:
        """Platform and arm, one after the other."""
        arm = self.arm.chain
        up = np.array([0.0, 0.0, DECK_M])
        T_0 = arm.T_0.copy()
        T_0[:3, 3] += up
        return JointChain(
            names=(*WHEELS, *(f"{UPPER}{name}" for name in arm.names)),
            slides=np.concatenate([[True, True, False], arm.slides]),
            axes=np.vstack([[1.0, 0, 0], [0, 1, 0], [0, 0, 1], arm.axes]),
            anchors=np.vstack([np.zeros((3, 3)), arm.anchors + up]),
            T_0=T_0,
            limits=np.vstack([np.tile([-np.inf, np.inf], (3, 1)), arm.limits]),
        )

    @property
    def flange(self) -> str:  # pyright: ignore[reportIncompatibleVariableOverride] - a property in place of a constant
        """That of the arm, in the model of both."""
        return f"{UPPER}{self.arm.flange}"

    @property
    def unit_m(self) -> float:
        """The arm's longest link [m]."""
        return self.arm.unit_m

    @property
    def file(self) -> str:  # pyright: ignore[reportIncompatibleVariableOverride] - a property in place of a constant
        """The model of both, made of the two files."""
        changes = self.platform.changes(planar=True)
        return reader().mounted(PLATFORM, changes, self.arm.file, (0.0, 0.0, DECK_M))

    @property
    def actuation(self) -> str:  # pyright: ignore[reportIncompatibleVariableOverride] - as above
        """That of the arm."""
        return self.arm.actuation

    @property
    def joint_speeds(self) -> Array:  # pyright: ignore[reportIncompatibleVariableOverride] - as above
        """Of the platform along each axis and in yaw, and of the arm."""
        p = self.platform
        speed = p.wheel_speed_radps * p.wheel_radius_m
        return np.concatenate([[speed, speed, speed / self._lever_m], self.arm.joint_speeds])

    @property
    def _lever_m(self) -> float:
        """From the platform's middle to where a wheel pushes in yaw [m]."""
        return (self.platform.wheelbase_m + self.platform.track_m) / 2

    @property
    def largest_torques(self) -> Array:
        force = 4 * self.platform.motor_torque_nm / self.platform.wheel_radius_m
        return np.concatenate([[force, force, force * self._lever_m], self.arm.largest_torques])

    @property
    def servo_set(self) -> Actuation:  # pyright: ignore[reportIncompatibleVariableOverride] - as above
        """Servos of the platform that hold what the ordered speeds have led to, and those of the
        arm.
        """
        own = self.arm.servo_set
        speeds = self.joint_speeds.tolist()
        most = self.largest_torques.tolist()
        q = tuple(self.configuration().tolist())
        M, _ = reader().inertia_at(self.file, self.chain.names, q)
        w = BANDWIDTH_RADPS
        wheels = []
        for i, name in enumerate(WHEELS):
            m = float(M[i, i])
            wheels.append(Servo(name, speeds[i], most[i], m * w * w, 2 * m * w))
        upper = [replace(servo, joint=f"{UPPER}{servo.joint}") for servo in own.servos]
        return replace(own, servos=(*wheels, *upper))

    def _away_from_limits(self, q: Array) -> Array:
        """dq* = -posture_gain (q - q_start) of the arm's joints; the platform has no middle."""
        pull = -self.posture_gain * (q - self.configuration())
        pull[: len(WHEELS)] = 0.0
        return pull
