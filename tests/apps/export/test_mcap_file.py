"""MCAP files, read by `mcap` and Foxglove's own schemas."""

from __future__ import annotations

import io
import json
from collections import defaultdict
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

import vstestbed as vs
from vstestbed.apps.export import mcap_file
from vstestbed.apps.export.mcap_file import write_mcap
from vstestbed.core.geometry import pose_from, transform
from vstestbed.report.recorded_run import RecordedRun, opened, write_each

FOXGLOVE = {
    "/camera/image": "foxglove.CompressedImage",
    "/camera/calibration": "foxglove.CameraCalibration",
    "/camera/markers": "foxglove.ImageAnnotations",
    "/camera/goal": "foxglove.ImageAnnotations",
    "/truth/markers": "foxglove.ImageAnnotations",
    "/truth/transforms": "foxglove.FrameTransforms",
    "/truth/camera_calibration": "foxglove.CameraCalibration",
}


def read(
    path: Path,
) -> tuple[dict[str, list[tuple[int, Any]]], dict[str, str], dict[str, bytes], dict[str, str]]:
    """Messages by topic with their times, schemas by topic, attachments, metadata."""
    found, schemas = defaultdict(list), {}
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()], validate_crcs=True)
        for schema, channel, message, decoded in reader.iter_decoded_messages():
            found[channel.topic].append((message.log_time, decoded))
            schemas[channel.topic] = schema.name
        attached = {a.name: a.data for a in reader.iter_attachments()}
        (about,) = (m.metadata for m in reader.iter_metadata())
    return found, schemas, attached, about


def decoded(message: Any) -> np.ndarray:
    """The picture of a CompressedImage, (H, W, 3) RGB."""
    return next(av.open(io.BytesIO(message.data)).decode(video=0)).to_ndarray(format="rgb24")


def stamp_ns(message: Any) -> int:
    """The time stamp of a message [ns]."""
    return message.timestamp.seconds * mcap_file.NS + message.timestamp.nanos


