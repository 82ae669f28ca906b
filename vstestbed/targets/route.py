"""Routes on the floor, for vehicles and for painted lines."""

from __future__ import annotations

from abc import ABC, abstractmethod
from functools import cached_property
from typing import Annotated, Literal

import numpy as np
from annotated_types import Len

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array
from vstestbed.core.planar import GroundPose
from vstestbed.core.quantity import Angle, Length, PositiveLength, TighterBounds
from vstestbed.core.registry import Registry
from vstestbed.core.spec import spec

# distance between the samples of a route [m]. Linear interpolation between them misses a bend of 1
# m radius by 12.5 um
SPACING_M = 0.01
LONGEST_M = 10_000.0  # longest track [m]: its table has a million samples
Samples = tuple[Array, Array, Array, Array]
"""A route as a table: arc length s (K,) [m], xy (K, 2) [m], heading (K,) [rad] without jumps,
curvature (K,) [1/m].
"""


@spec
class Route(ABC):
    """A smooth curve on the floor, parametrised by arc length s from its start.

    Args:
        start: its first point and the heading there.
    """

    start: GroundPose = GroundPose()
    closed = False  # whether its end coincides with its start

    @abstractmethod
    def _local(self) -> Samples:
        """The table of a route that starts at the origin along x."""

    @cached_property
    def samples(self) -> Samples:
        """The table in the world."""
        s, xy, heading, curvature = self._local()
        h = self.start.heading
        R = np.array([[np.cos(h), -np.sin(h)], [np.sin(h), np.cos(h)]])
        return s, xy @ R.T + [self.start.x, self.start.y], heading + h, curvature

    @property
    def length(self) -> float:
        """Arc length from start to end [m]."""
        return float(self.samples[0][-1])

    @property
    def least_radius_m(self) -> float:
        """Radius of its sharpest bend [m]; infinite for a straight route."""
        sharpest = float(np.abs(self.samples[3]).max())
        return 1 / sharpest if sharpest > 0 else np.inf

    def at(self, s: Array | float) -> Array:
        """(x, y, heading, curvature) at arc lengths s (...), shape (..., 4) [m, m, rad, 1/m].

        A closed route is periodic; an open one continues straight beyond both ends.
        """
        way, xy, turned, bent = self.samples
        # Not np.mod: the number of laps is needed for the heading, too.
        rounds = np.floor(s / self.length) if self.closed else np.zeros_like(s)
        along = s - rounds * self.length
        inside = np.clip(along, 0.0, self.length)
        x, y, heading, curvature = (np.interp(inside, way, c) for c in (*xy.T, turned, bent))
        beyond = along - inside
        # A route that turns by 360 degrees a lap has a heading that grows: without jumps, as
        # followers of it expect.
        heading = heading + rounds * (turned[-1] - turned[0])
        curvature = np.where(beyond == 0, curvature, 0.0)
        return np.stack(
            [x + beyond * np.cos(heading), y + beyond * np.sin(heading), heading, curvature],
            axis=-1,
        )

    def nearest(
        self, xy: Array, around: float | None = None, reach: float = 2.0
    ) -> tuple[float, float]:
        """(s, offset) of the route's point nearest to xy (2,): arc length [m], and the offset of xy
        to the left of it [m].

        Args:
            around: arc length near which to search, which selects the branch where a route crosses
                itself; None: everywhere.
            reach: largest distance from it along the route [m].
        """
        s = self.samples[0] if around is None else around + np.arange(-reach, reach, SPACING_M)
        places = self.at(s)
        i = int(np.argmin(np.hypot(places[:, 0] - xy[0], places[:, 1] - xy[1])))
        x, y, heading, _ = places[i]
        along = (xy[0] - x) * np.cos(heading) + (xy[1] - y) * np.sin(heading)
        # Refined once: the offset counts from the tangent at the foot point, up to half a sample's
        # distance from the sample.
        if not self.closed or around is not None or 0 < i < len(s) - 1:
            x, y, heading, _ = self.at(s[i] + along)
        left = -(xy[0] - x) * np.sin(heading) + (xy[1] - y) * np.cos(heading)
        return float(s[i] + along), float(left)

    def beside(self, place: Array) -> float:
        """Lateral offset of a vehicle at (x, y, heading) from the route [m], positive to the left
        of its driving direction (`branch`).
        """
        s, with_it = self.branch(place)
        offset = self.nearest(place[:2], around=s, reach=3 * SPACING_M)[1]
        return offset if with_it >= 0 else -offset

    def branch(self, place: Array) -> tuple[float, float]:
        """(s, cosine) of the sample nearest to a vehicle at (x, y, heading): arc length [m], cosine
        of the angle between their headings.

        Where the route crosses itself, the branch within 45 degrees of the vehicle's heading, in
        either sense, counts.
        """
        s, xy, heading, _ = self.samples
        distance = np.hypot(xy[:, 0] - place[0], xy[:, 1] - place[1])
        with_it = np.cos(heading - place[2])
        # Both senses (|cos|): a painted line has no direction. Far off, square to it, no branch
        # qualifies, and the nearest counts.
        near = np.where(np.abs(with_it) > np.sqrt(0.5), distance, np.inf)
        i = int(np.argmin(near if np.isfinite(near).any() else distance))
        return float(s[i]), float(with_it[i])


@spec
class Straight(Route):
    """An endless straight route.

    Args:
        length_m: the part of it that is painted, drawn and framed [m].
    """

    kind: Literal["straight"] = "straight"
    length_m: PositiveLength = 10.0

    def _local(self) -> Samples:
        return _joined([(self.length_m, 0.0)])


