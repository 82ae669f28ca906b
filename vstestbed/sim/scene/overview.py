"""Framing of the outside view, so that the whole path is in the picture."""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np

from vstestbed.core.geometry import Array
from vstestbed.robots import Robot
from vstestbed.sim.scene.meshes import CORNERS
from vstestbed.targets.base import Target

# The overview of a free camera stands this far behind the side (tangent), so that the markers'
# faces show
SEE_FACES = 0.35
WIDE_PICTURE = 16 / 9  # width over height of the film that the overview is framed for
# Elevation from which the overview of a vehicle looks down [rad]: both its path and its wheels are
# visible
FROM_ABOVE = np.radians(38.0)
ROOM = 1.12  # margin in width: the picture is this much wider than its contents
HEADROOM = 1.25  # margin in height, larger, since a film has a strip of plots along its lower edge
# Margin for a vehicle that leaves the hull of the given places: a share of their extent, up to a
# limit [m]
ROAM = 0.12
ROAM_M = 0.8
AZIMUTHS = np.radians(np.arange(0, 360, 10))
# height of the light that casts shadows over the middle of the view [m], above all objects
LIGHT_HEIGHT = 6.0
# least half width of the shadows' depth map [m]; a tighter one speckles lit surfaces
LEAST_REACH = 7.0
# directions in the picture of its left, right, lower and upper edge
SIDES = np.array([[-1.0, 0.0], [1.0, 0.0], [0.0, -1.0], [0.0, 1.0]])


def frame_flight(scene: mujoco.MjSpec, robot: Robot, target: Target) -> None:
    """View of the free camera's path from the side: start left, target right, room for a retreat by
    half of the path.

    The path runs across the picture whatever its direction: a free camera has no upright.
    """
    start = robot.flange_pose(robot.configuration())[:3, 3]
    goal = target.T_world_start[:3, 3]
    length = max(float(np.linalg.norm(goal - start)), 1e-9)
    way = (goal - start) / length if length > 1e-6 else target.T_world_start[:3, 2]
    up = np.array([0, 0, 1.0]) if abs(way[2]) < 0.9 else np.array([0, 1.0, 0])
    out = np.cross(way, up)
    out = out / np.linalg.norm(out) - SEE_FACES * way
    out /= np.linalg.norm(out)
    right = way - (way @ out) * out
    right /= np.linalg.norm(right)
    camera = scene.camera("overview")
    size = float(np.linalg.norm(target.points, axis=1).max())
    half_width = 0.75 * length + size + min(0.5, length)
    middle = goal - 0.75 * length * way
    camera.pos = middle + out * half_width / (np.tan(np.radians(camera.fovy / 2)) * WIDE_PICTURE)
    camera.alt.xyaxes = [*right, *np.cross(out, right)]


def frame_drive(scene: mujoco.MjSpec, places: Array, sights: Array, size: float) -> None:
    """View of a vehicle's path from above at an angle, from the azimuth at which it appears
    largest.

    The light that casts shadows is moved over the path, since its depth map has a limited extent.

    places: where it will be, shape (K, 3) [m]; with room round each. sights: what else must be in
    the picture, shape (M, 3) [m].
    size: of the vehicle [m].
    """
    room = 0.6 * size + min(ROAM * float(np.linalg.norm(np.ptp(places[:, :2], axis=0))), ROAM_M)
    corners = CORNERS * [room, room, size / 2] + [0, 0, size / 2]
    points = np.concatenate([(places[:, None] + corners).reshape(-1, 3), sights])
    camera = scene.camera("overview")
    half_height = np.tan(np.radians(camera.fovy / 2))
    views = [slanting(azimuth) for azimuth in AZIMUTHS]
    eyes = [eye_for(points, right, up, half_height) for right, up in views]
    best = min(
        range(len(views)),
        key=lambda i: _drawback(eyes[i], np.cross(views[i][1], views[i][0]), places, sights),
    )
    camera.pos = eyes[best]
    camera.alt.xyaxes = np.concatenate(views[best]).tolist()
    _light(scene, points)


