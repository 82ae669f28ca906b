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
from collections.abc import Mapping
from typing import Annotated, ClassVar, Literal

import numpy as np
from annotated_types import Gt, Lt

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array
from vstestbed.core.planar import motion_between
from vstestbed.core.spec import spec
from vstestbed.robots.allocation import Allocation, Mount
from vstestbed.robots.body import Change
from vstestbed.robots.ground import PLANE, GroundStart
from vstestbed.robots.omni_body import PLATFORM, OmniParameters, larger_wheel
from vstestbed.robots.own_model import OwnModel
from vstestbed.robots.reading import Reading
from vstestbed.robots.realism import Level
from vstestbed.robots.vehicle_presets import OMNI
from vstestbed.robots.wheels import WHEELS
from vstestbed.robots.worn_vehicle import WornVehicle

LAG_PERIOD_S = 0.004
"""Period in which the drive's lag is computed [s]."""


@spec
class Omni(WornVehicle):
    """A platform on four mecanum wheels, driven by wheel speeds. Of its imperfections `planar` wheels can have lag alone.

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
    presets: ClassVar[Mapping[Level, Mapping[str, object]]] = OMNI
    actuators: ClassVar[tuple[str, ...]] = WHEELS
    motion_names: ClassVar[tuple[str, ...]] = ("vx", "vy", "wz")

    def __post_init__(self) -> None:
        """Refuse what planar wheels, which have no contact, cannot have."""
        for name in ("wheel_spread", "rolling_resistance", "uneven_floor"):
            if self.wheels == "planar" and getattr(self, name) is not None:
                words = (
                    "must be rollers with realism, wheel_spread, rolling_resistance or uneven_floor: planar wheels do not touch the floor"
                )
                raise ParameterError("wheels", words, self.wheels)

    @property
    def control_period_s(self) -> float | None:  # pyright: ignore[reportIncompatibleVariableOverride] - a property in place of a constant
        """That of the drive's lag; without it the wheels' speeds are the actuators' controls."""
        return LAG_PERIOD_S if self.drive_lag_s else None

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
        """Those of its parameters and of its imperfections."""
        found = list(self.parameters.changes(planar=self.wheels == "planar"))
        if self.rolling_resistance is not None:
            found += self.parameters.rolling(self.rolling_resistance)
        if self.wheel_spread is not None:
            for name, factor in zip(WHEELS, self.wheel_spread.factors, strict=True):
                found += larger_wheel(name, factor)
        return tuple(found)

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

    def begin(self) -> Array | None:
        """A drive with lag at rest (4,) [rad/s]."""
        return np.zeros(4) if self.drive_lag_s else None

    def actuate(self, memory: Array | None, setpoint: Array, reading: Reading, dt: float) -> tuple[Array | None, Array]:
        """The wheel speeds (4,) [rad/s] that the drive follows: those of the setpoint, or behind them."""
        if memory is None:
            return None, setpoint
        drive = self.lagged(memory, setpoint, dt)
        return drive, drive

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
