"""The outside view: framed so that the whole way is in the picture."""

from __future__ import annotations

import mujoco
import numpy as np

from vstestbed.geometry import Array
from vstestbed.robots import Robot
from vstestbed.target import Target

SEE_FACES = 0.35
"""The overview of a free camera stands this far behind the side (tangent), so that the markers' faces show."""
WIDE_PICTURE = 16 / 9
"""Width over height of the film that the overview is framed for."""
FROM_ABOVE = np.radians(38.0)
"""How steeply the overview of a vehicle looks down [rad]: its way shows, and its wheels too."""
ROOM = 1.12
"""The picture is this much wider than what must be in it."""
VEHICLE_M = 1.0
"""Room round each place where a vehicle will be [m]."""


def frame_flight(scene: mujoco.MjSpec, robot: Robot, target: Target) -> None:
    """Look at the free camera's way from the side: start left, target right, room for a retreat by half of the way.

    The way runs across the picture whatever its direction, since up means nothing to a camera that flies.
    """
    start, goal = robot.flange_pose(robot.configuration())[:3, 3], target.T_world_start[:3, 3]
    length = max(float(np.linalg.norm(goal - start)), 1e-9)
    way = (goal - start) / length if length > 1e-6 else target.T_world_start[:3, 2]
    up = np.array([0, 0, 1.0]) if abs(way[2]) < 0.9 else np.array([0, 1.0, 0])
    out = np.cross(way, up)
    out = out / np.linalg.norm(out) - SEE_FACES * way
    out /= np.linalg.norm(out)
    right = way - (way @ out) * out
    right /= np.linalg.norm(right)
    camera = scene.camera("overview")
    half_width = 0.75 * length + float(np.linalg.norm(target.points, axis=1).max()) + 0.5
    middle = goal - 0.75 * length * way
    camera.pos = middle + out * half_width / (np.tan(np.radians(camera.fovy / 2)) * WIDE_PICTURE)
    camera.alt.xyaxes = [*right, *np.cross(out, right)]


def frame_drive(scene: mujoco.MjSpec, places: Array, sights: Array) -> None:
    """Look at a vehicle's way slantingly from above, square to its longer side.

    Args:
        places: where it will be, on the floor, shape (K, 3) [m]; with room round each.
        sights: what else must be in the picture, shape (M, 3) [m].
    """
    corners = np.array([[i, j, k] for i in (-1, 1) for j in (-1, 1) for k in (0, 1)]) * VEHICLE_M
    points = np.concatenate([(places[:, None] + corners).reshape(-1, 3), sights])
    flat = points[:, :2] - points[:, :2].mean(axis=0)
    right = np.array([*np.linalg.svd(flat, full_matrices=False)[2][0], 0.0])
    right = right if right[0] > 1e-9 or (abs(right[0]) <= 1e-9 and right[1] > 0) else -right
    ahead = np.cross([0.0, 0.0, 1.0], right)
    forward = np.cos(FROM_ABOVE) * ahead - np.sin(FROM_ABOVE) * np.array([0, 0, 1.0])
    up = np.cross(right, forward)
    camera = scene.camera("overview")
    camera.pos = eye_for(points, right, up, np.tan(np.radians(camera.fovy / 2)))
    camera.alt.xyaxes = [*right, *up]


def eye_for(points: Array, right: Array, up: Array, half_height: float) -> Array:
    """The nearest place (3,) from which a picture of tangent `half_height`, WIDE_PICTURE wide, holds all points (N, 3).

    With x along `right`, z ahead and D the eye's distance behind the origin, |x - cx| <= t (D + z) for every point is
    cx >= x - t z - t D and cx <= x + t z + t D: so 2 t D >= max(x - t z) - min(x + t z), and cx is midway. The same upwards.
    """
    forward = np.cross(up, right)
    z = points @ forward
    centre, distance = np.zeros(2), 0.0
    for i, (axis, tangent) in enumerate(((right, half_height * WIDE_PICTURE / ROOM), (up, half_height / ROOM))):
        low, high = (points @ axis - tangent * z).max(), (points @ axis + tangent * z).min()
        centre[i] = (low + high) / 2
        distance = max(distance, (low - high) / (2 * tangent))
    return centre[0] * right + centre[1] * up - distance * forward
