"""An uneven floor in the scene: a height field that wheels touch in place of the drawn plane."""

from __future__ import annotations

import mujoco
import numpy as np

from vstestbed.robots.uneven_floor import UnevenFloor
from vstestbed.sim.scene.groups import RANGE_GROUP
from vstestbed.sim.scene.model_files import ASSETS

RELIEF = "relief"
HALF_M = 20.0
"""Half the edge of the height field, as far as the floor is drawn [m]."""
THICKNESS_M = 0.1
"""Of the field under its lowest place [m]."""
AROUND = "relief_around"


def lay(scene: mujoco.MjSpec, uneven: UnevenFloor | None, floor_z: float) -> dict[str, bytes]:
    """The height field in place of the floor's contacts, and its file for the scene's assets; nothing for an even floor.

    Beyond its edge a plane at its lowest height takes over. Neither is drawn.
    """
    if uneven is None:
        return {}
    heights = uneven.heights(HALF_M)
    low, high = float(heights.min()), float(heights.max())
    n = len(heights)
    scene.meshdir = ASSETS
    scene.add_hfield(
        name=RELIEF, file=f"{RELIEF}.bin", content_type="image/vnd.mujoco.hfield", size=[HALF_M, HALF_M, high - low, THICKNESS_M]
    )
    floor = scene.geom("floor")
    # As the plane has them, also where the scenario has its friction.
    alike = {"friction": floor.friction, "contype": floor.contype, "conaffinity": floor.conaffinity, "group": RANGE_GROUP}
    at = [0, 0, floor_z + low]
    scene.worldbody.add_geom(name=RELIEF, type=mujoco.mjtGeom.mjGEOM_HFIELD, hfieldname=RELIEF, pos=at, **alike)
    scene.worldbody.add_geom(name=AROUND, type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 5], pos=at, **alike)
    floor.contype = floor.conaffinity = 0
    # MuJoCo's binary format: numbers of rows and columns, then the heights, which it stretches to [0, 1].
    data = np.array([n, n], dtype=np.int32).tobytes() + ((heights - low) / (high - low)).astype(np.float32).tobytes()
    return {f"{ASSETS}/{RELIEF}.bin": data}
