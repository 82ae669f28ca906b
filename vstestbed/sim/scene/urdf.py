"""Reads a model's file into MuJoCo's spec; of a URDF with the shapes to look at, the links that do not move, and `package://`."""

from __future__ import annotations

import re
from pathlib import Path
from xml.etree import ElementTree

import mujoco

from vstestbed.core.errors import ParameterError

ROOT = re.compile(r"\A\ufeff?(?:\s|<\?.*?\?>|<!--.*?-->)*<robot\b[^>]*>", re.DOTALL)
"""The beginning of a URDF: an MJCF file may have the word in a comment."""
XACRO = re.compile(r"<xacro:")
MESH = re.compile(r'(<mesh\b[^>]*\bfilename=")(package|file)://([^"]*)')
UNREADABLE = re.compile(
    r'<visual\b(?:(?!</visual>).)*\bfilename="[^"]*\.(?!stl"|obj")\w+"(?:(?!</visual>).)*</visual>', re.DOTALL | re.IGNORECASE
)
"""What is to be seen by a mesh in a format that MuJoCo does not read (dae, glb)."""
KEEP = '<mujoco><compiler discardvisual="false" fusestatic="false"/></mujoco>'
"""MuJoCo by default throws away a URDF's `visual` shapes, and the names of links on fixed joints, such as `tool0`."""
CONTACT_GROUP = 3


def read_model(path: Path) -> mujoco.MjSpec:
    """The spec of an MJCF or URDF file, as the file has it.

    Of a URDF, fixed links keep their names, a link shows its `visual` shapes, and its `collision` shapes only where it has no others.
    A `<mujoco>` block of its own counts instead. Meshes to look at of other formats than STL and OBJ are left out.

    Raises:
        ValueError: MuJoCo's, for a file that it cannot read.
        ParameterError: `file`, where it is a xacro, or names a package whose folder is not found.
    """
    text = path.read_text(errors="replace")
    if (root := ROOT.search(text)) is None:
        return mujoco.MjSpec.from_file(str(path))
    if XACRO.search(text):
        raise ParameterError("file", f"is a xacro, and no URDF yet; `xacro {path.name} > arm.urdf` writes one", str(path))
    if "<mujoco" not in text:
        text = text[: root.end()] + KEEP + text[root.end() :]  # in the same line: MuJoCo's errors tell lines
    text = UNREADABLE.sub(lambda visual: "\n" * visual[0].count("\n"), text)
    spec = mujoco.MjSpec.from_string(MESH.sub(lambda mesh: mesh[1] + _found(path, mesh[2], mesh[3]), text))
    spec.meshdir = str(path.parent.resolve() / spec.meshdir)
    for body in spec.bodies:
        _hide_contacts(body)
    return spec


def _hide_contacts(body: mujoco.MjsBody) -> None:
    """Leave a link's shapes for contacts out of pictures where it has others to be seen."""
    touch = [bool(geom.contype or geom.conaffinity) for geom in body.geoms]
    if not all(touch):
        for geom, touches in zip(body.geoms, touch, strict=True):
            geom.group = CONTACT_GROUP if touches else geom.group


def speeds_in(path: Path) -> dict[str, float]:
    """The `velocity` limits of a URDF's joints by their names [rad/s, m/s], which MuJoCo does not read; {} for an MJCF file."""
    text = path.read_text(errors="replace")
    if ROOT.search(text) is None:
        return {}
    limits = {joint.get("name", ""): joint.find("limit") for joint in ElementTree.fromstring(text).iter("joint")}
    found = {name: float(limit.get("velocity", 0)) for name, limit in limits.items() if limit is not None}
    return {name: speed for name, speed in found.items() if speed > 0}


def _found(path: Path, scheme: str, name: str) -> str:
    """The place of a mesh: of `package://NAME/rest` in the folder NAME beside the URDF or above it."""
    if scheme == "file":
        return name
    for folder in path.resolve().parents:
        for place in (folder / name, folder.parent / name):
            if place.is_file():
                return str(place)
    package = name.partition("/")[0]
    words = f"names the mesh package://{name}, and no folder {package} with it is beside the file or above it"
    raise ParameterError("file", f"{words}; put the package's folder there, or write the mesh's path from the URDF's folder", str(path))
