"""Attaches robots to a scene: their MJCF under a prefix, with the chosen servos and the floor's friction."""

from __future__ import annotations

import functools
from pathlib import Path

import mujoco
import numpy as np

from vstestbed.core.assets import model_path
from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array
from vstestbed.robots import Robot
from vstestbed.robots.body import Change
from vstestbed.sim.scene.groups import OF_FILES
from vstestbed.sim.scene.links import add_payload, displace_links
from vstestbed.sim.scene.model_files import carry_files
from vstestbed.sim.scene.reshape import reshape
from vstestbed.sim.scene.servos import choose_servos, compensated
from vstestbed.sim.scene.urdf import read_model

AUTO = mujoco.mjtJacobian.mjJAC_AUTO


def add_robot(scene: mujoco.MjSpec, robot: Robot, prefix: str, friction: float | None) -> tuple[mujoco.MjsBody, Array]:
    """The body that carries the camera, and the pose (4, 4) of the flange in it.

    Args:
        scene: receives the robot, and the solver options of its model.
        robot: to be attached; the ideal camera is a mocap body, which has no mass and is placed by the plant.
        prefix: of all its names (`robot/`, `leader/`).
        friction: of the floor, where the scenario sets it.

    Raises:
        ParameterError: the robot's model has no site `flange`.
    """
    if robot.model is None:
        return scene.worldbody.add_body(name=f"{prefix}camera", mocap=True), np.eye(4)
    T_body_flange = _flange_pose(robot.model, robot.flange)  # first: it refuses a model that has no flange
    model = _spec(robot.model, robot.body_changes)
    choose_servos(model, robot)
    if robot.mechanics is not None and robot.mechanics.links is not None:
        displace_links(model, _compiled(robot.model, robot.body_changes), robot.mechanics)
        T_body_flange = robot.mechanics.links[-1] @ T_body_flange
    _share_options(scene, model, friction)
    files = carry_files(model, Path(robot.model), scene, prefix)
    scene.attach(model, prefix=prefix, frame=scene.worldbody.add_frame())
    if files:  # after it: an attached model brings its own assets, under a prefix that nothing refers to
        scene.assets = {**scene.assets, **files}
    site = scene.site(f"{prefix}{robot.flange}")
    flange = site.parent if site else scene.body(f"{prefix}{robot.flange}")
    if robot.mechanics is not None and robot.mechanics.payload is not None:
        add_payload(flange, f"{prefix}payload", T_body_flange, robot.mechanics.payload, compensated(robot))
    return flange, T_body_flange


def _share_options(scene: mujoco.MjSpec, model: mujoco.MjSpec, friction: float | None) -> None:
    """Groups, solver options and the floor's friction of a model that will be attached to a scene."""
    for geom in model.geoms:
        geom.group = OF_FILES.get(geom.group, geom.group)
    # `attach` leaves the child's options behind: what its contacts and air were tuned with must be copied. Of two robots the larger
    # value serves both.
    model.option.timestep = scene.option.timestep
    scene.option.cone = max(scene.option.cone, model.option.cone)
    scene.option.impratio = max(scene.option.impratio, model.option.impratio)
    if model.option.jacobian != AUTO:
        scene.option.jacobian = model.option.jacobian
    scene.option.density = max(scene.option.density, model.option.density)
    scene.option.viscosity = max(scene.option.viscosity, model.option.viscosity)
    # Both geoms of a contact: MuJoCo takes the larger friction of the two, or that of the geom with priority (a car's wheel), so
    # a slippery floor alone would change nothing.
    if friction is not None:
        for geom in [*model.geoms, scene.geom("floor")]:
            geom.friction[0] = min(geom.friction[0], friction)


def _spec(model: str, changes: tuple[Change, ...]) -> mujoco.MjSpec:
    """The robot of an MJCF file with its parameters."""
    spec = read_model(model_path(model))
    reshape(spec, changes)
    return spec


@functools.lru_cache(maxsize=32)
def _compiled(model: str, changes: tuple[Change, ...] = ()) -> mujoco.MjModel:
    """The robot of an MJCF file on its own."""
    return _spec(model, changes).compile()


def _flange_pose(model: str, flange: str) -> Array:
    """Pose (4, 4) of the flange in its body, as the compiler has it; the identity where the flange is a body.

    A spec keeps an orientation as the file writes it (quat, euler, axisangle, xyaxes, zaxis), and its `quat` is the identity where
    the file writes another of these: only the compiled model has them all.

    Raises:
        ParameterError: the file has no such site or body.
    """
    compiled = _compiled(model)
    i = mujoco.mj_name2id(compiled, mujoco.mjtObj.mjOBJ_SITE, flange)
    if i < 0 <= mujoco.mj_name2id(compiled, mujoco.mjtObj.mjOBJ_BODY, flange):
        return np.eye(4)
    if i < 0:
        raise ParameterError("robot.kind", f"has a model without a site `{flange}`, which carries the camera; add one to {model}")
    R = np.zeros(9)
    mujoco.mju_quat2Mat(R, compiled.site_quat[i])
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R.reshape(3, 3), compiled.site_pos[i]
    return T


def extent_of(robot: Robot) -> float:
    """Size of a robot with a body, by MuJoCo's own measure [m]."""
    assert robot.model is not None
    return float(_compiled(robot.model, robot.body_changes).stat.extent)
