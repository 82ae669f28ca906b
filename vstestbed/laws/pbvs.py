"""Position-based visual servoing: the pose is the feature."""

from __future__ import annotations

from typing import Literal

import numpy as np

from vstestbed.core.geometry import Array, inverse, log
from vstestbed.core.spec import spec
from vstestbed.features import ThetaU, Translation
from vstestbed.features.observation import Goal, Observation
from vstestbed.laws.base import Command, ConstantGain, Gain, LawBase, TwistLimits
from vstestbed.laws.feedforward import Change, Feedforward, NoFeedforward
from vstestbed.laws.following import NOTHING, Followed, anti_windup, coasting, feedforward_term, inputs_of, usable_pose
from vstestbed.laws.points import NO_POSE, TOO_FEW
from vstestbed.laws.solve import Solve
from vstestbed.laws.views import Views

_THETA_U = ThetaU()
_TRANSLATIONS = {"cdMc": Translation(pose="cdMc"), "cMcd": Translation(pose="cMcd"), "cMo": Translation(pose="cMo")}


@spec
class PBVS(LawBase):
    """u = -lambda pinv(L B) e with e = (t - t*, theta u); the camera twist is v = B u.

    The rotation is theta u of R = R_goal_camera; the translation t and its rows of L are one of three:
    `cdMc`  t of the camera in the goal frame,      L_t = [R, 0]: the camera moves on a straight line to its goal;
    `cMcd`  t of the goal in the camera frame,      L_t = [-I, [t]x]: the goal moves on a straight line in the camera frame;
    `cMo`   t of the target in the camera frame,    L_t = [-I, [t]x]: the target's origin moves on a straight line in the camera
    frame to its place at the goal, so that it stays in view.
    The pose comes from the markers' pixels and the known target (perspective-n-point); its errors enter the law.

    With `feedforward` a moving target is tracked without lag, for CARRY_S also while it is not visible. Its displacement between two frames
    is that of the poses, log(T_before T_now^-1), less the camera's own.

    Errata. Corke 2017, section 15.1, moves the camera by a fraction of the pose error at each step (SE(3) interpolation), which is
    `cdMc` in finite steps; here the law gives a velocity, and the robot's dynamics lie in between.

    Args:
        gain: lambda [1/s].
        translation: `cdMc`, `cMcd` or `cMo`.
        solve: inversion of L B (`Solve`).
        limits: largest speed and rate of the commanded twist.
        feedforward: the feedforward term for a moving target.

    Reference: Chaumette & Hutchinson 2006, eqs 15-20, doi:10.1109/MRA.2006.250573.
    """

    kind: Literal["pbvs"] = "pbvs"
    gain: Gain = ConstantGain()
    translation: Literal["cdMc", "cMcd", "cMo"] = "cdMc"
    solve: Solve = Solve()
    limits: TwistLimits = TwistLimits()
    feedforward: Feedforward = NoFeedforward()
    state_size = 0

    @property
    def inputs(self) -> tuple[str, ...]:
        """The fields of an Observation that it looks at."""
        return ("T_camera_target", *inputs_of(self.feedforward))

    def init(self, goal: Goal) -> Followed:
        """The target's motion is unknown."""
        return NOTHING

    def markers_needed(self, basis: Array) -> int:
        """Three: with as few the pose has up to four solutions, and the observer takes the one next to the last pose."""
        return 3

    def step(self, memory: Followed, observation: Observation, goal: Goal, basis: Array) -> tuple[Followed, Command]:
        """One frame; rest where no pose is known."""
        measured = observation.T_camera_target
        few = np.count_nonzero(observation.seen) < self.markers_needed(basis)
        why = NO_POSE if measured is None else TOO_FEW if few else ""
        known = usable_pose(self.feedforward, memory, observation, goal, basis, why)
        T = None if known is None else known.T_camera_target
        if known is None or T is None:
            return NOTHING, Command.rest(basis, why)
        e, L = self.equations(T, goal.T_camera_target)
        solved = self.solve.least_squares(L @ basis, e)
        followed, solved, tau = feedforward_term(self.feedforward, memory, known, solved, _change(memory.seen, T), basis, why)
        command = self.limits.command(-self.gain.at(solved) * solved - tau, basis)
        return anti_windup(memory, followed, command), coasting(command, why)

    def step_batch(self, memory: Array, views: Views, goal: Goal) -> tuple[Array, Array]:
        """One frame of many runs (see `BatchLaw`)."""
        e, L = self.equations(views.T_camera_target, goal.T_camera_target)
        solved = self.solve.least_squares(L, e)
        return memory, self.limits.within(-self.gain.at(solved) * solved)

    def equations(self, T_camera_target: Array, T_goal_target: Array) -> tuple[Array, Array]:
        """The error (..., 6) and L (..., 6, 6) for poses of the target in the camera frame (..., 4, 4) and the goal frame (4, 4)."""
        T_goal_camera = T_goal_target @ inverse(T_camera_target)
        t, R = _TRANSLATIONS[self.translation], T_goal_camera[..., :3, :3]
        if self.translation == "cMo":
            pose, s_star = T_camera_target, T_goal_target[:3, 3]
        else:
            pose, s_star = inverse(T_goal_camera) if self.translation == "cMcd" else T_goal_camera, np.zeros(3)
        turn = _THETA_U.measure(R)
        e = np.concatenate([t.error(t.measure(pose), s_star), turn], axis=-1)
        return e, np.concatenate([t.interaction(pose), _THETA_U.interaction_at(turn)], axis=-2)


def _change(before: Observation | None, T_now: Array) -> Change | None:
    """Change of the pose (4, 4) since the last frame, as a displacement of the camera relative to the target (6,); here L = I."""
    if before is None or before.T_camera_target is None:
        return None
    return Change(log(before.T_camera_target @ inverse(T_now)), np.eye(6))
