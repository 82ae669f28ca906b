"""An arm on a platform as one model: the file that both become together."""

from __future__ import annotations

import functools
import hashlib
import tempfile
from pathlib import Path

import mujoco

from vstestbed.core.files import make_folder, write_whole
from vstestbed.core.named_files import model_path, place_of_file
from vstestbed.effects.body import Change, reshape
from vstestbed.sim.scene.model_files import read_model

ON_DECK = "battery", "scanner", "scanner_cap"  # what stands on the platform where the arm will
PREFIX = "arm_"  # of all names of the arm in the model of both


@functools.lru_cache(maxsize=8)
def mounted(platform: str, changes: tuple[Change, ...], arm: str, place: tuple[float, float, float]) -> str:
    """The path of an MJCF file of a platform with an arm on it, among the temporary files, where it stays; its name is that of its content.

    platform, arm: their files. changes: of the platform. place: of the arm's base in the platform's frame [m]. The platform has no
    actuators there; those of the arm keep the word before their names by which profiles of servos are chosen.
    """
    file = place_of_file(str(model_path(arm)))
    base, upper = read_model(model_path(platform)), read_model(file)
    reshape(base, changes)
    for thing in [*base.actuators, *(geom for geom in base.geoms if geom.name in ON_DECK)]:
        base.delete(thing)
    for things, folder in ((upper.meshes, upper.meshdir), (upper.textures, upper.texturedir)):
        for thing in things:
            if thing.file:  # absolute: the new file is elsewhere
                thing.file = str((file.parent / folder / thing.file).resolve())
    upper.meshdir = upper.texturedir = ""
    for key in list(upper.keys):
        upper.delete(key)
    for actuator in upper.actuators:
        profile, _, name = actuator.name.partition("_")
        actuator.name = f"{profile}_{PREFIX}{name}" if name else actuator.name
    names = [(actuator, actuator.name) for actuator in upper.actuators]
    base.attach(upper, prefix=PREFIX, frame=base.body("base").add_frame(pos=place))
    for actuator, name in names:
        actuator.name = name
    base.modelname = "mounted"
    base.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    base.compile()
    text = base.to_xml()
    folder = Path(tempfile.gettempdir()) / "vstestbed_mounted"
    path = folder / f"{hashlib.sha256(text.encode()).hexdigest()[:16]}.xml"
    if not path.is_file():
        make_folder(folder)
        write_whole(path, text)
    return str(path)
