"""Targets that are one region of colour: a flat shape on a board, and a ball. Their points are on
the outline, in order.
"""

from __future__ import annotations

import colorsys
import math
from functools import cached_property, lru_cache
from itertools import combinations
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from annotated_types import Ge, Le, Len

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array, homogeneous, lengths
from vstestbed.core.quantity import Angle, Length, PositiveLength
from vstestbed.core.registry import Registry
from vstestbed.core.spec import spec
from vstestbed.targets.base import Body, Target, in_plane
from vstestbed.targets.markers import Outline


# Ellipses as images: of a circle in space, from points, and points on them in an order that the
# picture alone determines.
def circle_conic(T_camera_circle: Array, radius: float) -> Array:
    """The conic C (..., 3, 3) with m^T C m = 0 for the images m = (x, y, 1) of a circle in the
    plane z = 0 of a frame at T (..., 4, 4).

    With H = [R ex, R ey, t] the circle X^2 + Y^2 = radius^2 becomes C = H^-T diag(1, 1, -radius^2)
    H^-1 (Hartley & Zisserman 2004, Multiple View Geometry, result 2.13).
    """
    H = np.concatenate([T_camera_circle[..., :3, :2], T_camera_circle[..., :3, 3:]], axis=-1)
    G = np.linalg.inv(H)
    return G.mT @ np.diag([1.0, 1.0, -(radius**2)]) @ G


def fitted_conic(xy: Array) -> Array:
    """The conic (3, 3) that fits points xy (K, 2) on an ellipse, by linear least squares about
    their mean, in units of their spread.
    """
    middle = xy.mean(axis=0)
    spread = float(xy.std())
    x, y = ((xy - middle) / spread).T
    a, b, c, d, e = np.linalg.lstsq(
        np.column_stack([x * x, x * y, y * y, x, y]), np.ones(len(x)), rcond=None
    )[0]
    C = np.array([[a, b / 2, d / 2], [b / 2, c, e / 2], [d / 2, e / 2, -1.0]])
    N = np.array(
        [[1 / spread, 0, -middle[0] / spread], [0, 1 / spread, -middle[1] / spread], [0, 0, 1]]
    )
    return N.T @ C @ N


def ellipse_points(C: Array, count: int) -> Array:
    """Points xy (..., count, 2) on the ellipses C (..., 3, 3), from the picture's right downwards;
    NaN where C is no ellipse.

    They are m + S (cos phi_i, sin phi_i), with the centre m and the symmetric root S of the
    ellipse's matrix,
    (x - m)^T S^-2 (x - m) = 1: of all maps of the unit circle onto the ellipse the one without a
    rotation, which depends on nothing that the picture of a circle does not show. Their polygon is
    an affine image of the regular one, so that its moments are those of the
    ellipse times constants.
    """
    A = C[..., :2, :2]
    b = C[..., :2, 2]
    with np.errstate(invalid="ignore", divide="ignore"):
        det = A[..., 0, 0] * A[..., 1, 1] - A[..., 0, 1] * A[..., 1, 0]
        adjugate = np.stack(
            [A[..., 1, 1], -A[..., 0, 1], -A[..., 1, 0], A[..., 0, 0]], axis=-1
        ).reshape(A.shape)
        inverse = adjugate / det[..., None, None]
        middle = -(inverse @ b[..., None])[..., 0]
        level = -(C[..., 2, 2] + (b * middle).sum(axis=-1))
        S2 = inverse * level[..., None, None]
        det = S2[..., 0, 0] * S2[..., 1, 1] - S2[..., 0, 1] ** 2
        # of a hyperbola the determinant is negative
        root = np.sqrt(np.where(S2[..., 0, 0] > 0, det, np.nan))
        S = (S2 + root[..., None, None] * np.eye(2)) / np.sqrt(
            S2[..., 0, 0] + S2[..., 1, 1] + 2 * root
        )[..., None, None]
    return middle[..., None, :] + unit_circle(count) @ S


def distance_to_conic(C: Array, xy: Array) -> Array:
    """Distance (K,) of points xy (K, 2) from a conic C (3, 3), to first order: m^T C m / |grad|;
    its sign is that side's of C.

    Reference: Sampson 1982, doi:10.1016/0146-664X(82)90101-0.
    """
    m = homogeneous(xy)
    line = m @ C
    return (line * m).sum(axis=1) / (2 * np.maximum(np.hypot(line[:, 0], line[:, 1]), 1e-300))


