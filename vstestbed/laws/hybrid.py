"""2.5D visual servoing: a point's image, its depth's ratio, and the rotation."""

from __future__ import annotations

from typing import Literal

import numpy as np

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array, inverse
from vstestbed.core.spec import spec
from vstestbed.features import LogDepth, Point, ThetaU
from vstestbed.features.observation import Goal, Observation
from vstestbed.laws.base import Command, ConstantGain, Gain, LawBase, TwistLimits
from vstestbed.laws.select import NO_POSE, TOO_FEW
from vstestbed.laws.solve import least_squares
from vstestbed.laws.views import Views
from vstestbed.laws.visibility import Visibility

FLAT = 1e-3
"""Markers that reach less far than this share of the set's length off a plane (a line) lie on it."""
_THETA_U, _POINT, _LOG_DEPTH = ThetaU(), Point(), LogDepth()


@spec
class Hybrid(LawBase):
    """u = -lambda pinv(L B) e with e = (x - x*, y - y*, log(Z/Z*), theta u), camera twist v = B u.

    (x, y) is the image of the markers' middle (their mean in space), Z its depth, R_goal_camera the rotation of theta u. They
    come
    - from the `homography` between the goal view and this one: the markers' plane, in which their middle lies, takes m*
      (goal) to Z/Z* m = H m*, and H = R + t n^T/d* falls apart into the rotation, the ratio Z/Z* and the image of the middle
      without the target's measures; the depth Z* at the goal is known;
    - or from the `model`: the pose by perspective-n-point.
    The middle's image is a linear function of time, so that the target stays in view for small rotations, and the law has
    no local minimum and no singularity in front of the target.

    Args:
        gain: lambda [1/s].
        source: `homography` (default, for markers in one plane, four or more of them seen, not all but one on a line) or
            `model`.
        limits: largest speed and rate of the commanded twist.
        visibility: keeps markers off the picture's border.

    Reference: Malis, Chaumette & Boudet 1999, doi:10.1109/70.760345.
    """

    kind: Literal["hybrid"] = "hybrid"
    gain: Gain = ConstantGain()
    source: Literal["homography", "model"] = "homography"
    limits: TwistLimits = TwistLimits()
    visibility: Visibility = Visibility()

    @property
    def inputs(self) -> tuple[str, ...]:
        """The field of an Observation that it looks at."""
        return ("relative",) if self.source == "homography" else ("T_camera_target",)

    def check(self, points: Array, goal: Goal) -> None:
        """Refuse what `visibility` does; for a homography, markers not in one plane, and all of them but one on a line."""
        self.visibility.check(goal)
        if self.source == "model":
            return
        *_, thickness = reaches = _reaches(points)
        if thickness > FLAT * reaches[0]:
            words = "has markers in space, and a homography takes them to lie in one plane; use law.source: model"
        elif any(_reaches(np.delete(points, i, axis=0))[1] <= FLAT * reaches[0] for i in range(len(points))):
            words = "has all markers but one on a line, which leaves the homography open; use law.source: model, or other places"
        else:
            return
        raise ParameterError("target", words)

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
        e, L = self.equations(*compared, goal.middle)
        solved = least_squares(L @ basis, e)
        u = -self.gain.at(solved) * solved
        if self.visibility.margin_px > 0:
            u = u + self.visibility.push(observation, goal, basis)
        return None, self.limits.command(u, basis)

    def _compare(self, observation: Observation, goal: Goal) -> tuple[Array, Array] | None:
        """The markers' middle over Z* (3,) in the camera's frame, and R_goal_camera (3, 3)."""
        o, relative = goal.middle, observation.relative
        if self.source == "homography":
            return None if relative is None else (relative.H @ (o / o[2]), relative.R_camera_goal.T)
        T = observation.T_camera_target
        return None if T is None else _compared(T, goal)

    @property
    def state_size(self) -> int:
        """Nothing."""
        return 0

    def step_batch(self, memory: Array, views: Views, goal: Goal) -> tuple[Array, Array]:
        """One frame of many runs (see `BatchLaw`): a homography of exact pixels says the same as the pose."""
        e, L = self.equations(*_compared(views.T_camera_target, goal), goal.middle)
        solved = least_squares(L, e)
        return memory, self.limits.within(-self.gain.at(solved) * solved)

    def equations(self, m: Array, R_goal_camera: Array, goal_middle: Array) -> tuple[Array, Array]:
        """The error (..., 6) and L (..., 6, 6) of views.

        Args:
            m: the markers' middle over Z*, (..., 3). R_goal_camera: (..., 3, 3). goal_middle: the middle at the goal (3,) [m].
        """
        xy, goal_xy, ratio = m[..., :2] / m[..., 2:], goal_middle[:2] / goal_middle[2], m[..., 2:]
        at, depth = xy[..., None, :], ratio * goal_middle[2]
        turn = _THETA_U.measure(R_goal_camera)
        rows = (_POINT.interaction(at, depth), _LOG_DEPTH.interaction(at, depth), _THETA_U.interaction_at(turn))
        e = np.concatenate([xy - goal_xy, np.log(ratio), turn], axis=-1)
        return e, np.concatenate(rows, axis=-2)


def _compared(T_camera_target: Array, goal: Goal) -> tuple[Array, Array]:
    """The markers' middle over Z* (..., 3) in the camera's frame, and R_goal_camera (..., 3, 3), from poses (..., 4, 4)."""
    T_camera_goal = T_camera_target @ inverse(goal.T_camera_target)
    R = T_camera_goal[..., :3, :3]
    return (R @ goal.middle + T_camera_goal[..., :3, 3]) / goal.middle[2], R.mT


def _reaches(points: Array) -> Array:
    """How far points (N, 3) reach along their own three axes, from the longest to the shortest (3,) [m]."""
    return np.linalg.svd(points - points.mean(axis=0), compute_uv=False).astype(float)
