"""Omnidirectional base on four mecanum wheels: wheel kinematics both ways, odometry, limits.

A wheel's rollers turn freely about their axles: the floor constrains the point under the wheel only along the axis of the roller that
lies there. With the wheel at (x, y), turning at q_dot, and that roller along (cos(phi), side):

    cos(phi) (vx - wz y - R q_dot) + side (vy + wz x) = 0

where phi is how far the wheel has turned from "a roller straight below", in [-pi/n, pi/n] for n rollers: a roller at 45 degrees
to the axle is tilted by phi, and its projection on the floor turned. Textbooks have cos(phi) = 1, as for infinitely many rollers; a wheel
with n rollers has the mean over a roller's turn, kappa = sin(pi/n) / (pi/n), which is .980 for nine. Thus

    R q_dot = vx + side (vy + wz x) / kappa - wz y

and with kappa = 1 the equations of the textbooks: vx -+ vy -+ (half base + half track) wz.

Reference: Muir & Neuman 1987, "Kinematic modeling for feedback control of an omnidirectional wheeled mobile robot", ICRA, pp.
1772-1778; Taheri, Qiao & Ghaeminezhad 2015, doi:10.5120/19804-1586. Any roller angle: Lynch & Park 2017, Modern Robotics, 13.2.
Bodies are in models/omni.xml and models/omni_planar.xml, which `parameters` changes (`omni_body.OmniParameters`).
"""

from __future__ import annotations

import dataclasses
from typing import Annotated, ClassVar, Literal

import numpy as np
from annotated_types import Gt, Lt

from vstestbed.core.geometry import Array
from vstestbed.core.planar import motion_between
from vstestbed.core.spec import spec
from vstestbed.robots.allocation import Allocation, Mount
from vstestbed.robots.body import Change
from vstestbed.robots.ground import PLANE, GroundStart, Vehicle
from vstestbed.robots.omni_body import PLATFORM, WHEELS, OmniParameters
from vstestbed.robots.own_model import OwnModel
from vstestbed.robots.reading import Reading


@spec
class Omni(Vehicle):
    """A platform on four mecanum wheels, driven by wheel speeds.

    Args:
        wheels: `rollers` (default): nine free rollers on each wheel touch the floor, and slip where it is slippery;
            `planar`: ideal wheels without contact, a tenth of the cost.
        parameters: mass, wheels and motors, which the base knows.
        start: where it starts on the floor.
        wheel_radius_error: relative error of the calibrated wheel radius [1]: .02 for 2 % too large.
    """

    kind: Literal["omni"] = "omni"
    wheels: Literal["rollers", "planar"] = "rollers"
    parameters: OmniParameters = PLATFORM
    start: GroundStart = GroundStart()
    wheel_radius_error: Annotated[float, Gt(-0.5), Lt(1)] = 0.0
    actuators: ClassVar[tuple[str, ...]] = WHEELS
    motion_names: ClassVar[tuple[str, ...]] = ("vx", "vy", "wz")

    @property
    def stop_s(self) -> float:  # pyright: ignore[reportIncompatibleVariableOverride] - a property in place of a constant
        """From its top speed, of 1 m/s by default, at 2 m/s^2: rollers hold on a dry floor [s]."""
        return self.top_speed_mps / 2.0

    @property
    def model(self) -> str:
        """Its MJCF file."""
        return "omni.xml" if self.wheels == "rollers" else "omni_planar.xml"

    @property
    def body_changes(self) -> tuple[Change, ...]:
        """Those of its parameters."""
        return self.parameters.changes(planar=self.wheels == "planar")

    @property
    def ends_m(self) -> tuple[float, float]:
        """The x of the rear and the front edge of its wheels [m]."""
        return self.parameters.ends_m

    @property
    def top_speed_mps(self) -> float:
        """Straight ahead [m/s]."""
        return self.parameters.top_speed_mps

    @property
    def slips(self) -> bool:
        """Rollers do; planar wheels never."""
        return self.wheels == "rollers"

    @property
    def joints(self) -> tuple[str, ...]:
        """The joints that its encoders read: the wheels, or the base's own joints in the model without wheel joints."""
        # Only differences of the latter are used (`odometry`): the absolute place would be truth.
        return WHEELS if self.wheels == "rollers" else ("root_x", "root_y", "root_yaw")

    def randomised(self, rng: np.random.Generator) -> Omni:
        """The same base with a start drawn from the box. ParameterError when it has none."""
        return dataclasses.replace(self, start=self.start.drawn(rng))

    def started_at(self, configuration: Array) -> Omni:
        """The same base from another place (x, y, heading)."""
        return dataclasses.replace(self, start=self.start.at(configuration))

    def motion_basis(self, mount: Mount, q: Array) -> Array:
        """Camera twists of (vx, vy, wz) of the base, shape (6, 3), for any mount."""
        return mount.to_camera @ PLANE

    @property
    def motion_limits(self) -> tuple[Array, Array]:
        """Straight ahead, sideways, on the spot, as its wheels' speed allows; it stops from these within `stop_s`."""
        speeds = self.parameters.wheel_speed_radps / np.abs(self.parameters.W).max(axis=0)
        return speeds, speeds / self.stop_s

    def own_model(self, reading: Reading, mount: Mount) -> OwnModel:
        """Its planar motion, with the speed that each wheel may have."""
        wheels = self.parameters.W / (1 + self.wheel_radius_error)
        most = np.full(len(wheels), self.parameters.wheel_speed_radps)
        return dataclasses.replace(super().own_model(reading, mount), sums=wheels, most=most)

    def odometry(self, before: Reading, now: Reading, duration: float) -> Array:
        """Mean motion (vx, vy, wz) of the base between two readings of its encoders, with the calibrated radius.

        Rollers: inverse wheel kinematics, blind to slip. Planar: the arc of constant velocity between the two poses, which is what
        wheels without slip would measure, to third order in the duration.
        """
        belief = 1 + self.wheel_radius_error
        if duration <= 0:
            return np.zeros(3)
        if self.wheels == "planar":
            return belief * motion_between(before.q, now.q, duration)
        return belief * (self.parameters.W_inverse @ (now.q - before.q)) / duration

    def measured_twist(self, before: Reading, now: Reading, duration: float, commanded: Array, mount: Mount) -> Array:
        """Mean camera twist (6,) between two readings, from the encoders alone; zero where no time has passed."""
        return mount.to_camera @ PLANE @ self.odometry(before, now, duration)

    def allocate(self, twist: Array, reading: Reading, mount: Mount, period: float) -> Allocation:
        """Wheel speeds (4,) [rad/s] for a camera twist (6,), scaled as a whole into their limits.

        Only (vx, vy, wz) of the base's twist can be realised; the rest is dropped, also from `Allocation.twist`.
        """
        motion = PLANE.T @ (mount.to_flange @ twist)
        # Wheels that the robot takes for larger than they are get less speed, and the base moves by less than `twist` says.
        speeds = self.parameters.W @ motion / (1 + self.wheel_radius_error)
        scale = min(1.0, self.parameters.wheel_speed_radps / max(float(np.abs(speeds).max()), 1e-12))
        limit: Literal["", "speed"] = "speed" if scale < 1.0 else ""
        return Allocation(setpoint=speeds * scale, twist=mount.to_camera @ PLANE @ motion * scale, scale=scale, limit=limit)