@lru_cache(maxsize=16)
def unit_circle(count: int) -> Array:
    """(cos, sin) at `count` equal angles from 0 on, shape (count, 2); kept, so nobody may write to
    it.
    """
    angle = np.arange(count) * (2 * np.pi / count)
    return np.column_stack([np.cos(angle), np.sin(angle)])


# Polygons in a plane: moments of their area, whether they cross themselves, triangles.
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
    """Second central moments (2, 2) of a polygon's area over that area, corners (E, 2) (Steger
    1996, FGBV-96-05).
    """
    p = xy - centroid(xy)
    q = np.roll(p, -1, axis=0)
    cross = p[:, 0] * q[:, 1] - q[:, 0] * p[:, 1]
    total = np.einsum("n,ni,nj->ij", cross, p, p) + np.einsum("n,ni,nj->ij", cross, q, q)
    mixed = np.einsum("n,ni,nj->ij", cross, p, q)
    return (2 * total + mixed + mixed.T) / (12 * cross.sum())


def evenly_along(xy: Array, count: int) -> Array:
    """Points (count, 2) along the sides of a polygon (E, 2), evenly by length, from its first
    corner on.
    """
    closed = np.concatenate([xy, xy[:1]])
    reached = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(closed, axis=0), axis=1))])
    at = np.arange(count) / count * reached[-1]
    return np.column_stack([np.interp(at, reached, closed[:, k]) for k in (0, 1)])


def crossing(xy: Array) -> tuple[int, int] | None:
    """Numbers of two sides of a polygon (E, 2) that meet elsewhere than neighbours do, or fold back
    onto each other; None without such.
    """
    for i, j in combinations(range(len(xy)), 2):
        if _meet(xy, i, j):
            return i, j
    return None


def _meet(xy: Array, i: int, j: int) -> bool:
    """Whether the sides i and j > i meet elsewhere than neighbours do."""
    n = len(xy)
    a, b, c, d = xy[[i, (i + 1) % n, j, (j + 1) % n]]
    if j == i + 1:
        return _folds(a, b, d)
    if i == 0 and j == n - 1:
        return _folds(c, a, b)
    # Segments on one line overlap only where their boxes do.
    low = np.maximum(np.minimum(a, b), np.minimum(c, d))
    high = np.minimum(np.maximum(a, b), np.maximum(c, d))
    apart = _side(a, b, c) * _side(a, b, d) > 0 or _side(c, d, a) * _side(c, d, b) > 0
    return not apart and bool((low <= high).all())


def _folds(before: Array, corner: Array, after: Array) -> bool:
    """Whether a side from a corner lies on the side before it."""
    back = float((before - corner) @ (after - corner)) >= 0
    return _side(before, corner, after) == 0 and back


def _side(a: Array, b: Array, c: Array) -> float:
    """Which side of the line from a to b the point c lies on: -1, 0, 1."""
    u = b - a
    v = c - a
    cross = float(u[0] * v[1] - u[1] * v[0])
    if abs(cross) <= 1e-12 * float(np.hypot(*u) * np.hypot(*v)):
        return 0.0
    return math.copysign(1.0, cross)


def triangulated(xy: Array) -> list[tuple[int, int, int]]:
    """Triangles of a polygon (E, 2) that does not cross itself, as numbers of its corners, by
    cutting off ears.

    Reference: Meisters 1975, Polygons have ears, doi:10.1080/00029890.1975.11993898.
    """
    left = list(range(len(xy)))
    out = []
    while len(left) > 3:
        k = next((k for k in range(len(left)) if _is_ear(xy, left, k)), 0)
        out.append((left[k - 1], left[k], left[(k + 1) % len(left)]))
        del left[k]
    return [*out, (left[0], left[1], left[2])]