def _drawback(eye: Array, forward: Array, places: Array, sights: Array) -> float:
    """Cost of a view [m]: depth of the farthest place, plus twice the depth by which sights are
    nearer than the nearest place.
    """
    # Sights before the vehicle would fill the picture. Rounded, so that equal views compare equal
    # and the first azimuth wins.
    depths = (places - eye) @ forward
    before = (sights - eye) @ forward
    return round(float(depths.max() + 2 * max(depths.min() - before.min(initial=np.inf), 0.0)), 6)


def slanting(azimuth: float, elevation: float = FROM_ABOVE) -> tuple[Array, Array]:
    """Right and up (3,) of a camera that looks down by an elevation,
    ahead along an azimuth [rad].
    """
    ahead = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    right = np.array([ahead[1], -ahead[0], 0.0])
    return right, np.cos(elevation) * np.array([0, 0, 1.0]) + np.sin(elevation) * ahead


def _light(scene: mujoco.MjSpec, points: Array) -> None:
    """Make the shadows' depth map cover all points (N, 3): it is a square about the light's place,
    across its direction.
    """
    light = scene.light("key")
    along = np.asarray(light.dir, dtype=float) / np.linalg.norm(light.dir)
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    light.pos = middle + along * (LIGHT_HEIGHT + np.ptp(points[:, 2])) / along[2]
    reach = np.linalg.norm(np.cross(points - middle, along), axis=1).max()
    scene.visual.map.shadowclip = max(float(reach), LEAST_REACH) / scene.stat.extent


def eye_for(points: Array, right: Array, up: Array, half_height: float) -> Array:
    """The nearest place (3,) from which a picture of tangent `half_height`, WIDE_PICTURE wide,
    holds all points (N, 3).
    """
    wide = half_height * WIDE_PICTURE / ROOM
    high = half_height / HEADROOM
    tangents = np.array([wide, wide, high, high])
    axes = Axes.of(right, up)
    return eye_of(extremes(points, axes, tangents), axes, tangents)


class Axes(NamedTuple):
    """Axes of a view in the world: to the right, up, and ahead along the optical axis,
    (3,) each.
    """

    right: Array
    up: Array
    ahead: Array

    @classmethod
    def of(cls, right: Array, up: Array) -> Axes:
        """The axes of which two are given."""
        return cls(right, up, np.cross(up, right))


def extremes(points: Array, axes: Axes, tangents: Array) -> Array:
    """What points (N, 3) ask of the place of a view, (4,): the larger, the farther they are out of
    the picture to each side.

    tangents (4,): of the angles from the optical axis to the edges (left, right, down, up) between
    which a picture shows its contents. With x to the right, z ahead, tangents l and r and D the
    eye's distance behind the origin, x - cx <= r (D + z) for every point is cx + r D >= max(x - r
    z), and x - cx >= -l (D + z) is l D - cx >= max(-x - l z). The same upwards.
    """
    x, y, z = (points @ axis for axis in axes)
    return (SIDES @ np.array([x, y]) - tangents[:, None] * z).max(axis=1)


def eye_of(most: Array, axes: Axes, tangents: Array) -> Array:
    """The nearest place (3,) that satisfies these extremes (4,), with the contents in the middle of
    what room is left.
    """
    left, to_right, down, to_up = tangents
    distance = max((most[0] + most[1]) / (left + to_right), (most[2] + most[3]) / (down + to_up))
    # cx lies between most[1] - r D and l D - most[0].
    across = (most[1] - to_right * distance + left * distance - most[0]) / 2
    upwards = (most[3] - to_up * distance + down * distance - most[2]) / 2
    return across * axes.right + upwards * axes.up - distance * axes.ahead


def holds(eye: Array, most: Array, axes: Axes, tangents: Array) -> bool:
    """Whether a place (3,) satisfies extremes (4,)."""
    place = np.array([axes.right @ eye, axes.up @ eye])
    distance = -(axes.ahead @ eye)
    return bool((SIDES @ place + tangents * distance >= most).all())
