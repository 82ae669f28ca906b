"""Calibrations that others wrote: what is in a file is used, known to change nothing, or refused by
its name.
"""

import json
import resource
import signal
from pathlib import Path

import numpy as np
import pytest
import yaml

import vstestbed as vs
from tests.camera.calibration_files import (
    CAMERA_INFO,
    EASY,
    MESSAGE,
    OPENCV,
    STAMPED,
    mutated,
    read_plainly,
)
from vstestbed.camera import Fisheye, intrinsics
from vstestbed.camera.intrinsics import read_calibration, read_intrinsics, read_mount
from vstestbed.core.errors import ParameterError, ScenarioError, VstestbedError
from vstestbed.core.geometry import Pose, rotation_from_rpy


def changed(plain, path, value):
    """A copy of a mapping with a field of another value; None: without it."""
    plain = json.loads(json.dumps(plain))
    *above, last = path.split(".")
    block = plain
    for name in above:
        block = block.setdefault(name, {})
    block[last] = value
    if value is None:
        del block[last]
    return plain


def refused(read, file) -> str:
    with pytest.raises(ParameterError) as error:
        read(str(file))
    assert file.name in str(error.value), "the sentence names the file"
    return str(error.value)


@pytest.fixture
def write(tmp_path):
    def wrote(plain, name="given.yaml"):
        text = (
            plain
            if isinstance(plain, str)
            else json.dumps(plain)
            if name.endswith(".json")
            else yaml.safe_dump(plain, sort_keys=False)
        )
        (tmp_path / name).write_text(text)
        return tmp_path / name

    return wrote


def test_what_changes_a_cameras_pictures_is_refused_by_name(write):
    """Each was passed over: the camera was another one than the file's, without a word."""
    R, P = (
        [0.9998, 0, 0.02, 0, 1, 0, -0.02, 0, 0.9998],
        [450, 0, 330, -54, 0, 450, 238, 0, 0, 0, 1, 0],
    )
    for path, value, words in (
        ("binning_x", 2, "binning_x is not used, and pictures are not those that were calibrated"),
        ("binning_y", 2, "binning_y is not used"),
        (
            "roi",
            {"x_offset": 100, "y_offset": 40, "height": 400, "width": 600, "do_rectify": False},
            "roi is not used",
        ),
        ("roi", {"x_offset": 0, "y_offset": 0, "height": 400, "width": 640}, "roi is not used"),
        (
            "rectification_matrix",
            {"rows": 3, "cols": 3, "data": R},
            "rectification_matrix must be the identity: it turns the camera",
        ),
        (
            "projection_matrix",
            {"rows": 3, "cols": 4, "data": P},
            "projection_matrix must have zeros as its fourth column",
        ),
        (
            "fisheye_model",
            1,
            "fisheye_model must be 0 or 1, and 0 beside distortion_model plumb_bob",
        ),
        (
            "camera_matrix.data",
            [500, 0, 0, 0, 500, 0, 320, 240, 1],
            "camera_matrix must be a camera matrix (3, 3)",
        ),
        (
            "camera_matrix.cols",
            4,
            "must have the numbers of its rows and columns, [3, 4], and has 9",
        ),
        (
            "camera_matrix.data",
            [True, 0, 320, 0, 500, 240, 0, 0, 1],
            "camera_matrix must be finite numbers",
        ),
        ("distortion_coefficients", {"k1": -0.1}, "distortion.k1 is not read here"),
        (
            "distortion_coefficients",
            None,
            "distortion_coefficients is missing: a lens of distortion_model plumb_bob has some",
        ),
        ("image_height", None, "image_size must be two whole numbers"),
        ("image_height", 480.5, "image_size must be two whole numbers"),
        ("K", [1, 0, 0, 0, 1, 0, 0, 0, 1], "it has a field twice"),
        ("rotation", 180, "rotation must be a block of w, x, y, z"),
        (
            "translation",
            {"x": 0.1, "y": 0, "z": 0},
            "translation is of the mount, and not the whole of it",
        ),
        ("z", 0.5, "z is of the mount, and not the whole of it"),
        ("t", [0.1, 0, 0], "translation_vector is of the mount, and not the whole of it"),
        ("skew", 1, "skew is not read here, and may change the meaning"),
        (
            "distortion_model",
            "inverse_brown_conrady",
            "cannot be drawn here; plumb_bob, rational_polynomial, equidistant",
        ),
    ):
        assert words in refused(read_intrinsics, write(changed(CAMERA_INFO, path, value))), path


