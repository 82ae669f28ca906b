"""Goal views that no camera has: markers outside the picture or behind it, and a craft that would
lean.
"""

import pytest

import vstestbed as vs
from vstestbed.core.errors import ScenarioError


def test_a_view_without_its_markers_is_refused():
    for name, change, words in (
        (
            "arm_ibvs",
            {"goal.T_camera_target.xyz": [0.5, 0, 0.8]},
            "goal.T_camera_target: is a view in which .* outside the .* picture",
        ),
        (
            "arm_ibvs",
            {"goal.T_camera_target.xyz": [0, 0, -1]},
            "markers 0, 1, 2, 3 are behind the camera; move the goal back",
        ),
    ):
        with pytest.raises(ScenarioError, match=words):
            vs.load(name, change)


def test_the_view_of_a_craft_that_leans_is_refused():
    for name, change, words in (
        # Views that a level craft does not have: leant, upside down, of points on a slope, through
        # a camera that looks aside
        (
            "quadrotor_hover",
            {"goal.T_camera_target.rpy_deg": [20, 0, 90]},
            "goal.T_camera_target: is the view .* tilted by 20 deg",
        ),
        ("quadrotor_hover", {"goal.T_camera_target.rpy_deg": [180, 0, 90]}, "tilted by 180 deg"),
        ("quadrotor_hover", {"target.pose.rpy_deg": [170, 0, 0]}, "tilted by 10 deg"),
        ("quadrotor_hover", {"camera.mount.rpy_deg": [180, 15, 0]}, "tilted by 15 deg"),
        (
            "quadrotor_path",
            {"goal.way.1.T_camera_target.rpy_deg": [0, 5, 0]},
            "goal.way.1.T_camera_target: .* tilted by 5 deg",
        ),
    ):
        with pytest.raises(ScenarioError, match=words):
            vs.load(name, change)
