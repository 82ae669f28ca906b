"""CSV files, read by polars and the standard library."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import polars as pl
import pytest

import vstestbed as vs
from vstestbed.apps.export.csv_files import write_csv
from vstestbed.core.errors import OutputError
from vstestbed.loop.log_file import open_log
from vstestbed.report.recorded_run import opened


def test_a_log_comes_back_as_it_was(folders: list[Path], home: Path, tmp_path: Path) -> None:
    table = pl.DataFrame({"folder": ["runs/0", "runs/1"], "success": [False, False]})
    out = write_csv(opened(folders), tmp_path / "out", within=home, table=table)
    assert sorted(p.relative_to(out).as_posix() for p in out.rglob("*.csv")) == [
        "columns.csv",
        "comparison.csv",
        "runs/0.csv",
        "runs/1.csv",
    ]
    for i, folder in enumerate(folders):
        assert pl.read_csv(out / f"runs/{i}.csv").equals(open_log(folder).frame())
    assert pl.read_csv(out / "comparison.csv").equals(table)


def test_columns_have_their_units_and_who_knows_them(folders: list[Path], tmp_path: Path) -> None:
    out = write_csv(opened(folders[:1]), tmp_path / "out")
    with (out / "columns.csv").open(newline="") as file:
        rows = {row["column"]: row for row in csv.DictReader(file)}
    assert list(rows) == pl.read_csv(out / "0.csv").columns
    assert (rows["cmd_vx"]["unit"], rows["cmd_vx"]["whose"]) == ("m/s", "command")
    assert (rows["position_error_m"]["unit"], rows["position_error_m"]["whose"]) == ("m", "truth")


def test_what_there_is_not_is_empty(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    folder.mkdir()
    settings = {"noise.dropout": 0.5, "stop.duration_s": 0.4, "detector": {"kind": "oracle"}}
    vs.run_into(folder, vs.load("arm_ibvs", settings, 3), "none", report=False)
    out, log = write_csv(opened([folder]), tmp_path / "out"), open_log(folder).frame()
    found = pl.read_csv(out / "run.csv")
    unseen = np.isnan(log["u_0"].to_numpy())
    assert 0 < unseen.sum() < len(log)
    np.testing.assert_array_equal(found["u_0"].is_null().to_numpy(), unseen)
    np.testing.assert_array_equal(found["u_0"].drop_nulls(), log["u_0"].to_numpy()[~unseen])
    assert "nan" not in (out / "run.csv").read_text().lower()


def test_a_folder_that_holds_something_is_refused(folders: list[Path], tmp_path: Path) -> None:
    (tmp_path / "mine.txt").touch()
    with pytest.raises(OutputError, match="not an empty folder"):
        write_csv(opened(folders), tmp_path)
    assert [p.name for p in tmp_path.iterdir()] == ["mine.txt"]
