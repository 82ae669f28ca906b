"""Polygons in a plane: moments of their area, whether they cross themselves, triangles."""

from __future__ import annotations

import math

import numpy as np

from vstestbed.core.geometry import Array


def signed_area(xy: Array) -> float:
    """Area of a polygon (E, 2), positive where it runs clockwise in a picture (x right, y down)."""
    there = np.roll(xy, -1, axis=0)
    return 0.5 * float((xy[:, 0] * there[:, 1] - there[:, 0] * xy[:, 1]).sum())


def centroid(xy: Array) -> Array:
    """Centroid (2,) of a polygon's area, corners (E, 2)."""
    there = np.roll(xy, -1, axis=0)
    cross = xy[:, 0] * there[:, 1] - there[:, 0] * xy[:, 1]
    return ((xy + there) * cross[:, None]).sum(axis=0) / (3 * cross.sum())


def covariance(xy: Array) -> Array:
    """Second central moments (2, 2) of a polygon's area over that area, corners (E, 2).

    Reference: Steger 1996, On the calculation of arbitrary moments of polygons, FGBV-96-05.
    """
    p = xy - centroid(xy)
    q = np.roll(p, -1, axis=0)
    cross = p[:, 0] * q[:, 1] - q[:, 0] * p[:, 1]
    total = np.einsum("n,ni,nj->ij", cross, p, p) + np.einsum("n,ni,nj->ij", cross, q, q)
    mixed = np.einsum("n,ni,nj->ij", cross, p, q)
    return (2 * total + mixed + mixed.T) / (12 * cross.sum())


def evenly_along(xy: Array, count: int) -> Array:
    """Points (count, 2) along the sides of a polygon (E, 2), evenly by length, from its first corner on."""
    closed = np.concatenate([xy, xy[:1]])
    reached = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(closed, axis=0), axis=1))])
    at = np.arange(count) / count * reached[-1]
    return np.column_stack([np.interp(at, reached, closed[:, k]) for k in (0, 1)])


def crossing(xy: Array) -> tuple[int, int] | None:
    """Numbers of two sides of a polygon (E, 2) that meet elsewhere than neighbours do; None where there are none.

    The side of a corner runs to the next one. Neighbours that fold back onto each other meet, too.
    """
    n = len(xy)
    pairs = ((i, j) for i in range(n) for j in range(i + 1, n))
    return next(((i, j) for i, j in pairs if _meet(xy, i, j)), None)


def _meet(xy: Array, i: int, j: int) -> bool:
    """Whether the sides i < j of a polygon meet elsewhere than at a common corner."""
    n = len(xy)
    a, b, c, d = xy[i], xy[(i + 1) % n], xy[j], xy[(j + 1) % n]
    if j == i + 1 or (i == 0 and j == n - 1):
        far, corner, near = (a, b, d) if j == i + 1 else (c, a, b)
        return _side(far, corner, near) == 0 and float((far - corner) @ (near - corner)) >= 0
    return _side(a, b, c) * _side(a, b, d) <= 0 and _side(c, d, a) * _side(c, d, b) <= 0 and _boxes_meet(a, b, c, d)


def _side(a: Array, b: Array, c: Array) -> float:
    """Which side of the line from a to b the point c lies on: -1, 0, 1."""
    u, v = b - a, c - a
    cross = float(u[0] * v[1] - u[1] * v[0])
    return 0.0 if abs(cross) <= 1e-12 * float(np.hypot(*u) * np.hypot(*v)) else math.copysign(1.0, cross)


def _boxes_meet(a: Array, b: Array, c: Array, d: Array) -> bool:
    """Whether the boxes round the segments a b and c d meet: of segments on one line, whether they overlap."""
    return bool((np.maximum(np.minimum(a, b), np.minimum(c, d)) <= np.minimum(np.maximum(a, b), np.maximum(c, d))).all())


def triangulated(xy: Array) -> list[tuple[int, int, int]]:
    """Triangles of a polygon (E, 2) that does not cross itself, as numbers of its corners, by cutting off ears.

    Reference: Meisters 1975, Polygons have ears, doi:10.1080/00029890.1975.11993898.
    """
    left, out = list(range(len(xy))), []
    while len(left) > 3:
        k = next((k for k in range(len(left)) if _is_ear(xy, left, k)), 0)
        out.append((left[k - 1], left[k], left[(k + 1) % len(left)]))
        del left[k]
    return [*out, (left[0], left[1], left[2])]


def _is_ear(xy: Array, left: list[int], k: int) -> bool:
    """Whether corner k of those that are left is convex and no other lies in the triangle with its neighbours."""
    i, j, m = left[k - 1], left[k], left[(k + 1) % len(left)]
    a, b, c = xy[i], xy[j], xy[m]
    if _side(a, b, c) <= 0:
        return False
    others = xy[[n for n in left if n not in (i, j, m)]]
    sides = [(q[0] - p[0]) * (others[:, 1] - p[1]) - (q[1] - p[1]) * (others[:, 0] - p[0]) for p, q in ((a, b), (b, c), (c, a))]
    return not bool(np.logical_and.reduce([side >= 0 for side in sides]).any())
