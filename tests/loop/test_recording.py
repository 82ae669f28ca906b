"""How long frames wait before they are rows of the log; what a recording gives."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import vstestbed as vs
from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Pose
from vstestbed.loop import log_file
from vstestbed.loop.log_file import Log, LogWriter


@pytest.mark.parametrize("interval_s", [0.0003, 0.01, 0.04, 0.099, 0.5])
def test_no_frame_waits_for_more_than_a_tenth_of_a_second(
    monkeypatch: pytest.MonkeyPatch, interval_s: float
) -> None:
    """Of frames at a constant rate; a row is as old as the time since its frame came."""
    now = [0.0]
    monkeypatch.setattr(log_file, "kept", lambda t: {"t": t})
    monkeypatch.setattr(log_file.time, "monotonic", lambda: now[0])
    layout: Any = SimpleNamespace(
        columns=("t",), rows=lambda frames: np.array([[f["t"]] for f in frames])
    )
    writer = LogWriter(layout)
    ages, sizes = [], [0]
    for i in range(2000):
        now[0] = (i + 1) * interval_s
        before = sizes[-1]
        frame: Any = now[0]
        writer.append(frame)
        waits_until = now[0] + interval_s  # a kill just before the next frame
        sizes.append(len(writer.log()))
        ages.append(waits_until - (sizes[-1] + 1) * interval_s if sizes[-1] < i + 1 else 0.0)
        assert sizes[-1] >= before
    assert max(ages) <= LogWriter.PERIOD_S + 1e-9
    batches = np.diff([0, *(b for a, b in pairwise(sizes) if b > a)])
    # as many as may wait, save for rounding
    assert np.median(batches) == pytest.approx(1 + np.floor(LogWriter.PERIOD_S / interval_s), abs=1)
    writer.flush()
    assert writer.log()["t"].tolist() == [(i + 1) * interval_s for i in range(2000)]


def test_a_log_that_was_taken_stays_as_it_is() -> None:
    layout: Any = SimpleNamespace(
        columns=("a", "b"), rows=lambda frames: np.zeros((len(frames), 2))
    )
    writer = LogWriter(layout)
    before = writer.log()
    assert before.table.shape == (0, 2)
    writer.add(np.array([[1.0, 2.0]]))
    after = writer.log()
    writer.add(np.array([[3.0, 4.0]]))
    assert (len(before), len(after), len(writer.log())) == (0, 1, 2)
    assert after.by_name()["b"].tolist() == after["b"].tolist() == [2.0]


def test_poses_are_those_of_spatialmath() -> None:
    run = vs.run(vs.load("ibvs_book", {"detector": "oracle", "law.depth": "oracle"}))
    camera, goal = run.camera_poses(), run.scenario.goal_poses[0]
    assert len(camera) == len(run.rows)
    start = run.scenario.robot.start.nominal.SE3()
    assert np.allclose(camera[0].A, start.A, atol=1e-12)
    # the relative pose of the last frame is the goal's, by spatialmath's own inverse and product
    assert np.allclose((camera[-1].inv() * run.target_poses()[-1]).A, goal, atol=1e-2)
    assert np.allclose(Pose.of(start).T, start.A)
    assert np.allclose(
        run.camera_twists()[3].S,
        [run[f"act_{name}"][3] for name in ("vx", "vy", "vz", "wx", "wy", "wz")],
    )


@pytest.mark.parametrize(
    ("name", "moves"), [("ibvs_book", False), ("quadrotor_path", True), ("arm_track_circle", True)]
)
def test_the_goal_pose_is_that_from_which_the_log_counts_errors(name: str, moves: bool) -> None:
    """Of one goal, of a path, behind a target that moves."""
    run = vs.run(
        vs.load(
            name,
            {"stop.duration_s": 0.6, "detector": "oracle"}
            | ({"goal.settle_s": 0.1} if moves else {}),
        )
    )
    left = [at.inv() * goal for at, goal in zip(run.camera_poses(), run.goal_pose(), strict=True)]
    assert [np.linalg.norm(T.t) for T in left] == pytest.approx(run["position_error_m"], abs=1e-12)
    assert [T.angvec()[0] for T in left] == pytest.approx(run["rotation_error_rad"], abs=1e-6)
    assert (np.ptp(run.goal_pose().t, axis=0).max() > 1e-3) == moves


def test_a_line_to_follow_has_no_goal_pose_and_no_frames_are_no_poses() -> None:
    run = vs.run(vs.load("car_line", {"stop.duration_s": 0.1}))
    with pytest.raises(ParameterError, match="goal of kind line is no single pose of the camera"):
        run.goal_pose()
    empty = replace(run, rows=Log(run.columns, run.table[:0]))
    assert len(empty.camera_poses()) == len(empty.camera_twists()) == 0


def test_spatialmath_plots_and_animates_the_poses(tmp_path: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    poses = vs.run(
        vs.load("ibvs_book", {"detector": "oracle", "stop.duration_s": 1})
    ).camera_poses()
    poses.plot(ax=pyplot.figure().add_subplot(projection="3d"), dims=[-1, 2, -1, 2, -3.5, 1])
    lines = pyplot.gca().lines + pyplot.gca().collections  # pyright: ignore[reportOperatorIssue]
    assert len(lines) >= 3 * len(poses)
    pyplot.figure()
    poses[::5].animate(dims=[-1, 2, -1, 2, -3.5, 1]).save(tmp_path / "a.gif", writer="pillow")
    assert (tmp_path / "a.gif").read_bytes()[:3] == b"GIF"
    pyplot.close("all")
