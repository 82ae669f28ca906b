"""What lights a scene: a lamp in place of the room's own light, and windows."""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np
from annotated_types import Ge, Gt, Le, Len

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Pose
from vstestbed.core.quantity import Position, PositiveLength
from vstestbed.core.spec import spec
from vstestbed.sim.scene.flicker import STEADY, Flicker
from vstestbed.targets.motion import PLATE_MOTIONS, MotionBase, Path, Still

LAMP = "lamp"
"""Name of the body of a lamp that moves."""
SAMPLES_S = (0.0, 0.37, 1.13, 2.9, 7.3, 41.0)
"""Times at which a motion is looked at for whether it turns a lamp [s]: without a common period."""
Colour = Annotated[tuple[Annotated[float, Ge(0), Le(1)], ...], Len(3, 3)]


@spec
class Light:
    """One lamp and an even light from all sides, in place of the room's own light and of the lights of scenery.

    A surface of colour c with normal n has c (ambient + brightness max(0, n . l)) for each channel, l towards the lamp, at most 1.

    Args:
        direction: along its rays in the world, of any length; the room's own comes from behind the robots' side, from above [1].
        xyz: place of the lamp, which shines into the half space along `direction`, equally far [m]; none: it is as far as the sun;
            e.g. `[0.5, 1.2, 2]`.
        brightness: of what faces the lamp [1].
        ambient: of what does not [1].
        color: of the lamp and of the light from all sides: red, green and blue, by which both are multiplied [1].
        motion: displacement of the lamp from its place, along the world's axes; its angles turn `direction`. A lamp without `xyz` is
            so far that they alone count. Shading and shadows (`camera.shadows`) move with it; a random walk is the same in all runs.
            It costs no time.
        flicker: of both lights, against the camera's shutter.
    """

    direction: Annotated[tuple[Annotated[float, Ge(-1e6), Le(1e6)], ...], Len(3, 3)] = (0.45, 0.45, -1.0)
    xyz: Position | None = None
    brightness: Annotated[float, Ge(0), Le(5)] = 0.6
    ambient: Annotated[float, Ge(0), Le(5)] = 0.5
    color: Colour = (1.0, 1.0, 1.0)
    motion: Annotated[MotionBase, PLATE_MOTIONS] = Still()
    flicker: Flicker = STEADY

    def __post_init__(self) -> None:
        """Refuse a direction of no length, and a motion that a lamp at infinity does not show."""
        if not 1e-6 < math.hypot(*self.direction) < 1e6:
            raise ParameterError("direction", "must be a vector along the lamp's rays, not zero", list(self.direction))
        if self.xyz is None and self.motion.moves:
            path = self.path()
            if all(np.allclose(path(t)[:3, :3], np.eye(3), atol=1e-9) for t in SAMPLES_S):
                words = "must turn a lamp that is as far as the sun; works: {kind: sinusoid, amplitude: {rpy_deg: [20, 0, 0]},"
                raise ParameterError("motion", f"{words} frequency_hz: 0.2}}, or give the lamp a place, xyz", self.motion.kind)

    def path(self) -> Path:
        """Pose (4, 4) of the lamp as a function of time [s], at rest along the world's axes; of one without a place about the origin."""
        rest, displacement = Pose(xyz=self.xyz or (0.0, 0.0, 0.0)).T, self.motion.path(np.random.default_rng(0))
        return lambda t: rest @ displacement(t)


@spec
class WindowPane:
    """A bright pane, such as a window or a lamp's diffuser, which shines along its z axis by Lambert's law.

    A surface of colour c whose normal makes an angle a with the direction to the pane's middle, at a distance d and at an angle b from the
    pane's z axis, gets the light c brightness cos a cos b A / (A + pi d^2) of a pane of area A. It is the light of a small Lambertian
    surface far away, and on its axis the exact one of a disc of this area. It casts no shadows; the pane itself is drawn with its
    brightness, at most white. A glossy surface shows it as a highlight, gloss brightness cos b A/(A + pi d^2) (n + 1)/2 (h . n)^s of
    `world.floor.sharpness` s: about the mirror direction a lobe cos^n, n = s/4, whose integral over the half space is 1.

    Args:
        pose: its middle and axes in the world; it spans its x and y axes, and shines along z;
            e.g. `{xyz: [1, 2, 1.5], rpy_deg: [90, 0, 0]}`.
        width, height: size along x and y [m].
        brightness: of the pane, 1 for white; the light that it sheds is in proportion to it, also above 1 [1].

    Reference: Howell, Menguc, Daun & Siegel 2020, Thermal Radiation Heat Transfer, 7th ed., configuration factors (element to disc:
    A/(A + pi d^2), with A = pi r^2).
    """

    pose: Pose
    width: PositiveLength = 1.2
    height: PositiveLength = 1.0
    brightness: Annotated[float, Gt(0), Le(100)] = 1.0

    @property
    def area(self) -> float:
        """Of the pane [m^2]."""
        return self.width * self.height
