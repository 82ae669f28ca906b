"""An arm of two joints as a plugin: it passes the suite of robots, and its camera finds a marker in
MuJoCo.
"""

from __future__ import annotations

import numpy as np
import pytest

import vstestbed as vs
from tests.examples.two_link import TwoLink
from vstestbed.camera import Perspective
from vstestbed.core.geometry import Pose
from vstestbed.features.depth import AtGoal
from vstestbed.laws import IBVS
from vstestbed.targets import Points
from vstestbed.tasks import GoalView
from vstestbed.tasks.stop import Converged, Stop
from vstestbed.vision import Oracle

DOWN = (180.0, 0.0, 0.0)


def test_its_basis_changes_with_its_configuration():
    """Fewer than six joints, and finite differences of its flange's pose agree."""
    vs.testing.check_robot(TwoLink())
    mount = vs.Mount.of(np.eye(4))
    bent, straight = (TwoLink().motion_basis(mount, np.array([0.3, elbow])) for elbow in (1.2, 0.1))
    assert bent.shape == (6, 2)
    assert np.abs(bent - straight).max() > 0.1


@pytest.mark.usefixtures("own_kinds")
def test_it_servoes_on_one_marker():
    """Two motions, two coordinates: the marker comes to the middle of the picture, with masses and
    velocity servos.
    """
    vs.ROBOTS.add(TwoLink)
    scenario = vs.Scenario(
        robot=TwoLink(),
        # under the link, which would hide the marker
        camera=Perspective(mount=Pose(xyz=(0, 0, -0.06), rpy_deg=DOWN)),
        target=Points(at=((0, 0, 0),), pose=Pose(xyz=(0.45, 0.45, 0.1), rpy_deg=DOWN)),
        detector=Oracle(),
        law=IBVS(gain=1.5, depth=AtGoal()),  # pyright: ignore[reportArgumentType] - a number is a constant gain
        goal=GoalView(T_camera_target=Pose(xyz=(0, 0, 0.84))),
        stop=Stop(duration_s=10, converged=Converged(error_px=0.5)),
    )
    recording = vs.run(scenario)
    assert recording.outcome is vs.Outcome.converged, recording.reason
    assert {"q_shoulder", "qd_elbow", "ctrl_elbow"} <= set(recording.columns)
    tip = TwoLink().flange_pose(np.array([recording["q_shoulder"][-1], recording["q_elbow"][-1]]))
    assert tip[:2, 3] == pytest.approx([0.45, 0.45], abs=2e-3)  # over the marker
