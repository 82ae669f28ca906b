"""Partitioned (XY/Z) image-based visual servoing."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

import numpy as np
from annotated_types import Gt, Len

from vstestbed.errors import ParameterError
from vstestbed.features import Point
from vstestbed.features.polygon import angle_error, segments, size, size_error, spans_area
from vstestbed.geometry import Array
from vstestbed.laws.base import Command, ConstantGain, Gain, TwistLimits
from vstestbed.laws.select import NO_AREA, Rows, require_area, usable_rows
from vstestbed.laws.solve import least_squares
from vstestbed.laws.visibility import Visibility
from vstestbed.observation import Depth, Goal, Observation, PnP
from vstestbed.spec import spec

XY, Z = [0, 1, 3, 4], [2, 5]
"""Columns of the twist: across the optical axis, and along and about it."""
_POINT = Point()


@dataclass(frozen=True, slots=True)
class PartitionedMemory:
    """The turn about the optical axis still to be made at the last frame [rad], not wrapped; None before the first."""

    turn: float | None = None


@spec
class Partitioned:
    """vz and wz by the size and the angle of the markers' polygon, the other four by the points.

    v_z  = -gain_z e_sigma,  w_z = gain_turn e_angle
    v_xy = pinv(L_xy) (-lambda e - L_z (v_z, w_z))

    e_sigma is positive where the target looks too large: sigma/sigma* - 1 (`ratio`), log(sigma/sigma*) (`log`, that of the
    depth for a target that faces the camera) or sigma - sigma* (`difference`, of normalised coordinates); times gain_z it is
    metres a second. e_angle is the turn of the longest segment between two markers from its goal.

    Errata. Print (Corke 2017, section 16.1) has w_z = gain (theta* - theta), which is unstable: theta_dot = -w_z. In its
    eq. 16.2 the gain also multiplies L_z (v_z, w_z), so that the points are told of a fraction of the motion along and
    about the axis that is really made. A test holds both against finite differences.

    Args:
        gain: lambda [1/s], of the points.
        gain_z, gain_turn: of the size and of the angle [1/s].
        sigma: which error of the size.
        turn_limits_deg: how far the camera may turn about its axis in all, seen from where it began (low, high) [deg]: the
            shorter way that stays between them is taken, even the long way round. Without limits, the shorter way.
        depth: where Z in L comes from.
        limits: largest speed and rate of the commanded twist.
        visibility: keeps markers off the picture's border.

    Reference: Corke & Hutchinson 2001, doi:10.1109/70.954764.
    """

    kind: Literal["partitioned"] = "partitioned"
    tasks: ClassVar[tuple[str, ...]] = ("view",)
    gain: Gain = ConstantGain()
    gain_z: Annotated[float, Gt(0)] = 1.0
    gain_turn: Annotated[float, Gt(0)] = 0.5
    sigma: Literal["difference", "ratio", "log"] = "ratio"
    turn_limits_deg: Annotated[tuple[float, ...], Len(2, 2)] | None = None
    depth: Depth = PnP()
    limits: TwistLimits = TwistLimits()
    visibility: Visibility = Visibility()

    def __post_init__(self) -> None:
        """Refuse limits that leave no way to turn."""
        if self.turn_limits_deg is not None and not self.turn_limits_deg[0] <= 0 <= self.turn_limits_deg[1]:
            raise ParameterError("turn_limits_deg", "must be [low, high] with low <= 0 <= high", self.turn_limits_deg)

    @property
    def inputs(self) -> tuple[str, ...]:
        """The fields of an Observation that it looks at."""
        return ("xy", "depth")

    def check(self, points: Array, goal: Goal) -> None:
        """Refuse fewer than four markers, a goal view without a size (`require_area`), and what `visibility` does.

        Three look the same from up to four places: the points' error vanishes at each, and size and angle with it.
        """
        if len(points) < 4:
            words = f"has {len(points)} markers, and law partitioned needs 4 or more: three look as at the goal from up to four places"
            raise ParameterError("target", words)
        require_area(goal)
        self.visibility.check(goal)

    def init(self, goal: Goal) -> PartitionedMemory:
        """No turn chosen yet."""
        return PartitionedMemory()

    def markers_needed(self, basis: Array) -> int:
        """Three markers span an area: enough to go on with while others are hidden, not to begin with (`check`).

        Raises:
            ParameterError: the robot cannot move its camera in all six directions.
        """
        if basis.shape[1] != 6:
            words = f"partitioned moves a camera in all six directions, and this robot has {basis.shape[1]}; use ibvs"
            raise ParameterError("law.kind", words)
        return 3

    def step(self, memory: PartitionedMemory, observation: Observation, goal: Goal, basis: Array) -> tuple[PartitionedMemory, Command]:
        """One frame, with the markers that are seen; rest when they are too few or span no area."""
        rows = usable_rows(observation, self.inputs, self.markers_needed(basis))
        if isinstance(rows, str):
            return memory, Command.rest(basis, rows)
        xy, goal_xy = observation.xy[rows], goal.xy[rows]
        sigma, d, sigma_star, d_star = size(xy), segments(xy), size(goal_xy), segments(goal_xy)
        if not (spans_area(sigma, d) and spans_area(sigma_star, d_star)):
            return memory, Command.rest(basis, NO_AREA)
        turn = self._turn(memory, float(angle_error(d, d_star)))
        along = -self.gain_z * float(size_error(sigma, sigma_star, self.sigma))
        twist = self._twist(observation, goal, rows, along, self.gain_turn * turn)
        if self.visibility.margin_px > 0:
            twist = twist + basis @ self.visibility.push(observation, goal, basis)
        twist = twist * (scale := self.limits.scale(twist))
        return PartitionedMemory(turn), Command(u=least_squares(basis, twist), twist=twist, scale=scale)

    def _twist(self, observation: Observation, goal: Goal, rows: Rows, along: float, about: float) -> Array:
        xy = observation.xy[rows]
        L = _POINT.interaction(xy, observation.depth[rows])
        e = (xy - goal.xy[rows]).ravel()
        across = least_squares(L[:, XY], e)
        twist = np.empty(6)
        twist[Z] = along, about
        twist[XY] = -self.gain.at(across) * across - least_squares(L[:, XY], L[:, Z] @ twist[Z])
        return twist

    def _turn(self, memory: PartitionedMemory, angle: float) -> float:
        """The turn still to be made [rad]: the way chosen at the first frame, gone on with."""
        last, ways = memory.turn, [angle + k * 2 * math.pi for k in (-1, 0, 1)]
        if last is not None:
            return min(ways, key=lambda way: abs(way - last))
        if self.turn_limits_deg is None:
            return angle
        low, high = (math.radians(limit) for limit in self.turn_limits_deg)
        return min(ways, key=lambda way: (max(low - way, way - high, 0.0), abs(way)))
