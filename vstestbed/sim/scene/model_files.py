"""Meshes and textures of a robot's file, carried into the scene, so that a run's folder holds all of it."""

from __future__ import annotations

from pathlib import Path

import mujoco

from vstestbed.core.assets import model_path

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
                path = model_path(str(file)).parent / folder / thing.file
                name = f"{prefix.strip('/')}_{len(taken)}_{path.name}"
                taken[f"{ASSETS}/{name}"] = path.read_bytes()
                thing.file = name
    if taken:
        model.meshdir = model.texturedir = scene.meshdir = scene.texturedir = ASSETS
    return taken
