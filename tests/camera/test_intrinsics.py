"""Calibrations of real cameras: every format of file that ROS and OpenCV write, drawn and projected
as OpenCV does.
"""

import json

import cv2
import numpy as np
import pytest
import yaml

import vstestbed as vs
from vstestbed.camera import Calibration, Fisheye, Perspective
from vstestbed.camera.intrinsics import (
    Intrinsics,
    as_ros,
    read_calibration,
    read_intrinsics,
    read_mount,
    write_calibration,
)
from vstestbed.core.errors import ParameterError, ScenarioError
from vstestbed.core.geometry import Pose

K = np.array([[712.5, 0, 390.25], [0, 705.0, 305.5], [0, 0, 1.0]])
PLUMB = (-0.2, 0.05, 0.001, -0.002, 0.0)
RATIONAL = (0.12, -0.31, 0.001, -0.0007, 0.05, 0.09, -0.22, 0.02)
FISHEYE = (0.03, -0.004, 0.002, -0.0005)
T_HAND_EYE = Pose(xyz=(0.01, -0.02, 0.11), rpy_deg=(3, -2, 45)).T


def ros(tmp_path, model, k, **more):
    plain = {
        "image_width": 800,
        "image_height": 600,
        "camera_name": "narrow",
        "distortion_model": model,
    }
    plain |= {"camera_matrix": {"rows": 3, "cols": 3, "data": K.ravel().tolist()}, **more}
    plain["distortion_coefficients"] = {"rows": 1, "cols": len(k), "data": list(k)}
    (tmp_path / "info.yaml").write_text(yaml.safe_dump(plain))
    return str(tmp_path / "info.yaml")


def opencv(path, **matrices):
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for name, value in matrices.items():
        storage.write(name, value)
    storage.release()
    return str(path)


@pytest.mark.parametrize(
    ("model", "k"), [("plumb_bob", PLUMB), ("plumb_bob", ()), ("rational_polynomial", RATIONAL)]
)
def test_a_camera_info_projects_as_opencv_does(tmp_path, model, k):
    camera = Perspective(intrinsics=ros(tmp_path, model, k))
    assert (camera.width, camera.height) == (800, 600)
    p = np.random.default_rng(1).uniform([-0.5, -0.4, 0.9], [0.5, 0.4, 1.5], (200, 3))
    expected = cv2.projectPoints(p, np.zeros(3), np.zeros(3), K, np.array(k or (0.0,) * 4))[0][:, 0]
    np.testing.assert_allclose(camera.project(p), expected, atol=1e-9)
    np.testing.assert_allclose(camera.project(camera.ray(expected)), expected, atol=1e-9)


def test_a_fisheye_calibration_projects_as_opencv_does(tmp_path):
    camera = Fisheye(intrinsics=ros(tmp_path, "equidistant", FISHEYE), fov_deg=150)
    p = np.random.default_rng(1).uniform([-1, -1, 0.5], [1, 1, 1.5], (200, 3))
    expected = cv2.fisheye.projectPoints(
        p[:, None], np.zeros(3), np.zeros(3), K, np.array(FISHEYE)
    )[0][:, 0]
    np.testing.assert_allclose(camera.project(p), expected, atol=1e-9)
    np.testing.assert_allclose(camera.project(camera.ray(expected)), expected, atol=1e-9)


def test_the_same_numbers_come_from_every_format(tmp_path):
    k = np.array([PLUMB])
    message = {
        "width": 800,
        "height": 600,
        "distortion_model": "plumb_bob",
        "d": list(PLUMB),
        "k": K.ravel().tolist(),
    }
    # as `ros2 topic echo` prints it
    (tmp_path / "echo.yaml").write_text(
        f"header: {{frame_id: cam}}\n{yaml.safe_dump(message)}---\n"
    )
    (tmp_path / "plain.json").write_text(
        json.dumps({"camera_matrix": K.tolist(), "dist_coeffs": [list(PLUMB)]})
    )
    files = [
        str(tmp_path / "echo.yaml"),
        str(tmp_path / "plain.json"),
        ros(tmp_path, "plumb_bob", PLUMB),
    ]
    files += [
        opencv(
            tmp_path / f"cv.{ending}",
            image_width=800,
            image_height=600,
            cameraMatrix=K,
            distCoeffs=k,
        )
        for ending in ("yaml", "json", "xml")
    ]
    for file in files:
        found = read_intrinsics(file)
        assert (found.focal_px, found.principal_px, found.distortion) == (
            (712.5, 705.0),
            (390.25, 305.5),
            PLUMB,
        ), file


