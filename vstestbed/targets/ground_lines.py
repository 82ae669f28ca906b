"""Lines painted on the floor, measured at two look-ahead distances from the camera."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cached_property
from typing import Annotated, Literal

import numpy as np
from annotated_types import Len

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array, Pose, inverse, transform
from vstestbed.core.planar import pose_on_ground
from vstestbed.core.quantity import Length
from vstestbed.core.spec import spec
from vstestbed.targets.base import Target, in_plane
from vstestbed.targets.markers import Stripe
from vstestbed.targets.route import AnyRoute, Route, Straight


def foot_of(T: Array) -> Array:
    """(x, y, heading) of the ground frame under a camera at T (4, 4) over z = 0: its x is the
    horizontal part of (camera z - camera y).
    """
    # Camera z alone has no horizontal part in a camera that looks straight down, and -y none in one
    # that looks straight ahead: the sum points ahead for both (the top of the picture ahead), and
    # for every tilt between them.
    ahead = T[:2, 2] - T[:2, 1]
    return np.array([T[0, 3], T[1, 3], np.arctan2(ahead[1], ahead[0])])


def on_foot(T: Array, xy: Array) -> Array:
    """Floor points xy (..., 2) of the ground frame `foot_of(T)`, in the frame of the camera at T
    (4, 4), shape (..., 3) [m].
    """
    return transform(inverse(T) @ pose_on_ground(foot_of(T)), in_plane(xy))


@spec
class GroundLines(Target):
    """One or two lines painted on the floor along a route, parallel to it.

    Two points are measured of each line, where it crosses the look-ahead distances `look_m` from
    the camera's foot, in the order line 0 near, line 0 far, line 1 near, line 1 far.

    Args:
        pose: where the route's frame lies on the floor (flat, z = 0).
        marker: the stripe; each line has a hue of its own.
        route: the route that the lines follow.
        offsets_m: offset of each line to the left of the route [m].
        look_m: look-ahead distances (near, far) from the point on the floor under the camera [m];
            negative: behind it.
    """

    kind: Literal["lines"] = "lines"
    pose: Pose = Pose()
    marker: Stripe = Stripe()
    route: AnyRoute
    offsets_m: Annotated[tuple[Length, ...], Len(1, 2)] = (0.0,)
    look_m: Annotated[tuple[Length, ...], Len(2, 2)] = (0.1, 0.3)

    def __post_init__(self) -> None:
        if self.moves:
            raise ParameterError.fixed("motion", "still", why="lines are painted on the floor")
        if abs(self.pose.T[2, 2] - 1) > 1e-9 or abs(self.pose.T[2, 3]) > 1e-9:
            raise ParameterError.fixed(
                "pose", "flat on the floor", self.pose.xyz, why="z = 0, and a turn about z only"
            )
        if self.look_m[1] - self.look_m[0] < 0.02:
            raise ParameterError.form(
                "look_m", "[near, far], far 0.02 m or more beyond near", self.look_m
            )
        width = self.marker.width_m
        if len(self.offsets_m) == 2 and abs(self.offsets_m[0] - self.offsets_m[1]) < 2 * width:
            raise ParameterError.bound(
                "offsets_m", "at least", f"2 stripe widths, {2 * width:g} m, apart", self.offsets_m
            )
        # Beyond the centre of curvature a parallel line runs backwards and crosses itself.
        tightest = 1 / max(float(np.abs(self.route.samples[3]).max()), 1e-9)
        if max(map(abs, self.offsets_m)) + width >= tightest:
            raise ParameterError.bound(
                "offsets_m",
                "smaller than",
                f"the way's tightest radius, {tightest:.4g} m",
                self.offsets_m,
            )
        self._check_names()

    @property
    def places(self) -> Array:
        """None: the measured points depend on the place of the camera."""
        return np.empty((0, 3))

    @property
    def painted_route(self) -> Route:
        return self.route

    @property
    def floor_path(self) -> Array:
        """The route in the world, every centimetre, shape (K, 2) [m]."""
        return transform(self.pose.T, in_plane(self.route.samples[1]))[:, :2]

    @property
    def stripes(self) -> tuple[tuple[Array, Array], ...]:
        """Left and right edge of each line in the target frame, each (K, 2) [m]."""
        half = self.marker.width_m / 2
        _, xy, heading, _ = self.route.samples
        edges = []
        for offset in self.offsets_m:
            left = _beside(xy, heading, offset + half)
            right = _beside(xy, heading, offset - half)
            edges.append((left, right))
        return tuple(edges)

    # Cached: `seen_from` runs for every frame, and a route has hundreds of samples.
    @cached_property
    def _lines(self) -> tuple[Array, ...]:
        _, xy, heading, _ = self.route.samples
        return tuple(_beside(xy, heading, offset) for offset in self.offsets_m)

    @cached_property
    def points(self) -> Array:
        """The points measured by a camera over the start of the route, facing along it, in the
        target frame, shape (N, 3) [m].
        """
        ahead = self.route.at(np.array(self.look_m))
        lines = [_beside(ahead[:, :2], ahead[:, 2], offset) for offset in self.offsets_m]
        return in_plane(np.concatenate(lines))

    def seen_from(self, T_target_camera: Array) -> Array:
        """Where the lines cross the look-ahead distances of a camera at a pose (4, 4): (N, 3) in
        its frame [m], NaN where one does not.
        """
        foot = foot_of(T_target_camera)
        xy = np.concatenate([_crossings(line, foot, self.look_m) for line in self._lines])
        return on_foot(T_target_camera, xy)

    def straight_ahead(self, T_base_camera: Array, offset: float) -> Array:
        """The points (N, 3) [m] that a vehicle's camera at a mount (4, 4) measures in its frame,
        `offset` [m] left of a straight route.
        """
        # In the middle of a route that reaches beyond what the camera looks at, ahead or behind,
        # wherever it is mounted.
        farthest = float(np.abs(T_base_camera[:2, 3]).max())
        reach = 10.0 + abs(self.look_m[0]) + abs(self.look_m[1]) + farthest
        T = pose_on_ground(np.array([reach, offset, 0.0])) @ T_base_camera
        return replace(self, pose=Pose(), route=Straight(length_m=2 * reach)).seen_from(T)

    @cached_property
    def hues_deg(self) -> tuple[float, ...]:
        """The hue of each point's line [deg]."""
        n = len(self.offsets_m)
        return tuple(360 * i / n for i in range(n) for _ in self.look_m)