def _is_ear(xy: Array, left: list[int], k: int) -> bool:
    """Whether corner k of those that are left is convex and no other lies in the triangle with its
    neighbours.
    """
    ear = [left[k - 1], left[k], left[(k + 1) % len(left)]]
    a, b, c = xy[ear]
    if _side(a, b, c) <= 0:
        return False
    x, y = xy[[n for n in left if n not in ear]].T
    inside = np.ones(len(x), bool)
    for p, q in ((a, b), (b, c), (c, a)):
        inside &= (q[0] - p[0]) * (y - p[1]) - (q[1] - p[1]) * (x - p[0]) >= 0
    return not inside.any()


Corner = Annotated[tuple[Length, ...], Len(2, 2)]


class Figure:
    """The outline of a region in the plane z = 0 of a target, seen with x to the right and y down;
    by default a polygon.

    Attributes:
        round: whether it is a circle, whose picture does not tell how it is turned.
        corners: of the polygon that is drawn, (E, 2) [m], clockwise as seen.
    """

    kind: Any
    corners: Any  # a property of each figure
    round: ClassVar[bool] = False

    def outline(self, count: int) -> Array:
        """At least `count` points on the outline in order, shape (M, 2) [m]: all corners, and
        points between them on long sides.
        """
        corners = self.corners
        side = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1)
        parts = np.ones(len(corners), dtype=int)
        while parts.sum() < count:
            parts[np.argmax(side / parts)] += 1
        ends = zip(corners, np.roll(corners, -1, axis=0), parts, strict=True)
        return np.concatenate([a + np.arange(n)[:, None] / n * (b - a) for a, b, n in ends])


@spec
class PolygonFigure(Figure):
    """A polygon.

    The picture of one with rotational symmetry fits its outline in several ways: the detector
    begins with the smallest rotation.

    Args:
        at: its corners (x, y) in order, in the target's plane, x to the right and y down as seen
            [m];
            e.g. `[[0, 0], [0.3, 0], [0, 0.2]]`.
    """

    kind: Literal["polygon"] = "polygon"
    at: Annotated[tuple[Corner, ...], Len(3, 96)]

    def __post_init__(self) -> None:
        given = np.array(self.at)
        if sides := crossing(given):
            words = (
                "must not cross or touch itself:"
                f" the sides from corners {sides[0]} and {sides[1]} meet"
            )
            raise ParameterError("at", words, [list(corner) for corner in self.at])

    @cached_property
    def corners(self) -> Array:
        """The corners, clockwise as seen."""
        given = np.array(self.at, dtype=float)
        return given if signed_area(given) > 0 else np.roll(given[::-1], 1, axis=0)


@spec
class DiscFigure(Figure):
    """A disc about the target's origin.

    Args:
        radius: of its edge [m]; e.g. `0.1`.
    """

    kind: Literal["disc"] = "disc"
    radius: PositiveLength
    round = True

    @cached_property
    def corners(self) -> Array:
        """A regular polygon with the disc's area, whose border is within 5e-5 of its radius."""
        n = 256
        larger = math.sqrt(2 * math.pi / (n * math.sin(2 * math.pi / n)))
        return self.radius * larger * unit_circle(n)

    def outline(self, count: int) -> Array:
        return self.radius * unit_circle(count)


@spec
class Whale(Figure):
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
class LShape(Figure):
    """The letter L, its short limb two thirds of the long one, about its centroid.

    Args:
        length: of the long limb [m]; e.g. `0.4`.
    """

    kind: Literal["l_shape"] = "l_shape"
    length: PositiveLength

    @cached_property
    def corners(self) -> Array:
        """The six corners, from the upper left on."""
        at = np.array([[0, 0], [0.3, 0], [0.3, 0.7], [0.67, 0.7], [0.67, 1], [0, 1]])
        return (at - centroid(at)) * self.length


# fmt: off
WHALE = (
    (0.50, 0.02), (0.46, 0.09), (0.31, 0.13), (0.15, 0.14), (0.12, 0.23), (0.05, 0.24),
    (0.02, 0.13), (-0.18, 0.07), (-0.34, 0.03), (-0.43, 0.10), (-0.50, 0.09), (-0.46, 0.00),
    (-0.50, -0.12), (-0.45, -0.16), (-0.36, -0.05), (-0.25, -0.07), (-0.08, -0.15),
    (0.13, -0.20), (0.33, -0.18), (0.46, -0.09),
)
# fmt: on
"""Points on the outline of a whale of length 1 that swims to the right,
clockwise as seen (y down).
"""

