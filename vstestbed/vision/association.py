"""Which blob is which marker, and the perspective bias of a marker's centroid."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import lru_cache
from itertools import combinations, product
from typing import NamedTuple

import numpy as np

from vstestbed.camera import Camera
from vstestbed.core.geometry import Array, transform
from vstestbed.targets.base import Target
from vstestbed.vision.colour import Blob
from vstestbed.vision.pnp import solve_pose_from_rays, three_ray_poses

# Perspective bias: the centroid of a marker's image is not the image of its centre (discs and spheres).
BALL_ROUNDS = 5
"""Iterations after which distance and bias have converged to 1e-4 (balls of 2 to 60 px, to 65 degrees off axis)."""
CORNERS = 32  # corners of the polygon that approximates an outline: its bias and area are then right to 1e-4


# Closed polygon with the area of the unit circle: cosines and sines, shape (CORNERS + 1,) each.
_ANGLE = np.arange(CORNERS + 1) * (2 * math.pi / CORNERS)
_SWELL = math.sqrt(2 * math.pi / (CORNERS * math.sin(2 * math.pi / CORNERS)))
_COS, _SIN = _SWELL * np.cos(_ANGLE), _SWELL * np.sin(_ANGLE)


class Outlines(NamedTuple):
    """Images of N markers: centroids less the images of their centres (N, 2) [px], areas (N,) [px^2], images of the centres (N, 2) [px]."""

    bias: Array
    area: Array
    centre: Array


def centre_bias(camera: Camera, target: Target, T_camera_target: Array) -> Outlines:
    """Centroid of each marker's image relative to the image of its centre, the image's area, and that of the centre.

    The rim (of a disc: across its normal; of a sphere: the circle where the rays touch it, centre p (d^2 - r^2)/d^2,
    radius r sqrt(1 - r^2/d^2), d = |p|) is projected as a polygon; with its corners q_i relative to the image of the centre,
    a_i = q_i x q_i+1,  area = |sum a_i|/2,  bias = sum (q_i + q_i+1) a_i / (3 sum a_i).
    This holds for any lens. Where the lens does not see a whole rim the result is NaN. In closed form for a pinhole and a disc:
    Heikkila & Silven 1997, doi:10.1109/CVPR.1997.609468.
    """
    points, radius = target.points, target.marker.radius
    with np.errstate(invalid="ignore", divide="ignore"):
        if not target.marker.height_m:  # flat
            p = transform(T_camera_target, _disc_rims(points.tobytes(), target.normals.tobytes(), radius)).reshape(len(points), -1, 3)
        else:
            p = _sphere_rims(transform(T_camera_target, points), radius)
        return _of_rims(camera, p)


def _of_rims(camera: Camera, p: Array) -> Outlines:
    uv = camera.project(p)
    q = uv[:, 1:] - uv[:, :1]
    here, there = q[:, :-1], q[:, 1:]
    a = here[..., 0] * there[..., 1] - here[..., 1] * there[..., 0]
    twice_area = np.add.reduce(a, axis=1)
    bias = np.einsum("nik,ni->nk", here + there, a) / (3 * twice_area[:, None])
    return Outlines(bias, 0.5 * np.abs(twice_area), uv[:, 0])


def ball_bias(camera: Camera, radius: float, centroid: Array, area: Array) -> Array:
    """The bias (N, 2) [px] of balls from centroids (N, 2) [px] and areas (N,) [px^2], which give their distances; NaN stays NaN."""
    bias, reach = np.zeros_like(centroid), np.full(len(area), 10 * radius)
    with np.errstate(invalid="ignore", divide="ignore"):
        for _ in range(BALL_ROUNDS):
            p = camera.ray(centroid - bias) * reach[:, None]
            bias, expected, _ = _of_rims(camera, _sphere_rims(p, radius))
            # The area falls with the square of the distance; never closer than the ball's own surface.
            reach = np.maximum(reach * np.sqrt(expected / area), 1.01 * radius)
    return bias


@lru_cache(maxsize=256)
def _disc_rims(points: bytes, normals: bytes, radius: float) -> Array:
    """Each disc's centre and rim in the target's frame, (N (CORNERS + 2), 3), from points and normals (N, 3) as bytes, for the cache."""
    centre = np.frombuffer(points).reshape(-1, 1, 3)
    across = np.array([_across(*normal) for normal in np.frombuffer(normals).reshape(-1, 3).tolist()])
    rim = centre + radius * (_COS[:, None] * across[:, :1] - _SIN[:, None] * across[:, 1:])
    return np.concatenate([centre, rim], axis=1).reshape(-1, 3)


def _sphere_rims(p: Array, radius: float) -> Array:
    """Centres of spheres, and the circles of tangency of the camera's rays, shape (N, CORNERS + 2, 3); NaN from inside."""
    d2 = np.einsum("ni,ni->n", p, p)
    shrink = 1 - radius**2 / d2
    rho = radius * np.sqrt(shrink)
    across = np.array([_across(*ray) for ray in (p / np.sqrt(d2)[:, None]).tolist()])
    out = np.empty((len(p), CORNERS + 2, 3))
    out[:, 0] = p
    rim = _COS[:, None] * across[:, :1]
    rim += _SIN[:, None] * across[:, 1:]
    rim *= rho[:, None, None]
    np.add((p * shrink[:, None])[:, None], rim, out=out[:, 1:])
    return out


