"""Fit of a polygon in a plane to the points of a region's border in a picture: the homography between them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vstestbed.core.geometry import Array

TURNS = 36
"""Rotations that are tried where none is known: every 10 degrees."""
TRIED = 3
"""Of these the best are refined."""
COARSE = 40
"""Points of the border by which they are compared."""
ROUNDS = 12
"""Most Gauss-Newton steps: from the affine guess three to six are enough."""
SETTLED = 1e-5
"""A step that moves no point by more than this share of the region's size ends the fit."""
OUTLIER = 4.0
"""Points farther than so many times the usual distance from the polygon (but at least FAINT) have no weight."""
FAINT = 2e-3
"""Share of the region's size under which no distance is unusual."""
FLAT = 1e3
"""Condition of a homography between both round figures over which it has folded the picture onto a line; of a region it is under ten."""
PREFERRED = 1.02
"""Of fits that differ by less than this factor, as of a square's four, the one that is turned least is taken."""


@dataclass(frozen=True, slots=True)
class PolygonFit:
    """The images of a polygon's plane that fit points of a border best.

    Attributes:
        H: homography (3, 3) from the polygon's plane to the picture. turn: the rotation in it, after both were made round [rad].
        off: distance of each point from the polygon, shape (K,), in standard deviations of the region (its half size, roughly).
    """

    H: Array
    turn: float
    off: Array


def fit_polygon(
    edge: Array, middle: Array, spread: Array, corners: Array, plane: tuple[Array, Array], turns: tuple[float, ...], expected: float
) -> PolygonFit | None:
    """The fit of a polygon with `corners` (E, 2) to points `edge` (K, 2) on the border of a region; None where none is found.

    Region and polygon are made round by their second moments, after which an affine image of the polygon differs by a rotation alone.
    From there Gauss-Newton steps change the homography G from picture to plane so that sum n_k . (G e_k - q_k)^2 is least, with q_k the
    point of the polygon next to G e_k and n_k the normal of its side.

    Args:
        edge: points on the border. middle, spread: centroid (2,) and covariance (2, 2) of the region's area, in the same coordinates.
        corners: of the polygon. plane: centroid and covariance of its area.
        turns: rotations to begin with [rad]; empty: all round. expected: the rotation that is taken where several fit alike.
    """
    whiten, colour = roundness(spread), _root(plane[1])
    e, q = (edge - middle) @ whiten, (corners - plane[0]) @ inverted(colour)
    best: PolygonFit | None = None
    for turn in turns or _likely(e, q, expected):
        found = _refined(e, q, turn)
        if found is None:
            continue
        G, off, left = found
        size = float(np.sqrt(np.mean(np.minimum(off, 0.5) ** 2)))
        if best is not None and not _better(size, turn, best, expected):
            continue
        to_plane = _affine(colour, plane[0]) @ G @ inverted(_affine(inverted(whiten), middle))
        best = PolygonFit(inverted(to_plane), left, off)
    return best


def _better(size: float, turn: float, best: PolygonFit, expected: float) -> bool:
    before = float(np.sqrt(np.mean(np.minimum(best.off, 0.5) ** 2)))
    if max(size, before) > PREFERRED * min(size, before) + FAINT:
        return size < before
    return _apart(turn, expected) < _apart(best.turn, expected)


def _apart(a: float, b: float) -> float:
    return abs(math.remainder(a - b, 2 * math.pi))