def test_numbers_of_another_base_are_refused_by_the_text_that_they_have(write):
    """YAML 1.1 reads 0640 as 416 and 10:00 as 600; OpenCV and YAML 1.2 read 640, and no number."""
    text = yaml.safe_dump(CAMERA_INFO, sort_keys=False)
    for field, said in (
        ("image_width", "0640"),
        ("image_width", "10:40"),
        ("image_height", "8:00.0"),
        ("image_height", "-0_17"),
    ):
        number = CAMERA_INFO[field]
        assert f"{said} (by YAML 1.1 of base 8 or 60)" in refused(
            read_intrinsics, write(text.replace(f"{field}: {number}", f"{field}: {said}"))
        )
    plain = write(text + "time: 12:30:45\nserial: 0123\n")  # these say nothing of the camera
    assert read_intrinsics(str(plain)) == read_intrinsics(str(write(CAMERA_INFO, "other.yaml")))


def test_what_changes_nothing_is_read_as_without_it(write):
    """P describes the rectified picture: of one camera alone it may have any focal length, and the
    raw picture has K and D.
    """
    plain = read_intrinsics(str(write(CAMERA_INFO)))
    P = [450, 0, 330, 0, 0, 450, 238, 0, 0, 0, 1, 0]
    for path, value in (
        ("binning_x", 1),
        ("binning_y", 0),
        ("roi", {"x_offset": 0, "y_offset": 0, "height": 0, "width": 0, "do_rectify": False}),
        ("roi", {"x_offset": 0, "y_offset": 0, "height": 480, "width": 640, "do_rectify": True}),
        ("rectification_matrix", {"rows": 3, "cols": 3, "data": np.eye(3).ravel().tolist()}),
        ("projection_matrix", {"rows": 3, "cols": 4, "data": P}),
        ("fisheye_model", 0),
        ("header", {"frame_id": "base_link", "stamp": {"sec": 1, "nanosec": 2}}),
        ("calibration_time", "Mon"),
        ("Avg_Reprojection_Error", 0.3),
    ):
        assert read_intrinsics(str(write(changed(CAMERA_INFO, path, value)))) == plain, path


def test_opencvs_fisheye_model_is_equidistant(write):
    """It was plumb_bob: the point (.5, .3, 1) was drawn at (671.3, 472.0). Right by OpenCV's
    fisheye.projectPoints.
    """
    import cv2

    K, k = (
        np.array([[500, 0, 320], [0, 510, 240], [0, 0, 1.0]]),
        np.array([-0.02, 0.005, -0.001, 0.0002]),
    )
    file = write(
        OPENCV.replace("<fisheye_model>0<", "<fisheye_model>1<").replace(
            "-0.1 0.02 0. 0. 0.01", " ".join(map(str, k))
        ),
        "cv.xml",
    )
    file.write_text(file.read_text().replace("<rows>5<", "<rows>4<"))
    found = read_intrinsics(str(file))
    assert found.model == "equidistant"
    camera, p = Fisheye(intrinsics=found, fov_deg=150), np.array([[0.5, 0.3, 1.0]])
    right = cv2.fisheye.projectPoints(p[:, None], np.zeros(3), np.zeros(3), K, k)[0][:, 0]
    np.testing.assert_allclose(camera.project(p), right, atol=1e-9)  # rounding
    with pytest.raises(ScenarioError, match="the model of a camera of kind fisheye"):
        vs.load("arm_ibvs", {"camera": {"kind": "perspective", "intrinsics": str(file)}})


