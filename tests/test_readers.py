"""Every reader of files that others write: a field that it does not know is refused by its name, at
every level, and a field that it knows is used.
"""

import copy
import csv
import json
from pathlib import Path

import numpy as np
import pytest
import yaml

import vstestbed as vs
from tests.camera.calibration_files import CAMERA_INFO, EASY, ECHO, POSE, STAMPED
from tests.shortcuts import in_app, of_apps
from vstestbed.camera.intrinsics import ABOUT, READ, read_calibration, read_intrinsics, read_mount
from vstestbed.core.errors import VstestbedError
from vstestbed.core.named_files import bundled_comparisons, bundled_labs, folder
from vstestbed.studies.comparison.plan import read_comparison

R, T = np.eye(3).tolist(), np.eye(4).tolist()
MATRIX = {"K": [500, 0, 320, 0, 510, 240, 0, 0, 1]}
ALL = {**CAMERA_INFO, **EASY, "header": {"frame_id": "c"}, "roi": ECHO["roi"]}
IMPERFECT = {"drive_lag_s": 0.05, "wheel_spread": {"sigma": 0.01}}
LAW = {"law": {"kind": "ibvs", "gain": 1.0}, "tasks": {"craft": {"gain": 0.5}}}
STARTS = {"about": "mine", "camera_from_goal": [{"xyz": [0, 0, 0.1]}]}


def omni(file):
    return vs.load("omni_ibvs", {"robot.realism": file}).robot


def starts(file):
    Path(file).with_name("plan.yaml").write_text(
        yaml.safe_dump({"base": ["arm_ibvs"], "tasks": {"mine": {"file": file}}})
    )
    return read_comparison(Path(file).with_name("plan.yaml")).tasks["mine"].lists


def yaml_of(path):
    return yaml.safe_load(path.read_text())


# reader, a valid content, and the levels where names are the user's own
READERS = {
    "camera_info": (
        read_intrinsics,
        {**CAMERA_INFO, "header": {"frame_id": "c"}, "roi": ECHO["roi"]},
        (),
    ),
    "message": (read_intrinsics, ECHO, ("header.stamp",)),
    "easy_handeye": (read_mount, EASY, ()),
    "stamped": (read_mount, STAMPED, ()),
    "calibration": (read_calibration, ALL, ()),
    "preset": (omni, IMPERFECT, ()),
    "starts": (starts, STARTS, ()),
    "lab": (
        lambda file: in_app("vstestbed.apps.course.grading:read_lab")(Path(file)),
        yaml_of(bundled_labs()["lab_1"]),
        ("tasks.*.set", "tasks.*.median"),
    ),
    "comparison": (
        lambda file: read_comparison(Path(file)),
        yaml_of(bundled_comparisons()["latency"]),
        ("set", "cases.**", "axes"),
    ),
    "suite": (
        in_app("vstestbed.apps.suite.suite:read_suite"),
        yaml_of(folder("scenarios") / "suite" / "VS-1.yaml"),
        ("laws", "tasks", "laws.*.tasks.**", "laws.*.law.**"),
    ),
    # blocks of a law's kind, checked when they are flown
    "law": (in_app("vstestbed.apps.suite.suite:law_of_file"), LAW, ("law", "tasks.**")),
    "scenario": (vs.load, yaml_of(folder("scenarios") / "arm_ibvs.yaml"), ()),
}


def levels(plain, at=()):
    """The path of each mapping."""
    if isinstance(plain, dict):
        yield at
    inner = (
        plain.items()
        if isinstance(plain, dict)
        else enumerate(plain)
        if isinstance(plain, list)
        else ()
    )
    for key, value in inner:
        yield from levels(value, (*at, key))


def own_names(path, free):
    """Whether a level is one of names of the user's own; with `**` at its end a pattern has all
    levels below it, too.
    """
    for pattern in free:
        parts = pattern.removesuffix(".**").split(".")
        fits = len(parts) <= len(path) if pattern.endswith("**") else len(parts) == len(path)
        if fits and all(part in ("*", str(key)) for part, key in zip(parts, path, strict=False)):
            return True
    return False


