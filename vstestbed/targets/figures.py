"""Figures of a flat target: its outline in the target's plane."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated, Literal, Protocol

import numpy as np
from annotated_types import Len

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array
from vstestbed.core.quantity import Length, PositiveLength
from vstestbed.core.spec import OneOf, spec
from vstestbed.targets.conic import unit_circle
from vstestbed.targets.polygons import centroid, crossing, signed_area

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

        @property
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
        at: its corners (x, y) in order, in the target's plane, x to the right and y down as seen [m];
            e.g. `[[0, 0], [0.3, 0], [0, 0.2]]`.
    """

    kind: Literal["polygon"] = "polygon"
    at: Annotated[tuple[Corner, ...], Len(3, 96)]

    def __post_init__(self) -> None:
        """Refuse a polygon that crosses or touches itself, or has no area."""
        given = np.array(self.at)
        if sides := crossing(given):
            words = f"must not cross or touch itself: the sides from corners {sides[0]} and {sides[1]} meet"
            raise ParameterError("at", words, [list(corner) for corner in self.at])

    @property
    def corners(self) -> Array:
        """The corners, clockwise as seen."""
        given = np.array(self.at, dtype=float)
        return given if signed_area(given) > 0 else np.roll(given[::-1], 1, axis=0)


@spec
class DiscFigure:
    """A disc about the target's origin.

    Args:
        radius: of its edge [m]; e.g. `0.1`.
    """

    kind: Literal["disc"] = "disc"
    radius: PositiveLength
    round = True

    @property
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

    @property
    def corners(self) -> Array:
        """Corners on a smooth curve through WHALE."""
        curve = _smooth(np.array(WHALE), 2)
        return (curve - centroid(curve)) * (self.length / float(np.ptp(curve[:, 0])))


@spec
class LShape(Cornered):
    """The letter L, its short limb two thirds of the long one, about its centroid.

    Args:
        length: of the long limb [m]; e.g. `0.4`.
    """

    kind: Literal["l_shape"] = "l_shape"
    length: PositiveLength

    @property
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


def _smooth(points: Array, parts: int) -> Array:
    """`parts` points for each of the points (E, 2) on a closed curve through them (Catmull & Rom 1974)."""
    before, after, beyond = (np.roll(points, k, axis=0) for k in (1, -1, -2))
    out = []
    for t in np.arange(parts) / parts:
        weights = 0.5 * np.array([-t + 2 * t**2 - t**3, 2 - 5 * t**2 + 3 * t**3, t + 4 * t**2 - 3 * t**3, -(t**2) + t**3])
        out.append(sum(w * p for w, p in zip(weights, (before, points, after, beyond), strict=True)))
    return np.stack(out, axis=1).reshape(-1, 2)