def _across(x: float, y: float, z: float) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """Two unit vectors across a ray (Duff et al. 2017, JCGT 6(1)); in plain floats, a quarter of numpy's time for some five markers."""
    sign = math.copysign(1.0, z)  # the branch without a singularity at z = -1
    a = -1 / (sign + z)
    b = x * y * a
    return (1 + sign * x * x * a, sign * b, -sign * x), (b, sign + y * y * a, -y)


# Data association: which blob is which marker where several have its hue, by the pose of the target that explains them.
Placed = tuple[int, Blob]  # index of the camera's panel, and a blob in it
Candidates = list[list[Placed]]  # for each marker the blobs of its hue
Hypothesis = tuple[Array, Candidates, int]
"""A pose (4, 4), the blobs that it may explain, and how many of them it must explain."""

MOST_OF_A_HUE = 4
"""Candidates of one marker at most: blobs that are not cut first, then the largest. Bounds the number of hypotheses."""
SEEDS = 4  # markers whose blobs make hypotheses: at most 4^4 of four
OFF_PX, OFF_SHARE = 3.0, 0.03
"""A blob farther than this from the predicted marker is another object [px], or by this share of the target's size in the image.
It is far more than the detection's error, and more than the distortion of a target by a lens some percent out of calibration."""
NEAR_PX, NEAR_SHARE = 15.0, 0.15
"""Search radius around a marker under the last pose [px], or this share of the target's size in the image."""
LIKE_AREA = 0.3
"""Largest |log(area / predicted area)| of a marker's blob: rejects balls of another size elsewhere in the scene."""


def allowed_px(uv: Array) -> float:
    """Largest distance of a blob from its predicted marker, in an image of markers at uv (N, 2) [px]."""
    seen = [(u, v) for u, v in uv.tolist() if math.isfinite(u)]
    return max([OFF_PX, *(OFF_SHARE * (max(side) - min(side)) for side in zip(*seen, strict=True))])


def assign_blobs(candidates: Candidates, camera: Camera, target: Target, previous: Array | None) -> list[Placed | None]:
    """One blob for each marker, None where none fits, from the blobs of each marker's hue in a camera of one panel.

    Hypothesise and verify, as in RANSAC but exhaustively: every combination of blobs of the markers with the fewest candidates
    gives a pose. The pose that explains most blobs by position and area wins, each blob weighted by how well it fits. Four blobs
    must agree with a pose, or three near the previous pose (4, 4): three blobs have a pose wherever they are, so only continuity tells
    them from others. Fewer than three markers determine no pose: then the first candidate, or the one nearest to the last pose, is taken.
    """
    few = [sorted(c, key=lambda f: (f[1].whole, f[1].area), reverse=True)[:MOST_OF_A_HUE] for c in candidates]
    present = [i for i, c in enumerate(few) if c]
    if len(present) < 3 or max(map(len, few)) < 2:
        return _without_pose(few, camera, target, previous)
    for hypotheses in (_of_four_or_near, _of_three):
        found = _best(hypotheses(few, present, camera, target, previous), camera, target)
        if found is not None:
            return found
    return [None] * len(few)


