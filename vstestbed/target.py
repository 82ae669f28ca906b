"""Targets: where markers are in the target's frame, what they look like, how the target moves.

Target frame: for planar targets the markers lie in z = 0, and z points away from a camera that looks at them
squarely, so that the goal view "1 m in front" is T_camera_target = (0, 0, 1) without rotation.
"""

from __future__ import annotations

import colorsys
from functools import cached_property
from typing import Annotated, Literal

import numpy as np
from annotated_types import Gt, Len

from vstestbed.errors import ParameterError
from vstestbed.geometry import Array, Pose, Triple
from vstestbed.spec import OneOf, spec

Radius = Annotated[float, Gt(0)]


@spec
class Disc:
    """A flat disc in the target's plane; radius [m]. Lit: shaded by the scene's lights, else of constant colour."""

    kind: Literal["disc"] = "disc"
    radius: Radius = 0.02
    lit: bool = True


@spec
class Sphere:
    """A ball round the marker point; radius [m]."""

    kind: Literal["sphere"] = "sphere"
    radius: Radius = 0.02
    lit: bool = True


MARKERS = OneOf("marker", Disc, Sphere, default="disc")
Marker = Annotated[Disc | Sphere, MARKERS]


@spec
class Still:
    """The target does not move."""

    kind: Literal["still"] = "still"


MOTIONS = OneOf("motion", Still, default="still")
Motion = Annotated[Still, MOTIONS]


@spec
class Target:
    """What all targets share: pose in the world, marker, motion. Subclasses give the `points`."""

    pose: Pose
    marker: Marker = Disc()
    motion: Motion = Still()

    @cached_property
    def points(self) -> Array:
        """Marker centres in the target frame, shape (N, 3) [m]."""
        raise NotImplementedError

    @cached_property
    def hues_deg(self) -> tuple[float, ...]:
        """One hue for each marker, spread evenly from red on [deg]: what tells the markers apart."""
        n = len(self.points)
        return tuple(360 * i / n for i in range(n))

    @cached_property
    def colors(self) -> Array:
        """The saturated colours of these hues, shape (N, 3) in 0..1."""
        return np.array([colorsys.hsv_to_rgb(hue / 360, 1.0, 1.0) for hue in self.hues_deg])

    def _check_spacing(self) -> None:
        p = self.points
        gaps = np.linalg.norm(p[:, None] - p[None], axis=-1) + np.eye(len(p)) * 1e9
        if gaps.min() <= 2 * self.marker.radius:
            words = f"must be under half of the smallest gap between markers, {gaps.min():.4g} m"
            raise ParameterError("marker.radius", words, self.marker.radius)


@spec
class Square(Target):
    """Four markers at the corners of a square in z = 0: (-,-), (+,-), (+,+), (-,+) times side/2."""

    kind: Literal["square"] = "square"
    side: Annotated[float, Gt(0)]

    def __post_init__(self) -> None:
        """Refuse markers that overlap."""
        self._check_spacing()

    @cached_property
    def points(self) -> Array:
        """Corners in the target frame, shape (4, 3)."""
        h = self.side / 2
        return np.array([[-h, -h, 0], [h, -h, 0], [h, h, 0], [-h, h, 0]])


@spec
class Points(Target):
    """Markers anywhere: `at`, a list of [x, y, z] in the target frame [m]."""

    kind: Literal["points"] = "points"
    at: Annotated[tuple[Triple, ...], Len(1, 24)]

    def __post_init__(self) -> None:
        """Refuse markers that overlap."""
        self._check_spacing()

    @cached_property
    def points(self) -> Array:
        """Marker centres in the target frame, shape (N, 3)."""
        return np.array(self.at, dtype=float)


TARGETS = OneOf("target", Square, Points)