def test_coefficients_are_told_by_their_number(write, caplog):
    """Five numbers under the rational model's name are plumb_bob, which is told; OpenCV's 14 are
    refused by what they are.
    """
    five = {"rows": 1, "cols": 5, "data": [0.1, -0.05, 0, 0, 0.01]}
    named = changed(CAMERA_INFO, "distortion_model", "rational_polynomial")
    intrinsics._tell.cache_clear()
    found = read_intrinsics(str(write(changed(named, "distortion_coefficients", five))))
    assert (found.model, found.distortion) == ("plumb_bob", (0.1, -0.05, 0, 0, 0.01))
    assert "rational_polynomial of 5 coefficients is read as plumb_bob" in caplog.text
    prism = [0.1, -0.05, 0, 0, 0.01, 0.1, -0.04, 0.005, 0.0005, 0.0001, -0.0004, 0.0001, 0, 0]
    words = refused(read_intrinsics, write(changed(named, "distortion_coefficients", prism)))
    assert "12 coefficients are of a thin prism or a tilted sensor" in words
    for k, kept in (
        ([*prism[:8], *[0] * 6], prism[:8]),
        ([0.1, -0.05, 0, 0, 0.01, 0.2, 0, 0], [0.1, -0.05, 0, 0, 0.01, 0.2, 0, 0]),
    ):
        found = read_intrinsics(str(write(changed(CAMERA_INFO, "distortion_coefficients", k))))
        assert (found.model, list(found.distortion)) == ("rational_polynomial", kept)


def test_a_mount_of_another_frame_is_refused_by_name(write):
    """A camera beside the robot, and the pose of its housing, became its mount on the flange, 1.5 m
    off.
    """
    for plain, path, value, words in (
        (
            EASY,
            "parameters.eye_on_hand",
            False,
            "eye_on_hand is of a camera that stands beside the robot",
        ),
        (EASY, "eye_on_hand", False, "eye_on_hand is of a camera that stands beside the robot"),
        (
            EASY,
            "parameters.calibration_type",
            "eye_on_base",
            "calibration_type is of a camera that stands beside",
        ),
        (
            EASY,
            "parameters.tracking_base_frame",
            "camera_link",
            "tracking_base_frame is not known as the camera's optical frame",
        ),
        (EASY, "parameters.scale", 1000, "parameters.scale is not read here"),
        (EASY, "transformation.scale", 1000, "transformation.scale is not read here"),
        (EASY, "unit", "mm", "unit is not read here"),
        (EASY, "transformation.x", "nan", "transformation.translation must be finite numbers"),
        (
            EASY,
            "transformation.qw",
            None,
            "transformation needs x, y, z, qw, qx, qy, qz, or translation and rotation",
        ),
        (EASY, "T_cam2gripper", np.eye(4).tolist(), "transformation excludes T_cam2gripper"),
        (
            STAMPED,
            "child_frame_id",
            "camera_link",
            "child_frame_id is not known as the camera's optical frame",
        ),
        (STAMPED, "header.frame_id", "base_link", "header.frame_id must be the flange's frame"),
        (
            STAMPED,
            "header.frame_id",
            "camera_link",
            "header.frame_id must be the flange's frame, and not one of a base, a room, a link",
        ),
        (EASY, "parameters.robot_effector_frame", "forearm_link", "robot_effector_frame must be"),
        (EASY, "parameters.robot_effector_frame", "panda_link0", "robot_effector_frame must be"),
        (EASY, "parameters.robot_effector_frame", "robot_base", "robot_effector_frame must be"),
        (EASY, "parameters.robot_effector_frame", "r/camera_link", "robot_effector_frame must be"),
        (EASY, "robot_effector_frame", "base_link", "robot_effector_frame must be the flange's"),
        (EASY, "parameters.robot_effector_frame", "upper_arm", "robot_effector_frame must be"),
        (
            changed(EASY, "robot_effector_frame", "tool0"),
            "parameters.robot_effector_frame",
            "elbow",
            "robot_effector_frame must be the flange's frame",
        ),
        (EASY, "x", 5, "transformation excludes x"),
        (EASY, "rotation", MESSAGE["rotation"], "transformation excludes rotation"),
        (EASY, "R_cam2gripper", np.eye(3).tolist(), "transformation excludes R_cam2gripper"),
        (EASY, "R", np.eye(3).tolist(), "transformation excludes rectification_matrix"),
        (MESSAGE, "t", [0, 0, 0], "translation_vector excludes translation"),
        (MESSAGE, "x", 5, "translation excludes x"),
        (STAMPED, "transform.qx", 0, "transformation.qx excludes translation and rotation"),
        (STAMPED, "transform.rotation.v", 0, "rotation.v is not read here"),
        (STAMPED, "transform.translation", [0, 0, 0.1], "translation must be a block of x, y, z"),
        (
            {},
            "T_cam2gripper",
            np.diag([2.0, 2, 2, 1]).tolist(),
            "mount must be a rotation and a translation",
        ),
        (
            {},
            "T_cam2gripper",
            np.diag([1.0, 1, -1, 1]).tolist(),
            "mount must be a rotation and a translation",
        ),
        ({}, "T_cam_gripper", np.eye(4).tolist(), "no pose of the camera among 'T_cam_gripper'"),
        (
            {"R_cam2gripper": np.eye(3).tolist()},
            "t_cam2gripper",
            [0, 0],
            "t_cam2gripper must be 3 numbers",
        ),
    ):
        assert words in refused(read_mount, write(changed(plain, path, value))), path
    for frame in ("tool0", "panda_link8", "camera_mount", "wrist_3_link", "gripper_base"):
        right = changed(EASY, "parameters.robot_effector_frame", frame)
        assert read_mount(str(write(right)))["xyz"] == [0.01, -0.02, 0.11]
    both = {**CAMERA_INFO, "header": {"frame_id": "camera_optical_frame"}}
    both |= {"transformation": EASY["transformation"]}
    assert read_mount(str(write(both)))["xyz"] == [0.01, -0.02, 0.11]
    for plain in (EASY, STAMPED, MESSAGE):
        assert read_mount(str(write(plain)))["xyz"] == [0.01, -0.02, 0.11]


