"""The uncalibrated law: estimates against closed forms, the measured Jacobian against the robot's,
and what it never reads.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest

import vstestbed as vs
from vstestbed.core.geometry import inverse, transform
from vstestbed.features.depth import AtGoal
from vstestbed.features.observation import Goal, Observation
from vstestbed.laws import Command, Uncalibrated
from vstestbed.laws.points import TOO_FEW
from vstestbed.laws.uncalibrated import (
    EXCITES,
    NO_CIRCLE,
    SERVOES,
    TILTS,
    Broyden,
    MotionSums,
    RecursiveLeastSquares,
    UncalibratedState,
)
from vstestbed.robots.own_model import OwnModel

ENDLESS = np.full(3, np.inf)


def linear_system(samples: int, noise_px: float = 0.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """J (4, 2, 3), displacements (K, 3), and the motion of four markers
    that they make (K, 4, 2).
    """
    rng = np.random.default_rng(5)
    J, x = rng.normal(size=(4, 2, 3)), rng.normal(size=(samples, 3))
    return J, x, np.einsum("nij,kj->kni", J, x) + noise_px * rng.normal(size=(samples, 4, 2))


def test_recursive_least_squares_without_forgetting_are_those_of_all_data() -> None:
    _, xs, ys = linear_system(30, noise_px=0.3)
    J, P = np.zeros((4, 2, 3)), np.repeat(1e9 * np.eye(3)[None], 4, axis=0)
    for x, y in zip(xs, ys, strict=True):
        J, P = RecursiveLeastSquares(forgetting=1.0).corrected(J, P, x, y, most=1e12)
    expected = np.linalg.lstsq(xs, ys.reshape(30, 8), rcond=None)[0].T.reshape(4, 2, 3)
    np.testing.assert_allclose(J, expected, atol=1e-7)
    np.testing.assert_allclose(P[0], np.linalg.inv(xs.T @ xs), rtol=1e-5)
    samples = MotionSums.none(4, 3)
    for x, y in zip(xs, ys, strict=True):
        samples = samples.with_one(x, y)
    np.testing.assert_allclose(samples.jacobian(), expected, atol=1e-9)


def test_forgetting_weighs_a_displacement_less_with_each_that_follows() -> None:
    _, xs, ys = linear_system(12, noise_px=0.3)
    J, P = np.zeros((4, 2, 3)), np.repeat(1e9 * np.eye(3)[None], 4, axis=0)
    for x, y in zip(xs, ys, strict=True):
        J, P = RecursiveLeastSquares(forgetting=0.7).corrected(J, P, x, y, most=1e12)
    w = np.sqrt(0.7 ** np.arange(11, -1, -1))[:, None]
    expected = np.linalg.lstsq(w * xs, w * ys.reshape(12, 8), rcond=None)[0].T.reshape(4, 2, 3)
    np.testing.assert_allclose(J, expected, atol=1e-5)


@pytest.mark.parametrize("estimator", [Broyden(rate=1.0), RecursiveLeastSquares()])
def test_both_find_a_constant_jacobian(estimator: Any) -> None:
    true, xs, ys = linear_system(200)
    J, P = np.zeros((4, 2, 3)), np.repeat(np.eye(3)[None], 4, axis=0)
    for x, y in zip(xs, ys, strict=True):
        before = J
        J, P = estimator.corrected(J, P, x, y, most=1.0)
        assert np.abs(J @ x - y).max() <= np.abs(before @ x - y).max() + 1e-12
    np.testing.assert_allclose(J, true, atol=1e-6)


def test_the_covariance_does_not_wind_up_where_nothing_is_excited() -> None:
    J, P = np.zeros((1, 2, 3)), 0.1 * np.eye(3)[None]
    for _ in range(200):
        J, P = RecursiveLeastSquares(forgetting=0.8).corrected(
            J, P, np.array([1.0, 0, 0]), np.array([[2.0, 0]]), most=0.1
        )
    assert np.linalg.eigvalsh(P[0]).max() <= 0.1 * (1 + 1e-9)
    np.testing.assert_allclose(J[0, 0], [2, 0, 0], atol=1e-6)


def test_a_marker_that_was_not_seen_in_one_velocitys_turn_has_no_rows() -> None:
    samples = MotionSums.none(2, 2)
    for i in (0, 1):
        y = np.array([[1.0, 2.0], [np.nan, np.nan] if i else [3.0, 4.0]])
        samples = samples.with_one(np.eye(2)[i], y)
    J = samples.jacobian()
    np.testing.assert_allclose(J[0], [[1, 1], [2, 2]])
    assert np.isnan(J[1]).all()


class Plant:
    """Three velocities that move three markers by a constant J; sensors, a delay in frames, and a
    target whose motion they can follow.
    """

    def __init__(self, law: Uncalibrated, late: int = 0, drift: float = 0.0, **model: Any):
        rng = np.random.default_rng(6)
        self.J = rng.normal(size=(3, 2, 3)) * 300 + 200 * np.repeat(np.eye(3)[:, None], 2, axis=1)
        self.q, self.t, self.late = np.zeros(3), 0.0, late
        self.drift = self.J @ (drift * np.array([1.0, -1.0, 0.5]))
        self.law, self.model = law, model
        goal = Goal.from_view(
            vs.load("ibvs_book").camera,
            np.array([[0.1, 0, 1], [0, 0.1, 1], [-0.1, 0, 1]]),
            np.eye(4),
        )
        self.goal = replace(goal, uv=60 * rng.normal(size=(3, 2)))
        self.start = self.goal.uv - (self.J @ np.array([0.2, -0.15, 0.1]))
        self.state: UncalibratedState = law.init(self.goal)
        self.places, self.orders = [self.q], [np.zeros(3)] * (late + 1)

    def step(self, hide: tuple[int, ...] = (), dt: float = 0.04) -> Command:
        """One frame."""
        uv = self.start + self.J @ self.q + self.drift * self.t
        uv[list(hide)] = np.nan
        moved = self.q - self.places[-1]
        pending = sum(self.orders[-self.late :], np.zeros(3)) * dt if self.late else np.zeros(3)
        robot = OwnModel.of_motions(
            ("a", "b", "c"), np.zeros((6, 3)), ENDLESS, ENDLESS, **self.model
        )
        robot = replace(
            robot,
            moved=moved,
            since_s=dt if self.t else 0.0,
            underway=pending,
            underway_s=self.late * dt,
        )
        seen = Observation(self.t, uv, uv, np.ones(3), robot=robot)
        self.places.append(self.q)
        self.state, command = self.law.step(self.state, seen, self.goal, np.eye(6)[:, :3])
        if command.rates is not None:
            self.orders.append(command.rates)
        self.q = self.q + dt * self.orders[-1 - self.late]
        self.t += dt
        return command

    def error_px(self) -> float:
        """Distance of the markers from the goal's."""
        uv = self.start + self.J @ self.q + self.drift * self.t
        return float(np.linalg.norm(uv - self.goal.uv, axis=1).mean())


