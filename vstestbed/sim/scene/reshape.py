"""Gives a robot's model the physical parameters of the scenario."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import mujoco
import numpy as np

from vstestbed.robots.body import Change, Couple, Loosen, Scale, Set, Stretch

PLAY_STOP = [0.004, 1.0], [0.99, 0.999, 0.001]
"""solref and solimp of the ends of a play: as stiff as the steering's couplings."""
OUTPUT_ARMATURE, OUTPUT_DAMPING, OUTPUT_FRICTION = 0.003, 0.5, 1.5
"""Inertia [kg m^2], damping [Nm s/rad] and Coulomb friction [Nm] of what is behind a play: a crank of the car's steering, as the file has
it, the damping of its column, and king pins (chosen). Without friction, wheels that were turned would swing on to the play's other end."""
OUTPUT_KG, OUTPUT_M = 1e-3, 0.01
"""Mass and radius of its body, since MuJoCo demands some [kg, m]."""


def reshape(model: mujoco.MjSpec, changes: tuple[Change, ...]) -> None:
    """Apply the changes of a robot (`Robot.body_changes`) to the model of its file.

    Raises:
        LookupError: the file has no such element.
    """
    for change in changes:
        match change:
            case Set():
                _set(_named(model, change.kind, change.name), change.field, change.value)
            case Scale():
                for element in _all(model, change.kind, change.of):
                    _scale(element, change.field, change.factor)
            case Stretch():
                for geom in _named(model, "body", change.body).geoms:
                    _stretch(model, geom, np.array(change.factors), np.array(change.shift))
            case Couple():
                _couple(model, change)
            case Loosen():
                _loosen(model, change.joint, change.width)


def _couple(model: mujoco.MjSpec, change: Couple) -> None:
    (pair,) = [e for e in model.equalities if e.name1 == change.joint]
    pair.data[:5] = change.coefficients


def _loosen(model: mujoco.MjSpec, joint: str, width: float) -> None:
    """Put a joint `<joint>_output` between a joint and its followers, within a play of the width [rad]."""
    servo, output = _named(model, "joint", joint), f"{joint}_output"
    holder = servo.parent.parent.add_body(name=output, pos=servo.parent.pos)
    holder.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[OUTPUT_M, 0, 0], mass=OUTPUT_KG, contype=0, conaffinity=0, group=2)
    made = holder.add_joint(name=output, type=servo.type, axis=servo.axis, armature=OUTPUT_ARMATURE, frictionloss=OUTPUT_FRICTION)
    made.damping[0] = OUTPUT_DAMPING
    for pair in model.equalities:
        if pair.name2 == joint:
            pair.name2 = output
    # The difference of the two angles as a tendon with limits: each end of the play is a stop.
    play = model.add_tendon(name=f"{joint}_play", limited=True, range=[-width / 2, width / 2])
    play.solref_limit[:2], play.solimp_limit[:3] = PLAY_STOP
    play.wrap_joint(output, 1.0)
    play.wrap_joint(joint, -1.0)


def _named(model: mujoco.MjSpec, kind: str, name: str) -> Any:
    element = getattr(model, kind)(name)
    if element is None:
        raise LookupError(f"the model {model.modelname} has no {kind} {name}")
    return element


def _all(model: mujoco.MjSpec, kind: str, of: str) -> Iterable[Any]:
    """All elements of a kind, or those that `Scale.of` names."""
    if of and kind in ("body", "actuator"):
        return [_named(model, kind, of)]
    return getattr(_named(model, "body", of) if of else model, {"body": "bodies"}.get(kind, f"{kind}s"))


def _set(element: Any, field: str, value: float | tuple[float, ...]) -> None:
    if isinstance(value, tuple):
        getattr(element, field)[: len(value)] = value
    else:
        setattr(element, field, value)


def _scale(element: Any, field: str, factor: float | tuple[float, ...]) -> None:
    before = getattr(element, field)
    if isinstance(factor, tuple):
        before[: len(factor)] *= factor
    elif isinstance(before, np.ndarray):
        before *= factor
    else:
        setattr(element, field, before * factor)


def _stretch(model: mujoco.MjSpec, geom: mujoco.MjsGeom, factors: np.ndarray, shift: np.ndarray) -> None:
    if geom.type == mujoco.mjtGeom.mjGEOM_MESH:
        mesh = model.mesh(geom.meshname)
        mesh.uservert = (np.array(mesh.uservert).reshape(-1, 3) * factors + shift).ravel()
        return
    if np.isfinite(geom.fromto[0]):  # NaN where the file has none
        geom.fromto = geom.fromto * np.tile(factors, 2) + np.tile(shift, 2)
    else:
        geom.pos = geom.pos * factors + shift
    if geom.type == mujoco.mjtGeom.mjGEOM_BOX:
        geom.size = geom.size * factors