@pytest.fixture(scope="module")
def exported(folders: list[Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The first run as MCAP."""
    return write_mcap(RecordedRun.of(folders[0]), tmp_path_factory.mktemp("mcap") / "a.mcap")


def test_topics_have_foxgloves_schemas_and_the_logs_times(
    exported: Path, folders: list[Path]
) -> None:
    found, schemas, _, _ = read(exported)
    log = RecordedRun.of(folders[0]).log.table
    columns = RecordedRun.of(folders[0]).log.columns
    assert FOXGLOVE.items() <= schemas.items()
    assert {name for name in schemas.values() if not name.startswith("foxglove.")} == {
        *(
            "vstestbed.CameraError",
            "vstestbed.CameraDepths",
            "vstestbed.RobotCommand",
            "vstestbed.RobotApplied",
            "vstestbed.RobotControls",
        ),
        *(
            "vstestbed.RobotState",
            "vstestbed.TruthError",
            "vstestbed.TruthCameraTwist",
            "vstestbed.TruthJointPositions",
        ),
        "vstestbed.TruthJointVelocities",
    }
    times = [round(t * 1e9) for t in log[:, columns.index("t")]]
    for topic, those in found.items():
        # no latency here: commands are in force at once
        assert [t for t, _ in those] == times, topic
    assert [stamp_ns(m) for _, m in found["/camera/image"]] == times


def test_numbers_are_the_logs_with_units_in_their_names(
    exported: Path, folders: list[Path]
) -> None:
    found, _, _, _ = read(exported)
    run = RecordedRun.of(folders[0])
    log = dict(zip(run.log.columns, run.log.table.T, strict=True))
    for topic, field, column in (
        ("/camera/error", "error_px", "error_px"),
        ("/camera/depths", "depth_0_m", "depth_0"),
        ("/robot/command", "vx_mps", "cmd_vx"),
        ("/robot/applied", "wz_radps", "applied_wz"),
        ("/robot/applied", "scale", "scale"),
        ("/truth/camera_twist", "wx_radps", "act_wx"),
        ("/truth/error", "rotation_error_rad", "rotation_error_rad"),
        ("/truth/joint_positions", "joint_6_rad", "q_joint_6"),
        ("/truth/joint_velocities", "joint_1_radps", "qd_joint_1"),
    ):
        np.testing.assert_array_equal(
            [getattr(m, field) for _, m in found[topic]], log[column], err_msg=field
        )


def test_annotations_lie_on_the_markers_whose_colours_are_red_green_blue(
    exported: Path, folders: list[Path]
) -> None:
    found, _, _, about = read(exported)
    run = RecordedRun.of(folders[0])
    colors = np.round(run.scenario.target.colors * 255)
    rows, columns = np.mgrid[:240, :321]
    assert about["pictures"].endswith("with the run's noise of 2 grey levels")
    for k, (_, message) in enumerate(found["/camera/image"]):
        image = decoded(message).astype(float)
        assert (
            image.shape == (240, 321, 3)
            and message.format == "jpeg"
            and message.frame_id == "camera"
        )
        true, measured = (
            [(c.position.x, c.position.y) for c in found[t][k][1].circles]
            for t in ("/truth/markers", "/camera/markers")
        )
        for (x, y), (x_seen, y_seen), color in zip(true, measured, colors, strict=True):
            near = np.hypot(columns + 0.5 - x, rows + 0.5 - y) < 9  # 0 is the picture's corner
            # shaded, and next to grey: what of a pixel is the marker's colour
            hue = (image - image.min(axis=-1, keepdims=True)) @ (color / 255 - (color / 255).mean())
            weight = np.where(near & (hue > 0.4 * hue[near].max()), 1.0, 0.0)
            x_found, y_found = (
                ((at + 0.5) * weight).sum() / weight.sum() for at in (columns, rows)
            )
            assert abs(x_found - x) < 0.35 and abs(y_found - y) < 0.35
            assert np.hypot(x_seen - x, y_seen - y) < 0.6  # measured, with noise of .1 px


def test_the_calibration_projects_the_target_through_the_transforms(
    exported: Path, folders: list[Path]
) -> None:
    found, _, _, _ = read(exported)
    points = RecordedRun.of(folders[0]).scenario.target.points
    calibration = found["/truth/camera_calibration"][-1][1]
    assert (calibration.width, calibration.height, calibration.distortion_model) == (
        321,
        240,
        "plumb_bob",
    )
    frames = {t.child_frame_id: t for t in found["/truth/transforms"][-1][1].transforms}
    assert {t.parent_frame_id for t in frames.values()} == {"world"}
    assert {
        "camera",
        "target",
        "goal",
    } < frames.keys()
    assert any(name.startswith("robot/") for name in frames)

    def pose(name: str) -> np.ndarray:
        p, q = frames[name].translation, frames[name].rotation
        return pose_from(np.array([p.x, p.y, p.z]), np.array([q.w, q.x, q.y, q.z]))

    p = transform(np.linalg.inv(pose("camera")) @ pose("target"), points)
    uv = (p @ np.array(calibration.K).reshape(3, 3).T)[:, :2] / p[:, 2:]
    circles = [(c.position.x, c.position.y) for c in found["/truth/markers"][-1][1].circles]
    # K has 0 in the middle of the first pixel
    np.testing.assert_allclose(uv + 0.5, circles, atol=1e-6)
    goal = transform(np.linalg.inv(pose("goal")) @ pose("target"), points)
    np.testing.assert_allclose(goal[:, 2], 1.0, atol=1e-9)


def test_it_holds_the_runs_files_and_what_a_reader_must_know(
    exported: Path, folders: list[Path]
) -> None:
    _, _, attached, about = read(exported)
    assert attached == {
        name: (folders[0] / name).read_bytes()
        for name in ("scenario.yaml", "resolved.yaml", "summary.json", "model.xml")
    }
    assert about["outcome"] == json.loads(attached["summary.json"])["outcome"] == "timed_out"
    assert about["success"] == "false" and about["seed"] == "0" and about["scenario"] == "arm_ibvs"


def test_a_start_moves_all_times_and_commands_are_stamped_with_the_time_they_are_in_force(
    tmp_path: Path,
) -> None:
    folder = tmp_path / "run"
    folder.mkdir()
    settings = {
        "camera.latency_s": 0.04,
        "timing.command_latency_s": 0.02,
        "stop.duration_s": 0.2,
        "detector": {"kind": "oracle"},
    }
    vs.run_into(
        folder,
        vs.load("arm_ibvs", settings | {"camera.width": 64, "camera.height": 48}),
        "none",
        report=False,
    )
    found, _, _, _ = read(
        write_mcap(RecordedRun.of(folder), tmp_path / "a.mcap", start_s=1_700_000_000.0)
    )
    assert [t for t, _ in found["/camera/image"]][:2] == [
        1_700_000_000_000_000_000,
        1_700_000_000_040_000_000,
    ]
    assert [t for t, _ in found["/robot/command"]][:2] == [
        1_700_000_000_060_000_000,
        1_700_000_000_100_000_000,
    ]
    assert found["/camera/image"][0][1].format == "png"  # without noise, and without loss


def test_lenses_without_a_standard_model_have_no_calibration() -> None:
    assert mcap_file.as_ros(vs.load("car_catadioptric").camera) is None
    assert mcap_file.calibration(0, vs.load("spherical_book").camera) is None
    fisheye = mcap_file.calibration(0, vs.load("arm_fisheye").camera)
    assert (
        fisheye is not None and fisheye.distortion_model == "kannala_brandt" and len(fisheye.D) == 4
    )


def test_runs_of_a_comparison_are_files_in_its_places_whole_or_not_at_all(
    folders: list[Path], home: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = write_each(opened(folders), tmp_path / "out", home, ".mcap", write_mcap)
    assert sorted(p.relative_to(out).as_posix() for p in out.rglob("*.mcap")) == [
        "runs/0.mcap",
        "runs/1.mcap",
    ]
    assert len(read(out / "runs/1.mcap")[0]["/camera/image"]) == 8
    monkeypatch.setattr(mcap_file, "circles", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        write_each(opened(folders), tmp_path / "broken", home, ".mcap", write_mcap)
    assert [p.name for p in tmp_path.iterdir()] == ["out"]
