"""`vstestbed export`: a run's folder, a comparison's, and what it refuses."""

from __future__ import annotations

import json
import resource
import shutil
import subprocess
import sys
from pathlib import Path

import polars as pl
import pytest

import vstestbed as vs
from vstestbed.scenario.dump import given_text
from vstestbed.studies.comparison import Jobs, chosen, controllers
from vstestbed.studies.comparison.record import PLAN
from vstestbed.studies.comparison.runs import perform
from vstestbed.studies.folder import write_plan
from vstestbed.studies.run_folder import ASSETS, store

SMALL = {
    "camera.width": 160,
    "camera.height": 120,
    "stop.duration_s": 0.12,
    "detector": {"kind": "oracle"},
}


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a run, `run`, and a comparison, `comparison`, of two runs."""
    place = tmp_path_factory.mktemp("made")
    run = place / "run"
    run.mkdir()
    vs.run_into(run, vs.load("arm_ibvs", SMALL), "none", report=False)
    compared = place / "comparison"
    compared.mkdir()
    plan = chosen(["arm_ibvs"], SMALL, {}, seeds=2)
    write_plan(compared / PLAN, plan, "base")
    # as `vstestbed compare` does it, without starting workers
    for job in Jobs(controllers(plan), plan.seeds):
        files = perform(given_text(job.scenario()), filmed=False)
        store(compared / job.folder, files, compared / ASSETS, attempts=1)
    return place


@pytest.fixture
def place(made: Path, tmp_path: Path) -> Path:
    """The same in a folder of the test's own."""
    return Path(shutil.copytree(made, tmp_path / "runs"))


def names(folder: Path) -> set[str]:
    return {p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file()}


def test_a_run_is_exported_beside_its_folder(command, place):
    for to in ("mcap", "lerobot", "csv"):
        ended = command("export", place / "run", "--to", to)
        assert ended.code == 0, ended.err
        assert (
            ended.err == f"{place / ('run.mcap' if to == 'mcap' else f'run_{to}')}\n"
            and ended.out == ""
        )
    assert (place / "run.mcap").read_bytes().startswith(b"\x89MCAP0\r\n")
    assert names(place / "run_csv") == {"run.csv", "columns.csv"}
    assert json.loads((place / "run_lerobot/meta/info.json").read_text())["total_episodes"] == 1
    assert not list(place.rglob("*.part"))


def test_a_file_of_the_folder_stands_for_it_and_the_folders_of_a_new_place_are_made(command, place):
    for given, to, out in (
        ("run/log.parquet", "csv", "a/b/c"),
        ("comparison/comparison.yaml", "csv", "d/e"),
        ("run", "mcap", "f/g/h.mcap"),
    ):
        ended = command("export", place / given, "--to", to, "--out", place / out, "-q")
        assert ended.code == 0 and (place / out).exists(), ended.err


def test_a_comparisons_runs_are_files_or_episodes_in_the_order_of_its_table(command, place):
    runs = [f"runs/arm_ibvs/as_it_is/{seed}" for seed in (0, 1)]
    for to in ("mcap", "lerobot", "csv"):
        assert command("export", place / "comparison", "--to", to, "-q").code == 0
    assert names(place / "comparison_mcap") == {f"{run}.mcap" for run in runs}
    assert names(place / "comparison_csv") == {
        *(f"{run}.csv" for run in runs),
        "columns.csv",
        "comparison.csv",
    }
    assert pl.read_csv(place / "comparison_csv/comparison.csv")["folder"].to_list() == runs
    episodes = pl.read_parquet(place / "comparison_lerobot/meta/episodes/*/*.parquet")
    assert episodes["vstestbed/run"].to_list() == runs
    assert episodes["vstestbed/seed"].to_list() == [
        0,
        1,
    ]


def test_what_is_left_out_is_told(command, place):
    runs = place / "comparison/runs/arm_ibvs/as_it_is"
    (runs / "0/log.parquet").unlink()
    ended = command("export", place / "comparison", "--to", "csv", "--out", place / "a")
    assert ended.err == f"1 of 2 runs crashed without a log, and are left out\n{place / 'a'}\n"
    shutil.rmtree(runs / "0")
    ended = command("export", place / "comparison", "--to", "csv", "--out", place / "b")
    assert (
        "1 of 2 runs are not done yet;"
        f" vstestbed compare --resume --out {place / 'comparison'} does them" in ended.err
    )
    (place / "run/summary.json").unlink()
    ended = command("export", place / "run", "--to", "csv", "--out", place / "c")
    assert (
        ended.code == 0
        and "has no summary: it was cut off, or goes on; its 4 frames so far are exported"
        in ended.err
    )
    shutil.rmtree(runs / "1")
    ended = command("export", place / "comparison", "--to", "csv", "--out", place / "d")
    assert ended.code == 2 and "has no finished run" in ended.err and not (place / "d").exists()


