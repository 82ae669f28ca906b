"""Hand-eye calibration: the closed forms against OpenCV 4's numbers, the bundle adjustment against
the truth and its own intervals.
"""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import vstestbed as vs
from tests.shortcuts import one_quick
from vstestbed.apps.calibrate.hand_eye import (
    METHODS,
    View,
    calibrate,
    held_out,
    joint_jacobian,
    motions,
    seen_from,
    turns,
)
from vstestbed.camera import Perspective
from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import exp, inverse, rigid_error, transform

GOLDEN = json.loads((Path(__file__).parents[2] / "golden" / "hand_eye.json").read_text())
CAMERA = Perspective(width=640, height=480, fovy_deg=50)
CORNERS = np.array([[x, y, 0] for x in range(1, 7) for y in range(1, 5)]) * 0.04
X = np.eye(4)
X[:3, :3], X[:3, 3] = (
    Rotation.from_euler("ZYX", [20, -5, 8], degrees=True).as_matrix(),
    [0.03, -0.02, 0.1],
)


def pose(w, t):
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.from_rotvec(w).as_matrix(), t
    return T


def views(n, in_hand=True, turn=0.5, corner_px=0.1, robot_m=0.0, seed=0, axis=None):
    """Views of a board before the camera, turned by up to an angle; the robot's poses with an error
    of `robot_m` [m, rad].
    """
    rng, fixed, found = np.random.default_rng(seed), pose([0.3, 0.2, 0.1], [0.8, 0.1, 0.3]), []
    for _ in range(n):
        w = (
            rng.uniform(-turn, turn, 3)
            if axis is None
            else np.array(axis) * rng.uniform(-turn, turn)
        )
        T = pose(w, [*rng.uniform(-0.05, 0.05, 2), rng.uniform(0.4, 0.5)]) @ pose(
            np.zeros(3), [-0.14, -0.1, 0]
        )
        # in hand: T_base_flange = fixed T^-1 X^-1; in the room: X T fixed^-1
        G = fixed @ inverse(T) @ inverse(X) if in_hand else X @ T @ inverse(fixed)
        uv = CAMERA.project(CORNERS @ T[:3, :3].T + T[:3, 3]) + corner_px * rng.standard_normal(
            (len(CORNERS), 2)
        )
        read = G @ pose(robot_m * rng.standard_normal(3), robot_m * rng.standard_normal(3))
        found.append(View("", read, CORNERS, uv, seen_from(CORNERS, uv, CAMERA), np.eye(6)))
    return found


@pytest.mark.parametrize("name", METHODS)
def test_the_closed_forms_are_opencvs(name):
    """OpenCV 4.14 leaves out of Tsai's method the pairs that turn the least: those under 23 degrees
    here.
    """
    A, B = motions(
        [
            View("", np.array(g), None, None, np.array(t), None)
            for g, t in zip(GOLDEN["G"], GOLDEN["T"], strict=True)
        ],
        True,
    )
    turned = Rotation.from_matrix(A[:, :3, :3]).magnitude() > (0.4 if name == "tsai" else 0)
    np.testing.assert_allclose(METHODS[name](A[turned], B[turned]), GOLDEN["X"][name], atol=1e-12)


# The example of Shiu & Ahmad 1989, doi:10.1109/70.88014, in Park & Martin 1994,
# doi:10.1109/70.326576: two motions, six digits, lengths without a unit; as two public programs
# copy it. (One of them has .997612 in the last, whose row would not have the length 1.)
SHIU_A = [
    [[-0.989992, -0.141120, 0, 0], [0.141120, -0.989992, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]],
    [[0.070737, 0, 0.997495, -400], [0, 1, 0, 0], [-0.997495, 0, 0.070737, 400], [0, 0, 0, 1]],
]
SHIU_B = [
    [
        [-0.989992, -0.138307, 0.028036, -26.9559],
        [0.138307, -0.911449, 0.387470, -96.1332],
        [-0.028036, 0.387470, 0.921456, 19.4872],
    ],
    [
        [0.070737, 0.198172, 0.977612, -309.543],
        [-0.198172, 0.963323, -0.180936, 59.0244],
        [-0.977612, -0.180936, 0.107415, 291.177],
    ],
]


@pytest.mark.parametrize("name", METHODS)
def test_the_example_of_shiu_and_ahmad(name):
    """R_x(.2), t = (10, 50, 100). Inputs of six digits: a rotation of 1e-6 moves 566 of length by
    6e-4, ten times so in Kronecker form.
    """
    B = np.array([[*map(list, M), [0, 0, 0, 1]] for M in SHIU_B])
    found = METHODS[name](np.array(SHIU_A), B)
    np.testing.assert_allclose(
        found[:3, :3], Rotation.from_rotvec([0.2, 0, 0]).as_matrix(), atol=4e-6
    )
    np.testing.assert_allclose(
        found[:3, 3], [10, 50, 100], atol=6e-3 if name == "andreff" else 6e-4
    )