def put(plain, path, name, value):
    plain = copy.deepcopy(plain)
    block = plain
    for key in path:
        block = block[key]
    block[name] = value
    return plain


APPS = {"lab": "course", "suite": "suite", "law": "suite"}


@pytest.mark.parametrize("reader", of_apps(READERS, APPS))
def test_a_field_that_is_not_known_is_refused_by_its_name_at_every_level(reader, tmp_path):
    read, valid, free = READERS[reader]
    file = tmp_path / ("given.json" if reader == "starts" else "given.yaml")

    def written(plain):
        file.write_text(
            json.dumps(plain) if file.suffix == ".json" else yaml.safe_dump(plain, sort_keys=False)
        )
        return str(file)

    if reader == "comparison":  # files that it names are beside it
        valid = {
            **valid,
            "base": ["arm_ibvs"],
            "cases": {"law": {"points": {"law": {"kind": "ibvs"}}}},
        }
    if reader == "suite":  # a few of its many laws
        valid = {**valid, "laws": dict(list(valid["laws"].items())[:2])}
    read(written(valid))
    checked = [path for path in levels(valid) if not own_names(path, free)]
    for path in checked:
        with pytest.raises(VstestbedError, match="not_a_field"):
            read(written(put(valid, path, "not_a_field", 1)))
    assert checked


@pytest.mark.app("calibrate")
def test_a_column_that_is_not_known_is_refused_by_its_name(tmp_path):
    import cv2

    from vstestbed.apps.calibrate.calibration import shots_of_folder

    cv2.imwrite(str(tmp_path / "a.png"), np.zeros((8, 8, 3), np.uint8))
    line = {"picture": "a.png", **POSE, "time": 0.1}
    for more, words in (
        ({}, ""),
        ({"x_mm": 3}, "x_mm is not read here"),
        ({"qz": 0, "qw": 0}, "a quaternion that is zero"),
        ({"qw": "nan"}, "must be finite"),
    ):
        with (tmp_path / "poses.csv").open("w", newline="") as file:
            table = csv.DictWriter(file, {**line, **more})
            table.writeheader()
            table.writerow({**line, **more})
        if not words:
            (shot,) = shots_of_folder(tmp_path, None)
            np.testing.assert_allclose(shot.T_base_flange[:3, 3], [POSE[name] for name in "xyz"])
            continue
        with pytest.raises(VstestbedError, match=words):
            list(shots_of_folder(tmp_path, None))


