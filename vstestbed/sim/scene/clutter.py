"""What can be taken for markers: distractors that are listed, and clutter that is drawn from the seed."""

from __future__ import annotations

import colorsys
import math
from collections.abc import Sequence
from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge, Gt, Le, Len, Lt

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Pose
from vstestbed.core.quantity import Angles, Position, PositiveLength
from vstestbed.core.spec import spec
from vstestbed.targets.motion import PLATE_MOTIONS, MotionBase, Path, Still

Shape = Literal["ball", "disc", "box"]
DISC_HALF_M = 1e-3
"""Half the thickness of a disc [m]."""
Share = Annotated[float, Ge(0), Le(1)]


@spec
class Decoy:
    """A distractor: a ball, a disc or a cube of a marker's colour, without collisions.

    Args:
        xyz: position [m]; e.g. `[1.5, 0.3, 0.7]`.
        shape: a disc, 2 mm thick, spans its own x and y axes.
        radius: of the ball or the disc, half the edge of the cube [m].
        hue_deg: its hue; markers have 0, 360/n, ... [deg].
        saturation, albedo: of its colour, as of markers [1].
        rpy_deg: how it is turned, as a pose [deg].
        motion: displacement from there.
    """

    xyz: Position
    shape: Shape = "ball"
    radius: PositiveLength = 0.02
    hue_deg: Annotated[float, Ge(0), Lt(360)] = 0.0
    saturation: Share = 1.0
    albedo: Share = 1.0
    rpy_deg: Angles = (0.0, 0.0, 0.0)
    motion: Annotated[MotionBase, PLATE_MOTIONS] = Still()

    @property
    def color(self) -> tuple[float, float, float]:
        """Its colour (r, g, b) in 0..1."""
        return colorsys.hsv_to_rgb(self.hue_deg / 360, self.saturation, self.albedo)

    @property
    def half_sizes(self) -> tuple[float, float, float]:
        """Sizes of its geom [m], in MuJoCo's order."""
        r = self.radius
        return {"ball": (r, 0.0, 0.0), "disc": (r, DISC_HALF_M, 0.0), "box": (r, r, r)}[self.shape]


@spec
class Clutter:
    """Distractors at random places in a box, drawn from the seed: each place uniform, each size uniform, each hue one of several.

    Object i is the same whatever their number. They may stand in each other and before the target: choose the box so that they do not, or
    so that they do. 20 objects take 1 ms of a picture's 6.5 ms in software OpenGL.

    Args:
        pose: middle and axes of the box in the world; discs face along its z axis, and cubes stand turned about it;
            e.g. `{xyz: [1.8, 0, 0.7], rpy_deg: [0, -90, 0]}`.
        size_m: edges of the box along its axes [m].
        count: number of objects [1].
        shapes: what is drawn, each as often.
        radius_m: smallest and largest radius [m].
        hues: of the `markers`, each as often, or `any`.
        saturation, albedo: of their colours [1].
        placed: the objects of this run; it is written by the run, and drawn again for each seed; e.g. `[{xyz: [1.5, 0.3, 0.7]}]`.
    """

    pose: Pose
    size_m: Annotated[tuple[PositiveLength, ...], Len(3, 3)] = (1.0, 1.0, 0.2)
    count: Annotated[int, Ge(0), Le(100)] = 10
    shapes: Annotated[tuple[Shape, ...], Len(1, 3)] = ("ball", "disc", "box")
    radius_m: Annotated[tuple[PositiveLength, ...], Len(2, 2)] = (0.01, 0.03)
    hues: Literal["markers", "any"] = "markers"
    saturation: Annotated[float, Gt(0), Le(1)] = 1.0
    albedo: Annotated[float, Gt(0), Le(1)] = 1.0
    placed: Annotated[tuple[Decoy, ...], Len(0, 100)] = ()

    def __post_init__(self) -> None:
        """Refuse a range of sizes in the wrong order."""
        if self.radius_m[0] > self.radius_m[1]:
            raise ParameterError("radius_m", "must be the smallest and the largest radius, in this order", list(self.radius_m))

    def draw(self, rng: np.random.Generator, hues_deg: Sequence[float]) -> tuple[Decoy, ...]:
        """The objects of a run.

        Args:
            rng: of the run. hues_deg: of the markers [deg].
        """
        return tuple(self._one(own, hues_deg) for own in rng.spawn(self.count))

    def _one(self, rng: np.random.Generator, hues_deg: Sequence[float]) -> Decoy:
        place, shape, size, hue, turn = rng.uniform(-0.5, 0.5, 3), *rng.random(4).tolist()
        z = math.tau * turn
        own = np.eye(4)
        own[:3, :3] = [[math.cos(z), -math.sin(z), 0], [math.sin(z), math.cos(z), 0], [0, 0, 1]]
        own[:3, 3] = place * self.size_m
        pose = Pose.of(self.pose.T @ own)
        return Decoy(
            xyz=pose.xyz,
            rpy_deg=pose.rpy_deg,
            shape=self.shapes[int(shape * len(self.shapes))],
            radius=self.radius_m[0] + size * (self.radius_m[1] - self.radius_m[0]),
            hue_deg=hues_deg[int(hue * len(hues_deg))] if self.hues == "markers" and hues_deg else 360 * hue,
            saturation=self.saturation,
            albedo=self.albedo,
        )


def decoy_path(decoy: Decoy) -> Path:
    """Pose (4, 4) of a decoy as a function of time [s]."""
    rest, displacement = Pose(xyz=decoy.xyz, rpy_deg=decoy.rpy_deg).T, decoy.motion.path(np.random.default_rng(0))
    return lambda t: rest @ displacement(t)
