"""What parameters change in a robot's MJCF file.

A change is a function of this file with its arguments, `(put, "body", "base", "mass", 4.0)`: plain
data, which can be compared and is applied when the scene is composed.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

if TYPE_CHECKING:
    import mujoco

Change = tuple[Any, ...]
Kind = Literal["body", "geom", "joint", "site", "actuator"]
Factors = tuple[float, float, float]


def reshape(model: mujoco.MjSpec, changes: tuple[Change, ...]) -> None:
    """Apply changes to the model of a file. Raises LookupError: the file has no such element."""
    change: Callable[..., None]
    for change, *given in changes:
        change(model, *given)


def put(
    model: mujoco.MjSpec, kind: Kind, name: str, field: str, value: float | tuple[float, ...]
) -> None:
    """Set a field of one element, as MjSpec calls it, in the unit of the file; of an array field
    the first `len(value)` entries.
    """
    element = _named(model, kind, name)
    if isinstance(value, tuple):
        getattr(element, field)[: len(value)] = value
    else:
        setattr(element, field, value)


def scale(
    model: mujoco.MjSpec, kind: Kind, field: str, factor: float | tuple[float, ...], of: str = ""
) -> None:
    """Multiply a field of all elements of a kind, or of the geoms or joints of one body, or of one
    body or actuator, `of`.

    factor: of all entries of an array field, or one for each of the first.
    """
    if of and kind in ("body", "actuator"):
        elements = [_named(model, kind, of)]
    else:
        whole = _named(model, "body", of) if of else model
        elements = getattr(whole, "bodies" if kind == "body" else f"{kind}s")
    for element in elements:
        before = getattr(element, field)
        if isinstance(factor, tuple):
            before[: len(factor)] *= factor
        elif isinstance(before, np.ndarray):
            before *= factor
        else:
            setattr(element, field, before * factor)


def stretch(
    model: mujoco.MjSpec, body: str, factors: Factors, shift: Factors = (0.0, 0.0, 0.0)
) -> None:
    """Stretch the geoms of a body about its origin, p -> factors p + shift [m]: places, sizes of
    boxes, vertices of meshes, no radii.
    """
    import mujoco

    for geom in _named(model, "body", body).geoms:
        if geom.type == mujoco.mjtGeom.mjGEOM_MESH:
            mesh = model.mesh(geom.meshname)
            mesh.uservert = (np.array(mesh.uservert).reshape(-1, 3) * factors + shift).ravel()
            continue
        if np.isfinite(geom.fromto[0]):  # NaN where the file has none
            geom.fromto = geom.fromto * np.tile(factors, 2) + np.tile(shift, 2)
        else:
            geom.pos = geom.pos * factors + shift
        if geom.type == mujoco.mjtGeom.mjGEOM_BOX:
            geom.size = geom.size * factors


def couple(model: mujoco.MjSpec, joint: str, coefficients: tuple[float, ...]) -> None:
    """Set the polynomial, (5,) of powers 0 to 4, by which a joint follows another
    (`equality/joint`).
    """
    (pair,) = [e for e in model.equalities if e.name1 == joint]
    pair.data[:5] = coefficients


def loosen(model: mujoco.MjSpec, joint: str, width: float) -> None:
    """Put a play of a width [rad] between a joint and all that follows it: a new joint
    `<joint>_output`, free within the play.
    """
    import mujoco

    servo = _named(model, "joint", joint)
    output = f"{joint}_output"
    holder = servo.parent.parent.add_body(name=output, pos=servo.parent.pos)
    # MuJoCo demands some mass. Behind the play are a crank of the car's steering, as the file has
    # it [kg m^2], king pins (chosen) [Nm] and the damping of the column [Nm s/rad]; without
    # friction, wheels that were turned would swing on to the play's other end.
    holder.add_geom(
        type=mujoco.mjtGeom.mjGEOM_SPHERE,
        size=[0.01, 0, 0],
        mass=1e-3,
        contype=0,
        conaffinity=0,
        group=2,
    )
    made = holder.add_joint(
        name=output, type=servo.type, axis=servo.axis, armature=0.003, frictionloss=1.5
    )
    made.damping[0] = 0.5
    for pair in model.equalities:
        if pair.name2 == joint:
            pair.name2 = output
    # The difference of the two angles as a tendon with limits: each end of the play is a stop, as
    # stiff as the steering's couplings.
    play = model.add_tendon(name=f"{joint}_play", limited=True, range=[-width / 2, width / 2])
    play.solref_limit[:2] = [0.004, 1.0]
    play.solimp_limit[:3] = [0.99, 0.999, 0.001]
    play.wrap_joint(output, 1.0)
    play.wrap_joint(joint, -1.0)


def _named(model: mujoco.MjSpec, kind: str, name: str) -> Any:
    element = getattr(model, kind)(name)
    if element is None:
        raise LookupError(f"the model {model.modelname} has no {kind} {name}")
    return element
