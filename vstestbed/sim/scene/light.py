"""The lights of a scene: `world.light` in place of the room's own."""

from __future__ import annotations

import mujoco
import numpy as np

from vstestbed.sim.scene.world import Light

SUN_M = 6.0
"""Distance of a lamp that is as far as the sun, from the room's middle [m]: shadows are drawn from there."""
FINE_QUADS = 48
"""Parts of a box's face along each edge where light differs within it, which OpenGL computes at their corners alone; else MuJoCo's 4."""


def light_scene(scene: mujoco.MjSpec, light: Light | None, glossy: bool) -> None:
    """Give the scene a lamp and an even light in place of all its own lights; None: these stay.

    glossy: something shows highlights.
    """
    if glossy or (light is not None and light.xyz is not None):
        scene.visual.quality.numquads = FINE_QUADS
    if light is None:
        return
    for other in scene.lights:
        other.active = other.name in ("key", "fill")
    key, fill = scene.light("key"), scene.light("fill")
    along = np.array(light.direction) / np.linalg.norm(light.direction)
    key.dir, key.pos = along, -SUN_M * along
    if light.xyz is not None:  # a spot light of half a space: MuJoCo's OpenGL draws its point lights as spots of 45 degrees
        key.type, key.pos, key.attenuation = mujoco.mjtLightType.mjLIGHT_SPOT, light.xyz, [1, 0, 0]
        key.exponent, key.cutoff = 0, 90
    key.diffuse = key.specular = [light.brightness] * 3
    fill.ambient, fill.diffuse = [light.ambient] * 3, [0, 0, 0]
