"""The lights of a scene: `world.light` in place of the room's own, windows, and what is seen of their light on the floor."""

from __future__ import annotations

import mujoco
import numpy as np

from vstestbed.core.geometry import quaternion_wxyz
from vstestbed.sim.scene.groups import GLOW
from vstestbed.sim.scene.model_files import lay_picture
from vstestbed.sim.scene.world import LAMP, Floor, Light, WindowPane, World
from vstestbed.targets.picture import place_of_picture, read_tile

SUN_M = 6.0  # Distance of a lamp that is as far as the sun, from the room's middle [m]: shadows are drawn from there
FINE_QUADS = 48
"""Parts of a box's face along each edge where light differs within it, which OpenGL computes at their corners alone; else MuJoCo's 4."""
FINE_FLOOR_M, FINE_GRID_M = 10.0, 0.05
"""Half the floor's edge, and the distance of its corners, where light differs within it [m]: in OpenGL the peak of a highlight of exponent
100 is up to 4 % too low, and found within 0.07 m of its place."""
PANE_HALF_M = 1e-3  # Half the thickness of a window's pane [m]; its lamp is as far before its face as that is before its middle


def light_scene(scene: mujoco.MjSpec, world: World, glossy: bool) -> None:
    """Give the scene a lamp and an even light in place of all its own lights, where the world has them, its windows, and its floor.

    glossy: the target shows highlights.
    """
    if glossy or world.light_differs:
        scene.visual.quality.numquads = FINE_QUADS
    if world.light is not None:
        _replace_lights(scene, world.light)
    for i, pane in enumerate(world.windows):
        _add_window(scene, pane, i, world.floor.sharpness)
    if world.floor != Floor():
        _paint_floor(scene, world.floor)
    if world.light_differs:
        scene.geom("floor").size = [FINE_FLOOR_M, FINE_FLOOR_M, FINE_GRID_M]


def _replace_lights(scene: mujoco.MjSpec, light: Light) -> None:
    """The lamp and the even light of `world.light` in place of all lights; a lamp that moves is on a body, `LAMP`."""
    for other in scene.lights:
        other.active = other.name in ("key", "fill")
    key, fill = scene.light("key"), scene.light("fill")
    along, colour = np.array(light.direction) / np.linalg.norm(light.direction), np.array(light.color)
    fill.ambient, fill.diffuse = light.ambient * colour, [0, 0, 0]
    place = np.zeros(3) if light.xyz is None else np.array(light.xyz)
    if light.motion.moves:
        scene.delete(key)
        holder = scene.worldbody.add_body(name=LAMP, mocap=True, pos=place)
        key, place = holder.add_light(name="key", castshadow=True), np.zeros(3)
    key.type, key.dir, key.pos, key.ambient = mujoco.mjtLightType.mjLIGHT_DIRECTIONAL, along, -SUN_M * along, [0, 0, 0]
    if light.xyz is not None:  # a spot light of half a space: MuJoCo's OpenGL draws its point lights as spots of 45 degrees
        key.type, key.pos, key.attenuation = mujoco.mjtLightType.mjLIGHT_SPOT, place, [1, 0, 0]
        key.exponent, key.cutoff = 0, 90
    key.diffuse = key.specular = light.brightness * colour


def _add_window(scene: mujoco.MjSpec, pane: WindowPane, i: int, sharpness: float) -> None:
    """A pane of constant brightness, and its light, as `WindowPane` has it, for highlights of an exponent."""
    T, grey = pane.pose.T, min(pane.brightness, 1.0) / GLOW
    name = f"window_{i}"
    paint = scene.add_material(name=name, rgba=[grey, grey, grey, 1], specular=0, shininess=0, emission=GLOW)
    body = scene.worldbody.add_body(name=name, pos=T[:3, 3], quat=quaternion_wxyz(T[:3, :3]))
    size = [pane.width / 2, pane.height / 2, PANE_HALF_M]
    kind = mujoco.mjtGeom.mjGEOM_BOX
    body.add_geom(name=name, type=kind, size=size, rgba=paint.rgba, material=name, contype=0, conaffinity=0, mass=0)
    # cos(b)^1 of a spot light is Lambert's law, 1/(1 + pi d^2/A) its attenuation
    body.add_light(
        name=name,
        type=mujoco.mjtLightType.mjLIGHT_SPOT,
        pos=[0, 0, 2 * PANE_HALF_M],
        dir=[0, 0, 1],
        ambient=[0, 0, 0],
        diffuse=[pane.brightness] * 3,
        specular=[pane.brightness * (sharpness / 4 + 1) / 2] * 3,
        attenuation=[1, 0, np.pi / (pane.width * pane.height)],
        cutoff=90,
        exponent=1,
        castshadow=False,
    )


def _paint_floor(scene: mujoco.MjSpec, floor: Floor) -> None:
    paint = scene.material("floor")
    paint.specular, paint.shininess, paint.reflectance = floor.gloss, floor.sharpness / 128, floor.mirror
    if floor.texture is None:
        return
    png, (width, height) = read_tile(place_of_picture(floor.texture), floor.albedo)
    lay_picture(scene, paint, "floor_picture", "floor_picture.png", png)
    # `texuniform`: so many tiles in two metres
    paint.texrepeat = [2 / floor.tile_m, 2 / (floor.tile_m * height / width)]
