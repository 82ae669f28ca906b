"""Tracking: the error is the camera's distance from where it should be,
wherever the target is now.
"""

import numpy as np
import pytest

import vstestbed as vs
from vstestbed.core.geometry import Pose, inverse
from vstestbed.tasks import GoalTrack


def test_its_error_moves_with_the_target():
    setup = vs.load(
        "arm_ibvs", {"camera.mount": {"xyz": [0.03, 0, 0.1], "rpy_deg": [20, 0, 0]}}
    ).setup
    goal = GoalTrack(T_camera_target=Pose(xyz=(0, 0, 0.8)))
    for T_target in (Pose(xyz=(1, 2, 3), rpy_deg=(10, 20, 30)).T, Pose(xyz=(-4, 0, 1)).T):
        T_camera = T_target @ inverse(goal.T_camera_target.T)
        for step, error in ((np.zeros(3), 0.0), (np.array([0.03, 0.04, 0.0]), 0.05)):
            moved = T_camera.copy()
            moved[:3, 3] += step
            T_base = moved @ inverse(setup.camera.mount.T)
            assert goal.error_m(setup, T_base, T_target, 0.0) == pytest.approx(error, abs=1e-12)


def test_any_robot_may_track_and_nobody_must_keep_going():
    goal, setup = (
        GoalTrack(T_camera_target=Pose(xyz=(0, 0, 1)), band_m=0.1, settle_s=2.0),
        vs.load("arm_ibvs").setup,
    )
    assert goal.bases == {"fixed", "planar", "floating"} and goal.continuing
    assert (goal.tolerance_m, goal.settle_s, goal.end_s) == (0.1, 2.0, 0.0)
    assert goal.least_speeds(setup) == ((), None)
