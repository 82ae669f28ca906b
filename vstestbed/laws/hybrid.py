"""2.5D visual servoing: the image of a point, the ratio of its depths, and the rotation."""

from __future__ import annotations

from typing import Literal

import numpy as np

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array, inverse
from vstestbed.core.spec import spec
from vstestbed.features import LogDepth, Point, ThetaU
from vstestbed.features.observation import Goal, Observation
from vstestbed.laws.base import Command, ConstantGain, Gain, LawBase, TwistLimits
from vstestbed.laws.feedforward import Change, Feedforward, NoFeedforward
from vstestbed.laws.following import NOTHING, Followed, anti_windup, coasting, feedforward_term, inputs_of, usable_pose
from vstestbed.laws.points import NO_POSE, TOO_FEW, Visibility
from vstestbed.laws.solve import Solve
from vstestbed.laws.views import Views

FLAT = 1e-3
"""Markers lie in a plane (on a line) if they extend less than this share of the set's length off it."""
_THETA_U, _POINT, _LOG_DEPTH = ThetaU(), Point(), LogDepth()


@spec
class Hybrid(LawBase):
    """u = -lambda pinv(L B) e with e = (x - x*, y - y*, log(Z/Z*), theta u), camera twist v = B u.

    (x, y) is the image of the markers' mean in space, Z its depth, and theta u the rotation R_goal_camera. They come from
    - the `homography` between the goal view and this one: it maps the mean, which lies in the markers' plane, from m* (goal) to
      Z/Z* m = H m*, and H = R + t n^T/d* is decomposed into the rotation, the ratio Z/Z* and the image of the mean without the
      target's dimensions; the depth Z* at the goal is known;
    - or the `model`: the pose by perspective-n-point.
    The image of the mean moves on a straight line, so that the target stays in view for small rotations, and the law has
    no local minimum and no singularity in front of the target.

    With `feedforward` a moving target is tracked without lag, for CARRY_S also while it is not visible. Its displacement between two frames
    is that of these six features, less the camera's own.

    Args:
        gain: lambda [1/s].
        source: `homography` (default; needs four or more visible markers in one plane, of which not all but one lie on a line)
            or `model`.
        solve: inversion of L B (`Solve`).
        limits: largest speed and rate of the commanded twist.
        visibility: repulsive field at the border of the image.
        feedforward: the feedforward term for a moving target.

    Reference: Malis, Chaumette & Boudet 1999, doi:10.1109/70.760345.
    """

    kind: Literal["hybrid"] = "hybrid"
    gain: Gain = ConstantGain()
    source: Literal["homography", "model"] = "homography"
    solve: Solve = Solve()
    limits: TwistLimits = TwistLimits()
    visibility: Visibility = Visibility()
    feedforward: Feedforward = NoFeedforward()
    state_size = 0

    @property
    def inputs(self) -> tuple[str, ...]:
        """The homography or the pose, the camera's own motion for feedforward, and the markers' radii for `visibility`."""
        source = "relative" if self.source == "homography" else "T_camera_target"
        return (source, *inputs_of(self.feedforward), *self.visibility.inputs)

    def check(self, points: Array, goal: Goal) -> None:
        """Refuse, for a homography, markers not in one plane, or all but one of them on a line."""
        if self.source == "model":
            return
        *_, thickness = reaches = _reaches(points)
        if thickness > FLAT * reaches[0]:
            words = "has markers that are not in one plane, which a homography requires; use law.source: model"
        # With all but one on a line, no four points are in general position, which a homography needs.
        elif any(_reaches(np.delete(points, i, axis=0))[1] <= FLAT * reaches[0] for i in range(len(points))):
            words = "has all markers but one on a line, which leaves the homography undetermined; use law.source: model, or other places"
        else:
            return
        raise ParameterError("target", words)

    def markers_needed(self, basis: Array) -> int:
        """Four determine a homography; three a pose, next to the last one."""
        return 4 if self.source == "homography" else 3

    def init(self, goal: Goal) -> Followed:
        """The target's motion is unknown."""
        return NOTHING

    def step(self, memory: Followed, observation: Observation, goal: Goal, basis: Array) -> tuple[Followed, Command]:
        """One frame; rest where the homography or the pose is unknown."""
        few = np.count_nonzero(observation.seen) < self.markers_needed(basis)
        why = TOO_FEW if few else NO_POSE if self._compare(observation, goal) is None else ""
        known = usable_pose(self.feedforward, memory, observation, goal, basis, why)
        compared = None if known is None else self._compare(known, goal)
        if known is None or compared is None:
            return NOTHING, Command.rest(basis, why)
        e, L = self.equations(*compared, goal.middle)
        solved = self.solve.least_squares(L @ basis, e)
        change = self._change(memory.seen, compared, goal) if memory.seen else None
        followed, solved, tau = feedforward_term(self.feedforward, memory, known, solved, change, basis, why)
        u = -self.gain.at(solved) * solved - tau
        if self.visibility.margin_px > 0:
            u = u + self.visibility.push(observation, goal, basis)
        command = self.limits.command(u, basis)
        return anti_windup(memory, followed, command), coasting(command, why)

    def _change(self, before: Observation, now: tuple[Array, Array], goal: Goal) -> Change | None:
        """Change of the law's features since the last frame: its own equations, with that frame in place of the goal."""
        last = self._compare(before, goal)
        if last is None:
            return None
        (m0, R0), (m1, R1), middle = last, now, last[0] * goal.middle[2]
        e, L = self.equations(m1 / m0[2], R0.T @ R1, middle)
        # The mean of both matrices: with one of them, the change is explained to first order in the motion only.
        return Change(e, (L + self.equations(m0 / m0[2], np.eye(3), middle)[1]) / 2, self.solve)

    def _compare(self, observation: Observation, goal: Goal) -> tuple[Array, Array] | None:
        """The markers' mean over Z* (3,) in the camera frame, and R_goal_camera (3, 3)."""
        o, relative = goal.middle, observation.relative
        if self.source == "homography":
            # H m* = Z/Z* m, with m* = o / Z* in normalised coordinates.
            return None if relative is None else (relative.H @ (o / o[2]), relative.R_camera_goal.T)
        T = observation.T_camera_target
        return None if T is None else _compared(T, goal)

    def step_batch(self, memory: Array, views: Views, goal: Goal) -> tuple[Array, Array]:
        """One frame of many runs (see `BatchLaw`), by the pose: with exact pixels the homography gives the same."""
        e, L = self.equations(*_compared(views.T_camera_target, goal), goal.middle)
        solved = self.solve.least_squares(L, e)
        return memory, self.limits.within(-self.gain.at(solved) * solved)

    def equations(self, m: Array, R_goal_camera: Array, goal_middle: Array) -> tuple[Array, Array]:
        """The error (..., 6) and L (..., 6, 6).
        m: the markers' mean over Z*, (..., 3). R_goal_camera: (..., 3, 3). goal_middle: the mean at the goal (3,) [m].
        """
        xy, goal_xy, ratio = m[..., :2] / m[..., 2:], goal_middle[:2] / goal_middle[2], m[..., 2:]
        at, depth = xy[..., None, :], ratio * goal_middle[2]
        turn = _THETA_U.measure(R_goal_camera)
        # Rows in the order of e: x, y, log Z, theta u.
        rows = (_POINT.interaction(at, depth), _LOG_DEPTH.interaction(at, depth), _THETA_U.interaction_at(turn))
        e = np.concatenate([xy - goal_xy, np.log(ratio), turn], axis=-1)
        return e, np.concatenate(rows, axis=-2)


def _compared(T_camera_target: Array, goal: Goal) -> tuple[Array, Array]:
    """The markers' mean over Z* (..., 3) in the camera frame, and R_goal_camera (..., 3, 3), from poses (..., 4, 4)."""
    T_camera_goal = T_camera_target @ inverse(goal.T_camera_target)
    R = T_camera_goal[..., :3, :3]
    return (R @ goal.middle + T_camera_goal[..., :3, 3]) / goal.middle[2], R.mT


def _reaches(points: Array) -> Array:
    """Singular values (3,) of centred points (N, 3) [m], descending: their extent along the principal axes."""
    return np.linalg.svd(points - points.mean(axis=0), compute_uv=False).astype(float)
