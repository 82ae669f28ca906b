"""A joint that swings a load, and one that rolls it, which the first does not feel: the textbook's
two-mass joint as an arm.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from vstestbed.camera import Perspective
from vstestbed.core.geometry import Array, Pose
from vstestbed.robots import Mjcf
from vstestbed.robots.arm import ArmStart, Positions
from vstestbed.robots.base import longest_step
from vstestbed.sim.base import Plant, SceneDescription
from vstestbed.sim.build import build_plant
from vstestbed.sim.scene.scene import Scene
from vstestbed.sim.scene.world import World
from vstestbed.targets import TARGETS
from vstestbed.timing.clock import Clock

ROTOR, REACH, MASS = 0.3, 0.6, 2.0
"""Inertia of the rotor [kg m^2]; place and mass of the load [m, kg]."""
FILE = """<mujoco><compiler angle="radian" autolimits="true"/><worldbody>
<body name="link" pos="0 0 1"><inertial pos="0.6 0 0" mass="1.5" diaginertia="0.05 0.1 0.1"/>
<joint name="swing" axis="{axis}" armature="{rotor}"/>
<body name="tip" pos="0.6 0 0"><inertial pos="0 0 0" mass="0.5" diaginertia="0.001 0.001 0.001"/>
<joint name="roll" axis="1 0 0" armature="0.01"/><site name="flange"/></body></body>
</worldbody></mujoco>"""
TARGET = TARGETS.members["square"](side=0.2, pose=Pose(xyz=(2, 0, 1), rpy_deg=(0, 90, 0)))


def arm(folder: Path, axis: str = "0 0 1", rotor: float = ROTOR, **effects: Any) -> Mjcf:
    """The arm, its first joint about an axis of the world: (0, 0, 1) without weight, (0, 1, 0) with
    the weight of MASS at REACH.
    """
    path = folder / "two_mass.xml"
    path.write_text(FILE.format(axis=axis, rotor=rotor))
    start = ArmStart(nominal=Positions(q_deg=(0.0, 0.0)))
    given: dict[str, Any] = (
        {"servo_kp": (2000.0, 50.0), "servo_kv": (50.0, 1.25)} if "actuation" not in effects else {}
    )
    return Mjcf(file=str(path), speed_limits=(2.0, 2.0), start=start, **given | effects)


def inertia() -> float:
    """The load's moment of inertia about z through the first joint [kg m^2]."""
    return 1.5 * REACH**2 + 0.1 + 0.5 * REACH**2 + 0.001


def frequency(t: Array, x: Array) -> float:
    """By the zero crossings [rad/s]."""
    i = np.flatnonzero(np.diff(np.sign(x)))
    at = t[i] - x[i] * (t[i + 1] - t[i]) / (x[i + 1] - x[i])
    return math.pi * (len(at) - 1) / (at[-1] - at[0])


def scene_of(robot: Mjcf, step_s: float) -> SceneDescription:
    """The arm before a target."""
    return SceneDescription(robot, Perspective(), TARGET, World(floor_z=-5.0), step_s)


def stage_of(robot: Mjcf, step_s: float | None = None) -> Scene:
    """Its compiled scene."""
    return Scene(scene_of(robot, step_s or longest_step(robot)))


def plant_of(robot: Mjcf, step_s: float | None = None) -> Plant:
    """Its plant without pictures."""
    return build_plant(
        scene_of(robot, Clock(step_s=step_s).resolve(Perspective(), longest_step(robot))[0])
    )[0]