FIGURES = Registry("figure", Whale, LShape, PolygonFigure, DiscFigure)


def _smooth(points: Array, parts: int) -> Array:
    """`parts` points for each of the points (E, 2) on a closed curve through them (Catmull & Rom
    1974).
    """
    before = np.roll(points, 1, axis=0)
    after = np.roll(points, -1, axis=0)
    beyond = np.roll(points, -2, axis=0)
    out = []
    for t in np.arange(parts) / parts:
        a, b, c, d = 0.5 * np.array(
            [-t + 2 * t**2 - t**3, 2 - 5 * t**2 + 3 * t**3, t + 4 * t**2 - 3 * t**3, -(t**2) + t**3]
        )
        out.append(a * before + b * points + c * after + d * beyond)
    return np.stack(out, axis=1).reshape(-1, 2)


# the board behind a shape reaches this share of the shape's longer side beyond it
BOARD_MARGIN = 0.25
LEAST_AHEAD = 0.05  # least Z of a unit ray to the border of a flat region: 87 degrees off the axis
LEAST_SEEN = 3  # fewest points of an outline from which a ball's place is found


@spec
class OneRegion(Target):
    """What targets of one region share: the colour, and how many points of the outline are
    measured.

    Args:
        marker: how the region is lit.
        hue_deg: its hue; no other thing in the scene may have it [deg].
        count: points on the outline; more where a shape has more corners.
    """

    marker: Outline = Outline()
    hue_deg: Angle = 0.0
    count: Annotated[int, Ge(12), Le(96)] = 32
    outlined = True

    def __post_init__(self) -> None:
        if self.names:
            raise ParameterError.only_for(
                "names", "markers; the points of an outline have none", list(self.names)
            )
        if self.pad:
            raise ParameterError.only_for("pad", "target square or points")

    @cached_property
    def hues_deg(self) -> tuple[float, ...]:
        return (self.hue_deg % 360,) * len(self.points)

    @property
    def _rgb(self) -> tuple[float, float, float]:
        return colorsys.hsv_to_rgb(self.hue_deg % 360 / 360, 1.0, 1.0)


@spec
class Shape(OneRegion):
    """A flat region of one colour on a board, in z = 0, upright for a camera that faces it: x to
    its right, y down.

    Its points are on its outline, clockwise as seen; of a polygon all corners are among them. The
    outline of a disc does not tell how it is turned: its points are those of `ellipse_points` in
    the picture, and where they are on the disc depends on the camera.

    Args:
        figure: the outline: `whale`, `l_shape`, `polygon` or `disc`.
    """

    kind: Literal["shape"] = "shape"
    figure: Annotated[Figure, FIGURES]
    one_sided = True

    @cached_property
    def points(self) -> Array:
        """Points on the outline in the target frame, shape (M, 3) [m]; of a disc those that a
        camera before it sees.
        """
        return in_plane(self.figure.outline(self.count))

    @property
    def figure_corners(self) -> Array | None:
        """The figure's corners; None of a disc."""
        return None if self.figure.round else self.figure.corners

    def round_outline(self, ray: Array) -> tuple[Array, Array] | None:
        """Of a disc the ellipse that fits the rays in the picture's plane."""
        if not self.figure.round or not (ray[:, 2] > LEAST_AHEAD).all():
            return None
        xy = ray[:, :2] / ray[:, 2:]
        conic = fitted_conic(xy)
        found = ellipse_points(conic, len(self.points))
        if not np.isfinite(found).all():
            return None
        off = np.abs(distance_to_conic(conic, xy)) / math.sqrt(abs(signed_area(found)) / math.pi)
        return homogeneous(found), off

    @property
    def places(self) -> Array:
        """The points; none of a disc, whose measured points depend on the camera's place."""
        return np.empty((0, 3)) if self.figure.round else self.points

    def points_at(self, T_camera_target: Array) -> Array:
        """Points on the outline (..., M, 3) in the camera's frame [m]; of a disc NaN where it
        reaches behind the image plane.
        """
        if not self.figure.round:
            return super().points_at(T_camera_target)
        T = T_camera_target
        radius = float(self.points[0, 0])
        ray = homogeneous(ellipse_points(circle_conic(T, radius), len(self.points)))
        normal = T[..., :3, 2]
        centre = T[..., :3, 3]
        reach = (normal * centre).sum(axis=-1)[..., None] / (ray @ normal[..., None])[..., 0]
        ahead = centre[..., 2] > radius * np.hypot(T[..., 2, 0], T[..., 2, 1])
        return np.where(ahead[..., None, None], ray * reach[..., None], np.nan)

    @property
    def body(self) -> Body:
        return self._triangles, self._rgb, self.marker.lit

    @cached_property
    def _triangles(self) -> Array:
        corners = self.figure.corners
        if len(corners) == 3:  # MuJoCo takes no mesh of three vertices
            corners = self.figure.outline(4)
        # Corners run clockwise as seen from the front, where z points away: from outside triangles
        # are counter-clockwise.
        return in_plane(corners)[[(a, c, b) for a, b, c in triangulated(corners)]]

    @property
    def board_half_m(self) -> tuple[float, float]:
        """It reaches BOARD_MARGIN of the longer side beyond the outline, on all sides of the
        origin.
        """
        corners = self.figure.corners
        beyond = BOARD_MARGIN * float(np.ptp(corners, axis=0).max())
        x, y = (np.abs(corners).max(axis=0) + beyond).tolist()
        return x, y


