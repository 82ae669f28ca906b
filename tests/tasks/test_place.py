"""A place: where a vehicle is to stand, reached by its own estimate."""

from dataclasses import replace

import numpy as np
import pytest

import vstestbed as vs
from vstestbed.core.errors import ParameterError, ScenarioError
from vstestbed.core.geometry import transform
from vstestbed.core.planar import GroundPose
from vstestbed.tasks import GoalPlace


def test_the_goal_view_is_that_from_the_place():
    scenario = vs.load("car_pbvs")
    pose, mount, target = scenario.goal.pose, scenario.camera.mount.T, scenario.target
    (T_camera_target,) = scenario.goal_poses
    np.testing.assert_allclose(pose.T @ mount @ T_camera_target, target.pose.T, atol=1e-12)
    np.testing.assert_array_equal(scenario.goal_view.place, pose.place)
    np.testing.assert_allclose(
        scenario.goal_view.depth, transform(T_camera_target, target.points)[:, 2]
    )


def test_a_place_from_which_nothing_is_seen_is_a_goal_too():
    """The vehicle gets there by its landmarks; where it stands in the end they may be behind it."""
    scenario = vs.load("car_pbvs")
    x, y, heading = scenario.goal.pose.place
    turned = GoalPlace(
        pose=GroundPose(x=float(x), y=float(y), heading_deg=float(np.degrees(heading)) + 180)
    )
    assert (replace(scenario, goal=turned).goal_view.depth < 0).any()


def test_a_place_that_cannot_be_reached_is_refused_with_what_would_work():
    for name, settings, words in (
        (
            "car_pbvs",
            {"law.rest_m": 0.05},
            "law.rest_m: must be under stop.converged.position_m = 0.05 m",
        ),
        (
            "car_pbvs",
            {"stop.converged": {"error_px": 1}},
            "stop.converged: must have position_m or rotation_deg for a goal of kind pose",
        ),
        (
            "car_pbvs",
            {"target.motion": {"kind": "line", "velocity_mps": [0.1, 0, 0]}},
            "needs a target that stands still",
        ),
    ):
        with pytest.raises((ParameterError, ScenarioError)) as told:
            vs.load(name, settings)
        assert words in str(told.value)


def test_nearer_than_where_the_law_rests_it_is_taken():
    vs.load("car_pbvs", {"law.rest_m": 0.04})