def test_what_is_there_is_never_written_over(command, place):
    (place / "run.mcap").write_text("mine")
    ended = command("export", place / "run", "--to", "mcap")
    assert (
        ended.code == 2
        and ended.err == f"{place / 'run.mcap'}: exists; give a new file with --out\n"
    )
    assert (place / "run.mcap").read_text() == "mine"
    for to in ("lerobot", "csv"):
        ended = command("export", place / "run", "--to", to, "--out", place / "run")
        assert (
            ended.code == 2
            and "exists and is not an empty folder; give a new folder with --out" in ended.err
        )


def test_bad_input_is_refused_in_a_sentence(command, place):
    (place / "note.txt").write_text("mine")
    for words, sentence in (
        ((place / "nowhere", "--to", "csv"), "no such folder"),
        ((place, "--to", "csv"), "no run here"),
        ((place / "run", "--to", "csv", "--start", "1"), "--start is for --to mcap"),
        ((place / "run", "--to", "bag"), "'mcap', 'lerobot', 'csv', 'rosbag2'"),
        (
            (place / "run", "--to", "mcap", "--out", place / "run/log.parquet/no.mcap"),
            "cannot be written",
        ),
        ((place / "run/assets.txt", "--to", "csv"), "no such folder"),
        (
            (place / "note.txt", "--to", "csv"),
            "is a file, and not one of a run's or a comparison's folder; give the folder",
        ),
    ):
        ended = command("export", *words)
        assert ended.code == 2 and sentence in ended.err, ended.err
    (place / "run/log.parquet").write_bytes(b"no parquet")
    ended = command("export", place / "run", "--to", "csv")
    assert ended.code == 2 and "cannot be read" in ended.err


def test_without_the_extra_the_command_that_installs_it_is_named(command, place, monkeypatch):
    monkeypatch.setitem(sys.modules, "mcap_protobuf.writer", None)
    monkeypatch.delitem(sys.modules, "vstestbed.apps.export.mcap_file", raising=False)
    ended = command("export", place / "run", "--to", "mcap")
    assert (
        ended.code == 4
        and "pip install 'vstestbed[export]'" in ended.err
        and not (place / "run.mcap").exists()
    )


def test_successes_alone_are_demonstrations(command, place):
    ended = command("export", place / "comparison", "--to", "lerobot", "--only", "successes")
    assert ended.code != 0 and "has no success among 2 runs" in ended.err
    summary = next((place / "comparison/runs").rglob("summary.json"))
    summary.write_text(
        json.dumps(json.loads(summary.read_text()) | {"success": True, "outcome": "converged"})
    )
    for to, file in (
        ("lerobot", "meta/episodes/chunk-000/file-000.parquet"),
        ("csv", "comparison.csv"),
    ):
        ended = command("export", place / "comparison", "--to", to, "--only", "successes")
        assert ended.code == 0 and "1 of 2 runs are no successes, and are left out" in ended.err
        path = place / f"comparison_{to}" / file
        assert len(pl.read_parquet(path) if to == "lerobot" else pl.read_csv(path)) == 1
    ended = command(
        "export", place / "run", "--to", "csv", "--task", "reach it", "--out", place / "c"
    )
    assert ended.code == 2 and "--task" in ended.err and "--to lerobot" in ended.err
    ended = command(
        "export", place / "run", "--to", "csv", "--only", "successes", "--out", place / "c"
    )
    assert ended.code == 2 and "--only" in ended.err and "a comparison's folder" in ended.err


@pytest.mark.process
@pytest.mark.parametrize(
    ("to", "most"),
    [(to, most) for to in ("rosbag2", "mcap", "lerobot", "csv") for most in (0, 3000)],
)
def test_a_full_disk_is_told_and_nothing_is_left_half(place, vstestbed_process, to, most):
    """Files that may not grow over so many bytes (EFBIG, as a full disk's ENOSPC): in mid-export,
    and at its first byte.
    """
    words, environment = vstestbed_process
    limit = (most, most)
    line = [*words, "export", str(place / "run"), "--to", to]
    before = names(place)
    done = subprocess.run(
        line,
        env={**environment, "PYTHONDONTWRITEBYTECODE": "1"},
        capture_output=True,
        text=True,
        check=False,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, limit),
    )
    assert done.returncode == 4, done.stderr
    assert done.stderr.count("\n") == 1
    said = (
        ("no room for", "free some, choose another place")
        if to == "lerobot"
        else ("no space left on the disk; free some, or",)
    )
    assert all(words in done.stderr for words in said)
    assert to != "rosbag2" or done.stderr.startswith(f"{place / 'run_rosbag2'}: ")
    assert names(place) == before and {p.name for p in place.iterdir()} == {"run", "comparison"}
