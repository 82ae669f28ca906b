"""The folder of a study: new ones, ones that go on, and the plan in them."""

from __future__ import annotations

from pathlib import Path

import polars as pl
import pytest

from vstestbed.core.errors import OutputError, ParameterError, RunFolderError
from vstestbed.core.files import study_folder, write_table
from vstestbed.studies.comparison import PLAN, Comparison
from vstestbed.studies.comparison.plan import read_comparison
from vstestbed.studies.folder import RESUMABLE, resumed_folder, write_plan


def test_a_study_that_fails_leaves_no_empty_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ZeroDivisionError), study_folder("basin", None) as folder:
        assert folder == Path("runs/basin/001") and folder.is_dir()
        raise ZeroDivisionError
    assert not Path("runs").exists()
    with study_folder("basin", None), study_folder("basin", None) as second:
        assert second == Path("runs/basin/002")


def test_a_study_goes_on_only_where_its_plan_is(quick: Path, tmp_path: Path):
    out = tmp_path / "out"
    with (
        pytest.raises(
            ParameterError, match="--resume needs the folder that `vstestbed compare` has made"
        ),
        resumed_folder("compare", None, PLAN),
    ):
        pass
    with (
        pytest.raises(RunFolderError, match="no such folder"),
        resumed_folder("compare", out, PLAN),
    ):
        pass
    with study_folder("compare", out, RESUMABLE):
        write_plan(out / PLAN, Comparison(base=(str(quick), "arm_ibvs"), seeds=3), "base")
    quick.unlink()  # the folder has a copy
    with resumed_folder("compare", out, PLAN) as again:
        assert read_comparison(again / PLAN).base == (str(out / "scenarios/quick.yaml"), "arm_ibvs")
    with (
        pytest.raises(RunFolderError, match=r"has no tuning\.yaml"),
        resumed_folder("tune", out, "tuning.yaml"),
    ):
        pass
    with (
        pytest.raises(OutputError, match="or --resume to go on with what is there"),
        study_folder("compare", out, RESUMABLE),
    ):
        pass


def test_a_table_is_written_twice_whole_or_not_at_all(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    table = pl.DataFrame({"a": [1, 2, 3], "b": ["x", "y", None]})
    write_table(tmp_path / "of.runs", table, row_group_size=2)
    assert pl.read_parquet(tmp_path / "of.runs.parquet").equals(table)
    assert pl.read_csv(tmp_path / "of.runs.csv").equals(table)
    monkeypatch.setattr(
        pl.DataFrame,
        "write_csv",
        lambda *_: (_ for _ in ()).throw(OSError(28, "No space left on device")),
    )
    with pytest.raises(Exception, match="no space left on the disk"):
        write_table(tmp_path / "more", table)
    assert sorted(p.name for p in tmp_path.iterdir()) == [
        "more.parquet",
        "of.runs.csv",
        "of.runs.parquet",
    ]
