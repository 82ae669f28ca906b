"""Figures of a flat target: its outline in the target's plane."""

from __future__ import annotations

import math
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Literal, Protocol

import numpy as np
from annotated_types import Len

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array
from vstestbed.core.quantity import Length, PositiveLength
from vstestbed.core.spec import OneOf, spec
from vstestbed.targets.conic import unit_circle

DISC_CORNERS = 256
"""Corners with which a disc is drawn; a polygon of its area, whose border is within 5e-5 of its radius."""
Corner = Annotated[tuple[Length, ...], Len(2, 2)]


class Figure(Protocol):
    """The outline of a region in the plane z = 0 of a target, seen with x to the right and y down."""

    @property
    def kind(self) -> str:
        """The figure's word in a scenario."""
        ...

    @property
    def round(self) -> bool:
        """Whether it is a circle, whose picture does not tell how it is turned."""
        ...

    @property
    def corners(self) -> Array:
        """Corners of the polygon that is drawn, (E, 2) [m], clockwise as seen."""
        ...

    def outline(self, count: int) -> Array:
        """At least `count` points on the outline in order, all corners of a polygon among them, shape (M, 2) [m]."""
        ...


class Cornered:
    """A figure that is a polygon."""

    round = False

    if TYPE_CHECKING:  # each figure has its own

        @cached_property
        def corners(self) -> Array:
            """Corners of the polygon, (E, 2) [m], clockwise as seen."""
            ...

    def outline(self, count: int) -> Array:
        """The corners, and points on the sides between them, where those are longest."""
        corners = self.corners
        side = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1)
        parts = np.ones(len(corners), dtype=int)
        while parts.sum() < count:
            parts[np.argmax(side / parts)] += 1
        ends = zip(corners, np.roll(corners, -1, axis=0), parts, strict=True)
        return np.concatenate([a + np.arange(n)[:, None] / n * (b - a) for a, b, n in ends])


@spec
class PolygonFigure(Cornered):
    """A polygon.

    The picture of one with rotational symmetry, such as a square, fits its outline in several ways: the detector begins with that of the
    smallest rotation to the picture, and goes on with it.

    Args:
        at: its corners (x, y) in order, in the target's plane, x to the right and y down as seen [m].
    """

    kind: Literal["polygon"] = "polygon"
    at: Annotated[tuple[Corner, ...], Len(3, 96)]

    def __post_init__(self) -> None:
        """Refuse a polygon that crosses or touches itself, or has no area."""
        given = np.array(self.at)
        if crossing := _crossing(given):
            words = f"must not cross or touch itself: the sides from corners {crossing[0]} and {crossing[1]} meet"
            raise ParameterError("figure.at", words, [list(corner) for corner in self.at])

    @cached_property
    def corners(self) -> Array:
        """The corners, clockwise as seen."""
        given = np.array(self.at, dtype=float)
        return given if signed_area(given) > 0 else np.roll(given[::-1], 1, axis=0)


@spec
class DiscFigure:
    """A disc about the target's origin.

    Args:
        radius: [m].
    """

    kind: Literal["disc"] = "disc"
    radius: PositiveLength
    round = True

    @cached_property
    def corners(self) -> Array:
        """A regular polygon with the disc's area."""
        swell = math.sqrt(2 * math.pi / (DISC_CORNERS * math.sin(2 * math.pi / DISC_CORNERS)))
        return self.radius * swell * unit_circle(DISC_CORNERS)

    def outline(self, count: int) -> Array:
        """Points on the circle."""
        return self.radius * unit_circle(count)


@spec
class Whale(Cornered):
    """The outline of a whale, without symmetry: a polygon of 40 corners about its centroid.

    Args:
        length: from head to tail [m].
    """

    kind: Literal["whale"] = "whale"
    length: PositiveLength

    @cached_property
    def corners(self) -> Array:
        """Corners on a smooth curve through WHALE."""
        curve = _smooth(np.array(WHALE), 2)
        return (curve - centroid(curve)) * (self.length / float(np.ptp(curve[:, 0])))


@spec
class LShape(Cornered):
    """The letter L, its short limb two thirds of the long one, about its centroid.

    Args:
        length: of the long limb [m].
    """

    kind: Literal["l_shape"] = "l_shape"
    length: PositiveLength

    @cached_property
    def corners(self) -> Array:
        """The six corners, from the upper left on."""
        at = np.array([[0, 0], [0.3, 0], [0.3, 0.7], [0.67, 0.7], [0.67, 1], [0, 1]])
        return (at - centroid(at)) * self.length


WHALE = (
    (0.50, 0.02),
    (0.46, 0.09),
    (0.31, 0.13),
    (0.15, 0.14),
    (0.12, 0.23),
    (0.05, 0.24),
    (0.02, 0.13),
    (-0.18, 0.07),
    (-0.34, 0.03),
    (-0.43, 0.10),
    (-0.50, 0.09),
    (-0.46, 0.00),
    (-0.50, -0.12),
    (-0.45, -0.16),
    (-0.36, -0.05),
    (-0.25, -0.07),
    (-0.08, -0.15),
    (0.13, -0.20),
    (0.33, -0.18),
    (0.46, -0.09),
)  # fmt: skip - a table of points
"""Points on the outline of a whale of length 1 that swims to the right, clockwise as seen (y down)."""

FIGURES = OneOf("figure", Whale, LShape, PolygonFigure, DiscFigure)


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


def _smooth(points: Array, parts: int) -> Array:
    """`parts` points for each of the points (E, 2) on a closed curve through them (Catmull & Rom 1974)."""
    before, after, beyond = (np.roll(points, k, axis=0) for k in (1, -1, -2))
    out = []
    for t in np.arange(parts) / parts:
        weights = 0.5 * np.array([-t + 2 * t**2 - t**3, 2 - 5 * t**2 + 3 * t**3, t + 4 * t**2 - 3 * t**3, -(t**2) + t**3])
        out.append(sum(w * p for w, p in zip(weights, (before, points, after, beyond), strict=True)))
    return np.stack(out, axis=1).reshape(-1, 2)


def _crossing(xy: Array) -> tuple[int, int] | None:
    """Numbers of two sides of a polygon (E, 2) that meet elsewhere than neighbours do; None where there are none.

    The side of a corner runs to the next one. Neighbours that fold back onto each other meet, too.
    """
    n = len(xy)
    for i in range(n):
        for j in range(i + 1, n):
            a, b, c, d = xy[i], xy[(i + 1) % n], xy[j], xy[(j + 1) % n]
            if j == i + 1 or (i == 0 and j == n - 1):
                far, corner, near = (a, b, d) if j == i + 1 else (c, a, b)
                if _side(far, corner, near) == 0 and float((far - corner) @ (near - corner)) >= 0:
                    return i, j
            elif _side(a, b, c) * _side(a, b, d) <= 0 and _side(c, d, a) * _side(c, d, b) <= 0 and _boxes_meet(a, b, c, d):
                return i, j
    return None


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
