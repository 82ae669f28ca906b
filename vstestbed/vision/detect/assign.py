"""Which blob is which marker where several have its hue: the choice that one pose of the target explains."""

from __future__ import annotations

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
"""A blob and the panel of the camera in which it is."""
MOST_OF_A_HUE = 4
"""Blobs of one hue that are weighed at most, whole ones first, the largest."""
SEEDS = 4
"""Markers whose blobs make the poses that are tried: 4^4 of them at most."""
OFF_PX, OFF_SHARE = 3.0, 0.03
"""A blob this far from where the pose has its marker is another thing [px], or by this share of the target's size in the picture:
far more than detection errs by, and more than a lens some percent out of calibration bends a target."""
NEAR_PX, NEAR_SHARE = 15.0, 0.15
"""A blob this near to where the last pose has its marker may be where that has gone [px], or by this share of the target's size."""
LIKE_AREA = 0.3
"""|log(area / expected)| up to which a blob may be the marker: a sphere of another size elsewhere is not."""


def allowed_px(uv: Array) -> float:
    """How far off a marker's blob may lie in a picture of markers at uv (N, 2) [px]."""
    seen = uv[np.isfinite(uv[:, 0])]
    return max(OFF_PX, OFF_SHARE * float(np.ptp(seen, axis=0).max())) if len(seen) else OFF_PX


def choose(candidates: list[list[Placed]], camera: Camera, target: Target, previous: Array | None) -> list[Placed | None]:
    """One blob for each marker, None where none fits.

    Every choice for the markers with the fewest candidates gives a pose, and so do, near the previous pose, three blobs: they
    have a pose wherever they are, and only what continues tells. That pose is best which explains most blobs, by place
    and by area, each counted by how well it fits. With no pose that explains four (three that continue the previous one)
    nothing is told from another: no marker is reported. Fewer than three markers make no pose: the first of each, or
    the nearest to where it was.

    Args:
        candidates: for each marker the blobs of its hue, the likeliest first.
        camera: the lens, of one panel. target: what is looked at. previous: its last pose (4, 4).
    """
    few = [sorted(c, key=lambda f: (f[1].whole, f[1].area), reverse=True)[:MOST_OF_A_HUE] for c in candidates]
    first: list[Placed | None] = [c[0] if c else None for c in few]
    there = [i for i, c in enumerate(few) if c]
    if all(len(c) < 2 for c in few) or len(there) < 3:
        return _nearest(few, camera, target, previous) if previous is not None and len(there) else first
    for tried in (_likely, _anywhere):
        best, found = 0.0, [None] * len(few)
        for T, near, least in tried(few, there, camera, target, previous):
            score, chosen = _explained(near, T, camera, target)
            if score > best and sum(f is not None for f in chosen) >= least:
                best, found = score, chosen
        if best > 0:
            return list(found)
    return [None] * len(few)


Tried = Iterator[tuple[Array, list[list[Placed]], int]]
"""Poses to be tried, the blobs that each may explain, and how many of them it must."""


def _likely(few: list[list[Placed]], there: list[int], camera: Camera, target: Target, previous: Array | None) -> Tried:
    """Poses of four blobs, and of three near where they were."""
    seeds = sorted(there, key=lambda i: len(few[i]))[:SEEDS]
    if len(seeds) > 3:
        for some in product(*(few[i] for i in seeds)):
            for T in _poses(seeds, [b for _, b in some], camera, target, previous):
                yield T, few, 4
    if previous is None:
        return
    uv = camera.project(transform(previous, target.points))
    reach = max(NEAR_PX, NEAR_SHARE * float(np.ptp(uv, axis=0).max()))
    near = [[f for f in c if _off(f[1], uv[i]) <= reach] for i, c in enumerate(few)]
    for three in combinations([i for i in there if near[i]][:SEEDS], 3):
        for some in product(*(near[i] for i in three)):
            for T in _poses(list(three), [b for _, b in some], camera, target, previous):
                yield T, near, 3


def _anywhere(few: list[list[Placed]], there: list[int], camera: Camera, target: Target, previous: Array | None) -> Tried:
    """Poses of three blobs that continue the previous pose, or of a target of three."""
    if len(there) == 3 and (previous is not None or len(target.points) == 3):
        for some in product(*(few[i] for i in there)):
            for T in _poses(there, [b for _, b in some], camera, target, previous):
                yield T, few, 3


def _poses(which: list[int], blobs: list[Blob], camera: Camera, target: Target, previous: Array | None) -> list[Array]:
    rays, points = camera.ray(np.array([(b.u, b.v) for b in blobs])), target.points[which]
    if len(which) == 3 and previous is None:
        return three_ray_poses(rays, points)
    T = solve_pose_from_rays(rays, points, previous)
    return [] if T is None else [T]


def _explained(few: list[list[Placed]], T: Array, camera: Camera, target: Target) -> tuple[float, list[Placed | None]]:
    """How many blobs a pose explains, each counted by 1 less its distance over the one allowed, and which."""
    bias, area = centre_bias(camera, target, T)
    uv = camera.project(transform(T, target.points)) + bias
    allowed, chosen, score = allowed_px(uv), [], 0.0
    for i, some in enumerate(few):
        fitting = [(f, _off(f[1], uv[i])) for f in some if _like(f[1], area[i])]
        f, distance = min(fitting, key=lambda g: g[1], default=(None, np.inf))
        chosen.append(f if distance <= allowed else None)
        score += max(0.0, 1 - distance / allowed)
    return score, chosen


def _nearest(few: list[list[Placed]], camera: Camera, target: Target, previous: Array) -> list[Placed | None]:
    """Of each marker's candidates the one nearest to where it was last."""
    uv = camera.project(transform(previous, target.points))
    return [min(c, key=lambda f: _off(f[1], uv[i]), default=None) for i, c in enumerate(few)]


def _off(blob: Blob, uv: Array) -> float:
    return float(np.hypot(blob.u - uv[0], blob.v - uv[1]))


def _like(blob: Blob, area: float) -> bool:
    return not blob.whole or abs(np.log(blob.area / area)) <= LIKE_AREA