def _beside(xy: Array, heading: Array, offset: float) -> Array:
    """Points (K, 2) beside points xy (K, 2) of a route with headings (K,) [rad], at an offset to
    the left [m].
    """
    return xy + offset * np.stack([-np.sin(heading), np.cos(heading)], axis=-1)


def _crossings(line: Array, foot: Array, aheads: tuple[float, ...]) -> Array:
    """(ahead, left) where a line (K, 2) crosses distances ahead of a ground frame (x, y, heading)
    [m], (n, 2); NaN where it does not.
    """
    d = line - foot[:2]
    c = math.cos(foot[2])
    s = math.sin(foot[2])
    x = c * d[:, 0] + s * d[:, 1]
    y = c * d[:, 1] - s * d[:, 0]
    out = np.full((len(aheads), 2), np.nan)
    for point, ahead in zip(out, aheads, strict=True):
        # A crossing is where neighbouring samples lie on different sides; between them the line is
        # straight.
        before = x < ahead
        at = np.flatnonzero(before[:-1] != before[1:])
        if len(at):
            # Where a line bends back into view there are several crossings: the one nearest to
            # straight ahead counts.
            left = y[at] + (ahead - x[at]) * (y[at + 1] - y[at]) / (x[at + 1] - x[at])
            point[:] = ahead, left[np.argmin(np.abs(left))]
    return out
