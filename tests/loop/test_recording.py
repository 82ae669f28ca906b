"""How long frames wait before they are rows of the log; what a recording gives."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest

import vstestbed as vs
from vstestbed.core.geometry import Pose
from vstestbed.loop import recording
from vstestbed.loop.recording import Log, MemoryRows


@pytest.mark.parametrize("interval_s", [0.0003, 0.01, 0.04, 0.099, 0.5])
def test_no_frame_waits_for_more_than_a_tenth_of_a_second(monkeypatch: pytest.MonkeyPatch, interval_s: float) -> None:
    """Of frames at a constant rate; a row is as old as the time since its frame came."""
    now, rows = [0.0], MemoryRows(("t",))
    monkeypatch.setattr(recording, "kept", lambda t: {"t": t})
    monkeypatch.setattr(recording.time, "monotonic", lambda: now[0])
    layout: Any = type("Layout", (), {"rows": lambda _, frames: np.array([[f["t"]] for f in frames])})()
    log = Log(layout, rows)
    ages, sizes = [], [0]
    for i in range(2000):
        now[0] = (i + 1) * interval_s
        before = len(rows)
        frame: Any = now[0]
        log.append(frame)
        waits_until = now[0] + interval_s  # a kill just before the next frame
        sizes.append(len(rows))
        ages.append(waits_until - (len(rows) + 1) * interval_s if len(rows) < i + 1 else 0.0)
        assert len(rows) >= before
    assert max(ages) <= Log.PERIOD_S + 1e-9
    batches = np.diff([0, *(b for a, b in pairwise(sizes) if b > a)])
    assert np.median(batches) == pytest.approx(1 + np.floor(Log.PERIOD_S / interval_s), abs=1)  # as many as may wait, save for rounding
    log.flush()
    assert rows.table()[:, 0].tolist() == [(i + 1) * interval_s for i in range(2000)]


def test_columns_and_tables_are_read_once() -> None:
    rows = MemoryRows(("a", "b"))
    for i in range(5):
        rows.append(np.array([[i, 10.0 * i]]))
    assert rows.table() is rows.table()
    assert [block["b"].tolist() for block in rows.blocks(["b"])] == [[0.0, 10.0, 20.0, 30.0, 40.0]]
    assert MemoryRows(("a", "b")).table().shape == (0, 2)


def test_poses_are_those_of_spatialmath() -> None:
    run = vs.run(vs.load("ibvs_book", {"detector": "oracle", "law.depth": "oracle"}))
    camera, goal = run.camera_poses(), run.scenario.goal_poses[0]
    assert len(camera) == len(run.rows)
    start = run.scenario.robot.start.nominal.SE3()
    assert np.allclose(camera[0].A, start.A, atol=1e-12)
    # the relative pose of the last frame is the goal's, by spatialmath's own inverse and product
    assert np.allclose((camera[-1].inv() * run.target_poses()[-1]).A, goal, atol=1e-2)
    assert np.allclose(Pose.of(start).T, start.A)
