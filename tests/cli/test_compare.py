"""`vstestbed compare`: words, files, exit codes, what it leaves."""

from __future__ import annotations

import json
from pathlib import Path

import polars as pl
import pytest

import vstestbed as vs

NO_FILM = ("--no-film", "--jobs", 1)


def test_it_leaves_a_whole_folder_and_says_where(
    command, quick: Path, here: None, one_figure: None
):
    ended = command("compare", "quick.yaml", "--vary", "law.gain=3,6", "--seeds", 2, *NO_FILM)
    folder = Path("runs/compare/001")
    assert (ended.code, ended.out) == (0, "")
    first, *statistics, last = ended.err.splitlines()
    assert (
        first == "4 of 4 runs reached the goal"
        and last == f"  results   {folder} (open report.html)"
    )
    found = json.loads((folder / "verdicts.json").read_text())
    assert statistics[0] == found["overall"] and statistics[-1] == found["pairs"][0]["sentence"]
    assert [line.split()[0] for line in statistics if line.startswith("  ")] == ["gain=3", "gain=6"]
    names = {p.name for p in folder.iterdir()}
    tables = {
        f"{name}.{end}"
        for name in ("comparison", "controllers", "pairs")
        for end in ("csv", "parquet")
    }
    assert names == {
        *tables,
        "comparison.yaml",
        "figures",
        "report.html",
        "runs",
        "scenarios",
        "record.json",
        "tables.md",
        "tables.tex",
        "verdicts.json",
    }
    # the page's first figure, in three formats
    assert len(list((folder / "figures").iterdir())) == 3
    assert (folder / "scenarios" / "quick.yaml").read_text() == quick.read_text()


@pytest.mark.study
def test_the_report_the_plan_and_a_run_of_it_again(command, quick: Path):
    assert (
        command("compare", "quick.yaml", "--vary", "law.gain=3,6", "--seeds", 2, *NO_FILM).code == 0
    )
    folder = Path("runs/compare/001")
    (folder / "report.html").unlink()
    assert command("report", folder).code == 0
    assert "vstestbed compare" in (folder / "report.html").read_text(encoding="utf-8")
    again = command("compare", folder / "comparison.yaml", *NO_FILM, "--json")
    found = json.loads(again.out)
    assert [row["seed"] for row in found["runs"]] == [0, 0, 1, 1]
    assert found["verdicts"]["overall"].startswith("Only law.gain differs.")
    assert Path("runs/compare/002").is_dir()
    one = folder / "runs/quick/law.gain=3/1"
    assert (
        command("run", one / "scenario.yaml", "--video", "none", "--quiet", "--out", "alone").code
        == 0
    )
    assert (Path("alone") / "log.parquet").read_bytes() == (one / "log.parquet").read_bytes()


@pytest.mark.study
def test_runs_that_fail_are_no_failure_of_the_command(command, quick: Path):
    ended = command("compare", "quick.yaml", "--vary", "stop.duration_s=0.2,8", *NO_FILM)
    assert ended.code == 0
    assert ended.err.startswith("1 of 2 runs reached the goal; 1 did not reach the goal\n")
    table = pl.read_parquet("runs/compare/001/comparison.parquet")
    assert table["outcome"].to_list() == ["timed_out", "converged"]
    # no seed on which both arrived: nothing to draw
    assert not Path("runs/compare/001/figures/differences.png").exists()
    assert (
        (Path("runs/compare/001") / table["folder"][0] / "end.png")
        .read_bytes()
        .startswith(b"\x89PNG")
    )


@pytest.mark.study
def test_the_first_seed_is_filmed_side_by_side(command, quick: Path):
    words = (
        "--set",
        "camera.rate_hz=10",
        "--set",
        "stop.converged.hold_s=0.1",
        "--jobs",
        1,
        "--quiet",
    )
    assert (
        command("compare", "quick.yaml", "--vary", "law.gain=3,6", "--seeds", 2, *words).code == 0
    )
    folder = Path("runs/compare/001")
    assert (folder / "comparison.mp4").stat().st_size > 1000
    filmed = {p.parent.name for p in folder.glob("runs/*/*/*/overview.mp4")}
    assert filmed == {"0"}
    assert "<video" in (folder / "report.html").read_text(encoding="utf-8")


