"""Damaged folders in `report`, `render` and `compare --resume`: a sentence that names the file,
never a traceback or a wait.
"""

from __future__ import annotations

import io
import json
import os
import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from vstestbed.core.errors import VstestbedError
from vstestbed.loop.log_file import open_log
from vstestbed.loop.recording import read_summary
from vstestbed.report import write_report
from vstestbed.scenario.load import load
from vstestbed.studies.comparison import PLAN, compare, report_again
from vstestbed.studies.run_folder import run_into


@pytest.fixture
def run(quick: Path, tmp_path: Path) -> Path:
    folder = tmp_path / "run"
    folder.mkdir()
    run_into(folder, load(quick, {"stop.duration_s": 0.2}), "none", report=False)
    return folder


def refused(command, name: str, folder: Path, *words: str) -> str:
    ended = command(name, folder, *words)
    assert (ended.code, ended.out) == (2, ""), ended.err
    return ended.err


SUMMARIES = (
    *(
        "",
        "[]",
        "5",
        "null",
        "{}",
        "{",
        "\x00" * 99,
        "[" * 100_000,
        '{"outcome": "converged"}',
        '{"outcome": 3, "success": true}',
    ),
    *(
        '{"outcome": "won", "success": true}',
        '{"outcome": "converged", "success": true, "time_ms": 5}',
    ),
    *(
        '{"outcome": "converged", "success": true, "versions": [1]}',
        '{"outcome": "converged", "success": true, "frames": "x"}',
    ),
    *(
        '{"outcome": "converged", "success": true, "reason": "\\ud800"}',
        '{"outcome": "converged", "success": true, "x": [[1]]}',
    ),
    f'{{"outcome": "converged", "success": true, "frames": {"9" * 500}}}',
)


def test_summaries(command, run: Path) -> None:
    (run / "summary.json").write_text(
        '{"outcome": "converged", "success": true, "more": {"a": 1}, "frames": 7}'
    )
    assert read_summary(run, "")["frames"] == 7
    for text in SUMMARIES:
        (run / "summary.json").write_text(text)
        err = refused(command, "report", run)
        assert (
            err.startswith(f"{run}/summary.json: is not the summary of a run (")
            and err.count("\n") == 1
        ), err
        assert err.endswith("; without this file `report` shows what the log has\n")
    (run / "summary.json").unlink()
    os.mkfifo(run / "summary.json")
    assert "is not a plain file" in refused(command, "report", run)


def parquet(table: pl.DataFrame) -> bytes:
    sink = io.BytesIO()
    table.write_parquet(sink)
    return sink.getvalue()


@pytest.mark.parametrize(
    "words",
    [
        ("report",),
        ("render",),
        pytest.param(("export", "--to", "csv"), marks=pytest.mark.app("export")),
    ],
    ids=str,
)
def test_a_log_without_frames(command, run: Path, words: tuple[str, ...]) -> None:
    (run / "log.parquet").write_bytes(parquet(pl.read_parquet(run / "log.parquet").clear()))
    (run / "summary.json").unlink()
    err = refused(command, words[0], run, *words[1:])
    assert (
        err.startswith(f"{run}: has a log without frames; ") and "run the scenario again" in err
    ), err
    assert not (run / "report.html").exists()


