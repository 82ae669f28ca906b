"""Planar pose of a vehicle from the rays to landmarks of known height: its camera is upright over
the floor.
"""

from __future__ import annotations

import math

import numpy as np

from vstestbed.core.geometry import Array, inverse, transform
from vstestbed.core.planar import place_of, pose_on_ground, wrapped
from vstestbed.vision.pnp import angular_errors

ROUNDS = 12  # most Gauss-Newton steps; three or four suffice from the pose a frame ago
SETTLED = 1e-10  # converged when a step is smaller than this [m, rad]
# least |z| of a unit ray (1.7 degrees of elevation) whose landmark's height gives a distance
LEVEL = 0.03
ALIKE = 1e-9  # errors below this [rad] are rounding
# a solution whose angular errors have a larger root mean square than this [rad] is rejected
FITS = 0.1


def solve_place(
    rays: Array, points: Array, T_base_camera: Array, previous: Array | None = None
) -> Array | None:
    """Planar pose (x, y, heading) of a base on the floor from N >= 1 rays; None where they leave it
    open.

    Minimises the angles between the rays and the landmarks by Gauss-Newton, with two equations a
    landmark for three unknowns. With one landmark the heading stays as it was (0 without a previous
    pose).

    Args:
        rays: unit rays in the camera frame, shape (N, 3). points: the landmarks in the map's frame,
            z up from the floor (N, 3) [m].
        T_base_camera: the camera's mount (4, 4); the base's origin is on the floor. previous: the
            planar pose a frame ago (3,) [m, rad].
    Reference: virtual visual servoing (there with six unknowns): Marchand, Uchiyama & Spindler
    2016, doi:10.1109/TVCG.2015.2513408.
    """
    d = rays @ T_base_camera[:3, :3].T
    origin = T_base_camera[:3, 3]
    # The previous pose may be a local minimum: the closed form competes with it, unless it leads to
    # the same one.
    solved = [] if previous is None else [_refined(d, points, origin, previous)]
    guess = _by_height(d, points, origin)
    # within which it leads there, too [m, rad]
    if guess is not None and not (solved and np.abs(guess - solved[0][0]).max() < 0.05):
        solved.append(_refined(d, points, origin, guess))
    if not solved:
        return None
    # Of two that fit alike the first, which continues the previous pose: of two landmarks on one
    # vertical every heading fits.
    place, error = min(solved, key=lambda s: max(s[1], ALIKE))
    return place if error < FITS else None


def _by_height(d: Array, points: Array, origin: Array) -> Array | None:
    """Initial guess: the points where rays reach their landmark's height, registered to the map by
    a planar rigid motion.
    """
    height = points[:, 2] - origin[2]
    usable = (np.abs(d[:, 2]) > LEVEL) & (height * d[:, 2] > 0)
    if not usable.any():
        return None
    here = origin[:2] + d[usable, :2] / d[usable, 2:] * height[usable, None]
    there = points[usable, :2]
    middle = np.add.reduce(here) / len(here)
    goal = np.add.reduce(there) / len(there)
    a = here - middle
    b = there - goal
    heading = math.atan2(
        np.add.reduce(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]), np.add.reduce(a * b, axis=None)
    )
    c = math.cos(heading)
    s = math.sin(heading)
    return np.array([*(goal - np.array([[c, -s], [s, c]]) @ middle), heading])


def _refined(d: Array, points: Array, origin: Array, place: Array) -> tuple[Array, float]:
    """Gauss-Newton from an initial planar pose: the pose, and the root mean square of its angular
    errors [rad].

    p = R(heading)^T (m - (x, y)) - o is a landmark m relative to the lens at o;  dp/d(x, y) = -R^T,
    dp/dheading = R'^T (m - (x, y)), and the error is the component of p/|p| orthogonal to the ray.
    """
    place = np.array(place, dtype=float)
    across = np.eye(3) - d[:, :, None] * d[:, None, :]
    unknowns = 3 if len(points) > 1 else 2
    error = math.inf
    for _ in range(ROUNDS):
        e, J = _errors(d, across, points, origin, place)
        error = math.sqrt(float(e @ e) / len(points))
        # two landmarks on one vertical leave the heading open
        step = np.linalg.lstsq(J[:, :unknowns], -e, rcond=1e-4)[0]
        place[:unknowns] += step
        if np.abs(step).max() < SETTLED:
            break
    return place, error