# OpenCV, modules/calib3d/test/test_calibration_hand_eye.cpp, regression_24871: four poses, and what
# they were made of.
OPENCV_T = [
    [[0.04964505493834381, 0.5136826827431226, 0.8565427426404346, -1.588728904724121],
     [-0.3923117691818854, 0.7987004864191318, -0.4562554205214679, 0.07843752950429916],
     [-0.9184916136152514, -0.3133809733274676, 0.2411752915926112, -1.002813339233398]],
    [[-0.3048000068139332, 0.6971848192711539, 0.6488684640388026, -1.906493663787842],
     [-0.9377589344241749, -0.3387497187353627, -0.07652979135179161, -0.07281044125556946],
     [0.1664486009369332, -0.6318084803439735, 0.7570422097951847, 0.6088893413543701]],
    [[-0.590234879685801, -0.7051138289845309, -0.3929850823848928, -0.9809040427207947],
     [0.6017371069678565, -0.7088332765096816, 0.3680595606834615, -0.2707894444465637],
     [-0.5380847896941907, -0.01923211603859842, 0.8426712792141644, -0.2577074766159058]],
    [[0.7643667483125168, -0.08523002870239212, 0.63912386614923, -1.58987033367157],
     [-0.2583463792779588, 0.8676987164647345, 0.424683512464778, -1.924914002418518],
     [-0.5907627462764713, -0.489729292214425, 0.6412211770980741, -0.3109001517295837]],
]  # fmt: skip
OPENCV_G = [
    [[-0.4143743581399177, -0.6105088815982459, -0.6749613298595637, -1.249274406461827],
     [-0.1598851232573451, -0.6812625208693498, 0.71436554019614, -1.916570771580279],
     [-0.895952364066927, 0.4039310376145889, 0.1846864320259794, 2.005069553422765]],
    [[0.7262439860936567, -0.201662933718935, -0.6571923111439066, -0.7375172846804027],
     [-0.4640017362244384, -0.8491808316335328, -0.2521791108852766, -2.579760910816792],
     [-0.5072199339965884, 0.4880819361030014, -0.7102844234575628, 1.336561572270101]],
    [[0.2541996332132083, 0.6186461729765909, 0.7434106934499181, -1.040123533893404],
     [0.2194912986375709, 0.711701808961156, -0.6673111005698995, -0.1303773962721222],
     [-0.9419161938817396, 0.3328024155303503, 0.04512688689130734, 1.068029475621886]],
    [[0.116348305340805, -0.9917998080681939, 0.0528792261688552, -2.551899142554571],
     [-0.2760629007224059, 0.01884966191381591, 0.9609547154213178, -2.986937398237611],
     [-0.9540714578526358, -0.1264034452126562, -0.2716060057313114, 1.317613923218308]],
]  # fmt: skip
OPENCV_X = [[0, 0, -1, 0.1], [1, 0, 0, 0.2], [0, -1, 0, 0.3]]


@pytest.mark.parametrize("name", METHODS)
def test_opencvs_own_four_poses(name):
    """Every method is exact there within 1e-12, which is the bound of OpenCV's test."""
    last = [0, 0, 0, 1]
    four = [
        View("", np.array([*g, last]), None, None, np.array([*t, last]), None)
        for g, t in zip(OPENCV_G, OPENCV_T, strict=True)
    ]
    np.testing.assert_allclose(METHODS[name](*motions(four, True))[:3], OPENCV_X, atol=1e-12)


@pytest.mark.parametrize("in_hand", [True, False])
def test_without_noise_all_of_them_find_the_camera(in_hand):
    made = calibrate(views(8, in_hand, corner_px=0.0), CAMERA, in_hand)
    for found in (made.X, *made.methods.values()):
        np.testing.assert_allclose(found, X, atol=1e-5)
    assert made.rms_px < 1e-3


@pytest.mark.parametrize("n", one_quick(10, 60))
def test_the_bundle_adjustment_knows_how_exact_it_is(n):
    """The squared errors over the variances are 6 on the mean: chi-squared of 6 degrees of freedom,
    3 standard errors.
    """
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
    assert spread[2] > 10 > 1e-3 > spread[1]
    assert abs(axes[2] @ X[:3, :3][:, 0]) == pytest.approx(1, abs=1e-6)


def test_the_jacobian_of_a_flange_is_that_of_its_motion():
    robot = vs.load("arm_ibvs").robot
    q, dq = robot.start_joints(), 1e-4 * np.array([1, -2, 3, 1, 2, -1.0])
    D = inverse(robot.flange_pose(q)) @ robot.flange_pose(q + dq)
    moved = np.concatenate([D[:3, 3], Rotation.from_matrix(D[:3, :3]).as_rotvec()])
    np.testing.assert_allclose(joint_jacobian(robot.flange_pose, q) @ dq, moved, atol=2e-7)


def test_a_board_seen_exactly_from_the_front_has_a_pose():
    camera = Perspective()
    board = np.array(
        [[x, y, 0.0] for y in np.linspace(-0.1, 0.1, 5) for x in np.linspace(-0.14, 0.14, 7)]
    )
    # at one in eighteen of these OpenCV's own solver gives NaN
    for roll in np.radians(np.arange(0, 360, 5)):
        T = exp(np.array([0, 0, 0, 0, 0, roll]))
        T[2, 3] = 0.6
        # rounding of pixels of some hundreds, over the focal length
        np.testing.assert_allclose(
            seen_from(board, camera.project(transform(T, board)), camera), T, atol=1e-9
        )


def test_corners_on_a_line_are_no_board():
    line = np.array([[x, 0.0, 0.0] for x in np.linspace(-0.1, 0.1, 5)])
    with pytest.raises(ParameterError, match="determine no pose"):
        seen_from(line, Perspective().project(line + [0, 0, 0.6]), Perspective())
