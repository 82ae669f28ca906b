"""Constraints of a robot's velocities, each against what it stands for: finite differences of
pictures, distances, joint limits.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import vstestbed as vs
from vstestbed.camera import Fisheye, Perspective
from vstestbed.core.geometry import exp, transform
from vstestbed.features.observation import Goal, Observation
from vstestbed.laws.constraints import (
    above_plane,
    border,
    off_singularities,
    shared_limits,
    twist_limits,
    velocity_bounds,
)
from vstestbed.robots import Car, Mount
from vstestbed.robots.own_model import OwnModel

POINTS = np.array([[-0.2, -0.2, 0.05], [0.2, -0.2, 0.0], [0.25, 0.2, 0.0], [-0.2, 0.2, 0.0]])
T_GOAL = np.array([[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 1.0], [0, 0, 0, 1]])


def arm(**more: object) -> OwnModel:
    """The Puma in its nominal start, nothing under way."""
    scenario = vs.load("arm_ibvs")
    q = scenario.robot.start_joints()
    model = scenario.robot.own_model(vs.Reading(q, 0 * q), Mount.of(scenario.camera.mount.T))
    return replace(
        model,
        **(
            {
                "underway": np.zeros(6),
                "coming": np.zeros(6),
                "ordered": np.zeros(6),
                "moved": np.zeros(6),
            }
            | more
        ),
    )


def seen(camera: Perspective | Fisheye, T: np.ndarray) -> tuple[Observation, Goal]:
    """An observation of the four points from a pose T_camera_target, and the goal view."""
    p = transform(T, POINTS)
    uv, reach = camera.project(p), np.linalg.norm(p, axis=1)
    xy = p[:, :2] / p[:, 2:]
    return Observation(
        0.0, uv, xy, p[:, 2], T, p / reach[:, None], reach, radius_px=np.full(4, 7.0)
    ), Goal.from_view(camera, POINTS, T_GOAL)


@pytest.mark.parametrize("camera", [Perspective(), Fisheye()], ids=["perspective", "fisheye"])
def test_barriers_are_those_of_the_markers_edges_in_any_lens(camera: Perspective | Fisheye) -> None:
    T = exp(np.array([0.1, -0.05, 0.9, 0.2, -0.1, 0.3]))
    observation, goal = seen(camera, T)
    robot, rng = arm(), np.random.default_rng(0)
    group = border(observation, goal, robot, 12.0, 3.0)
    for rates in rng.normal(size=(5, 6)):
        ahead, behind = (
            camera.project(transform(exp(-side * 1e-6 * (robot.J @ rates)) @ T, POINTS))
            for side in (1, -1)
        )
        h_dot = (camera.borders(ahead)[0] - camera.borders(behind)[0]).ravel() / 2e-6
        np.testing.assert_allclose(
            group.A @ rates, h_dot, rtol=1e-4, atol=1e-3 * np.abs(h_dot).max()
        )
    h = camera.borders(observation.uv)[0].ravel() - 7.0 - 12.0
    np.testing.assert_allclose(group.low, -3.0 * h, atol=1e-9)


def test_barriers_hold_where_the_command_takes_effect() -> None:
    camera, T = Perspective(), exp(np.array([0.1, -0.05, 1.0, 0.2, -0.1, 0.3]))
    observation, goal = seen(camera, T)
    way = np.array([0.01, -0.005, 0.01, 0.0, 0.01, 0.02])
    robot = arm(underway=way, coming=way)  # by commands that are still to take effect
    later, _ = seen(camera, exp(-robot.way) @ T)
    group = border(observation, goal, robot, 12.0, 3.0)
    h = camera.borders(later.uv)[0].ravel() - 7.0 - 12.0
    # px/s, of barriers 100 to 900 px away
    np.testing.assert_allclose(group.low, -3.0 * h, atol=5.0)
    assert np.abs(border(observation, goal, arm(), 12.0, 3.0).low - group.low).max() > 20


def test_a_marker_that_is_not_seen_has_no_barrier() -> None:
    observation, goal = seen(Perspective(), T_GOAL)
    lost = observation.only(np.array([True, False, True, False]))
    assert len(border(lost, goal, arm(), 5.0, 3.0).A) == 8
    assert len(border(lost.only(np.zeros(4, bool)), goal, arm(), 5.0, 3.0).A) == 0


def test_the_distance_to_the_targets_plane() -> None:
    flat = POINTS * [1, 1, 0]
    T = exp(np.array([0.1, -0.05, 0.9, 0.2, -0.1, 0.3]))
    p = transform(T, flat)
    observation, goal = seen(Perspective(), T)
    observation = replace(observation, xy=p[:, :2] / p[:, 2:], depth=p[:, 2], ray=None, range=None)
    robot = arm()
    group = above_plane(observation, goal, robot, 0.5, 2.0)

    def distance(T: np.ndarray) -> float:
        return abs(float(np.linalg.inv(T)[2, 3]))  # the camera's z in the target's frame

    assert group.low[0] == pytest.approx(-2.0 * (distance(T) - 0.5))
    for rates in np.random.default_rng(1).normal(size=(4, 6)):
        step = 1e-6 * (robot.J @ rates)
        assert float((group.A @ rates)[0]) == pytest.approx(
            (distance(exp(-step) @ T) - distance(exp(step) @ T)) / 2e-6, abs=1e-6
        )


def test_the_plane_of_a_single_marker_faces_the_camera() -> None:
    T = exp(np.array([0.1, -0.05, 0.9, 0.2, -0.1, 0.3]))
    observation, goal = seen(Perspective(), T)
    p, robot = transform(T, POINTS)[0], arm()
    group = above_plane(
        observation.only(np.array([True, False, False, False])), goal, robot, 0.5, 2.0
    )
    assert group.low[0] == pytest.approx(-2.0 * (np.linalg.norm(p) - 0.5))
    assert group.A[0] == pytest.approx(-(p / np.linalg.norm(p)) @ robot.J[:3])


def test_bounds_stop_a_joint_at_its_margin_and_bring_it_back_from_beyond() -> None:
    robot = arm()
    q = robot.q.copy()
    # .1 rad before its margin, and .045 beyond it
    q[0], q[3] = robot.high[0] - 0.135, robot.low[3] - 0.01
    low, high, _ = velocity_bounds(replace(robot, q=q), 0.035, 0.2, accelerate=False)
    assert high[0] == pytest.approx(0.1 / 0.2) and low[0] == -robot.speed[0]
    assert low[3] == pytest.approx(0.045 / 0.2) and high[3] == pytest.approx(robot.speed[3])
    assert (low <= high).all()


def test_accelerations_give_way_to_positions() -> None:
    robot = arm(ordered=np.array([1.5, 0, 0, 0, 0, 0]))
    step = robot.acceleration * robot.period_s
    low, high, gave_way = velocity_bounds(robot, 0.035, 0.3, accelerate=True)
    assert (
        not gave_way
        and high[0] == pytest.approx(min(robot.speed[0], 1.5 + step[0]))
        and low[0] == pytest.approx(1.5 - step[0])
    )
    q = robot.q.copy()
    q[0] = robot.high[0] - 0.04  # where it must nearly stand, whatever it was told before
    low, high, gave_way = velocity_bounds(replace(robot, q=q), 0.035, 0.3, accelerate=True)
    assert gave_way and high[0] == pytest.approx(0.005 / 0.3) and low[0] == high[0]


def test_twist_limits_bound_each_component() -> None:
    robot = arm()
    group = twist_limits(0.2, None, robot.J)
    assert group.A.shape == (6, 6)
    rates = np.linalg.solve(robot.J, np.array([0.2, -0.2, 0.1, 1, 1, 1]))
    assert (group.A @ rates >= group.low - 1e-9).all()
    assert (group.A @ (1.01 * rates) < group.low).any()


def test_a_car_keeps_its_tightest_circle_forward_and_in_reverse() -> None:
    car = Car()
    reading = vs.Reading(np.zeros(7), np.zeros(7))
    model = car.own_model(reading, Mount.of(vs.load("car_pbvs").camera.mount.T))
    radius = car.turning_radius_m
    for sign in (1.0, -1.0):
        group = shared_limits(model, sign)
        for w in (0.5, -0.5):
            assert (group.A @ [sign * 0.5 * radius * 1.001, w] >= group.low).all()
            assert (group.A @ [sign * 0.5 * radius * 0.999, w] < group.low).any()


def test_the_smallest_singular_value_keeps_its_distance() -> None:
    scenario = vs.load("arm_ibvs")
    q = scenario.robot.start_joints()
    q[4] = 0.08  # the wrist is aligned at 0
    mount = Mount.of(scenario.camera.mount.T)

    def model(at: np.ndarray) -> OwnModel:
        return replace(
            scenario.robot.own_model(vs.Reading(at, 0 * at), mount),
            underway=np.zeros(6),
            coming=np.zeros(6),
        )

    def least(at: np.ndarray) -> float:
        robot = model(at)
        return float(
            np.linalg.svd(robot.J / np.array([robot.unit_m] * 3 + [1.0] * 3)[:, None])[1][-1]
        )

    group = off_singularities(model(q), 0.05, 3.0)
    assert group.low[0] == pytest.approx(-3.0 * (least(q) - 0.05))
    for i in range(6):
        step = 1e-6 * np.eye(6)[i]
        assert group.A[0, i] == pytest.approx((least(q + step) - least(q - step)) / 2e-6, abs=1e-5)
    away, aligned = q.copy(), q.copy()
    away[4], aligned[4] = 0.8, 0.001
    assert (
        len(off_singularities(model(away), 0.05, 3.0).A) == 0
        and len(off_singularities(model(aligned), 0.05, 3.0).A) == 0
    )
