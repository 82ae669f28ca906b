"""Position-based visual servoing: the pose is the feature."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np

from vstestbed.core.geometry import inverse, log
from vstestbed.core.spec import spec
from vstestbed.features import ThetaU
from vstestbed.features.observation import Goal, Observation
from vstestbed.features.pose import translation_interaction
from vstestbed.laws.error_law import Equations, ErrorLaw

_THETA_U = ThetaU()


@spec
class PBVS(ErrorLaw):
    """u = -lambda pinv(L B) e with e = (t - t*, theta u); the camera twist is v = B u.

    The rotation is theta u of R = R_goal_camera; the translation t and its rows of L are one of
    three:

    `cdMc`  t of the camera in the goal frame,     L_t = [R, 0]:
            the camera moves on a straight line to its goal;
    `cMcd`  t of the goal in the camera frame,     L_t = [-I, [t]x]:
            the goal moves on a straight line in the camera frame;
    `cMo`   t of the target in the camera frame,   L_t = [-I, [t]x]:
            the target's origin moves on a straight line in the camera frame to its place at the
            goal, so that it stays in view.

    The pose comes from the markers' pixels and the known target (perspective-n-point); its errors
    enter the law.

    For `feedforward` the target's displacement between two frames is that of the poses,
    log(T_before T_now^-1), less the camera's own.

    Errata. Corke 2017, section 15.1, moves the camera by a fraction of the pose error at each step
    (SE(3) interpolation), which is `cdMc` in finite steps; here the law gives a velocity, and the
    robot's dynamics lie in between.

    Args:
        translation: `cdMc`, `cMcd` or `cMo`.

    Reference: Chaumette & Hutchinson 2006, eqs 15-20, doi:10.1109/MRA.2006.250573.
    """

    kind: Literal["pbvs"] = "pbvs"
    translation: Literal["cdMc", "cMcd", "cMo"] = "cdMc"
    inputs = ("T_camera_target",)

    def equations(self, view: Any, goal: Any) -> Equations:
        """The error (..., 6) and L (..., 6, 6) by the poses of the target in the camera frame and
        in the goal frame.
        """
        T_camera_target = view.T_camera_target
        T_goal_target = goal.T_camera_target
        T_goal_camera = T_goal_target @ inverse(T_camera_target)
        if self.translation == "cMo":
            pose = T_camera_target
            s_star = T_goal_target[:3, 3]
        else:
            pose = inverse(T_goal_camera) if self.translation == "cMcd" else T_goal_camera
            s_star = np.zeros(3)
        turn = _THETA_U.measure(T_goal_camera[..., :3, :3])
        e = np.concatenate([pose[..., :3, 3] - s_star, turn], axis=-1)
        rows = translation_interaction(pose, self.translation), _THETA_U.interaction_at(turn)
        return e, np.concatenate(rows, axis=-2)

    def change(self, before: Observation, now: Observation, goal: Goal) -> Equations:
        """Change of the pose since the last frame, as a displacement of the camera relative to the
        target (6,); here L = I.
        """
        assert before.T_camera_target is not None and now.T_camera_target is not None
        return log(before.T_camera_target @ inverse(now.T_camera_target)), np.eye(6)
