"""Targets that are one region of colour: a flat shape on a board, and a ball. Their points are on the outline, in order."""

from __future__ import annotations

import colorsys
import math
from functools import cached_property
from typing import Annotated, ClassVar, Literal

import numpy as np
from annotated_types import Ge, Le

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array, lengths
from vstestbed.core.quantity import Angle, PositiveLength
from vstestbed.core.spec import spec
from vstestbed.targets.base import RoundOutline, Target
from vstestbed.targets.conic import circle_conic, distance_to_conic, ellipse_points, fitted_conic, unit_circle
from vstestbed.targets.figures import FIGURES, Figure
from vstestbed.targets.outline_edge import Outline
from vstestbed.targets.polygons import signed_area, triangulated
from vstestbed.targets.surfaces import Body, Globe

BOARD_MARGIN = 0.25
"""The board behind a shape reaches this share of the shape's longer side beyond it."""
LEAST_AHEAD = 0.05
"""Least Z of a unit ray to the border of a flat region: 87 degrees off the axis."""
LEAST_SEEN = 3
"""Fewest points of an outline from which a ball's place is found."""


@spec
class OneRegion(Target):
    """What targets of one region share: the colour, and how many points of the outline are measured.

    Args:
        marker: how the region is lit.
        hue_deg: its hue; no other thing in the scene may have it [deg].
        count: points on the outline; more where a shape has more corners.
    """

    marker: Outline = Outline()
    hue_deg: Angle = 0.0
    count: Annotated[int, Ge(12), Le(96)] = 32
    outlined: ClassVar[bool] = True

    def _check_region(self) -> None:
        """Refuse names of points that are not distinct things, and a pad."""
        if self.names:
            raise ParameterError("names", "are for markers; the points of an outline have none", list(self.names))
        if self.pad:
            raise ParameterError("pad", f"has no place behind a {self.kind}; works: target square or points")  # type: ignore[attr-defined] # each subclass has it

    @cached_property
    def hues_deg(self) -> tuple[float, ...]:
        """The region's hue, for each point."""
        return (self.hue_deg % 360,) * len(self.points)

    @property
    def _rgb(self) -> tuple[float, float, float]:
        return colorsys.hsv_to_rgb(self.hue_deg % 360 / 360, 1.0, 1.0)


@spec
class Shape(OneRegion):
    """A flat region of one colour on a board, in z = 0, upright for a camera that faces it: x to its right, y down.

    Its points are on its outline, clockwise as seen; of a polygon all corners are among them, so that the polygon of the points is the
    region. The outline of a disc does not tell how it is turned: its points are those of `ellipse_points` in the picture, and where
    they are on the disc depends on the camera.

    Args:
        figure: the outline: `whale`, `l_shape`, `polygon` or `disc`.
    """

    kind: Literal["shape"] = "shape"
    figure: Annotated[Figure, FIGURES]
    one_sided: ClassVar[bool] = True

    def __post_init__(self) -> None:
        """Refuse names and a pad."""
        self._check_region()

    @cached_property
    def points(self) -> Array:
        """Points on the outline in the target frame, shape (M, 3) [m]; of a disc those that a camera before it sees."""
        xy = self.figure.outline(self.count)
        return np.column_stack([xy, np.zeros(len(xy))])

    @cached_property
    def _drawn(self) -> Array:
        """Corners of the figure as it is drawn, (E, 2) [m], clockwise as seen."""
        return self.figure.corners

    @property
    def figure_corners(self) -> Array | None:
        """The figure's corners; None of a disc."""
        return None if self.figure.round else self._drawn

    def round_outline(self, ray: Array) -> RoundOutline | None:
        """Of a disc the ellipse that fits the rays in the picture's plane."""
        if not self.figure.round or not (ray[:, 2] > LEAST_AHEAD).all():
            return None
        xy = ray[:, :2] / ray[:, 2:]
        conic = fitted_conic(xy)
        found = ellipse_points(conic, len(self.points))
        if not np.isfinite(found).all():
            return None
        off = np.abs(distance_to_conic(conic, xy)) / math.sqrt(abs(signed_area(found)) / math.pi)
        return RoundOutline(np.column_stack([found, np.ones(len(found))]), off)

    @property
    def places(self) -> Array:
        """The points; none of a disc, whose measured points depend on the camera's place."""
        return np.empty((0, 3)) if self.figure.round else self.points

    def points_at(self, T_camera_target: Array) -> Array:
        """Points on the outline (..., M, 3) in the camera's frame [m]; of a disc NaN where it reaches behind the image plane."""
        if not self.figure.round:
            return super().points_at(T_camera_target)
        T, radius = T_camera_target, float(self.points[0, 0])
        xy = ellipse_points(circle_conic(T, radius), len(self.points))
        ray = np.concatenate([xy, np.ones_like(xy[..., :1])], axis=-1)
        normal, centre = T[..., :3, 2], T[..., :3, 3]
        reach = (normal * centre).sum(axis=-1)[..., None] / (ray @ normal[..., None])[..., 0]
        ahead = centre[..., 2] > radius * np.hypot(T[..., 2, 0], T[..., 2, 1])
        return np.where(ahead[..., None, None], ray * reach[..., None], np.nan)

    @property
    def body(self) -> Body:
        """The region, a sheet without thickness."""
        return Body(self._triangles, self._rgb, self.marker.lit)

    @cached_property
    def _triangles(self) -> Array:
        corners = self._drawn
        if len(corners) == 3:  # MuJoCo takes no mesh of three vertices
            corners = self.figure.outline(4)
        at = np.column_stack([corners, np.zeros(len(corners))])
        # Corners run clockwise as seen from the front, where z points away: from outside triangles are counter-clockwise.
        return at[[(a, c, b) for a, b, c in triangulated(corners)]]

    @property
    def board_half_m(self) -> tuple[float, float]:
        """It reaches BOARD_MARGIN of the longer side beyond the outline, on all sides of the origin."""
        corners = self._drawn
        x, y = (np.abs(corners).max(axis=0) + BOARD_MARGIN * float(np.ptp(corners, axis=0).max())).tolist()
        return x, y


