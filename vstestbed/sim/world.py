"""What else is in the world: plates that hide things."""

from __future__ import annotations

import colorsys
from typing import Annotated

import numpy as np
from annotated_types import Ge, Gt, Le, Lt

from vstestbed.errors import ParameterError
from vstestbed.geometry import Pose, Triple
from vstestbed.motion import PLATE_MOTIONS, OwnMotion, Path, Still
from vstestbed.spec import spec


@spec
class Plate:
    """An opaque plate that stands in the room from `from_s` until `until_s`; it can hide markers, and touches nothing.

    Args:
        pose: its centre in the world; the plate spans its x and y axes.
        width, height: size along x and y [m].
        from_s, until_s: when it is there [s].
        motion: how it moves about its pose, in its own axes; a random walk of a plate is always the same one.
    """

    pose: Pose
    motion: Annotated[OwnMotion, PLATE_MOTIONS] = Still()
    width: Annotated[float, Gt(0)] = 0.5
    height: Annotated[float, Gt(0)] = 0.5
    from_s: Annotated[float, Ge(0)] = 0.0
    until_s: Annotated[float, Gt(0)] = 1e9

    def __post_init__(self) -> None:
        """Refuse a plate that leaves before it comes."""
        if self.until_s <= self.from_s:
            raise ParameterError("until_s", f"must be after from_s = {self.from_s:g} s", self.until_s)


@spec
class Decoy:
    """A ball of a marker's colour that is no marker; it touches nothing.

    Args:
        xyz: where it is [m]. radius: [m]. hue_deg: its hue; markers have 0, 360/n, ... [deg]. motion: how it moves about there.
    """

    xyz: Triple
    radius: Annotated[float, Gt(0)] = 0.02
    hue_deg: Annotated[float, Ge(0), Lt(360)] = 0.0
    motion: Annotated[OwnMotion, PLATE_MOTIONS] = Still()

    @property
    def color(self) -> tuple[float, float, float]:
        """Saturated (r, g, b) in 0..1."""
        return colorsys.hsv_to_rgb(self.hue_deg / 360, 1.0, 1.0)


@spec
class World:
    """The room round the robot and the target.

    Args:
        floor_z: height of the floor [m]; scenes in a textbook's coordinates need it out of the way.
        floor_friction: Coulomb friction between the floor and what stands on it, where that is less than the wheels' own;
            .05 is ice.
        plates: what can hide markers, or cast a shadow on them (`camera.shadows`).
        decoys: what can be taken for markers.
    """

    floor_z: float = 0.0
    floor_friction: Annotated[float, Gt(0), Le(10)] | None = None
    plates: tuple[Plate, ...] = ()
    decoys: tuple[Decoy, ...] = ()


AWAY = np.array([0.0, 0.0, -50.0])
"""Where plates are while they are not there: under the floor [m]."""


def decoy_path(decoy: Decoy) -> Path:
    """Where a decoy is at a time [s], as a function that gives its pose (4, 4)."""
    rest, displacement = Pose(xyz=decoy.xyz).T, decoy.motion.path(np.random.default_rng(0))
    return lambda t: rest @ displacement(t)


def plate_path(plate: Plate) -> Path:
    """Where a plate is at a time [s], as a function that gives its pose (4, 4)."""
    rest, displacement = plate.pose.T, plate.motion.path(np.random.default_rng(0))
    away = rest.copy()
    away[:3, 3] = AWAY
    return lambda t: rest @ displacement(t) if plate.from_s - 1e-9 <= t < plate.until_s - 1e-9 else away