def _likely(e: Array, q: Array, expected: float) -> list[float]:
    """The rotations for which round points e (K, 2) are nearest to a round polygon q (E, 2), the best first."""
    few = e[:: max(1, len(e) // COARSE)]
    turns = expected + np.arange(TURNS) * (2 * math.pi / TURNS)
    c, s = np.cos(turns), np.sin(turns)
    turned = few @ np.stack([np.stack([c, s], -1), np.stack([-s, c], -1)], -1)  # rotated back by each, (TURNS, K, 2)
    distance = _foot(turned.reshape(-1, 2), q)[2].reshape(TURNS, -1)
    cost = np.minimum(distance, 0.5).mean(axis=1)
    lowest = np.flatnonzero((cost <= np.roll(cost, 1)) & (cost <= np.roll(cost, -1)))
    # A figure with n-fold symmetry has n such minima, and all are to be compared.
    kept = lowest[cost[lowest] <= 1.5 * cost.min() + FAINT]
    return [float(turns[k]) for k in sorted(kept, key=lambda k: cost[k])[: max(TRIED, len(kept))]]


def _refined(e: Array, q: Array, turn: float) -> tuple[Array, Array, float] | None:
    """G (3, 3) from round points e (K, 2) to a round polygon q (E, 2), the points' distances (K,), and the rotation in it."""
    c, s = math.cos(turn), math.sin(turn)
    G = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])  # back by the rotation
    m = np.column_stack([e, np.ones(len(e))])
    off = np.zeros(len(e))
    for _ in range(ROUNDS):
        x = m @ G.T
        if not (x[:, 2] > 0.1).all():
            return None
        p = x[:, :2] / x[:, 2:]
        normal, height, off, within = _foot(p, q)
        usual = 1.4826 * float(np.median(off))
        used = within & (off <= max(OUTLIER * usual, FAINT))
        if np.count_nonzero(used) < 16:
            return None
        rows = m[used] / x[used, 2:]
        n, along = normal[used], (normal[used] * p[used]).sum(axis=1)
        J = np.concatenate([n[:, :1] * rows, n[:, 1:] * rows, -along[:, None] * rows[:, :2]], axis=1)
        step = np.linalg.lstsq(J, -height[used], rcond=None)[0]
        G = G + np.append(step, 0.0).reshape(3, 3)
        if np.abs(step).max() < SETTLED:
            break
    if not np.linalg.cond(G) < FLAT:
        return None
    return G, off, math.atan2(G[0, 1] - G[1, 0], G[0, 0] + G[1, 1])


def _foot(p: Array, q: Array) -> tuple[Array, Array, Array, NDArray[np.bool_]]:
    """The side of a polygon q (E, 2) that is next to each point p (K, 2): its normal (K, 2), the point's height over its line (K,),
    its distance (K,), and whether its foot lies within the side.
    """
    way = np.roll(q, -1, axis=0) - q
    length = np.hypot(way[:, 0], way[:, 1])
    along = way / length[:, None]
    t = p @ along.T - (q * along).sum(axis=1)
    h = p[:, :1] * along[:, 1] - p[:, 1:] * along[:, 0]
    h -= q[:, 0] * along[:, 1] - q[:, 1] * along[:, 0]
    beyond = np.maximum(np.maximum(-t, t - length), 0.0)
    distance = h * h + beyond * beyond
    side = distance.argmin(axis=1)
    k = np.arange(len(p))
    normal = np.column_stack([along[:, 1], -along[:, 0]])[side]
    return normal, h[k, side], np.sqrt(distance[k, side]), beyond[k, side] == 0


def inverted(A: Array) -> Array:
    """The inverse (n, n) of a matrix."""
    return np.linalg.inv(A).astype(float)


def roundness(S: Array) -> Array:
    """The matrix (2, 2) that makes a region with covariance S (2, 2) round, of unit variance: S^-1/2."""
    return _root(inverted(S))


def _root(S: Array) -> Array:
    """The symmetric root of a positive definite matrix (2, 2)."""
    root = math.sqrt(max(float(S[0, 0] * S[1, 1] - S[0, 1] * S[1, 0]), 0.0))
    return (S + root * np.eye(2)) / math.sqrt(float(np.trace(S)) + 2 * root)


def _affine(A: Array, shift: Array) -> Array:
    """The homography x -> A x + shift."""
    out = np.eye(3)
    out[:2, :2], out[:2, 2] = A, shift
    return out