@spec
class Ball(OneRegion):
    """A ball about the target's origin. Its points are on the circle where the camera's rays touch
    it, which depends on the camera.

    With the centre c in the camera's frame and a = c/|c|, the circle has the centre c (1 -
    r^2/|c|^2) and the radius r sqrt(1 - r^2/|c|^2) across a. It begins in the direction of the
    camera's x axis and runs clockwise in the picture.

    Args:
        radius: of the ball [m].
    """

    kind: Literal["ball"] = "ball"
    radius: PositiveLength

    @cached_property
    def points(self) -> Array:
        """The circle that a camera far before it sees, in the target frame,
        shape (count, 3) [m].
        """
        return in_plane(self.radius * unit_circle(self.count))

    @property
    def places(self) -> Array:
        """None: the measured points depend on the place of the camera."""
        return np.empty((0, 3))

    @property
    def body(self) -> Body:
        return self.radius, self._rgb, self.marker.lit

    def points_at(self, T_camera_target: Array) -> Array:
        """The outline (..., count, 3) in the camera's frame [m]; NaN from inside the ball."""
        return self.outline_of(T_camera_target[..., :3, 3])

    def outline_of(self, centre: Array) -> Array:
        """The outline (..., count, 3) of a ball with its centre (..., 3) in the camera's frame [m];
        NaN from inside.
        """
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
        """The ball's centre (3,) in the camera's frame [m] from unit rays (K, 3) that touch it;
        None where they are on no cone.

        The rays lie on a cone, ray . n = 1 with n = a / cos(theta), sin(theta) = radius / distance:
        linear least squares in n.
        """
        if len(ray) < LEAST_SEEN:
            return None
        n: Array = np.linalg.lstsq(ray, np.ones(len(ray)), rcond=None)[0].astype(float)
        size2 = float(n @ n)
        if not size2 > 1:
            return None
        sine = math.sqrt(1 - 1 / size2)
        return n / math.sqrt(size2) * (self.radius / sine)

    def round_outline(self, ray: Array) -> tuple[Array, Array] | None:
        centre = self.centre_of(ray)
        if centre is None:
            return None
        far = float(np.linalg.norm(centre))
        theta = math.asin(self.radius / far)
        off = np.abs(np.arccos(np.clip(ray @ centre / far, -1.0, 1.0)) - theta) / theta
        return self.outline_of(centre), off

    def by_size(self, ray: Array) -> Array | None:
        """The outline (count, 3) [m] from its unit rays (count, 3): the ball's place follows from
        its size.
        """
        seen = np.isfinite(ray[:, 0])
        centre = self.centre_of(ray[seen])
        if centre is None:
            return np.full_like(ray, np.nan)
        # of each point where a ray touches
        reach = math.sqrt(max(float(centre @ centre) - self.radius**2, 0.0))
        return ray * reach