@pytest.mark.parametrize("late", [0, 5])
@pytest.mark.parametrize("estimator", [Broyden(), RecursiveLeastSquares()])
def test_a_linear_plant_is_measured_and_driven_to_the_goal(estimator: Any, late: int) -> None:
    plant = Plant(Uncalibrated(estimator=estimator), late)
    modes = [plant.step().mode for _ in range(500)]
    first = modes.index(SERVOES)
    assert set(modes[:first]) == {EXCITES} and set(modes[first:]) == {SERVOES}
    assert plant.state.estimate is not None
    np.testing.assert_allclose(
        plant.state.estimate.J * plant.state.estimate.scale, plant.J, rtol=1e-6, atol=1e-4
    )
    assert plant.error_px() < 0.1


def test_the_excitation_moves_the_markers_by_what_was_asked_and_back() -> None:
    plant = Plant(Uncalibrated())
    farthest = 0.0
    while plant.step().mode == EXCITES:
        farthest = max(farthest, float(np.linalg.norm(plant.J @ plant.q, axis=1).mean()))
    assert 8 < farthest < 25  # half of the amplitude of 20 px, and what one frame adds
    assert np.linalg.norm(plant.J @ plant.q, axis=1).max() < 12


def test_a_targets_own_motion_is_a_column_of_the_jacobian() -> None:
    left = []
    for dynamic in (False, True):
        plant = Plant(Uncalibrated(dynamic=dynamic, patience_s=0.0), drift=0.04)
        for _ in range(600):
            plant.step()
        left.append(plant.error_px())
    assert left[1] < 0.1 * left[0]


def test_a_jacobian_that_turned_wrong_is_measured_anew() -> None:
    plant = Plant(Uncalibrated())
    while plant.step().mode == EXCITES:
        pass
    # as if the camera had been mounted upside down
    plant.start, plant.J = plant.start + 2 * plant.J @ plant.q, -plant.J
    modes = [plant.step().mode for _ in range(1500)]
    assert plant.state.excitations >= 2 and EXCITES in modes and plant.error_px() < 0.2
    assert plant.state.patience_s == 3.0 * 2 ** (plant.state.excitations - 1)


def test_a_marker_out_of_sight_keeps_its_rows_and_too_few_are_rest() -> None:
    plant = Plant(Uncalibrated())
    while plant.step().mode == EXCITES:
        pass
    assert plant.state.estimate is not None
    rows = plant.state.estimate.J[0]
    for _ in range(20):
        assert plant.step(hide=(0,)).mode == SERVOES
    np.testing.assert_array_equal(plant.state.estimate.J[0], rows)
    command = plant.step(hide=(0, 1))
    assert command.rest_reason == TOO_FEW and not command.twist.any()
    for _ in range(300):
        plant.step()
    assert plant.error_px() < 0.3


