"""Meshes and textures of a robot's file, or of scenery, carried into the scene, so that a run's folder holds all of it."""

from __future__ import annotations

from pathlib import Path

import mujoco

from vstestbed.core.assets import model_path
from vstestbed.targets.picture_file import as_png

JPEG = ".jpg", ".jpeg"
ASSETS = "assets"
"""Folder beside model.xml for its asset files."""


def carry_files(model: mujoco.MjSpec, file: Path, scene: mujoco.MjSpec, prefix: str) -> dict[str, bytes]:
    """The files that a model refers to, under names of their own, for the scene's assets; keyframes, which fit no other scene, go.

    model: of the file, not attached yet. prefix: of its names in the scene (`robot/`).
    """
    for key in list(model.keys):
        model.delete(key)
    taken: dict[str, bytes] = {}
    folders = [(model.meshes, model.meshdir), (model.textures, model.texturedir), (model.hfields, model.meshdir)]
    for things, folder in folders:
        for thing in things:
            if thing.file:
                thing.file = _carried(file, folder, thing.file, taken, prefix)
    for texture in model.textures:
        texture.cubefiles = [_carried(file, model.texturedir, face, taken, prefix) for face in texture.cubefiles]
    if taken:
        model.meshdir = model.texturedir = scene.meshdir = scene.texturedir = ASSETS
    return taken


def take_jpeg(model: mujoco.MjSpec, file: Path) -> None:
    """The textures of a model in `file` that are JPEG files, which MuJoCo does not read, as PNG among the model's assets, to compile it.

    Raises:
        ParameterError: one is no picture.
    """
    for number, texture in enumerate(model.textures):
        path = file.parent / model.texturedir / texture.file
        if path.suffix.lower() in JPEG and path.is_file():
            texture.file = f"{number}_{path.stem}.png"
            model.assets = {**model.assets, str(Path(model.texturedir) / texture.file): as_png(path)}


def _carried(file: Path, folder: str, name: str, taken: dict[str, bytes], prefix: str) -> str:
    """Take up a file that a model in `file` refers to; its name in the scene's assets, "" for none."""
    if not name:
        return ""
    path = model_path(str(file)).parent / folder / name
    own = path.with_suffix(".png").name if path.suffix.lower() in JPEG else path.name
    new = f"{prefix.strip('/')}_{len(taken)}_{own[-60:]}"  # its end: file systems take 255 bytes, of which its own name may have all
    taken[f"{ASSETS}/{new}"] = as_png(path) if path.suffix.lower() in JPEG else path.read_bytes()
    return new
