"""An arm that is shown its goal stands there in truth."""

from __future__ import annotations

import numpy as np
import pytest

import vstestbed as vs
from vstestbed.core.geometry import inverse, rigid_error
from vstestbed.sim.base import flange_for, posture_at
from vstestbed.sim.plant import shown_at
from vstestbed.sim.scene.scene import Scene


@pytest.mark.parametrize("level", ["none", "field"])
def test_the_camera_is_at_the_goal_view(level: str) -> None:
    s = vs.load("arm_ibvs", {"robot.realism": level}).resolved
    stage = Scene(s.scene)
    T = flange_for(s.camera, s.target, s.goal_poses[-1])
    own = posture_at(s.robot, T)
    q = shown_at(stage, T, own)
    stage.place(0.0, s.target.T_world_start, q)
    away_m, away_rad = rigid_error(stage.camera_pose() @ inverse(s.camera.mount.T), T)
    stage.close()
    assert away_m < 2e-6 and away_rad < 2e-6
    assert np.abs(q - own).max() > 1e-4 if level == "field" else (q == own).all()
