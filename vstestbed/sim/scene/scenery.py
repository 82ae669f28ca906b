"""Scenery: an MJCF file of one's own round the experiment. It stands still, collides as it says,
and all renderers draw it.

Its names stand in the scene under `scenery/`, so that none can clash with the robot's or the
target's. What it may have and what becomes of it: geoms, meshes, materials and textures are taken
as they are (groups 3 and up are for contacts alone, as in a robot's file); its lights take the
place of the scene's key light, and its skybox that of the scene's; a horizontal plane at the
floor's height, or a geom named `floor`, is drawn in place of the floor, which stays what wheels and
feet stand on. Cameras, sensors, keyframes, equalities, `<option>`, `<visual>` and `<statistic>` are
left out: the scene has its own. Joints and actuators are refused.
"""

from __future__ import annotations

import functools
import logging
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array, quaternion_wxyz
from vstestbed.core.named_files import place_of_file
from vstestbed.sim.scene.joint_chain import before
from vstestbed.sim.scene.meshes import RANGE_GROUP, own_colours, texels_of, texture_of
from vstestbed.sim.scene.model_files import (
    cannot_compile,
    carry_files,
    line_with,
    read_model,
    take_jpeg,
)

PREFIX = "scenery/"
SAME_HEIGHT_M = 1e-3  # faces nearer to one another than this flicker in pictures [m]
# Brightness of a surface under the scene's lights, at most: its chroma in a picture is that of its
# colour times this
BRIGHTEST = 1.3
# of pictures, from which on detectors by default take a pixel for a marker's [grey levels]
CHROMA = 60
MOST_TOLD = 3
LEFT_OUT = "cameras", "sensors", "keys", "equalities", "tendons"
PLANE = int(mujoco.mjtGeom.mjGEOM_PLANE)
FLAT = PLANE, int(mujoco.mjtGeom.mjGEOM_BOX)


def check_scenery(file: str, T: Array, floor_z: float) -> None:
    """Refuse a file that cannot stand round an experiment.

    file: absolute, or inside a package. T: its pose in the world (4, 4). floor_z: height of the
    floor [m]. Raises ParameterError: `file`, with what is wrong, its line where MuJoCo knows it,
    and what would work.
    """
    _floors(_model(place_of_file(file)), T, floor_z)


def _model(path: Path) -> mujoco.MjModel:
    return _checked(str(path), path.stat().st_mtime_ns)


@functools.lru_cache(maxsize=8)
def _checked(path: str, mtime_ns: int) -> mujoco.MjModel:
    """The compiled file; mtime_ns: so that a changed file is read again."""
    try:
        spec = read_model(Path(path))
        take_jpeg(spec, Path(path))
        model = spec.compile()
    except ParameterError:
        raise
    except (ValueError, mujoco.FatalError) as error:
        raise cannot_compile(error, Path(path), "an MJCF file") from None
    still = "scenery stands still, as a run's log has no place for its motion"
    for what, moving, why in (
        ("actuator", spec.actuators, "nothing would drive it"),
        ("joint", spec.joints, still),
    ):
        if moving:
            name = moving[0].name or "without a name"
            line = _line(moving[0], path)
            words = f"has the {what} {name}{line}, and {why}; remove it from the file"
            raise ParameterError("file", words, path)
    if not model.ngeom:
        raise ParameterError.unreadable(
            "file", "it has no geoms", "an MJCF file with geoms in its worldbody", path
        )
    return model


def _line(element: Any, path: str) -> str:
    """` (line 7)`, where MuJoCo knows it, which it does not of a free joint, or the file itself has
    the name.
    """
    if element.info:
        return f" ({element.info})"
    number = line_with(f'name="{element.name}"', Path(path)) if element.name else 0
    return f" (line {number})" if number else ""


