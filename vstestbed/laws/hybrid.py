"""2.5D visual servoing: a point's image, its depth's ratio, and the rotation."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np

from vstestbed.features import LogDepth, Point, ThetaU
from vstestbed.geometry import Array
from vstestbed.laws.base import Command, ConstantGain, Gain, TwistLimits
from vstestbed.laws.select import NO_POSE, TOO_FEW
from vstestbed.laws.solve import least_squares
from vstestbed.laws.visibility import Visibility
from vstestbed.observation import Depth, Goal, Observation, PnP
from vstestbed.spec import spec

_THETA_U, _POINT, _LOG_DEPTH = ThetaU(), Point(), LogDepth()


@spec
class Hybrid:
    """u = -lambda pinv(L B) e with e = (x - x*, y - y*, log(Z/Z*), theta u), camera twist v = B u.

    (x, y) is the image of the target's origin, Z its depth, R_goal_camera the rotation of theta u. They come
    - from the `homography` between the goal view and this one: the target's plane takes m* (goal) to Z/Z* m = H m*, and
      H = R + t n^T/d* falls apart into the rotation, the ratio Z/Z* and the image of the origin without the target's
      measures; the depth Z* at the goal is known;
    - or from the `model`: the pose by perspective-n-point.
    The origin's image is a linear function of time, so that the target stays in view for small rotations, and the law has
    no local minimum and no singularity in front of the target.

    Args:
        gain: lambda [1/s].
        source: `homography` (default, for markers in one plane, four or more of them seen) or `model`.
        limits: largest speed and rate of the commanded twist.
        visibility: keeps markers off the picture's border.

    Reference: Malis, Chaumette & Boudet 1999, doi:10.1109/70.760345.
    """

    kind: Literal["hybrid"] = "hybrid"
    gain: Gain = ConstantGain()
    source: Literal["homography", "model"] = "homography"
    limits: TwistLimits = TwistLimits()
    visibility: Visibility = Visibility()
    depth: ClassVar[Depth] = PnP()

    @property
    def inputs(self) -> tuple[str, ...]:
        """The field of an Observation that it looks at."""
        return ("relative",) if self.source == "homography" else ("T_camera_target",)

    def check(self, points: Array, goal: Goal) -> None:
        """Any will do."""

    def init(self, goal: Goal) -> None:
        """No memory."""

    def markers_needed(self, basis: Array) -> int:
        """Four markers make a homography; three leave a pose that continues the last one."""
        return 4 if self.source == "homography" else 3

    def step(self, memory: None, observation: Observation, goal: Goal, basis: Array) -> tuple[None, Command]:
        """One frame; rest where the views cannot be compared."""
        if np.count_nonzero(observation.seen) < self.markers_needed(basis):
            return None, Command.rest(basis, TOO_FEW)
        compared = self._compare(observation, goal)
        if compared is None:
            return None, Command.rest(basis, NO_POSE)
        e, L = self.feature(*compared, goal.T_camera_target[:3, 3])
        solved = least_squares(L @ basis, e)
        u = -self.gain.at(solved) * solved
        if self.visibility.margin_px > 0:
            u = u + self.visibility.push(observation, goal, basis)
        return None, self.limits.command(u, basis)

    def _compare(self, observation: Observation, goal: Goal) -> tuple[Array, Array] | None:
        """The target's origin over Z* (3,) in the camera's frame, and R_goal_camera (3, 3)."""
        o, relative = goal.T_camera_target[:3, 3], observation.relative
        if self.source == "homography":
            return None if relative is None else (relative.H @ (o / o[2]), relative.R_camera_goal.T)
        T = observation.T_camera_target
        return None if T is None else (T[:3, 3] / o[2], goal.T_camera_target[:3, :3] @ T[:3, :3].T)

    def feature(self, m: Array, R_goal_camera: Array, goal_origin: Array) -> tuple[Array, Array]:
        """The error (6,) and L (6, 6), of the origin at m Z* (3,), the rotation (3, 3), and the origin at the goal (3,) [m]."""
        xy, goal_xy, ratio = m[:2] / m[2], goal_origin[:2] / goal_origin[2], m[2]
        Z = ratio * goal_origin[2]
        at, depth = xy[None], np.array([Z])
        L = np.concatenate([_POINT.interaction(at, depth), _LOG_DEPTH.interaction(at, depth), _THETA_U.interaction(R_goal_camera)])
        return np.concatenate([xy - goal_xy, [np.log(ratio)], _THETA_U.measure(R_goal_camera)]), L