def test_a_matrix_of_three_digits_is_a_mount(write):
    """Rounded, its axes are not perpendicular to the last digit, as those of no file are."""
    turn = rotation_from_rpy(np.radians([3.0, -7.0, 40.0]))
    T = np.eye(4)
    T[:3, :3] = turn.round(3)
    T[:3, 3] = 0.01, -0.02, 0.11
    found = read_mount(str(write({"T_cam2gripper": T.tolist()})))
    # half of the last digit, twice: 1e-3 rad
    np.testing.assert_allclose(found["rpy_deg"], [3.0, -7.0, 40.0], atol=0.1)


def test_quaternions_are_of_norm_one(write):
    """A zero one "must be finite", and one of another norm was made one without a word. A file of
    three digits is well within 1e-3.
    """
    for q, words in (
        ([0, 0, 0, 0], "rotation is a quaternion that is zero, which is no rotation"),
        ([1e-9, 0, 0, 0], "rotation is a quaternion that has the norm 1e-09"),
        ([0, 0, 0, 2], "rotation is a quaternion that has the norm 2"),
        ([0, 0, 0, ".nan"], "rotation must be finite numbers"),
        ([0.707, 0, 0, 0.707], ""),
    ):
        plain = EASY
        for name, value in zip(("qx", "qy", "qz", "qw"), q, strict=True):
            plain = changed(plain, f"transformation.{name}", value)
        file = write(plain)
        if words:
            assert words in refused(read_mount, file)
        else:
            # rounding
            np.testing.assert_allclose(
                Pose(**read_mount(str(file))).T[:3, :3],
                [[1, 0, 0], [0, 0, -1], [0, 1, 0]],
                atol=1e-12,
            )


