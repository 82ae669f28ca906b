"""Partitioned image-based visual servoing: XY/Z, and other partitions."""

from __future__ import annotations

from functools import cached_property
from typing import Annotated, Any, Literal

import numpy as np
from annotated_types import Len

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array, exp, transform
from vstestbed.core.quantity import Angle, PositiveGain
from vstestbed.core.spec import spec
from vstestbed.features import Point, Polygon
from vstestbed.features.depth import Depth, PnP
from vstestbed.features.observation import Goal
from vstestbed.features.polygon import angle_error, segments, size, size_error, spans_area
from vstestbed.laws.error_law import Equations, ErrorLaw
from vstestbed.laws.points import NO_AREA, check_goal, moved_markers, points
from vstestbed.laws.solve import least_squares, units_of

# column of the twist of each motion that a single feature can command
COLUMN = {"x": 0, "y": 1, "z": 2, "wz": 5}
Axis = Literal["x", "y", "z", "wz"]
_POINT = Point()
_POLYGON = Polygon()
# An angle is known up to a full turn: the candidates beside it are the same orientation, the other
# way round.
_ROUND = 2 * np.pi * np.array([-1.0, 0.0, 1.0])


@spec
class Partitioned(ErrorLaw):
    """Each of the motions `axes` is controlled by one feature of all markers together, the other
    motions by the points.

    v_z = -gain_z e_sigma,  w_z = gain_turn e_angle,
    (v_x, v_y) = gain_xy Z e_middle                     those of them in `axes`
    v_rest = pinv(L_rest) (-lambda e - L_axes v_axes)   the others

    With `feedforward` the features are those of the markers where they are predicted.

    `solve` inverts L_rest. Far from the target, with neither x nor y in `axes`, its smallest
    singular value, of lateral motion together with a tilt, is a hundredth of the largest or less,
    and the default keeps it: errors there grow, and the camera flies metres sideways.

    By default `axes` are z and wz (the XY/Z partition of print): size and angle of the markers'
    polygon drive the camera along and about its axis, the points do the rest.

    e_sigma is positive where the target appears too large: sigma/sigma* - 1 (`ratio`),
    log(sigma/sigma*) (`log`: that of the depth for a target that faces the camera) or sigma -
    sigma* (`difference`, of normalised coordinates). e_angle is the angle of the longest segment
    between two markers from its direction at the goal. e_middle is the error of the mean (x, y) of
    the markers, which changes with v_x by -mean(1/Z); 1/Z in the equation stands for that mean.

    Where x (or y) is in `axes`, the x (y) coordinates in e and L are those from the markers' mean.
    Else the law would nearly stand still: for a frontal square of half side a, lateral motion and
    tilt differ in the image by a^4 alone, and the points' tilt would cancel all but a^4/((1 +
    a^2)^2 + a^4) of the error of the mean that it caused, a 290th at 1 m from a square of .5 m.
    From their mean the points do not see lateral motion of a frontal target at all, and tell the
    tilt by its perspective. For the same reason tilt and pan are not among the axes: with the mean
    commanding them, nothing would be left for x and y.

    Errata. Corke 2017, section 16.1, prints w_z = gain (theta* - theta), which is unstable:
    theta_dot = -w_z. In its eq. 16.2 the gain also multiplies L_z (v_z, w_z), so that only a
    fraction of the actual motion along and about the axis is compensated for the points. A test
    checks both against finite differences.

    Args:
        gain_z: gain of the size [m/s per unit of e_sigma].
        gain_turn: gain of the angle [1/s].
        gain_xy: gain of the markers' mean, where x or y is in `axes` [1/s].
        axes: the motions with a feature of their own, among x, y, z and wz.
        sigma: form of the size error.
        turn_limits_deg: bounds (low, high) [deg] of the camera's rotation about its axis, from its
            start: the shortest rotation within them is chosen, which may be the longer way round.
            Without bounds, the shortest; e.g. `[-200, 160]`.
        depth: source of Z in L.

    Reference: Corke & Hutchinson 2001, doi:10.1109/70.954764.
    """

    kind: Literal["partitioned"] = "partitioned"
    stacks = False
    needs_same_markers = True  # their polygon's size and angle
    gain_z: PositiveGain = 1.0
    gain_turn: PositiveGain = 0.5
    gain_xy: PositiveGain = 0.5
    axes: Annotated[tuple[Axis, ...], Len(1, 4)] = ("z", "wz")
    sigma: Literal["difference", "ratio", "log"] = "ratio"
    turn_limits_deg: Annotated[tuple[Angle, ...], Len(2, 2)] | None = None
    depth: Depth = PnP()
    # the remaining rotation about the optical axis at the last frame [rad], not wrapped
    extra_size = 1

    def __post_init__(self) -> None:
        """Refuse bounds that exclude the start, and an axis named twice."""
        if len(set(self.axes)) < len(self.axes):
            raise ParameterError.twice("axes", "a motion", list(self.axes))
        low, high = self.turn_limits_deg or (0.0, 0.0)
        if not low <= 0 <= high:
            raise ParameterError.form(
                "turn_limits_deg", "[low, high] with low <= 0 <= high", self.turn_limits_deg
            )

    @property
    def idle(self) -> tuple[str, ...]:
        """Gains of motions that are not among `axes`."""
        driven = {"gain_z": {"z"}, "gain_turn": {"wz"}, "gain_xy": {"x", "y"}}
        return tuple(gain for gain, axes in driven.items() if axes.isdisjoint(self.axes))

    def check(self, points: Array, goal: Goal) -> None:
        """Refuse fewer than four markers, and a goal view without an area (`Polygon.check_goal`).

        Three have the same image from up to four poses: there the points' error vanishes, and with
        it those of size and angle.
        """
        if len(points) < 4:
            words = (
                f"has {len(points)} markers, and law partitioned needs 4 or more:"
                " three look as at the goal from up to four poses"
            )
            raise ParameterError("target", words)
        check_goal(_POLYGON, goal)

    def markers_needed(self, basis: Array) -> int:
        """Three span an area: enough while others are hidden for some frames, not enough for a
        target (`check`).
        Raises ParameterError: the robot cannot move its camera in all six directions.
        """
        if basis.shape[1] != 6:
            words = (
                "partitioned moves a camera in all six directions,"
                f" and this robot has {basis.shape[1]}; use ibvs"
            )
            raise ParameterError("law.kind", words)
        return 3

    def equations(self, view: Any, goal: Any) -> Equations:
        """Those of all points, which `motion` divides: the error (..., 2N) and L (..., 2N, 6)."""
        e = _POINT.error(_POINT.measure(view.xy), _POINT.measure(goal.xy))
        return e, _POINT.interaction(view.xy, view.depth)

    def motion(
        self,
        extra: Array,
        equations: Equations,
        view: Any,
        goal: Goal,
        basis: Array | None,
        shift: Array | None,
    ) -> tuple[Array, Array | str, Array | None]:
        """The rotation that is left (..., 1), and the velocities; rest where the markers span no
        area.
        """
        if basis is not None and shift is not None:
            # The features are no linear function of that motion, so that it moves the markers: by
            # its difference from the horizon's.
            p = transform(exp(-basis @ shift), points(view))
            view = moved_markers(view, p, np.ones(len(p), dtype=bool))
            equations = self.equations(view, goal)
        sigma = size(view.xy)
        d = segments(view.xy)
        sigma_star = size(goal.xy)
        d_star = segments(goal.xy)
        flat = ~(spans_area(sigma, d) & spans_area(sigma_star, d_star))
        if basis is not None and flat:
            return extra, NO_AREA, None
        # of many, those without an area are computed with sigma* instead, and set to NaN at the
        # end: no branches
        if basis is None:
            sigma = np.where(flat, sigma_star, sigma)
        turn = self._turn(extra[..., 0], angle_error(d, d_star))
        too_large = size_error(sigma, sigma_star, self.sigma)
        twist = self._twist(equations, view, goal, too_large, turn)
        if basis is None:
            twist[flat] = np.nan
            return turn[..., None], twist, None
        return turn[..., None], least_squares(basis, twist), None

    def _twist(
        self, equations: Equations, view: Any, goal: Goal, too_large: Array, turn: Array
    ) -> Array:
        """Camera twists (..., 6) for given errors of size and angle (...); equations: e (..., 2N)
        and L (..., 2N, 6) of the points.
        """
        e, L = equations
        twist = np.empty((*e.shape[:-1], 6))
        for axis in self.axes:
            i = COLUMN[axis]
            if axis == "z":
                twist[..., i] = -self.gain_z * too_large
            elif axis == "wz":
                twist[..., i] = self.gain_turn * turn
            else:
                aside = (view.xy[..., i] - goal.xy[..., i]).mean(axis=-1)
                twist[..., i] = self.gain_xy * aside / (1 / view.depth).mean(axis=-1)
        for i, axis in enumerate(("x", "y")):
            if axis in self.axes:  # the equations of this coordinate, from the markers' mean
                e = e.copy()
                L = L.copy()
                e[..., i::2] -= e[..., i::2].mean(axis=-1, keepdims=True)
                L[..., i::2, :] -= L[..., i::2, :].mean(axis=-2, keepdims=True)
        given, rest = self._columns
        units = np.broadcast_to(units_of(goal, None), 6)
        A = L[..., rest] * units[rest]
        by_points = self.solve.least_squares(A, e)
        # The motion along and about the axis moves the points, too; the gain must not multiply this
        # part (see the errata).
        carried = (L[..., given] @ twist[..., given, None])[..., 0]
        wanted = self.gain.at(by_points) * by_points + self.solve.least_squares(A, carried)
        twist[..., rest] = -units[rest] * wanted
        return twist

    @cached_property
    def _columns(self) -> tuple[list[int], list[int]]:
        given = sorted(COLUMN[axis] for axis in self.axes)
        return given, [i for i in range(6) if i not in given]

    def _turn(self, last: Array, angle: Array) -> Array:
        """The remaining rotations (...) [rad], not wrapped: the way round is chosen at the first
        frame, where `last` is NaN, and kept.
        """
        ways = angle[..., None] + _ROUND
        first = np.isnan(last)
        # At first the shortest; then the one nearest to the last, since near a half turn the
        # wrapped angle would change its sign.
        cost = np.abs(ways - np.where(first, angle, last)[..., None])
        if self.turn_limits_deg is not None and first.any():
            low, high = np.radians(self.turn_limits_deg)
            beyond = np.maximum(np.maximum(low - ways, ways - high), 0.0)
            # Of those that exceed the bounds the least, the shortest.
            at_first = np.abs(ways) + 1e3 * beyond
            cost = np.where(first[..., None], at_first, cost)
        return np.take_along_axis(ways, np.argmin(cost, axis=-1, keepdims=True), axis=-1)[..., 0]
