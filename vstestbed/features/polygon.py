"""The polygon of all markers: its size and its rotation in the image."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array
from vstestbed.core.spec import spec
from vstestbed.features.base import Feature, bounded_inverse, in_one, wrap
from vstestbed.features.points import Point

_POINT = Point()
# segments over this share of the longest one's length have a weight; a square's sides (0.71 of its
# diagonals) have none
SHARE = 0.8
# sigma under this share of the longest segment counts as zero: markers on a line, a plane seen edge
# on, loops that cancel
FLAT = 1e-2


@spec
class Polygon(Feature):
    """Size sigma = sqrt(area) and the angle of the longest segment between two markers; e and L
    have these two rows.

    area = |sum_i x_i y_i+1 - x_i+1 y_i| / 2 over the markers in their order. For two markers sigma
    = 0, with a zero row. A segment (i, j), i < j, is d = p_j - p_i and rotates at
    (dx dy_dot - dy dx_dot)/|d|^2: at -1 for wz, not at +1.

    The longest segment may change as the camera moves, and often two are equally long (a square's
    diagonals).
    So e uses, for every segment, the angle e_ij from its own direction at the goal, and is the
    weighted mean over those that are nearly the longest: e = arg(sum w_ij exp(i e_ij)), w_ij =
    max(0, |d_ij|/longest - 0.8)^2, which is continuous. L has the same weights and is the exact
    derivative where all e_ij agree: at the goal, and for rotations about the optical axis. To this
    end s has sigma and then every d (..., 1 + N (N-1)), pairs in the order (0, 1), (0, 2), ..., (1,
    2), ...

    Reference: Corke 2017, Robotics, Vision & Control, section 16.1, doi:10.1007/978-3-319-54413-7,
    with the sign of the angle's rate corrected; the rows follow by the chain rule from those of
    `Point`.
    """

    kind: Literal["polygon"] = "polygon"
    least_markers = 2

    def measure(self, xy: Array) -> Array:
        """The vector s (..., 1 + N (N-1)) of xy (..., N, 2):
        sigma, then dx, dy of every segment.
        """
        return np.concatenate([size(xy)[..., None], in_one(segments(xy))], axis=-1)

    def interaction(self, xy: Array, depth: Array) -> Array:
        """L (..., 2, 6) of xy (..., N, 2) and depth (..., N) [m]: the rows of sigma and of the
        angle.
        """
        xy, depth = self._checked(xy, depth)
        points = _POINT.interaction(xy, depth).reshape(*xy.shape, 6)
        area = _signed_area(xy)
        after = np.roll(xy, -1, axis=-2)
        before = np.roll(xy, 1, axis=-2)
        slope = 0.5 * np.stack(
            [after[..., 1] - before[..., 1], before[..., 0] - after[..., 0]], axis=-1
        )
        # sigma_dot = area_dot / (2 sigma) is unbounded at sigma = 0, where the bounded inverse
        # gives a zero row.
        half_inv = 0.5 * bounded_inverse(np.sqrt(np.abs(area))) * np.sign(area)
        size_row = half_inv[..., None] * np.einsum("...nc,...nck->...k", slope, points)
        d = segments(xy)
        i, j = np.triu_indices(xy.shape[-2], 1)
        across = np.stack([-d[..., 1], d[..., 0]], axis=-1)
        share = _weights(d) * bounded_inverse(np.hypot(d[..., 0], d[..., 1])) ** 2
        way = points[..., j, :, :] - points[..., i, :, :]
        angle_row = np.einsum("...p,...pc,...pck->...k", share, across, way)
        return np.stack([size_row, angle_row], axis=-2)

    def error(self, s: Array, s_star: Array) -> Array:
        """Error e (..., 2): sigma - sigma*, and the angle in (-pi, pi] rad of the longest segment
        from its direction at the goal.
        """
        s = np.asarray(s, dtype=float)
        s_star = np.asarray(s_star, dtype=float)
        d = s[..., 1:].reshape(*s.shape[:-1], -1, 2)
        d_star = s_star[..., 1:].reshape(*s_star.shape[:-1], -1, 2)
        turned = angle_error(d, d_star)
        larger = size_error(s[..., 0], s_star[..., 0])
        return np.stack([np.broadcast_to(larger, turned.shape), turned], axis=-1)

    def check_goal(self, xy: Array, depth: Array) -> None:
        """Refuse a goal view xy (N, 2) in which three or more markers span no area: on one line, or
        with loops that cancel.
        """
        if len(xy) > 2 and not spans_area(size(xy), segments(xy)):
            words = (
                "spans no area in the goal view, by which the law measures size;"
                " the markers must not lie on one line, and must be in order around the polygon:"
                " the areas of a bow tie's two loops cancel"
            )
            raise ParameterError("target", words)


def size(xy: Array) -> Array:
    """Sigma (...), the square root of the area of the polygon with vertices xy (..., N, 2) in
    order.
    """
    return np.sqrt(np.abs(_signed_area(np.asarray(xy, dtype=float))))


def spans_area(sigma: Array, d: Array) -> NDArray[np.bool_]:
    """Whether a polygon of size sigma (...) with the segments d (..., P, 2) between its vertices
    spans an area.

    It does not if the vertices lie on one line, or if it crosses itself and the areas of its loops
    cancel.
    """
    return np.asarray(sigma > FLAT * np.hypot(d[..., 0], d[..., 1]).max(axis=-1))


def size_error(
    sigma: Array, sigma_star: Array, form: Literal["difference", "ratio", "log"] = "difference"
) -> Array:
    """The error of sigma, any shape: sigma - sigma*, sigma/sigma* - 1 or log(sigma/sigma*).

    Positive where the target appears too large, because the camera is too close. For a target that
    faces the camera sigma_dot = sigma vz/Z, so that the last form is that of the depth, log(Z*/Z).
    A size that is not positive has no ratio: ParameterError.
    """
    if form == "difference":
        return sigma - sigma_star
    if not ((sigma > 0).all() and (sigma_star > 0).all()):
        raise ParameterError.bound(
            "sigma",
            ">",
            f"0, now and at the goal, for the error {form!r}",
            why="the markers must span an area",
        )
    return np.log(sigma / sigma_star) if form == "log" else sigma / sigma_star - 1


def segments(xy: Array) -> Array:
    """The vectors p_j - p_i (..., N (N-1)/2, 2) between all markers i < j of xy (..., N, 2)."""
    xy = np.asarray(xy, dtype=float)
    i, j = np.triu_indices(xy.shape[-2], 1)
    return xy[..., j, :] - xy[..., i, :]


def angle_error(d: Array, d_star: Array) -> Array:
    """Angle in (-pi, pi] rad of the longest of the segments d (..., P, 2) from its direction in
    d_star; see `Polygon`.
    """
    # As complex numbers, so that the mean of angles is right at +-pi, too.
    z = d[..., 0] + 1j * d[..., 1]
    z_star = d_star[..., 0] + 1j * d_star[..., 1]
    turn = z * np.conj(z_star)
    blend = np.sum(_weights(d) * turn / np.maximum(np.abs(turn), np.finfo(float).tiny), axis=-1)
    return wrap(np.angle(blend))


def _weights(d: Array) -> Array:
    """Weights (..., P) of the segments d (..., P, 2), with the sum 1; all 0 if the longest has no
    length.
    """
    length = np.hypot(d[..., 0], d[..., 1])
    longest = np.maximum(length.max(axis=-1, keepdims=True), np.finfo(float).tiny)
    weight = np.maximum(0, length / longest - SHARE) ** 2
    return weight / np.maximum(weight.sum(axis=-1, keepdims=True), np.finfo(float).tiny)


def _signed_area(xy: Array) -> Array:
    x = xy[..., 0]
    y = xy[..., 1]
    return 0.5 * np.sum(x * np.roll(y, -1, axis=-1) - np.roll(x, -1, axis=-1) * y, axis=-1)