@spec
class CircularRoute(Route):
    """A circle that starts at `start`.

    Args:
        radius_m: its radius; positive: to the left, negative: to the right [m].
    """

    kind: Literal["circle"] = "circle"
    radius_m: Length = 3.0
    closed = True

    def __post_init__(self) -> None:
        if abs(self.radius_m) < 0.1:
            raise ParameterError.bound(
                "radius_m", "at least", "0.1 m in size (negative: to the right)", self.radius_m
            )

    def _local(self) -> Samples:
        return _joined([(2 * np.pi * abs(self.radius_m), 1 / self.radius_m)])


@spec
class FigureEight(Route):
    """A figure of eight, x = length/2 sin 2 pi p, y = width/2 sin 4 pi p for p in 0..1, from its
    crossing on.

    Its curvature is continuous, so that a vehicle can follow it at constant speed. At `start` it
    crosses itself, along the first branch.

    Args:
        length_m: its extent along the direction of `start` [m].
        width_m: its extent across that direction [m].
    """

    kind: Literal["figure_eight"] = "figure_eight"
    length_m: PositiveLength = 10.0
    width_m: PositiveLength = 5.0
    closed = True

    def _local(self) -> Samples:
        a = self.length_m / 2
        b = self.width_m / 2
        # Arc length has no closed form here: the speed along p is integrated by trapezoids, finely,
        # and the table resampled evenly in s.
        p = np.linspace(0.0, 2 * np.pi, 20001)
        x = a * np.sin(p)
        y = b * np.sin(2 * p)
        dx = a * np.cos(p)
        dy = 2 * b * np.cos(2 * p)
        ddx = -a * np.sin(p)
        ddy = -4 * b * np.sin(2 * p)
        speed = np.hypot(dx, dy)
        s = np.concatenate([[0.0], np.cumsum((speed[1:] + speed[:-1]) / 2 * np.diff(p))])
        heading = np.unwrap(np.arctan2(dy, dx))
        curvature = (dx * ddy - dy * ddx) / speed**3
        even = np.linspace(0.0, s[-1], max(2, round(s[-1] / SPACING_M)) + 1)
        x, y, heading, curvature = (np.interp(even, s, c) for c in (x, y, heading, curvature))
        turn = heading[0]  # the first branch runs along x
        cos = np.cos(turn)
        sin = np.sin(turn)
        xy = np.stack([cos * x + sin * y, -sin * x + cos * y], axis=1)
        return even, xy, heading - turn, curvature


@spec
class Piece:
    """A piece of a track: straight (`length_m`), or a bend (`turn_deg` and `radius_m`).

    Args:
        length_m: length of a straight piece [m].
        turn_deg: angle of a bend, positive to the left [deg].
        radius_m: radius of a bend [m].
    """

    length_m: PositiveLength | None = None
    turn_deg: Annotated[Angle, TighterBounds(ge=-720, le=720)] | None = None
    radius_m: PositiveLength | None = None

    def __post_init__(self) -> None:
        given = [name for name, value in vars(self).items() if value is not None]
        if given not in (["length_m"], ["turn_deg", "radius_m"]):
            words = "a piece has either length_m (straight), or turn_deg and radius_m (a bend)"
            raise ParameterError("length_m", words)

    @property
    def length_and_curvature(self) -> tuple[float, float]:
        """Length [m] and curvature [1/m], positive to the left."""
        if self.length_m is not None:
            return self.length_m, 0.0
        turn = np.radians(self.turn_deg or 0.0)
        radius = self.radius_m or 1.0
        return abs(turn) * radius, float(np.sign(turn)) / radius


@spec
class Track(Route):
    """Straight pieces and bends, one after another; `closed` where the last leads back to the
    start.

    Args:
        pieces: the pieces in their order along the route.
    """

    kind: Literal["track"] = "track"
    pieces: Annotated[tuple[Piece, ...], Len(1, 100)]

    def __post_init__(self) -> None:
        length = sum(piece.length_and_curvature[0] for piece in self.pieces)
        if length > LONGEST_M:
            raise ParameterError.bound(
                "pieces", "at most", f"{LONGEST_M:g} m long together", round(length, 2)
            )

    @cached_property
    def closed(self) -> bool:
        """Whether place and heading at its end are those at its start, within 1 mm and 1/1000 of a
        turn.
        """
        s, xy, heading, _ = self._local()
        turn = heading[-1] / (2 * np.pi)
        return bool(np.hypot(*xy[-1]) < 1e-3 and abs(turn - round(turn)) < 1e-3 and len(s) > 2)

    def _local(self) -> Samples:
        return _joined([piece.length_and_curvature for piece in self.pieces])


def _joined(pieces: list[tuple[float, float]]) -> Samples:
    """The table of arcs (length, curvature) one after another, from the origin along x; exact at
    each sample.
    """
    s = [np.zeros(1)]
    xy = [np.zeros((1, 2))]
    heading = [np.zeros(1)]
    curvature = [np.full(1, pieces[0][1])]
    for length, k in pieces:
        u = np.linspace(0.0, length, max(1, round(length / SPACING_M)) + 1)[1:]
        # Chord u sinc(k u / 2) at half the turned angle: exact for an arc, and for a straight
        # piece, k = 0, without a division by it.
        half = k * u / 2
        chord = u * np.sinc(half / np.pi)
        h0 = heading[-1][-1]
        xy.append(
            xy[-1][-1] + np.stack([chord * np.cos(h0 + half), chord * np.sin(h0 + half)], axis=1)
        )
        heading.append(h0 + k * u)
        s.append(s[-1][-1] + u)
        curvature.append(np.full(len(u), k))
    return np.concatenate(s), np.concatenate(xy), np.concatenate(heading), np.concatenate(curvature)


ROUTES = Registry("route", Straight, CircularRoute, FigureEight, Track)
AnyRoute = Annotated[Route, ROUTES]