def test_pixels_that_are_no_squares_and_the_rational_model_are_drawn(tmp_path):
    """The middle of a drawn disc is where the lens projects it, within what the detector of discs
    makes of them.
    """
    lens = {
        "kind": "perspective",
        "intrinsics": ros(tmp_path, "rational_polynomial", RATIONAL),
        "multisampling": 4,
    }
    scenario = vs.load("arm_ibvs", {"camera": lens})
    shown = scenario.displaced(Pose(xyz=(0.02, 0.01, -0.1)), "camera")
    with vs.Session(shown) as session:
        frame = session.reset()
    assert frame.observation.seen.all()
    # of the detector; 1 % of fx is 2 px here
    assert np.abs(frame.observation.uv - shown.camera.project(frame.truth.p_camera)).max() < 0.1


def test_a_hand_eye_calibration_is_read_from_every_form(tmp_path):
    from scipy.spatial.transform import Rotation

    x, y, z, w = Rotation.from_matrix(T_HAND_EYE[:3, :3]).as_quat()
    place = dict(zip("xyz", T_HAND_EYE[:3, 3].tolist(), strict=True))
    easy = {
        "parameters": {"name": "x"},
        "transformation": {**place, "qx": x, "qy": y, "qz": z, "qw": w},
    }
    message = {
        "header": {},
        "transform": {"translation": place, "rotation": {"x": x, "y": y, "z": z, "w": w}},
    }
    for name, plain in (
        ("easy", easy),
        ("message", message),
        ("matrix", {"T_cam2gripper": T_HAND_EYE.tolist()}),
    ):
        (tmp_path / f"{name}.yaml").write_text(yaml.safe_dump(json.loads(json.dumps(plain))))
    opencv(tmp_path / "cv.yml", R_cam2gripper=T_HAND_EYE[:3, :3], t_cam2gripper=T_HAND_EYE[:3, 3:])
    for name in ("easy.yaml", "message.yaml", "matrix.yaml", "cv.yml"):
        np.testing.assert_allclose(
            Pose(**read_mount(str(tmp_path / name))).T, T_HAND_EYE, atol=1e-12, err_msg=name
        )
    assert np.allclose(Perspective(mount=str(tmp_path / "easy.yaml")).mount.T, T_HAND_EYE)


def test_what_is_written_is_read_again(tmp_path):
    camera = Perspective(width=800, height=600, intrinsics=Intrinsics.of(K, RATIONAL))
    write_calibration(tmp_path / "made.yaml", camera, T_HAND_EYE, "two lines\nof words")
    found = read_calibration(str(tmp_path / "made.yaml"))
    assert (
        found["intrinsics"].focal_px == (712.5, 705.0)
        and found["intrinsics"].distortion == RATIONAL
    )
    np.testing.assert_allclose(Pose(**found["mount"]).T, T_HAND_EYE, atol=1e-12)
    for one in (Perspective(), Fisheye(coefficients=FISHEYE, fov_deg=120)):
        made = Intrinsics.of(*as_ros(one)[::2], (one.width, one.height), as_ros(one)[1])
        again = type(one)(intrinsics=made, **({"fov_deg": 120} if isinstance(one, Fisheye) else {}))
        p = np.random.default_rng(2).uniform([-0.3, -0.3, 0.9], [0.3, 0.3, 1.5], (20, 3))
        np.testing.assert_array_equal(again.project(p), one.project(p))