@spec
class Ball(OneRegion):
    """A ball about the target's origin. Its points are on the circle where the camera's rays touch it, which depends on the camera.

    With the centre c in the camera's frame and a = c/|c|, the circle has the centre c (1 - r^2/|c|^2) and the radius
    r sqrt(1 - r^2/|c|^2) across a. It begins in the direction of the camera's x axis and runs clockwise in the picture, so that
    the order does not depend on how the ball is turned, which nobody sees.

    Args:
        radius: of the ball [m].
    """

    kind: Literal["ball"] = "ball"
    radius: PositiveLength

    def __post_init__(self) -> None:
        """Refuse names and a pad."""
        self._check_region()

    @cached_property
    def points(self) -> Array:
        """The circle that a camera far before it sees, in the target frame, shape (count, 3) [m]."""
        return np.column_stack([self.radius * unit_circle(self.count), np.zeros(self.count)])

    @property
    def places(self) -> Array:
        """None: the measured points depend on the place of the camera."""
        return np.empty((0, 3))

    @property
    def body(self) -> Globe:
        """The ball."""
        return Globe(self.radius, self._rgb, self.marker.lit)

    def points_at(self, T_camera_target: Array) -> Array:
        """The outline (..., count, 3) in the camera's frame [m]; NaN from inside the ball."""
        return self.outline_of(T_camera_target[..., :3, 3])

    def outline_of(self, centre: Array) -> Array:
        """The outline (..., count, 3) of a ball with its centre (..., 3) in the camera's frame [m]; NaN from inside."""
        far = lengths(centre)
        with np.errstate(invalid="ignore", divide="ignore"):
            axis = centre / far
            shrink = 1 - (self.radius / far) ** 2
            right = np.array([1.0, 0.0, 0.0]) - axis[..., :1] * axis
            right = right / lengths(right)
            rim = self.radius * np.sqrt(shrink)
            down = np.cross(axis, right)
            across = np.stack([rim * right, rim * down], axis=-2)
            return (centre * shrink)[..., None, :] + unit_circle(self.count) @ across

    def centre_of(self, ray: Array) -> Array | None:
        """The ball's centre (3,) in the camera's frame [m] from unit rays (K, 3) that touch it; None where they are on no cone.

        The rays lie on a cone, ray . n = 1 with n = a / cos(theta), sin(theta) = radius / distance: linear least squares in n.
        """
        if len(ray) < LEAST_SEEN:
            return None
        n: Array = np.linalg.lstsq(ray, np.ones(len(ray)), rcond=None)[0].astype(float)
        size2 = float(n @ n)
        if not size2 > 1:
            return None
        sine = math.sqrt(1 - 1 / size2)
        return n / math.sqrt(size2) * (self.radius / sine)

    def round_outline(self, ray: Array) -> RoundOutline | None:
        """That of the ball which the rays touch best."""
        centre = self.centre_of(ray)
        if centre is None:
            return None
        far = float(np.linalg.norm(centre))
        theta = math.asin(self.radius / far)
        off = np.abs(np.arccos(np.clip(ray @ centre / far, -1.0, 1.0)) - theta) / theta
        return RoundOutline(self.outline_of(centre), off)

    def by_size(self, ray: Array) -> Array | None:
        """The outline (count, 3) [m] from its unit rays (count, 3): the ball's place follows from its size."""
        seen = np.isfinite(ray[:, 0])
        centre = self.centre_of(ray[seen])
        if centre is None:
            return np.full_like(ray, np.nan)
        reach = math.sqrt(max(float(centre @ centre) - self.radius**2, 0.0))  # of each point where a ray touches
        return ray * reach