def _best(hypotheses: Iterator[Hypothesis], camera: Camera, target: Target) -> list[Placed | None] | None:
    best, found = 0.0, None
    for T, candidates, least in hypotheses:
        score, chosen = _explained(candidates, T, camera, target)
        if score > best and sum(f is not None for f in chosen) >= least:
            best, found = score, chosen
    return found


def _of_four_or_near(few: Candidates, present: list[int], camera: Camera, target: Target, previous: Array | None) -> Iterator[Hypothesis]:
    """Poses of four blobs anywhere, then of three blobs near the markers under the last pose."""
    seeds = sorted(present, key=lambda i: len(few[i]))[:SEEDS]
    if len(seeds) > 3:
        for T in _poses(seeds, few, camera, target, previous):
            yield T, few, 4
    if previous is None:
        return
    near = _near(few, camera, target, previous)
    for three in combinations([i for i in present if near[i]][:SEEDS], 3):
        for T in _poses(list(three), near, camera, target, previous):
            yield T, near, 3


def _of_three(few: Candidates, present: list[int], camera: Camera, target: Target, previous: Array | None) -> Iterator[Hypothesis]:
    """Poses of three blobs anywhere: where three markers are all that is seen, and continue a pose or are the whole target."""
    if len(present) == 3 and (previous is not None or len(target.points) == 3):
        for T in _poses(present, few, camera, target, previous):
            yield T, few, 3


def _near(few: Candidates, camera: Camera, target: Target, previous: Array) -> Candidates:
    uv = camera.project(transform(previous, target.points))
    radius = max(NEAR_PX, NEAR_SHARE * float(np.ptp(uv, axis=0).max()))
    return [[f for f in c if _off(f[1], uv[i]) <= radius] for i, c in enumerate(few)]


def _poses(which: list[int], few: Candidates, camera: Camera, target: Target, previous: Array | None) -> Iterator[Array]:
    """The poses of every combination of candidates of the markers `which`."""
    points = target.points[which]
    for some in product(*(few[i] for i in which)):
        rays = camera.ray(np.array([(b.u, b.v) for _, b in some]))
        if len(which) == 3 and previous is None:
            yield from three_ray_poses(rays, points)
        elif (T := solve_pose_from_rays(rays, points, previous)) is not None:
            yield T


def _explained(few: Candidates, T: Array, camera: Camera, target: Target) -> tuple[float, list[Placed | None]]:
    """Score of a pose, sum over markers of max(0, 1 - distance / allowed), and the blob of each marker that it explains."""
    bias, area, centre = centre_bias(camera, target, T)
    uv = centre + bias
    allowed, chosen, score = allowed_px(uv), [], 0.0
    for i, some in enumerate(few):
        like = [f for f in some if not f[1].whole or abs(np.log(f[1].area / area[i])) <= LIKE_AREA]  # a cut one may have any area
        fitting = [(f, _off(f[1], uv[i])) for f in like]
        f, distance = min(fitting, key=lambda g: g[1], default=(None, np.inf))
        chosen.append(f if distance <= allowed else None)
        score += max(0.0, 1 - distance / allowed)
    return score, chosen


def _without_pose(few: Candidates, camera: Camera, target: Target, previous: Array | None) -> list[Placed | None]:
    """Of each marker's candidates the one nearest to it under the last pose; without one the first."""
    if previous is None:
        return [c[0] if c else None for c in few]
    uv = camera.project(transform(previous, target.points))
    return [min(c, key=lambda f: _off(f[1], uv[i]), default=None) for i, c in enumerate(few)]


def _off(blob: Blob, uv: Array) -> float:
    return float(np.hypot(blob.u - uv[0], blob.v - uv[1]))
