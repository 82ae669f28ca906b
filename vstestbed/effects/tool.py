"""What an arm has in its hand: a plug, and a force sensor at the wrist."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from annotated_types import Ge, Gt, Le

from vstestbed.core.geometry import Array, quaternion_wxyz
from vstestbed.core.quantity import Mass, PositiveLength
from vstestbed.core.spec import spec
from vstestbed.effects.base import Actor, Effect, RobotBody, RobotModel, Sensors

# names of the geom and of the sensors in the robot's model
PLUG = "plug"
FORCE = "wrist_force"
TORQUE = "wrist_torque"
# a sensor of MuJoCo, and its parameters: force, the net one of all contacts, one
CONTACT = "plug_contact"
NET_FORCE = (2, 3, 1)
STEEL = [0.72, 0.72, 0.75, 1.0]
TOOL_GROUP = 2  # of geoms that every camera sees
# time constant of the contact, two physics steps of 2 ms: shorter, and it would swing (MuJoCo's own
# is .02)
SOFT_S = 0.004


@spec
class Plug:
    """A round plug of steel with a hemispherical nose, along the z axis of the flange from its
    origin on.

    Args:
        radius: of the cylinder and of the nose [m].
        length: from the flange to the tip [m]. It passes through its own arm.
        mass_kg: its mass [kg]; the drives do not know it.
        friction: Coulomb friction of what it touches [1].
    """

    radius: PositiveLength = 0.01
    length: PositiveLength = 0.15
    mass_kg: Mass = 0.2
    friction: Annotated[float, Gt(0), Le(2)] = 0.3


@spec
class WristSensor:
    """A sensor of force and moment between the flange and what it carries; what that weighs is part
    of its reading.

    Args:
        noise_n: standard deviation of each force [N].
        noise_nm: of each moment [Nm].
    """

    noise_n: Annotated[float, Ge(0), Le(1e3)] = 0.0
    noise_nm: Annotated[float, Ge(0), Le(1e3)] = 0.0

    def read(self, sensors: Sensors, rng: np.random.Generator) -> Array:
        """The wrench (6,) on the tool, force and moment at the flange's origin in the flange's
        frame [N, Nm].
        """
        # MuJoCo's are those of the flange on the tool
        true = -np.array([*sensors[FORCE], *sensors[TORQUE]])
        sigma = np.repeat([self.noise_n, self.noise_nm], 3)
        return true + sigma * rng.standard_normal(6) if sigma.any() else true


@dataclass(frozen=True)
class Tool(Effect):
    """A plug at the flange and the wrist's sensor, each where there is one. `plug_force_n`: the
    largest force of contacts of the plug since the last picture [N].
    """

    plug: Plug | None
    wrist: WristSensor | None

    @property
    def columns(self) -> tuple[str, ...]:  # pyright: ignore[reportIncompatibleVariableOverride] - a property in place of a constant
        """The force on the plug."""
        return () if self.plug is None else ("plug_force_n",)

    def edit(self, robot: RobotModel) -> None:
        """A body at the flange, with the plug's shape, and the sensor between both."""
        import mujoco

        T = robot.T_body_flange
        spec_ = robot.spec
        body = robot.flange.add_body(name="tool", pos=T[:3, 3], quat=quaternion_wxyz(T[:3, :3]))
        plug = self.plug
        if plug is not None:
            r = plug.radius
            end = plug.length - plug.radius
            geom = body.add_geom(
                name=PLUG,
                type=mujoco.mjtGeom.mjGEOM_CAPSULE,
                size=[r, 0, 0],
                fromto=[0, 0, r, 0, 0, end],
                rgba=STEEL,
            )
            geom.material = ""  # and not that of its body's class
            geom.mass = plug.mass_kg
            geom.group = TOOL_GROUP
            geom.contype = 1
            geom.conaffinity = 1
            geom.friction = [plug.friction, 0.005, 0.0001]
            geom.solref = [SOFT_S, 1.0]
            geom.condim = 4
            spec_.add_sensor(
                name=CONTACT,
                type=mujoco.mjtSensor.mjSENS_CONTACT,
                objtype=mujoco.mjtObj.mjOBJ_GEOM,
                objname=PLUG,
                intprm=[*NET_FORCE],
            )
            # it does not touch its own arm, whose hand may enclose its foot
            for other in spec_.bodies:
                if other.name and other.name not in ("world", "tool"):
                    spec_.add_exclude(bodyname1="tool", bodyname2=other.name)
        if self.wrist is not None:
            body.add_site(name="wrist", group=4, size=[0.005] * 3)
            at = {"objtype": mujoco.mjtObj.mjOBJ_SITE, "objname": "wrist"}
            spec_.add_sensor(name=FORCE, type=mujoco.mjtSensor.mjSENS_FORCE, **at)
            spec_.add_sensor(name=TORQUE, type=mujoco.mjtSensor.mjSENS_TORQUE, **at)

    def actor(self, body: RobotBody, rng: np.random.Generator) -> Actor | None:
        return None if self.plug is None else PlugForce(body)


class PlugForce(Actor):
    """Remembers the largest force on the plug between two rows of the log."""

    def __init__(self, body: RobotBody):
        sensor = body.model.sensor(f"robot/{CONTACT}")
        self._net = body.data.sensordata[sensor.adr[0] : sensor.adr[0] + 3]  # a view
        self._most = 0.0

    def act(self, t: float, dt: float) -> None:
        x, y, z = self._net.tolist()
        self._most = max(self._most, math.sqrt(x * x + y * y + z * z))

    def row(self) -> Sequence[float]:
        self.act(0.0, 0.0)
        most = self._most
        self._most = 0.0
        return (most,)