def _floors(model: mujoco.MjModel, T: Array, floor_z: float) -> list[int]:
    """The geoms that are the floor, for a pose (4, 4) of the scenery.

    Raises ParameterError: a horizontal plane at another height; or a face of a box that would
    flicker in the floor.
    """
    level: list[int] = []
    floors: list[int] = []
    for g in range(model.ngeom):
        z = _top(model, g, T)
        if z is None:
            continue
        plane = model.geom_type[g] == PLANE
        if abs(z - floor_z) <= SAME_HEIGHT_M:
            level.append(g)
            if plane or model.geom(g).name == "floor":
                floors.append(g)
        elif plane:
            words = (
                f"has the horizontal plane {_name(model, g)} at z = {z:g} m,"
                f" and the floor is at world.floor_z = {floor_z:g} m"
            )
            raise ParameterError("file", f"{words}; set world.floor_z: {z:g}, or make a box of it")
    if level and not floors:
        words = (
            f"has the geom {_name(model, level[0])},"
            " whose upper face is at the height of the floor, where both would flicker"
        )
        raise ParameterError(
            "file",
            f"{words}; lift it by 2 mm, or name it floor to have it drawn in place of the floor",
        )
    return floors


def _top(model: mujoco.MjModel, g: int, T: Array) -> float | None:
    """Height of the upper face of a plane or a box [m]; None where it has no horizontal one that is
    drawn.
    """
    if int(model.geom_type[g]) not in FLAT or model.geom_group[g] > 2:
        return None
    data = _placed(model)
    normal = T[:3, :3] @ data.geom_xmat[g].reshape(3, 3)
    at = T[:3, :3] @ data.geom_xpos[g] + T[:3, 3]
    axis = int(np.abs(normal[2]).argmax())
    if abs(normal[2, axis]) < 1 - 1e-6:
        return None
    if model.geom_type[g] == mujoco.mjtGeom.mjGEOM_PLANE:
        return float(at[2]) if axis == 2 and normal[2, 2] > 0 else None
    return float(at[2] + model.geom_size[g, axis])


@functools.lru_cache(maxsize=8)
def _placed(model: mujoco.MjModel) -> mujoco.MjData:
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    return data


def _name(model: mujoco.MjModel, g: int) -> str:
    body = model.body(model.geom_bodyid[g]).name
    owner = f" of the body {body}" if model.geom_bodyid[g] and body else ""
    return model.geom(g).name or f"number {g + 1}{owner} (without a name)"


def parts_before(
    file: str, T_scenery_camera: Array, p_camera: Array, slack: float
) -> tuple[str, ...]:
    """Which geom of a file hides each of points p_camera (N, 3) from a camera at a pose (4, 4) in
    the scenery's frame; "" for none.

    A ray from the camera hits it more than `slack` [m] before the point. Groups from 3 on are not
    drawn, and hide nothing.
    """
    model = _model(place_of_file(file))
    eye = np.ascontiguousarray(T_scenery_camera[:3, 3])
    ways = p_camera @ T_scenery_camera[:3, :3].T
    hides = before(model, _placed(model), eye, ways, slack, (3, 4, 5)).tolist()
    return tuple(f"geom {_name(model, g)}" if g >= 0 else "" for g in hides)


def add_scenery(scene: mujoco.MjSpec, file: str, T: Array, floor_z: float) -> dict[str, bytes]:
    """Attach the scenery of a file to the scene, at a pose (4, 4); returns its meshes and textures,
    for the scene's assets.

    floor_z: height of the scene's own floor [m].
    """
    path = place_of_file(file)
    floors = _floors(_model(path), T, floor_z)
    spec = read_model(path)
    _take_parts(spec, floors)
    if floors:
        scene.geom("floor").group = RANGE_GROUP
    if spec.lights:
        scene.light("key").active = False
    if any(texture.type == mujoco.mjtTexture.mjTEXTURE_SKYBOX for texture in spec.textures):
        scene.delete(scene.texture("sky"))
    for name in _changed_options(spec, scene):  # of options of the file's own MuJoCo would warn
        setattr(spec.option, name, getattr(scene.option, name))
    files = carry_files(spec, path, scene, PREFIX)
    scene.attach(
        spec,
        prefix=PREFIX,
        frame=scene.worldbody.add_frame(pos=T[:3, 3], quat=quaternion_wxyz(T[:3, :3])),
    )
    return files


def _changed_options(spec: mujoco.MjSpec, other: mujoco.MjSpec) -> list[str]:
    """Names of the options in which two models differ."""
    return [
        name
        for name in dir(spec.option)
        if not name.startswith("_")
        and not np.array_equal(getattr(spec.option, name), getattr(other.option, name))
    ]


