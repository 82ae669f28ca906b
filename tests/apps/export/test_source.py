"""Recorded runs as exports read them: pictures, actions and state are those that the run had."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

import vstestbed as vs
from vstestbed.apps.export.lerobot import features_of, numbers_of
from vstestbed.core.errors import RunFolderError
from vstestbed.loop.columns import Layout
from vstestbed.report.recorded_run import RecordedRun, meaning, name_with_unit

VARIANTS = {
    "noise and drift": (
        "arm_ibvs",
        {"noise.image_sigma": 3.0, "noise.drift.brightness": 0.2, "noise.drift.color": 0.1},
    ),
    "latency and lost pictures": (
        "arm_ibvs",
        {"camera.latency_s": 0.08, "timing.drop_probability": 0.3},
    ),
    "lens, exposure, sensor and stream": (
        "arm_ibvs",
        {
            "camera.optics": {"vignetting": 0.3},
            "camera.exposure": {"auto": {}},
            "camera.sensor": {},
            "camera.stream": "h264",
        },
    ),
    "eye to hand": ("arm_eye_to_hand", {}),
}
SMALL = {"camera.width": 320, "camera.height": 240, "stop.duration_s": 0.28}


@pytest.mark.app("learn")
@pytest.mark.parametrize("variant", VARIANTS)
def test_pictures_and_numbers_are_those_of_the_environment(variant: str, tmp_path: Path) -> None:
    from vstestbed.apps.learn.rollout import Rollout

    name, settings = VARIANTS[variant]
    scenario = vs.load(name, SMALL | settings, 0)
    rollout = Rollout(vs.load(name, SMALL | settings), "both")
    step = rollout.reset(0)
    vs.run_into(tmp_path, scenario, "none", report=False)
    run = RecordedRun.of(tmp_path)
    numbers, state = numbers_of(run)
    assert state == scenario.robot.proprioception_names
    for k, frame in enumerate(run.frames()):
        seen = step.observation
        np.testing.assert_array_equal(frame.picture, seen["pixels"])  # noise and all
        np.testing.assert_array_equal(
            numbers["markers"][k].astype(np.float32), seen["markers"].ravel()
        )
        np.testing.assert_array_equal(numbers["seen"][k], seen["seen"])
        np.testing.assert_array_equal(numbers["goal"][k].astype(np.float32), seen["goal"].ravel())
        np.testing.assert_allclose(numbers["observation.state"][k], seen["agent_pos"], atol=1e-7)
        if not (step.terminated or step.truncated):
            action = rollout.expert()
            np.testing.assert_allclose(numbers["action"][k], action, atol=1e-12)
            step = rollout.step(action)
            np.testing.assert_allclose(numbers["next.reward"][k], step.reward, atol=1e-6)
    rollout.close()
    assert k == len(run.log) - 1 and step.truncated
    assert (
        numbers["next.done"].ravel().tolist() == [False] * k + [True]
        and not numbers["next.success"].any()
    )


def test_pictures_of_a_lens_with_panels_are_its_own(tmp_path: Path) -> None:
    scenario = vs.load(
        "spherical_book",
        {
            "stop.duration_s": 0.2,
            "noise.image_sigma": 1.0,
            "camera.width": 200,
            "camera.height": 200,
        },
    )
    session = vs.Session(scenario, pictures=True)
    frames = [session.reset()]
    while frames[-1].outcome is None:
        frames.append(session.step())
    session.close()
    vs.run_into(tmp_path, scenario, "none", report=False)
    taken = list(RecordedRun.of(tmp_path).frames())
    assert len(taken) == len(frames)
    for again, frame in zip(taken, frames, strict=True):
        np.testing.assert_array_equal(again.picture, frame.image)


@pytest.mark.parametrize("name", ["car_pbvs", "quadrotor_hover", "omni_ibvs"])
def test_the_state_is_what_the_log_has_of_the_robots_own_sensors(name: str, tmp_path: Path) -> None:
    scenario = vs.load(name, {"stop.duration_s": 0.28, "detector": {"kind": "oracle"}})
    session = vs.Session(scenario)
    frames = [session.reset()]
    own = []
    while True:
        before, robot = session.episode.controller.before, scenario.robot
        own.append(robot.proprioception(before.reading, frames[-1].observation.odometry))
        if frames[-1].outcome is not None:
            break
        frames.append(session.step())
    session.close()
    vs.run_into(tmp_path, scenario, "none", report=False)
    numbers, state = numbers_of(RecordedRun.of(tmp_path))
    at = [scenario.robot.proprioception_names.index(entry) for entry in state]
    # the log has no compass, and no range
    assert len(at) >= len(scenario.robot.proprioception_names) - 1
    np.testing.assert_allclose(numbers["observation.state"], np.array(own)[:, at], atol=1e-12)


def test_it_says_how_its_pictures_were_made(folders: list[Path], tmp_path: Path) -> None:
    words = (
        "redrawn from the log at the camera's rate and size, with the run's noise of 2 grey levels"
    )
    assert RecordedRun.of(folders[0]).how_taken == words
    blurred = shutil.copytree(folders[0], tmp_path / "blurred")
    text = (blurred / "resolved.yaml").read_text().replace("exposure_s: 0.0", "exposure_s: 0.01")
    (blurred / "resolved.yaml").write_text(text)
    assert (
        RecordedRun.of(blurred).how_taken
        == f"{words}, without the motion blur of its 0.01 s exposure"
    )
    (blurred / "resolved.yaml").write_text(text.replace("readout_s: 0.0", "readout_s: 0.02"))
    assert RecordedRun.of(blurred).how_taken.endswith(
        " exposure, without the skew of its rolling shutter of 0.02 s"
    )


def test_a_folder_without_a_run_is_refused_and_one_that_was_cut_off_is_known(
    folders: list[Path], tmp_path: Path
) -> None:
    with pytest.raises(RunFolderError, match="no such folder"):
        RecordedRun.of(tmp_path / "nowhere")
    with pytest.raises(RunFolderError, match="no run here"):
        RecordedRun.of(tmp_path)
    cut = shutil.copytree(folders[0], tmp_path / "cut")
    (cut / "summary.json").unlink()
    run = RecordedRun.of(cut)
    assert run.outcome == "cut off" and not run.success


def test_a_run_without_markers_has_no_features_of_them(tmp_path: Path) -> None:
    settings = {"camera.width": 160, "camera.height": 120, "law.levels": 3, "stop.duration_s": 0.12}
    vs.run_into(tmp_path, vs.load("arm_photometric", settings), "none", report=False)
    run = RecordedRun.of(tmp_path)
    numbers, state = numbers_of(run)
    assert not {"markers", "seen", "goal"} & (
        numbers.keys() | features_of(run.scenario, state).keys()
    )
    assert name_with_unit("error_grey", meaning("error_grey", run.scenario)[0]) == "error_grey"


def test_every_column_of_the_bundled_robots_has_a_meaning() -> None:
    for name in (
        "arm_ibvs",
        "arm_jaco",
        "car_parking",
        "omni_via_points",
        "quadrotor_land",
        "quadrotor_aggressive",
    ):
        scenario = vs.load(name)
        assert [c for c in Layout(scenario).columns if meaning(c, scenario)[1] == "own"] == []
    scenario = vs.load("arm_ibvs")
    assert (
        meaning("q_joint_1", scenario)[:2] == ("rad", "truth")
        and meaning("qd_joint_1", scenario)[0] == "rad/s"
    )
    assert meaning("cmd_vx", scenario)[:2] == ("m/s", "command")
    assert meaning("u_true_3", scenario)[:2] == ("px", "truth")
    assert meaning("gap_mm", scenario)[:2] == ("mm", "own")  # of a plugin
    assert [
        name_with_unit(*of)
        for of in (("vx", "m/s"), ("error_px", "px"), ("joint-1", "rad"), ("scale", ""))
    ] == [
        "vx_mps",
        "error_px",
        "joint_1_rad",
        "scale",
    ]
