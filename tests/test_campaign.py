"""Comparisons in parts: which runs are asked for, and that an interrupted part is kept."""

from __future__ import annotations

import json
import signal
import sys
from pathlib import Path

import pytest

from docs.build import campaign, kept
from tests.shortcuts import Here

PLAN = """
base: [ibvs_book]
set: {detector: oracle, camera.rate_hz: 5, stop.duration_s: 0.4}
axes: {law.gain: [0.5, 1.0]}
tasks: {near: {camera_from_goal: [{xyz: [0, 0, -0.1]}, {xyz: [0, 0, -0.2]}, {xyz: [0, 0, -0.3]}]}}
"""


class Stopped(Here):
    """Does two runs in this process; at the third the process is told to end, as by `kill`."""

    left = 2

    def submit(self, request):
        if not self.left:
            signal.raise_signal(signal.SIGTERM)
        self.left -= 1
        return super().submit(request)


@pytest.fixture
def rows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """`campaign WORDS`: its exit code, and the rows that are kept after it."""
    monkeypatch.setattr(kept, "FOLDER", tmp_path / "kept")
    (tmp_path / "plan.yaml").write_text(PLAN)
    monkeypatch.chdir(tmp_path)

    def of(pool: Here, *words: str):
        monkeypatch.setattr(campaign, "pool_of", lambda *_: pool)
        monkeypatch.setattr(sys, "argv", ["campaign", "plan.yaml", *words])
        code = campaign.main()
        (file,) = (tmp_path / "kept").glob("*.json")
        columns = json.loads(file.read_text())["result"]["columns"]
        return code, [
            dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)
        ]

    return of


def test_an_interrupted_part_is_kept_and_gone_on_with(rows):
    code, found = rows(Stopped(), "--starts", "3", "--only", "law.gain=1.0")
    # the second run was done, and not written yet
    assert code == 130 and [row["law.gain"] for row in found] == [1.0]
    code, more = rows(Here(), "--starts", "3", "--only", "law.gain=1.0")
    assert code == 0 and found[0] in more and sorted(row["seed"] for row in more) == [0, 1, 2]


def test_rows_kept_before_have_the_labels_of_the_plan(rows, tmp_path: Path):
    rows(Here(), "--starts", "1")
    (file,) = (tmp_path / "kept").glob("*.json")
    kept_before = json.loads(file.read_text())
    kept_before["result"]["columns"]["amount"] = ["9", "9"]
    file.write_text(json.dumps(kept_before))
    _, found = rows(Here(), "--starts", "2")
    assert len(found) == 4 and all(row["amount"] == str(row["seed"]) for row in found)


@pytest.mark.parametrize("word", ["1.0", "law.gain=2", "gain=1.0"])
def test_a_part_that_no_run_is_of_is_refused(rows, word: str, capsys: pytest.CaptureFixture[str]):
    rows(Here(), "--starts", "1")
    code, _ = rows(Here(), "--starts", "1", "--only", word)
    assert (
        code == 2 and "--only must be AXIS=NAME of runs that there are" in capsys.readouterr().err
    )
