"""A gap: its error, the speeds that both vehicles must keep, and how far they have come."""

import numpy as np
import pytest

import vstestbed as vs
from vstestbed.core.errors import ParameterError, ScenarioError
from vstestbed.core.geometry import inverse
from vstestbed.core.planar import place_of, pose_on_ground
from vstestbed.tasks.following import leader_and_follower

STILL = {"target.motion": "still", "target.pose.xyz": [3, 0, 0.6]}


def test_both_distances_count_the_leaders_by_its_own_origin():
    target = vs.load("car_pursuit").target
    odometer = leader_and_follower(target)
    for k in range(101):
        leader = pose_on_ground(np.array([0.02 * k, 0.0, 0.0]))
        travelled = odometer(
            pose_on_ground(np.array([-3 + 0.01 * k, 0.5, 0.1])), leader @ target.pose.T
        )
    assert travelled == pytest.approx((2.0, 1.0))


def test_only_a_vehicle_that_is_told_to_drive_has_a_least_speed():
    scenario = vs.load("car_pursuit")
    speeds, odometer = scenario.goal.least_speeds(scenario.setup)
    assert speeds == (("the vehicle ahead", 0.5, 0.4), ("the vehicle that follows", 0.5, 0.25))
    assert odometer is not None
    still = vs.load("car_pursuit", STILL)
    assert still.goal.least_speeds(still.setup) == ((), None)


def test_its_error_is_the_distance_on_the_floor_minus_the_gap():
    scenario = vs.load("car_pursuit", {"goal.gap_m": 1.5})
    T_target = pose_on_ground(np.array([4.0, 6.0, 1.0]))
    T_target[2, 3] = 0.7  # how high it sits is no distance
    assert scenario.goal.error_m(
        scenario.setup, pose_on_ground(np.array([1.0, 2.0, 0.3])), T_target, 0.0
    ) == pytest.approx(3.5)


def test_a_tenth_of_it_is_the_band_by_default():
    assert vs.load(
        "car_pursuit", {"goal.gap_m": 2.0, "goal.band_m": None}
    ).goal.tolerance_m == pytest.approx(0.2)
    assert vs.load("car_pursuit", {"goal.band_m": 0.07}).goal.tolerance_m == 0.07


def test_the_goal_view_is_that_of_the_target_straight_ahead():
    scenario = vs.load("car_pursuit", {"goal.gap_m": 2.0})
    target, mount = scenario.target, scenario.camera.mount.T
    (pose,) = scenario.goal.goal_poses(target, mount)
    x, y, heading = place_of(mount @ pose @ inverse(target.pose.T))
    assert scenario.goal_view.gap_m == 2.0
    origin = (mount @ pose)[:3, 3]
    np.testing.assert_allclose(origin, [2.0, 0.0, target.pose.xyz[2]], atol=1e-12)
    assert heading == pytest.approx(0.0, abs=1e-12)
    assert y == pytest.approx(-target.pose.xyz[1], abs=1e-12)
    assert x == pytest.approx(2.0 - target.pose.xyz[0])


def test_a_gap_that_cannot_be_kept_is_refused_with_what_would_work():
    for settings, words in (
        # Its bumper ends .188 m behind its origin, the follower's 1.208 m before its own, the
        # target sits .25 m behind its origin.
        (
            {"goal.gap_m": 1.1},
            (
                "goal.gap_m: must be over 1.146 m:"
                " there the front of robot car, 1.208 m before its origin"
            ),
        ),
        ({"target.motion.by": "omni", "goal.gap_m": 1.1}, "must be over 1.166 m"),
        # One point, or one above the other, beside the origin to which the gap is measured
        ({"target.at": [[0, 0.3, 0]]}, "target: has its points at one place of the floor plan"),
        (
            {"target.at": [[0.1, 0, 0], [0.1, 0, 0.5]]},
            "put the place into target.pose, or add a point beside it",
        ),
        ({"target.at": [[0, 0, 0.2]]}, "target: has its points at the camera's own height"),
    ):
        with pytest.raises((ParameterError, ScenarioError)) as told:
            vs.load("car_pursuit", settings)
        assert words in str(told.value)


def test_a_gap_that_can_be_kept_is_taken():
    for settings in (
        {"goal.gap_m": 1.2},
        STILL | {"goal.gap_m": 0.5},  # a sign, which has no body
        {"target.at": [[0, 0, 0.5]]},
    ):
        vs.load("car_pursuit", settings)