def _take_parts(spec: mujoco.MjSpec, floors: list[int]) -> None:
    """Remove what is left out, and give the geoms their groups; `floors`: the numbers of those that
    are the floor.
    """
    for kind in LEFT_OUT:
        for element in list(getattr(spec, kind)):
            spec.delete(element)
    for body in spec.bodies[1:]:
        body.mocap = False
    for number, geom in enumerate(spec.geoms):
        geom.group = RANGE_GROUP if geom.group > 2 else 0
        if number in floors:  # the scene's floor carries: two in one place would hold a wheel twice
            geom.contype = geom.conaffinity = 0


@functools.cache
def warn_of_colours(file: str, detector: str, chroma: int) -> None:
    """Warn once of scenery whose colours a detector may take for markers, those above a chroma
    (max - min of r, g, b) [grey levels].
    """
    if words := _saturated(place_of_file(file), chroma, f"detector {detector}"):
        logging.getLogger("vstestbed").warning("world.scenery: %s", words)


def _saturated(path: Path, chroma: int, who: str) -> str:
    """What of a file is of a colour above a chroma in pictures, which `who` takes for a marker, and
    what would not be; "" for nothing.
    """
    model = _model(path)
    limit = chroma / 255 / BRIGHTEST
    found = {name: value for name, value in _saturations(model) if value > limit}
    if not found:
        return ""
    names = ", ".join(list(found)[:MOST_TOLD])
    if len(found) > MOST_TOLD:
        names += f" and {len(found) - MOST_TOLD} more"
    one = "has a saturated colour" if len(found) == 1 else "have saturated colours"
    words = f"{names} in {path.name} {one} (max - min of r, g, b up to {max(found.values()):.2g})"
    return (
        f"{words}, which {who} may take for markers;"
        f" keep max - min under {limit:.2f}, or use detector tags"
    )


def _saturations(model: mujoco.MjModel) -> Iterator[tuple[str, float]]:
    colours = own_colours(model)
    for g in np.flatnonzero((model.geom_group <= 2) & (colours[:, 3] > 0)).tolist():
        texture = texture_of(model, g)
        rgb = colours[g, :3]
        spread = float(np.ptp(rgb)) if texture < 0 else _spread(texels_of(model, texture), rgb)
        yield f"geom {_name(model, g)}", spread
    for texture in np.flatnonzero(model.tex_type == mujoco.mjtTexture.mjTEXTURE_SKYBOX):
        yield "the skybox", _spread(texels_of(model, int(texture)), np.ones(3))


def _spread(texels: NDArray[np.uint8], rgb: Array) -> float:
    """Largest less smallest of r, g, b of a texture (H, W, 3) on a colour (3,), which all but a
    thousandth of it stay under.
    """
    return float(np.quantile(np.ptp(texels / 255 * rgb, axis=-1), 0.999))


def examine_scenery(file: str) -> Iterator[tuple[str, str]]:
    """What of a file without joints is used as scenery, in words: each part and what becomes of it.

    Raises ParameterError: see `check_scenery`.
    """
    path = place_of_file(file)
    model = _model(path)
    spec = read_model(path)
    solid = int(np.count_nonzero((model.geom_contype | model.geom_conaffinity) != 0))
    words = f"{model.ngeom} geoms, {solid} of which can be touched"
    yield "scenery", f"{words}; {model.nmesh} meshes, {model.ntex} textures"
    if spec.lights:
        words = f"{len(spec.lights)}, in place of the scene's key light; the fill light stays"
        yield "lights", words
    counts = {kind: len(list(getattr(spec, kind))) for kind in LEFT_OUT}
    found = [f"{n} {kind}" for kind, n in counts.items() if n]
    if changed := _changed_options(spec, mujoco.MjSpec()):
        found.append(f"<option> ({', '.join(changed)}), where the scene's own count")
    if found:
        yield "left out", "; ".join(found)
    if words := _saturated(path, CHROMA, "detector blobs"):
        yield "colours", words
    from vstestbed.sim.render.shade import Paint

    if rays := [_name(model, g) for g in Paint(model, _placed(model)).averaged]:
        words = f"draw {', '.join(rays)} in the mean colour of the texture"
        yield "rays", f"{words}; OpenGL draws it whole"
