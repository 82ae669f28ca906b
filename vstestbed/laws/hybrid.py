"""2.5D visual servoing: the image of a point, the ratio of its depths, and the rotation."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array, inverse
from vstestbed.core.spec import spec
from vstestbed.features import Point, ThetaU
from vstestbed.features.observation import Goal, Observation
from vstestbed.features.pose import log_depth_interaction
from vstestbed.laws.error_law import Equations, ErrorLaw

# markers lie in a plane (on a line) if they extend less than this share of the set's length off it
FLAT = 1e-3
_THETA_U = ThetaU()
_POINT = Point()


@spec
class Hybrid(ErrorLaw):
    """u = -lambda pinv(L B) e with e = (x - x*, y - y*, log(Z/Z*), theta u), camera twist v = B u.

    (x, y) is the image of the markers' mean in space, Z its depth, and theta u the rotation
    R_goal_camera. They come from
    - the `homography` between the goal view and this one: it maps the mean, which lies in the
      markers' plane, from m* (goal) to Z/Z* m = H m*, and H = R + t n^T/d* is decomposed into the
      rotation, the ratio Z/Z* and the image of the mean without the target's dimensions; the depth
      Z* at the goal is known;
    - or the `model`: the pose by perspective-n-point.

    The image of the mean moves on a straight line, so that the target stays in view for small
    rotations, and the law has no local minimum and no singularity in front of the target.

    For `feedforward` the target's displacement between two frames is that of these six features,
    less the camera's own.

    Args:
        source: `homography` (default; needs four or more visible markers in one plane, of which not
            all but one lie on a line) or `model`.

    Reference: Malis, Chaumette & Boudet 1999, doi:10.1109/70.760345.
    """

    kind: Literal["hybrid"] = "hybrid"
    stacks = False
    source: Literal["homography", "model"] = "homography"

    @property
    def inputs(self) -> tuple[str, ...]:
        """The homography or the pose."""
        return ("relative",) if self.source == "homography" else ("T_camera_target",)

    def check(self, points: Array, goal: Goal) -> None:
        """Refuse, for a homography, markers not in one plane, or all but one of them on a line."""
        if self.source == "model":
            return
        *_, thickness = reaches = _reaches(points)
        if thickness > FLAT * reaches[0]:
            words = (
                "has markers that are not in one plane, which a homography requires;"
                " use law.source: model"
            )
        elif any(
            _reaches(np.delete(points, i, axis=0))[1] <= FLAT * reaches[0]
            for i in range(len(points))
        ):
            # With all but one on a line, no four points are in general position, which a homography
            # needs.
            words = (
                "has all markers but one on a line, which leaves the homography undetermined;"
                " use law.source: model, or other places"
            )
        else:
            return
        raise ParameterError("target", words)

    def markers_needed(self, basis: Array) -> int:
        """Four determine a homography; three a pose, next to the last one."""
        return 4 if self.source == "homography" else 3

    def equations(self, view: Any, goal: Any) -> Equations:
        """The error (..., 6) and L (..., 6, 6); of many views by the pose: with exact pixels the
        homography gives the same.
        """
        return self.of_middle(*self._compared(view, goal), goal.middle)

    def change(self, before: Observation, now: Observation, goal: Goal) -> Equations:
        """The law's equations with the last frame in place of the goal."""
        m0, R0 = self._compared(before, goal)
        m1, R1 = self._compared(now, goal)
        middle = m0 * goal.middle[2]
        e, L = self.of_middle(m1 / m0[2], R0.T @ R1, middle)
        # The mean of both matrices: with one of them, the change is explained to first order in the
        # motion only.
        return e, (L + self.of_middle(m0 / m0[2], np.eye(3), middle)[1]) / 2

    def _compared(self, view: Any, goal: Goal) -> tuple[Array, Array]:
        """The markers' mean over Z* (..., 3) in the camera frame, and R_goal_camera (..., 3, 3)."""
        o = goal.middle
        if self.source == "homography" and view.relative is not None:
            # H m* = Z/Z* m, with m* = o / Z* in normalised coordinates.
            H, R_camera_goal = view.relative
            return H @ (o / o[2]), R_camera_goal.T
        T_camera_goal = view.T_camera_target @ inverse(goal.T_camera_target)
        R = T_camera_goal[..., :3, :3]
        return (R @ o + T_camera_goal[..., :3, 3]) / o[2], R.mT

    @staticmethod
    def of_middle(m: Array, R_goal_camera: Array, goal_middle: Array) -> Equations:
        """The error (..., 6) and L (..., 6, 6).
        m: the markers' mean over Z*, (..., 3). R_goal_camera: (..., 3, 3). goal_middle: the mean at
        the goal (3,) [m].
        """
        xy = m[..., :2] / m[..., 2:]
        goal_xy = goal_middle[:2] / goal_middle[2]
        ratio = m[..., 2:]
        at = xy[..., None, :]
        depth = ratio * goal_middle[2]
        turn = _THETA_U.measure(R_goal_camera)
        # Rows in the order of e: x, y, log Z, theta u.
        rows = (
            _POINT.interaction(at, depth),
            log_depth_interaction(at, depth),
            _THETA_U.interaction_at(turn),
        )
        e = np.concatenate([xy - goal_xy, np.log(ratio), turn], axis=-1)
        return e, np.concatenate(rows, axis=-2)


def _reaches(points: Array) -> Array:
    """Singular values (3,) of centred points (N, 3) [m], descending: their extent along the
    principal axes.
    """
    return np.linalg.svd(points - points.mean(axis=0), compute_uv=False).astype(float)