def _errors(
    d: Array, across: Array, points: Array, origin: Array, place: Array
) -> tuple[Array, Array]:
    """Errors (3 N,) [1] and their Jacobian (3 N, 3) by (x, y, heading)."""
    c = math.cos(place[2])
    s = math.sin(place[2])
    x, y = (points[:, :2] - place[:2]).T
    p = np.empty((len(points), 3))
    p[:, 0] = c * x + s * y
    p[:, 1] = -s * x + c * y
    p[:, 2] = points[:, 2]
    p -= origin
    dp = np.zeros((len(points), 3, 3))
    dp[:, 0, 0] = -c
    dp[:, 0, 1] = -s
    dp[:, 1, 0] = s
    dp[:, 1, 1] = -c
    dp[:, 0, 2] = p[:, 1] + origin[1]
    dp[:, 1, 2] = -p[:, 0] - origin[0]
    unit, e, J = angular_errors(across, p, dp)
    behind = np.add.reduce(unit * d, axis=1) < 0
    if behind.any():  # the orthogonal component is small there too
        e[behind] = np.sign(unit[behind])
    return e.ravel(), J.reshape(-1, 3)


def pose_on_floor(
    rays: Array, points: Array, T_base_camera: Array, T_world_target: Array, predicted: Array | None
) -> Array | None:
    """The pose T_camera_target (4, 4) for a base that stands upright on the floor; None where the
    rays do not determine it.

    As `solve_place`, with points (n, 3) in the target's frame [m], and T_camera_target predicted
    (4, 4) or None.
    """
    before = None
    if predicted is not None:
        before = place_of(T_world_target @ inverse(T_base_camera @ predicted))
    place = solve_place(rays, transform(T_world_target, points), T_base_camera, before)
    if place is None:
        return None
    return inverse(pose_on_ground(place) @ T_base_camera) @ T_world_target


# Planar pose of a ground vehicle: odometry, corrected by a compass and by landmarks (complementary
# filter).
COMPASS_S = 0.5  # time constant with which the heading by odometry follows the compass [s]
LANDMARKS_S = 0.25  # time constant with which the position by odometry follows the landmarks [s]


def corrections(dt: float) -> Array:
    """Gains (2,) of one filter step, 1 - exp(-dt / tau), for the compass and for the landmarks."""
    return -np.expm1([-dt / tau for tau in (COMPASS_S, LANDMARKS_S)])


def fused_place(
    predicted: Array | None,
    T_map_camera: Array | None,
    T_base_camera: Array,
    compass: float | None,
    gains: Array,
) -> Array | None:
    """Planar pose (x, y, heading) of a vehicle; None where it has never been known.

    heading <- heading + k_c wrap(compass - heading),
    (x, y)  <- (x, y) + k_l ((x, y) by landmarks - (x, y))

    The landmarks give the position of the lens whatever the heading is; that of the base follows
    from it by the mount's lever arm at the filtered heading. Noise is averaged by the filter;
    biases of compass and landmarks remain.

    Args:
        predicted: by odometry from the last frame (3,) [m, rad]; None where it was not known then.
            gains: k_c, k_l of this frame (2,).
        T_map_camera: camera pose by the landmarks (4, 4); None where they are not seen.
            T_base_camera: the mount (4, 4).
        compass: measured heading [rad]; None without a compass.
    """
    known = predicted if T_map_camera is None else place_of(T_map_camera @ inverse(T_base_camera))
    if known is None:
        return None
    heading = float(known[2])
    if compass is not None and predicted is not None:
        heading = float(predicted[2] + gains[0] * wrapped(compass - predicted[2]))
    elif compass is not None:
        heading = compass
    if T_map_camera is None:
        return np.array([known[0], known[1], heading])
    lever = pose_on_ground(np.array([0.0, 0.0, heading])) @ T_base_camera[:, 3]
    xy = T_map_camera[:2, 3] - lever[:2]
    if predicted is not None:
        xy = predicted[:2] + gains[1] * (xy - predicted[:2])
    return np.array([xy[0], xy[1], heading])