def test_bad_input(command, quick: Path):
    for words, line in (
        ([], "SCENARIO is missing: name scenarios to compare, or a comparison"),
        (["nowhere"], "nowhere: no such file, and no bundled scenario"),
        (["quick.yaml", "--vary", "law.gain"], "--vary needs the form a.b=v1,v2, got 'law.gain'"),
        (
            ["quick.yaml", "--vary", "law.gain=1,1"],
            "axes.law.gain must be a list of different values",
        ),
        (["quick.yaml", "--vary", "law.gain=1,-1"], "--vary: law.gain: must be > 0, got -1"),
        (
            ["quick.yaml", "--vary", "law.gian=1,2"],
            "--vary: law.gian: is an unknown field; did you mean 'gain'?",
        ),
        (
            ["quick.yaml", "--vary", "law.gain=1", "--vary", "law.gain=2"],
            "--vary has a field twice",
        ),
        (
            ["ibvs_retreat", "--seeds", "3"],
            (
                "ibvs_retreat: robot.start.random is missing,"
                " and nothing else is random: every seed would"
            ),
        ),
        (
            ["quick.yaml", "--executor", "ray"],
            " or dask://HOST:PORT, got 'ray'",
        ),
        (["--resume"], "--resume needs the folder that `vstestbed compare` has made: --out DIR"),
        (["--resume", "--out", "nowhere"], "nowhere: no such folder"),
        (["quick.yaml", "quick.yaml"], "base has a scenario, or a file name, twice"),
    ):
        ended = command("compare", *words, *NO_FILM)
        assert (ended.code, ended.out) == (2, "")
        assert line in ended.err
        assert "Traceback" not in ended.err
        assert not Path("runs").exists()


def test_a_folder_that_holds_something_stays_as_it_is(command, quick: Path):
    Path("mine").mkdir()
    Path("mine/thesis.tex").touch()
    ended = command("compare", "quick.yaml", "--out", "mine", *NO_FILM)
    assert ended.code == 2
    assert (
        ended.err == "mine: exists and is not an empty folder;"
        " give a new one, or --resume to go on with what is there\n"
    )
    assert [p.name for p in Path("mine").iterdir()] == ["thesis.tex"]


def test_from_python_also_after_the_room_has_been_imported():
    import vstestbed.studies.comparison

    assert vs.compare is vstestbed.studies.comparison.compare


def test_a_plan_flies_nothing_and_says_how_many_starts_it_needs(command):
    ended = command("compare", "--plan", "arm_laws", "--seeds", 20)
    lines = ended.out.splitlines()
    assert (ended.code, ended.err) == (0, "") and not Path("runs").exists()
    assert (
        lines[0] == "controllers 3, pairs 3, limit 30 s, margin 0.1, starts 20"
        and lines[-1] == "20 starts cannot decide by time"
    )
    with_one = command(
        "compare", "--plan", "arm_laws", "--reference", "arm_pbvs", "--set", "stop.duration_s=60"
    ).out
    assert with_one.startswith("controllers 3, pairs 2, limit 60 s")
    nominal = command("compare", "--plan", "arm_ibvs", "arm_pbvs").out.splitlines()
    assert (
        nominal[1] == "it flies the nominal start: never a verdict; --seeds N draws random starts"
    )
    tasks = command("compare", "--plan", "starts").out  # four laws, seven tasks of five starts
    assert tasks.startswith("controllers 4, pairs 6, limit 60 s, margin 0.1, starts 35\n")
    gains = ",".join(map(str, range(1, 31)))  # of more than 24 each is compared with the first
    assert command("compare", "--plan", "arm_ibvs", "--vary", f"law.gain={gains}").out.startswith(
        "controllers 30, pairs 29,"
    )
    assert command("compare", "--plan").err.startswith("SCENARIO is missing")


def test_a_reference_that_is_no_controller_is_refused_before_anything_flies(
    command, quick: Path, tmp_path: Path
):
    given = ("compare", quick, "--vary", "law.gain=1,2", "--out", tmp_path / "out", "--reference")
    ended = command(*given, "pbvs")
    assert (
        ended.err.startswith("reference must be one of gain=1, gain=2, got 'pbvs'")
        and not (tmp_path / "out").exists()
    )