def test_files_of_other_libraries_are_told_from_damaged_ones(write, tmp_path):
    """One sentence each that says what was found: a traceback, a crash of OpenCV's reader,
    gigabytes were some of the answers.
    """
    visp = (
        '<?xml version="1.0"?>\n'
        "<root><camera><name>Camera</name><image_width>640</image_width></camera></root>"
    )
    deep, twice = (
        "[" * 3000,
        OPENCV.replace("</opencv_storage>", "<camera_matrix>1</camera_matrix></opencv_storage>"),
    )
    bomb = "a: &a [x, x, x, x]\nb: &b [*a, *a, *a]\ncamera_matrix: [*b, *b]\n"
    wider = yaml.safe_dump(changed(CAMERA_INFO, "image_width", 800))
    for name, text, words in (
        ("visp.xml", visp, "its XML is not OpenCV's"),
        ("deep.yaml", f"K: {deep}", "cannot be read"),
        ("deep.json", f'{{"K": {deep}', "cannot be read"),
        (
            "deep.yml",
            "%YAML:1.0\n---\nK: " + "[" * 100_000,
            "it has more parts than a calibration, or deeper ones",
        ),
        ("cut.xml", OPENCV[:300], "cannot be read"),
        ("twice.xml", twice, "it has a field twice"),
        ("twice.yaml", "K: [1]\nK: [2]", "it has a field twice"),
        ("twice.json", '{"K": [1], "K": [2]}', "it has a field twice"),
        ("two.yaml", f"{yaml.safe_dump(CAMERA_INFO)}---\n{wider}", "several calibrations"),
        ("bomb.yaml", bomb, "it has aliases"),
        ("large.yaml", "#" * 2_000_000, "it has 2 MiB, at most 1 are read"),
        ("zeros.yaml", "K: [1]\0", "it has bytes of zeros"),
        (
            "kalibr.yaml",
            "cam0: {camera_model: pinhole, intrinsics: [460, 459, 362, 248]}",
            "among 'cam0'",
        ),
        ("stereo.yml", "M1: [500, 0, 320, 0, 500, 240, 0, 0, 1]", "among 'M1'"),
        ("huge.yaml", f"K: [1{'0' * 400}, 0, 320, 0, 500, 240, 0, 0, 1]", "must be finite numbers"),
        (
            "mat.yml",
            (
                "%YAML:1.0\n"
                "---\n"
                "camera_matrix: !!opencv-matrix\n"
                "   rows: 99999\n"
                "   cols: 99999\n"
                "   dt: d\n"
                "   data: [ 1. ]\n"
            ),
            "and has 1",
        ),
    ):
        assert words in refused(read_calibration, write(text, name)), name
    (tmp_path / "wide.yaml").write_text(yaml.safe_dump(CAMERA_INFO), encoding="utf-16")
    assert "cannot be read ('utf-8' codec" in refused(read_intrinsics, tmp_path / "wide.yaml")
    (tmp_path / "marked.json").write_text(json.dumps(CAMERA_INFO), encoding="utf-8-sig")
    assert read_intrinsics(str(tmp_path / "marked.json")).focal_px == (500, 510)


def tried(folder: Path, count: int, first: int = 0) -> tuple[int, list[str]]:
    """How many of `count` mutated calibrations are read, and what is wrong: no sentence, no name of
    the file, another K or D.
    """
    read, wrong = 0, []
    for number in range(first, first + count):
        name, content = mutated(number)
        file = folder / f"{number}_{name}"
        file.write_bytes(content)
        signal.alarm(20)  # a hang ends the test
        try:
            found = read_calibration(str(file))
        except VstestbedError as error:
            if file.name not in str(error) or "\n" in str(error) or len(str(error)) > 1500:
                wrong.append(f"{file.name}: {error}")
        except Exception as error:  # what is looked for
            wrong.append(f"{file.name}: {type(error).__name__}: {error}")
        else:
            read += 1
            if "intrinsics" in found and not read_plainly(file, found["intrinsics"]):
                wrong.append(f"{file.name}: {found['intrinsics']}")
        finally:
            signal.alarm(0)
        file.unlink()
    return read, wrong


@pytest.mark.skipif(not hasattr(signal, "alarm"), reason="the alarm that ends a hang is POSIX's")
def test_mutated_calibrations_are_read_right_or_refused_in_a_sentence(tmp_path):
    read, wrong = tried(tmp_path, 100)
    assert not wrong, wrong
    assert 5 < read < 95  # the mutations reach both


@pytest.mark.study
def test_a_thousand_mutated_calibrations_are_read_right_or_refused_in_a_sentence(tmp_path):
    read, wrong = tried(tmp_path, 1000, 100)
    assert not wrong, wrong
    most_kb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    assert most_kb < 1 << 20, most_kb  # 1 GB, with the package and OpenCV
    print(f"{read} of 1000 are read, {most_kb / 1e3:.0f} MB")