def test_logs(command, run: Path) -> None:
    log = pl.read_parquet(run / "log.parquet")
    whole = (run / "log.parquet").read_bytes()
    tables = {
        "has no column": [pl.DataFrame({"a": [1], "b": [2]}), pl.DataFrame(), log.drop("cam_x")],
        "something else than numbers": [
            log.with_columns(pl.lit(v).alias("u_0")) for v in ("x", [1.0], None)
        ],
        "times do not go on": [
            log.reverse(),
            log.with_columns(t=pl.lit(np.nan)),
            log.with_columns(t=pl.lit(np.inf)),
        ],
    }
    cut = [(text, parquet(table)) for text, some in tables.items() for table in some]
    cut += [("cannot be read", whole[:n]) for n in (0, 1, len(whole) // 2, len(whole) - 1)]
    for text, content in cut:
        (run / "log.parquet").write_bytes(content)
        for name in ("report", "render"):
            err = refused(command, name, run)
            assert (
                err.startswith(f"{run}/log.parquet: ") and text in err and err.count("\n") == 1
            ), err
    (run / "log.parquet").write_bytes(parquet(log.with_columns(cam_x=pl.lit(1e308))))
    assert "over 1e+06 m in the column cam_x" in refused(command, "report", run)


def flipped(whole: bytes, seed: int) -> Iterator[bytes]:
    rng = np.random.default_rng(seed)
    for count in (1, 2, 3, 8) * 8:
        damaged = bytearray(whole)
        for place in rng.integers(len(whole), size=count):
            damaged[place] ^= 1 << rng.integers(8)
        yield bytes(damaged)


@pytest.mark.parametrize("name", ["scenario.yaml", "summary.json", "log.parquet"])
def test_flipped_bits_are_read_or_refused(run: Path, name: str) -> None:
    """Whatever they change: no other error than one of this package."""
    scenario, messages = load(run / "scenario.yaml"), 0
    for damaged in flipped((run / name).read_bytes(), 1):
        (run / name).write_bytes(damaged)
        try:
            {
                "scenario.yaml": lambda: load(run / name),
                "log.parquet": lambda: open_log(run, scenario).frame(),
            }.get(name, lambda: read_summary(run, ""))()
        except VstestbedError:
            messages += 1
    assert messages > 4


def test_scenarios_and_what_is_no_folder(command, run: Path, tmp_path: Path) -> None:
    text = (run / "scenario.yaml").read_bytes()
    for damaged in (
        b"",
        text[: len(text) // 2],
        bytes(99),
        "é".encode("latin-1"),
        b"[]",
        text.replace(b"kind: ibvs", b"kind: no"),
    ):
        (run / "scenario.yaml").write_bytes(damaged)
        for name in ("report", "render"):
            assert refused(command, name, run).startswith(f"{run}/scenario.yaml:")
    (tmp_path / "empty").mkdir()
    for name in ("report", "render"):
        assert refused(command, name, tmp_path / "empty").startswith(
            f"{tmp_path}/empty: no run here; "
        )
        assert refused(command, name, run / "model.xml").startswith(
            f"{run}/model.xml: is a file, and no run's folder; "
        )
        assert "File name too long" in refused(command, name, tmp_path / ("x" * 300))


def test_a_run_without_its_model_has_its_report(run: Path) -> None:
    (run / "model.xml").unlink()
    assert write_report(run).is_file()


def test_a_comparison(command, quick: Path, tmp_path: Path, here: None, one_figure: None) -> None:
    """The report names the damaged file; `--resume` does that run again."""
    out = tmp_path / "c"
    compare([quick], {"stop.duration_s": [0.2]}, seeds=1, jobs=1, out=out, film=False, report=False)
    place = next(out.glob("runs/*/*/0"))
    for text in ("[]", "{", '{"outcome": "converged"}'):
        (place / "summary.json").write_text(text)
        err = refused(command, "report", out)
        assert (
            err.startswith(f"{place}/summary.json: is not the summary")
            and f"`vstestbed compare --resume --out {out}` does" in err
        )
    assert (
        command("compare", "--resume", "--out", out, "--jobs", 1, "--no-film", "--quiet").code == 0
    )
    assert json.loads((place / "summary.json").read_text())["outcome"] == "timed_out"
    (place / "log.parquet").write_bytes(b"PAR1")
    assert refused(command, "report", out).startswith(f"{place}/log.parquet: cannot be read")
    shutil.rmtree(out / "runs")
    assert (out / PLAN).is_file()
    with pytest.raises(VstestbedError, match="has no finished run; `vstestbed compare --resume"):
        report_again(out)
