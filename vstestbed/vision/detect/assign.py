"""Data association: which blob is which marker where several have its hue, by the pose of the target that explains them."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import combinations, product

import numpy as np

from vstestbed.camera import Camera
from vstestbed.core.geometry import Array, transform
from vstestbed.targets.base import Target
from vstestbed.vision.detect.centre import centre_bias
from vstestbed.vision.detect.colour_blobs import Blob
from vstestbed.vision.pose.pnp import solve_pose_from_rays, three_ray_poses

Placed = tuple[int, Blob]
"""Index of the camera's panel, and a blob in it."""
Candidates = list[list[Placed]]
"""For each marker the blobs of its hue."""
Hypothesis = tuple[Array, Candidates, int]
"""A pose (4, 4), the blobs that it may explain, and how many of them it must explain."""

MOST_OF_A_HUE = 4
"""Candidates of one marker at most: blobs that are not cut first, then the largest. Bounds the number of hypotheses."""
SEEDS = 4
"""Markers whose blobs make hypotheses: at most 4^4 of four."""
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
    """One blob for each marker, None where none fits.

    Hypothesise and verify, as in RANSAC but exhaustively: every combination of blobs of the markers with the fewest candidates
    gives a pose. The pose that explains most blobs by position and area wins, each blob weighted by how well it fits. Four blobs
    must agree with a pose, or three near the previous pose: three blobs have a pose wherever they are, so only continuity tells
    them from others. Where no pose is explained so, no marker is reported. Fewer than three markers determine no pose: then the
    first candidate, or the one nearest to the last pose, is taken.

    Args:
        candidates: for each marker the blobs of its hue.
        camera: the camera, of one panel.
        target: the marker layout.
        previous: last pose of the target, shape (4, 4).
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
    """The blobs that the best hypothesis explains; None where none explains enough of them."""
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
    """The candidates within the search radius of their marker under the last pose."""
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
        fitting = [(f, _off(f[1], uv[i])) for f in some if _like(f[1], area[i])]
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
    """Distance of a blob's centroid from uv (2,) [px]."""
    return float(np.hypot(blob.u - uv[0], blob.v - uv[1]))


def _like(blob: Blob, area: float) -> bool:
    """Whether a blob has the predicted area [px^2]; a cut one may have any."""
    return not blob.whole or abs(np.log(blob.area / area)) <= LIKE_AREA