@pytest.mark.parametrize("dynamic", [False, True])
def test_an_excitation_that_loses_the_markers_goes_back_by_the_sensors(dynamic: bool) -> None:
    plant = Plant(Uncalibrated(dynamic=dynamic))
    while plant.q[1] == 0:
        plant.step()
    while np.linalg.norm(plant.J @ (plant.q * [0, 1, 0]), axis=1).mean() < 8:
        plant.step()
    blind = [plant.step(hide=(0, 1, 2)) for _ in range(8)]
    assert (
        all(command.rest_reason == TOO_FEW and command.mode == EXCITES for command in blind)
        and blind[0].rates is not None
    )
    assert np.linalg.norm(plant.J @ (plant.q * [0, 1, 0]), axis=1).mean() < 3
    for _ in range(500):
        plant.step()
    assert plant.error_px() < 0.5 and plant.state.excitations == 1


@pytest.mark.parametrize(
    ("model", "why"), [({"turning_radius_m": 1.0}, NO_CIRCLE), ({"tilt": np.zeros(2)}, TILTS)]
)
def test_a_robot_whose_velocities_are_not_free_rests_and_says_why(
    model: dict[str, Any], why: str
) -> None:
    assert Plant(Uncalibrated(), **model).step().rest_reason == why


class Frames:
    """Keeps the frames of a run."""

    def __init__(self) -> None:
        self.kept: list[vs.Frame] = []

    def frame(self, frame: vs.Frame) -> None:
        """Keep it."""
        self.kept.append(frame)


def frames_of(name: str, seconds: float) -> tuple[vs.Recording, list[vs.Frame], vs.Scenario]:
    """A short run with exact pixels."""
    law = {"kind": "uncalibrated", "gain": 1.0}
    scenario = vs.load(
        name,
        {
            "law": law,
            "detector": "oracle",
            "stop": {"duration_s": seconds},
            "camera.latency_s": 0.04,
        },
    )
    watch = Frames()
    return vs.run(scenario, watch=[watch]), watch.kept, scenario


@pytest.mark.parametrize("name", ["arm_ibvs", "arm_eye_to_hand"])
def test_the_measured_jacobian_is_that_of_the_arm_and_the_camera(name: str) -> None:
    _, frames, scenario = frames_of(name, 7.0)
    state, robot, q = scenario.law.init(frames[0].goal), scenario.robot, frames[0].truth.q
    for frame in frames:
        state, command = scenario.law.step(state, frame.observation, frame.goal, np.eye(6))
        if command.mode == SERVOES:
            break
    J = state.estimate.J * state.estimate.scale

    def pixels(at: np.ndarray) -> np.ndarray:
        flange, mount = robot.flange_pose(at), scenario.camera.mount.T
        T = inverse(mount) @ flange if scenario.target.on_gripper else inverse(flange @ mount)
        return scenario.camera.project(
            transform(T @ scenario.target.pose.T, scenario.target.points)
        )

    true = np.stack([(pixels(q + d) - pixels(q - d)) / 2e-5 for d in 1e-5 * np.eye(6)], axis=-1)
    # Three per cent of each column: servos bring the joints back to within 2 px, and the picture is
    # curved.
    assert (np.linalg.norm(J - true, axis=(0, 1)) < 0.03 * np.linalg.norm(true, axis=(0, 1))).all()


def test_commands_follow_from_pixels_and_sensors_alone() -> None:
    recording, frames, scenario = frames_of("arm_ibvs", 8.0)
    law, rng = cast(Any, scenario.law), np.random.default_rng(7)
    fisheye = vs.load("arm_fisheye").camera
    state = law.init(frames[0].goal)
    assert set(recording["law_mode"]) == {EXCITES, SERVOES}
    for frame in frames:
        robot = frame.observation.robot
        assert robot is not None and frame.command.rates is not None
        wrong = replace(robot, J=7 * rng.normal(size=(6, 6)), jacobian=lambda q: np.zeros((6, 6)))
        n = len(frame.observation.uv)
        garbage = {
            "xy": rng.normal(size=(n, 2)),
            "depth": rng.normal(size=n),
            "T_camera_target": None,
        }
        goal = replace(
            frame.goal, depth=np.full(n, np.nan), T_camera_target=np.zeros((4, 4)), camera=fisheye
        )
        state, command = law.step(
            state, replace(frame.observation, robot=wrong, **garbage), goal, np.eye(6)
        )
        np.testing.assert_array_equal(command.rates, frame.command.rates)
        np.testing.assert_allclose(frame.command.twist, robot.J @ frame.command.rates)
    assert law.depth == AtGoal() and law.inputs == ("robot",)
