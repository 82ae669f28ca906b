"""Hand-eye calibration: the closed forms against OpenCV 4's numbers, the bundle adjustment against the truth and its own intervals."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import vstestbed as vs
from tests.shortcuts import one_quick
from vstestbed.camera import Perspective
from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import exp, inverse, rigid_error, transform
from vstestbed.studies.hand_eye import METHODS, View, calibrate, held_out, joint_jacobian, motions, seen_from, turns

GOLDEN = json.loads((Path(__file__).parents[1] / "golden" / "hand_eye.json").read_text())
CAMERA = Perspective(width=640, height=480, fovy_deg=50)
CORNERS = np.array([[x, y, 0] for x in range(1, 7) for y in range(1, 5)]) * 0.04
X = np.eye(4)
X[:3, :3], X[:3, 3] = Rotation.from_euler("ZYX", [20, -5, 8], degrees=True).as_matrix(), [0.03, -0.02, 0.1]


def pose(w, t):
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.from_rotvec(w).as_matrix(), t
    return T


def views(n, in_hand=True, turn=0.5, corner_px=0.1, robot_m=0.0, seed=0, axis=None):
    """Views of a board before the camera, turned by up to an angle; the robot's poses with an error of `robot_m` [m, rad]."""
    rng, fixed, found = np.random.default_rng(seed), pose([0.3, 0.2, 0.1], [0.8, 0.1, 0.3]), []
    for _ in range(n):
        w = rng.uniform(-turn, turn, 3) if axis is None else np.array(axis) * rng.uniform(-turn, turn)
        T = pose(w, [*rng.uniform(-0.05, 0.05, 2), rng.uniform(0.4, 0.5)]) @ pose(np.zeros(3), [-0.14, -0.1, 0])
        # in hand: T_base_flange = fixed T^-1 X^-1; in the room: X T fixed^-1
        G = fixed @ inverse(T) @ inverse(X) if in_hand else X @ T @ inverse(fixed)
        uv = CAMERA.project(CORNERS @ T[:3, :3].T + T[:3, 3]) + corner_px * rng.standard_normal((len(CORNERS), 2))
        read = G @ pose(robot_m * rng.standard_normal(3), robot_m * rng.standard_normal(3))
        found.append(View("", read, CORNERS, uv, seen_from(CORNERS, uv, CAMERA), np.eye(6)))
    return found


@pytest.mark.parametrize("name", METHODS)
def test_the_closed_forms_are_opencvs(name):
    """OpenCV 4.14 leaves out of Tsai's method the pairs that turn the least: those under 23 degrees here."""
    A, B = motions([View("", np.array(g), None, None, np.array(t), None) for g, t in zip(GOLDEN["G"], GOLDEN["T"], strict=True)], True)
    turned = Rotation.from_matrix(A[:, :3, :3]).magnitude() > (0.4 if name == "tsai" else 0)
    np.testing.assert_allclose(METHODS[name](A[turned], B[turned]), GOLDEN["X"][name], atol=1e-12)


@pytest.mark.parametrize("in_hand", [True, False])
def test_without_noise_all_of_them_find_the_camera(in_hand):
    made = calibrate(views(8, in_hand, corner_px=0.0), CAMERA, in_hand)
    for found in (made.X, *made.methods.values()):
        np.testing.assert_allclose(found, X, atol=1e-5)
    assert made.rms_px < 1e-3


@pytest.mark.parametrize("n", one_quick(10, 60))
def test_the_bundle_adjustment_knows_how_exact_it_is(n):
    """The squared errors over the variances are 6 on the mean: chi-squared of 6 degrees of freedom, 3 standard errors."""
    z, better = [], 0
    for seed in range(n):
        made = calibrate(views(12, corner_px=0.2, robot_m=2e-4, seed=seed), CAMERA, True, 0.2, 2e-4)
        D = inverse(X) @ made.X
        d = np.concatenate([D[:3, 3], Rotation.from_matrix(D[:3, :3]).as_rotvec()])
        z.append(float(np.sum((d / np.concatenate(made.sigma)) ** 2)))
        better += rigid_error(made.X, X)[0] < rigid_error(made.methods["park"], X)[0]
    assert np.mean(z) == pytest.approx(6, abs=3 * math.sqrt(12 / n))
    assert better >= 0.8 * n


def test_views_that_were_left_out_are_predicted():
    found = held_out(views(12, corner_px=0.1, seed=3), CAMERA, True, 0.1, 1e-5)
    assert found.shape == (12, 3) and 0.05 < np.sqrt((found[:, 0] ** 2).mean()) < 0.2


def test_views_that_tell_too_little_are_refused():
    with pytest.raises(ParameterError, match="3 or more"):
        calibrate(views(2), CAMERA)
    with pytest.raises(ParameterError, match="about one axis of the flange alone"):
        calibrate(views(8, axis=[0, 0, 1]), CAMERA)
    spread, axes = turns(views(20, turn=0.4, axis=[1, 0, 0]))
    assert spread[2] > 10 > 1e-3 > spread[1] and abs(axes[2] @ X[:3, :3][:, 0]) == pytest.approx(1, abs=1e-6)


def test_the_jacobian_of_a_flange_is_that_of_its_motion():
    robot = vs.load("arm_ibvs").robot
    q, dq = robot.start_joints(), 1e-4 * np.array([1, -2, 3, 1, 2, -1.0])
    D = inverse(robot.flange_pose(q)) @ robot.flange_pose(q + dq)
    moved = np.concatenate([D[:3, 3], Rotation.from_matrix(D[:3, :3]).as_rotvec()])
    np.testing.assert_allclose(joint_jacobian(robot.flange_pose, q) @ dq, moved, atol=2e-7)


def test_a_board_seen_exactly_from_the_front_has_a_pose():
    camera = Perspective()
    board = np.array([[x, y, 0.0] for y in np.linspace(-0.1, 0.1, 5) for x in np.linspace(-0.14, 0.14, 7)])
    for roll in np.radians(np.arange(0, 360, 5)):  # at one in eighteen of these OpenCV's own solver gives NaN
        T = exp(np.array([0, 0, 0, 0, 0, roll]))
        T[2, 3] = 0.6
        # rounding of pixels of some hundreds, over the focal length
        np.testing.assert_allclose(seen_from(board, camera.project(transform(T, board)), camera), T, atol=1e-9)


def test_corners_on_a_line_are_no_board():
    line = np.array([[x, 0.0, 0.0] for x in np.linspace(-0.1, 0.1, 5)])
    with pytest.raises(ParameterError, match="determine no pose"):
        seen_from(line, Perspective().project(line + [0, 0, 0.6]), Perspective())