def test_a_calibrations_file_is_what_the_law_believes(tmp_path):
    write_calibration(
        tmp_path / "believed.yaml",
        Perspective(intrinsics=Intrinsics.of(K, PLUMB, (640, 480))),
        T_HAND_EYE,
    )
    scenario = vs.load("arm_ibvs", {"calibration": str(tmp_path / "believed.yaml")})
    believed = scenario.believed_camera
    np.testing.assert_array_equal(believed.K, K)
    np.testing.assert_allclose(believed.mount.T, T_HAND_EYE, atol=1e-12)
    assert scenario.camera.lens_coefficients == () and believed.lens_coefficients == PLUMB
    made = Calibration.of(K, PLUMB, T_HAND_EYE).believed(scenario.camera)
    np.testing.assert_array_equal(made.K, K)
    further = vs.load(
        "arm_ibvs",
        {"calibration.intrinsics": str(tmp_path / "believed.yaml"), "calibration.focal_error": 0.1},
    )
    np.testing.assert_allclose(np.diag(further.believed_camera.K)[:2], 1.1 * np.diag(K)[:2])
    assert further.believed_camera.mount == further.camera.mount


def test_a_runs_folder_has_its_calibration_and_runs_again(tmp_path, monkeypatch):
    from vstestbed.scenario.dump import documents, kept_files

    write_calibration(tmp_path / "cam.yaml", Perspective(), T_HAND_EYE)
    monkeypatch.chdir(tmp_path)
    scenario = vs.load("arm_ibvs", {"calibration": "cam.yaml"})
    given = documents(scenario)["scenario.yaml"]
    assert (
        list(kept_files(scenario)) == ["assets/calibration/cam.yaml"]
        and "calibration: assets/calibration/cam.yaml" in given
    )
    assert "focal_px" in documents(scenario)["resolved.yaml"]


def test_bad_files_are_refused_in_one_sentence(tmp_path):
    def file(name, text):
        (tmp_path / name).write_text(text)
        return str(tmp_path / name)

    fisheye = ros(tmp_path, "equidistant", FISHEYE)
    skewed = file("skew.yaml", "K: [500, 3, 320, 0, 500, 240, 0, 0, 1]")
    for given, words in (
        ({"camera.intrinsics": str(tmp_path / "no.yaml")}, "camera.intrinsics: is not there"),
        ({"camera.intrinsics": file("empty.yaml", "")}, "holds no fields"),
        ({"camera.intrinsics": file("bad.yaml", "a: [")}, "cannot be read"),
        ({"camera.intrinsics": file("none.yaml", "a: 1")}, "no camera matrix"),
        ({"camera.intrinsics": skewed}, "has a skew"),
        ({"camera.intrinsics": file("text.yaml", "K: hello")}, "must be finite numbers"),
        ({"camera.intrinsics": file("few.yaml", "K: [1, 2]")}, "must be a camera matrix"),
        ({"camera.mount": skewed}, "no pose of the camera"),
        ({"calibration": file("other.yaml", "a: 1")}, "neither a camera matrix nor a pose"),
        (
            {"camera": {"kind": "perspective", "intrinsics": fisheye}},
            "the model of a camera of kind fisheye",
        ),
        ({"camera": {"kind": "fisheye", "intrinsics": fisheye, "width": 640}}, "800 x 600"),
        (
            {"camera.intrinsics": {"focal_px": [500, 500], "principal_px": [320, 240]}},
            "excludes intrinsics",
        ),
        (
            {"camera": {"kind": "catadioptric"}, "calibration": fisheye},
            "this camera is catadioptric",
        ),
    ):
        with pytest.raises(ScenarioError) as refused:
            vs.load("arm_ibvs", given)
        assert words in str(refused.value), given
    with pytest.raises(ParameterError, match=r"cannot be drawn.*thin_prism"):
        Intrinsics.of(K, [0.1] * 12, model="thin_prism")