# For each field of READ a file, the field in its own spelling, and another value: the result
# changes, or is refused by the field's name.
USED = {
    "camera_matrix": (CAMERA_INFO, "camera_matrix", MATRIX["K"][:2] + [321] + MATRIX["K"][3:]),
    "distortion_coefficients": (CAMERA_INFO, "distortion_coefficients", [0.1, 0, 0, 0]),
    "distortion_model": (
        {**CAMERA_INFO, "distortion_coefficients": [0.1, 0, 0, 0]},
        "distortion_model",
        "equidistant",
    ),
    "fisheye_model": (MATRIX, "fisheye_model", 1),
    "image_width": (CAMERA_INFO, "image_width", 641),
    "image_height": (CAMERA_INFO, "image_height", 481),
    "image_size": (MATRIX, "image_size", [640, 480]),
    "binning_x": (ECHO, "binning_x", 2),
    "binning_y": (ECHO, "binning_y", 2),
    "roi": (ECHO, "roi", {**ECHO["roi"], "x_offset": 1}),
    "rectification_matrix": (ECHO, "r", [0, -1, 0, 1, 0, 0, 0, 0, 1]),
    "projection_matrix": (ECHO, "p", [450, 0, 330, -54, 0, 450, 238, 0, 0, 0, 1, 0]),
    "header": (STAMPED, "header", {"frame_id": "base_link"}),
    "R_cam2gripper": (
        {"R_cam2gripper": R, "t_cam2gripper": [0, 0, 1]},
        "R_cam2gripper",
        [0, -1, 0, 1, 0, 0, 0, 0, 1],
    ),
    "translation_vector": ({"R": R, "t": [0, 0, 1]}, "t", [0, 0, 2]),
    "T_cam2gripper": ({"T_cam2gripper": T}, "T_cam2gripper", put(T, (2,), 3, 1.0)),
    "transformation": (EASY, "transformation", {**POSE, "x": 1}),
    "translation": ({**STAMPED["transform"]}, "translation", {"x": 1, "y": 0, "z": 0}),
    "rotation": ({**STAMPED["transform"]}, "rotation", {"x": 0, "y": 0, "z": 0, "w": 1}),
    **{name: (POSE, name, 1) for name in "xyz"},
    **{name: (POSE, name, -0.8) for name in ("qw", "qx", "qy")},
    "qz": (POSE, "qz", -0.6),
    "parameters": (EASY, "parameters", {"eye_on_hand": False}),
    "eye_on_hand": (POSE, "eye_on_hand", False),
    "calibration_type": (POSE, "calibration_type", "eye_on_base"),
    "tracking_base_frame": (POSE, "tracking_base_frame", "camera_link"),
    "child_frame_id": (STAMPED, "child_frame_id", "camera_link"),
    "robot_effector_frame": (EASY, "robot_effector_frame", "forearm_link"),
}


def test_each_field_of_a_calibration_that_is_known_is_used(tmp_path):
    assert set(USED) == set(READ), "a field that is read has its line here"
    file = tmp_path / "given.yaml"

    def read(plain):
        file.write_text(yaml.safe_dump(json.loads(json.dumps(plain))))
        return read_calibration(str(file))

    for field, (plain, spelled, value) in USED.items():
        before = read(plain)
        try:
            after = read({**plain, spelled: value})
        except VstestbedError as error:
            parts = {
                field,
                *(value if isinstance(value, dict) else ()),
                "rotation" if field[0] == "q" else field,
            }
            assert any(part in str(error) for part in parts), field
        else:
            assert after != before, field


def test_what_says_how_a_calibration_was_made_changes_nothing(tmp_path):
    file = tmp_path / "given.yaml"
    file.write_text(yaml.safe_dump({**CAMERA_INFO, **dict.fromkeys(ABOUT, 7)}))
    with_all = read_intrinsics(str(file))
    file.write_text(yaml.safe_dump(CAMERA_INFO))
    assert read_intrinsics(str(file)) == with_all
    assert not set(ABOUT) & set(READ)


def test_a_preset_is_one_plain_block(tmp_path):
    """A field twice was the last one of the two, nesting a traceback."""
    for text, words in (
        ("drive_lag_s: 0.05\ndrive_lag_s: 0.07", "it has a field twice"),
        ("a: " + "[" * 3000, "it is nested too deeply"),
        ("drive_lag_s: 0.05\n---\ndrive_lag_s: 0.07", "it is no block of imperfections"),
        ("kind: omni", "it is no block of imperfections"),
        ("a: &a 1\nb: *a", "it has aliases"),
    ):
        (tmp_path / "worn.yaml").write_text(text)
        with pytest.raises(VstestbedError, match=words):
            omni(str(tmp_path / "worn.yaml"))
    (tmp_path / "worn.yaml").write_text("drive_lag_s: 5e-2", encoding="utf-8-sig")
    assert omni(str(tmp_path / "worn.yaml")).drive_lag_s == 0.05


@pytest.mark.app("bench")
def test_a_saved_benchmark_is_read_whole(tmp_path):
    from vstestbed.apps.bench.bench import read_saved

    (tmp_path / "saved.yaml").write_text("not_a_field: 1")
    with pytest.raises(VstestbedError, match="not_a_field"):
        read_saved(tmp_path / "saved.yaml")
