"""Loops before targets of one's own: what is hidden is not seen, what is lost has its name, and the
folder keeps the file.
"""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import mujoco
import numpy as np
import pytest

import vstestbed as vs
from vstestbed.core.errors import ScenarioError
from vstestbed.core.named_files import folder
from vstestbed.report.run.figures import depth
from vstestbed.report.run.space import features
from vstestbed.report.run.tracks import LogArrays, Setting
from vstestbed.studies.run_folder import run_into

QUICK = {"stop.duration_s": 0.4, "detector": "oracle"}


@pytest.mark.parametrize("renderer", ["gl", "rays"])
@pytest.mark.parametrize("name", ["arm_picture", "arm_mesh"])
def test_the_arm_begins_well_by_either_renderer(name: str, renderer: str):
    r = vs.run(vs.load(name, {"camera.renderer": renderer, "stop.duration_s": 0.6}))
    off = np.array([r[f"{c}_{i}"] - r[f"{c}_true_{i}"] for c in "uv" for i in range(4)])
    assert (
        np.isfinite(off).all()
        and np.median(np.abs(off)) < 0.06
        and r["error_px"][-1] < r["error_px"][0]
    )


@pytest.mark.study
@pytest.mark.parametrize("renderer", ["gl", "rays"])
@pytest.mark.parametrize("name", ["arm_picture", "arm_mesh"])
def test_the_arm_converges_by_either_renderer(name: str, renderer: str):
    assert vs.run(vs.load(name, {"camera.renderer": renderer})).outcome is vs.Outcome.converged


def test_a_folder_keeps_the_file_and_can_be_moved(tmp_path: Path):
    shutil.copy(folder("scenarios") / "targets" / "page.png", tmp_path / "mine.png")
    (tmp_path / "run").mkdir()
    run_into(
        tmp_path / "run",
        vs.load("arm_picture", QUICK | {"target.file": str(tmp_path / "mine.png")}),
        films="none",
        report=False,
    )
    (tmp_path / "mine.png").unlink()
    (tmp_path / "run").rename(tmp_path / "moved")
    again = vs.load(tmp_path / "moved" / "scenario.yaml")
    assert again.target.source == tmp_path / "moved" / "assets" / "target" / "mine.png"
    assert (
        json.loads((tmp_path / "moved" / "summary.json").read_text())["marker_names"]["2"]
        == again.target.names[2]
    )
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "moved" / "model.xml"))
    assert model.geom("target/picture").matid[0] >= 0


def test_a_name_is_in_the_reason_of_a_run_and_chooses_markers():
    away = {
        "goal.markers": ["bolt A", "bolt C", "bolt D"],
        "world.plates": [{"pose": {"xyz": [1.0, 0, 0.7], "rpy_deg": [0, 90, 0]}}],
    }
    r = vs.run(
        vs.load("arm_mesh", QUICK | away | {"stop.lost_after_s": 0.2, "stop.duration_s": 2.0})
    )
    assert r.outcome is vs.Outcome.target_lost
    assert "(not seen: bolt A, bolt B, bolt C, bolt D)" in r.reason
    np.testing.assert_array_equal(r.scenario.goal_view.counted, [True, False, True, True])
    with pytest.raises(
        ScenarioError,
        match=(
            r"goal.markers: must be numbers of markers, 0 to 3, or names:"
            r" bolt A, bolt B, bolt C, bolt D, got"
        ),
    ):
        vs.load("arm_mesh", {"goal.markers": ["bolt A", "nut", "bolt C"]})


def test_markers_that_no_picture_can_show_are_told():
    bare = {"target.draw_markers": False}
    words = (
        "target.draw_markers: may not be false with detector blobs:"
        " a mesh without markers shows it nothing to detect; use true, or"
    )
    with pytest.raises(ScenarioError, match=f"{words} detector oracle"):
        vs.load("arm_mesh", bare)
    assert vs.load("arm_mesh", bare | {"detector": "oracle"}).detector.kind == "oracle"
    lost = {"stop.lost_after_s": 0.2, "stop.duration_s": 1.0}
    r = vs.run(
        vs.load(
            "arm_picture",
            lost | {"target.marker.family": "apriltag_25h9", "target.marker.first_id": 3},
        )
    )
    words = (
        "the file page.png may not show tags of family apriltag_25h9,"
        " number 3 to 6 there) for 0.2 s; markers"
    )
    assert r.outcome is vs.Outcome.target_lost
    assert f"(detector tags has not found one of 4 markers in any picture: {words}" in r.reason


def test_a_goal_view_from_behind_the_part_is_refused():
    behind = {"goal.T_camera_target": {"xyz": [0, 0, 0.8]}}
    words = (
        r"markers 0 \(bolt A\), 1 \(bolt B\), 2 \(bolt C\),"
        r" 3 \(bolt D\) are hidden by the target itself; move the goal"
    )
    with pytest.raises(ScenarioError, match=words):
        vs.load("arm_mesh", behind)


def test_the_oracle_does_not_see_through_the_part():
    part = {
        "at": [[-85, 0, 18], [85, 0, 18], [0, 85, 18], [0, -85, 18]],
        "file": str(folder("scenarios") / "targets" / "flange.stl"),
    }
    target = {
        "kind": "mesh",
        "scale": 0.001,
        "pose": {"xyz": [0, 0, 1], "rpy_deg": [180, 0, 0]},
        "marker": {"radius": 0.01},
    } | part
    robot = {"kind": "free", "start": {"nominal": {"xyz": [-0.9, 0, 0.8], "rpy_deg": [0, 75, 0]}}}
    settings = {
        "robot": robot,
        "target": target,
        "goal": {"T_camera_target": {"xyz": [0, 0, 1.0], "rpy_deg": [180, 0, 0]}},
    }
    r = vs.run(vs.load("ibvs_book", settings | {"detector": "oracle", "stop.duration_s": 0.2}))
    assert np.isnan(r["u_1"][0]) and np.isfinite([r[f"u_{i}"][0] for i in (0, 2, 3)]).all()


def test_figures_show_the_names():
    r = vs.run(vs.load("arm_mesh", QUICK))
    tracks = LogArrays.of(r.rows, Setting.of(r.scenario))
    trails, depths = features(tracks), depth(tracks)
    assert trails is not None and depths is not None
    assert [words[2].strip("\N{NO-BREAK SPACE}") for words in trails.panels[0].words] == list(
        r.scenario.target.names
    )
    assert [c.label for c in depths.panels[0].curves if c.label] == list(r.scenario.target.names)
