"""Position-based visual servoing: the pose is the feature."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np

from vstestbed.core.geometry import Array, inverse, log
from vstestbed.core.spec import spec
from vstestbed.features import ThetaU, Translation
from vstestbed.features.observation import Goal, Observation
from vstestbed.laws.base import Command, ConstantGain, Gain, LawBase, TwistLimits
from vstestbed.laws.feedforward import Change, Feedforward, NoFeedforward
from vstestbed.laws.following import NOTHING, Followed, anti_windup, coast, feedforward_term, inputs_of
from vstestbed.laws.select import NO_POSE, TOO_FEW
from vstestbed.laws.solve import least_squares
from vstestbed.laws.views import Views

_THETA_U = ThetaU()
_TRANSLATIONS = {"cdMc": Translation(pose="cdMc"), "cMcd": Translation(pose="cMcd"), "cMo": Translation(pose="cMo")}


@spec
class PBVS(LawBase):
    """u = -lambda pinv(L B) e with e = (t - t*, theta u); the camera twist is v = B u.

    The rotation is theta u of R = R_goal_camera; the translation t and its rows of L, with o the target's origin:
    `cdMc`  t of the camera in the goal's frame,            L_t = [R, 0]: the camera goes straight to its goal;
    `cMcd`  t of the goal in the camera's frame,            L_t = [-I, [t]x]: the goal comes straight at the camera;
    `cMo`   t of the target in the camera's frame,          L_t = [-I, [t]x]: the target's origin goes straight to where it is
    in the goal's frame, so that it stays in view.
    The pose comes from the markers' pixels and the known target (perspective-n-point); its errors are the law's.

    With `feedforward` a target that moves is followed without lag (`feedforward.py`), for a second also unseen. Its displacement
    between two pictures is that of the poses, log(T_before T_now^-1), less the camera's own.

    Errata. Corke 2017, section 15.1, moves the camera by a share of the pose error at each step, SE3 interpolation, which is
    `cdMc` in steps of finite length; here it is a velocity, and the robot's dynamics are in between.

    Args:
        gain: lambda [1/s].
        translation: which of the three.
        limits: largest speed and rate of the commanded twist.
        feedforward: what is done about a target that moves.

    Reference: Chaumette & Hutchinson 2006, eqs 15-20, doi:10.1109/MRA.2006.250573.
    """

    kind: Literal["pbvs"] = "pbvs"
    gain: Gain = ConstantGain()
    translation: Literal["cdMc", "cMcd", "cMo"] = "cdMc"
    limits: TwistLimits = TwistLimits()
    feedforward: Feedforward = NoFeedforward()

    @property
    def inputs(self) -> tuple[str, ...]:
        """The fields of an Observation that it looks at."""
        return ("T_camera_target", *inputs_of(self.feedforward))

    def init(self, goal: Goal) -> Followed:
        """Nothing known of the target's motion."""
        return NOTHING

    def markers_needed(self, basis: Array) -> int:
        """Three markers leave a pose that continues the last one."""
        return 3

    def step(self, memory: Followed, observation: Observation, goal: Goal, basis: Array) -> tuple[Followed, Command]:
        """One frame; rest where no pose can be told."""
        T = observation.T_camera_target
        if T is None or np.count_nonzero(observation.seen) < self.markers_needed(basis):
            return self._without(memory, observation, basis, NO_POSE if T is None else TOO_FEW)
        e, L = self.equations(T, goal.T_camera_target)
        solved = least_squares(L @ basis, e)
        followed, solved, aside = feedforward_term(self.feedforward, memory, observation, solved, _change(memory.seen, T), basis)
        command = self.limits.command(-self.gain.at(solved) * solved - aside, basis)
        return anti_windup(memory, followed, command), command

    def _without(self, memory: Followed, seen: Observation, basis: Array, why: str) -> tuple[Followed, Command]:
        """A frame without a pose: rest, or on with the target's own motion."""
        gone_on = coast(self.feedforward, memory, seen, basis)
        if gone_on is None:
            return NOTHING, Command.rest(basis, why)
        followed, u = gone_on
        return followed, replace(self.limits.command(u, basis), rest_reason=why)

    @property
    def state_size(self) -> int:
        """Nothing."""
        return 0

    def step_batch(self, memory: Array, views: Views, goal: Goal) -> tuple[Array, Array]:
        """One frame of many runs (see `BatchLaw`)."""
        e, L = self.equations(views.T_camera_target, goal.T_camera_target)
        solved = least_squares(L, e)
        return memory, self.limits.within(-self.gain.at(solved) * solved)

    def equations(self, T_camera_target: Array, T_goal_target: Array) -> tuple[Array, Array]:
        """The error (..., 6) and L (..., 6, 6) at poses of the target, (..., 4, 4) in the camera's frame and (4, 4) in the goal's."""
        T_goal_camera = T_goal_target @ inverse(T_camera_target)
        by_itself = T_camera_target if self.translation == "cMo" else T_goal_camera
        seen = inverse(T_goal_camera) if self.translation == "cMcd" else by_itself
        t, R = _TRANSLATIONS[self.translation], T_goal_camera[..., :3, :3]
        s_star = T_goal_target[:3, 3] if self.translation == "cMo" else np.zeros(3)
        turn = _THETA_U.measure(R)
        e = np.concatenate([t.error(t.measure(seen), s_star), turn], axis=-1)
        return e, np.concatenate([t.interaction(seen), _THETA_U.interaction_at(turn)], axis=-2)


def _change(before: Observation | None, T_now: Array) -> Change | None:
    """How the pose (4, 4) changed since the last picture, as a displacement of the camera against the target, (6,)."""
    if before is None or before.T_camera_target is None:
        return None
    return Change(log(before.T_camera_target @ inverse(T_now)), np.eye(6))
