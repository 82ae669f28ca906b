"""Comparisons that run: the same results wherever they are done, dead workers, laws that raise,
what is kept, what is resumed.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

import vstestbed as vs
from tests.shortcuts import Here, run_here
from vstestbed.core.errors import EnvironmentLackError, OutputError, ParameterError
from vstestbed.report.comparison.statistics import paired_difference
from vstestbed.scenario.dump import given_text
from vstestbed.studies import pools
from vstestbed.studies.comparison import Comparison, Job, Jobs, Runner, compare, controllers
from vstestbed.studies.comparison.folder import table_of
from vstestbed.studies.comparison.runs import perform
from vstestbed.studies.pools import RUNNING, LocalPool, Request, WorkerLostError
from vstestbed.studies.run_folder import files_of_failure, store

GAINS = {"law.gain": (3.0, 6.0)}


@pytest.fixture(autouse=True)
def by_workers(monkeypatch: pytest.MonkeyPatch) -> None:
    """Also light runs are done by worker processes."""
    monkeypatch.setattr(pools, "HERE_S", 0.0)


BROKEN = '''
"""Laws that fail: one raises, one kills its worker, the first time or always."""

import os
import signal
from pathlib import Path
from typing import Literal

import numpy as np

from vstestbed.laws import IBVS, LAWS
from vstestbed.core.spec import spec


@LAWS.add
@spec
class Raises(IBVS):
    """Raises in its third step."""

    kind: Literal["raises"] = "raises"

    def step(self, memory, observation, goal, basis):
        if observation.t > 0.1:
            raise ZeroDivisionError("gain over nothing")
        return IBVS.step(self, memory, observation, goal, basis)


@LAWS.add
@spec
class Drives(IBVS):
    """Goes one way, whatever it sees."""

    kind: Literal["drives"] = "drives"
    twist: tuple[float, ...]

    def step(self, memory, observation, goal, basis):
        return memory, self.limits.command(np.array(self.twist), basis)


@LAWS.add
@spec
class Kills(IBVS):
    """Kills its process, until a file says that it has done so `times` times."""

    kind: Literal["kills"] = "kills"
    tally: str = ""
    times: int = 1

    def step(self, memory, observation, goal, basis):
        tally = Path(self.tally)
        done = len(tally.read_text()) if tally.exists() else 0
        if observation.t > 0.1 and done < self.times:
            tally.write_text("x" * (done + 1))
            os.kill(os.getpid(), signal.SIGKILL)
        return IBVS.step(self, memory, observation, goal, basis)
'''


def timeless(table: pl.DataFrame) -> pl.DataFrame:
    """The table without what depends on the machine's mood."""
    return table.drop(
        [c for c in table.columns if c.startswith("time_ms.")]
        + ["wall_time_s", "real_time_factor", "attempts"]
    )


def logs(folder: Path) -> dict[str, bytes]:
    return {
        p.relative_to(folder).as_posix(): p.read_bytes()
        for p in sorted(folder.glob("runs/**/log.parquet"))
    }


@pytest.fixture
def plugin(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, own_kinds: None) -> Iterator[str]:
    (tmp_path / "broken_laws.py").write_text(BROKEN, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    yield "broken_laws"
    sys.modules.pop("broken_laws", None)


@pytest.mark.process
def test_this_process_two_jobs_and_dask_give_the_same(
    quick: Path, tmp_path: Path, cluster: str, monkeypatch: pytest.MonkeyPatch
):
    tables = [
        compare(
            [quick],
            GAINS,
            seeds=3,
            jobs=jobs,
            executor=executor,
            out=tmp_path / name,
            film=False,
            report=False,
        )
        for name, jobs, executor in (("two", 2, "local"), ("dask", None, cluster))
    ]
    run_here(monkeypatch)
    tables.append(compare([quick], GAINS, seeds=3, out=tmp_path / "one", film=False, report=False))
    assert timeless(tables[0]).equals(timeless(tables[1]))
    assert timeless(tables[0]).equals(timeless(tables[2]))
    assert len(tables[0]) == 6
    assert logs(tmp_path / "one") == logs(tmp_path / "two") == logs(tmp_path / "dask")
    # And the same as `vstestbed run --seed 1 --set law.gain=6` by itself.
    alone = vs.run(vs.load(quick, {"law.gain": 6.0}, seed=1)).frame()
    assert alone.equals(pl.read_parquet(tmp_path / "one/runs/quick/law.gain=6.0/1/log.parquet"))


def test_the_table_says_what_the_summaries_say(quick: Path, tmp_path: Path, here: None):
    table = compare([quick], GAINS, seeds=2, jobs=1, out=tmp_path / "c", film=False, report=False)
    assert table.columns[:5] == ["scenario", "law.gain", "seed", "folder", "outcome"]
    assert table.columns[-1] == "attempts"
    assert table["law.gain"].to_list() == [3.0, 6.0, 3.0, 6.0]
    assert table["seed"].to_list() == [0, 0, 1, 1]
    assert table.equals(pl.read_parquet(tmp_path / "c" / "comparison.parquet"))
    assert pl.read_csv(tmp_path / "c" / "comparison.csv").columns == table.columns
    for row in table.iter_rows(named=True):
        folder = tmp_path / "c" / row["folder"]
        summary = json.loads((folder / "summary.json").read_text())
        assert row["final_error_px"] == summary["final_error_px"]
        assert row["time_ms.law"] == summary["time_ms"]["law"]
        assert {p.name for p in folder.iterdir()} == {
            "scenario.yaml",
            "resolved.yaml",
            "model.xml",
            "log.parquet",
            "summary.json",
        }


@pytest.mark.study
def test_the_paired_difference_of_two_gains_is_what_theory_gives(quick: Path, tmp_path: Path):
    """The error falls as exp(-gain t), so a run takes log(error at the start /
    threshold) / gain.
    """
    table = compare([quick], GAINS, seeds=8, jobs=2, out=tmp_path / "c", film=False, report=False)
    slow, fast = (table.filter(pl.col("law.gain") == gain) for gain in GAINS["law.gain"])
    first = [
        pl.read_parquet(tmp_path / "c" / folder / "log.parquet")["error_px"][0]
        for folder in slow["folder"]
    ]
    theory = np.log(np.array(first) / 0.2) * (1 / 3 - 1 / 6)
    found = paired_difference(
        slow["time_to_converge_s"].to_numpy(), fast["time_to_converge_s"].to_numpy()
    )
    assert found.p <= 0.05 and found.excludes_zero
    # times are whole frames of 40 ms
    assert found.low <= theory.mean() + 0.04 and theory.mean() - 0.04 <= found.high
    same = paired_difference(
        slow["time_to_converge_s"].to_numpy(), slow["time_to_converge_s"].to_numpy()
    )
    assert (same.mean, same.low, same.high, same.p) == (0, 0, 0, 1)


@pytest.mark.study
def test_laws_that_raise_diverge_lose_and_kill(quick: Path, tmp_path: Path, plugin: str):
    laws = (
        {"kind": "ibvs", "gain": 6.0},
        {"kind": "raises"},
        {"kind": "kills", "gain": 6.0, "tally": str(tmp_path / "once"), "times": 1},
        {"kind": "kills", "gain": 6.0, "tally": str(tmp_path / "always"), "times": 9},
        {"kind": "drives", "twist": [0, 0, -100, 0, 0, 0]},
        {"kind": "drives", "twist": [0, 0, 0, 0, 1, 0]},
    )
    table = compare(
        [quick], {"law": laws}, jobs=2, out=tmp_path / "c", plugins=[plugin], film=False
    )
    assert table["outcome"].to_list() == [
        "converged",
        "law_failed",
        "converged",
        "crashed",
        "diverged",
        "target_lost",
    ]
    assert table["attempts"].to_list() == [1, 1, 2, 2, 1, 1]
    assert "ZeroDivisionError: gain over nothing (broken_laws.py, line 24)" in table["reason"][1]
    assert table["reason"][3] == "its worker process died, and the one that tried again, too"
    assert len((tmp_path / "always").read_text()) == 2
    page = (tmp_path / "c" / "report.html").read_text(encoding="utf-8")
    for words in (
        "ZeroDivisionError: gain over nothing",
        "its worker process died, and the one that tried again, too",
        "worker died once",
    ):
        assert words in page


@pytest.mark.process
@pytest.mark.study
def test_a_worker_killed_in_the_middle_is_replaced_and_one_that_dies_with_nothing_to_do_is_no_loss(
    quick: Path, tmp_path: Path
):
    runner = Runner(tmp_path, Jobs(controllers(Comparison(base=(str(quick),), seeds=2)), 2))
    request = Request("runs/a", perform, (given_text(vs.load(quick)), False))
    with closing(LocalPool(1, tmp_path)) as pool:
        pool._start()
        slot = pool._free[0]
        before = slot.pid.result()
        future = pool.submit(request)
        os.kill(before, signal.SIGKILL)
        with pytest.raises(WorkerLostError):
            future.result(timeout=60)
        again = pool.submit(request).result(timeout=60)
        assert json.loads(again["summary.json"])["outcome"] == "converged"
        assert pool.tries(request) == 2
        assert slot.pid.result() != before
        # one worker leaves shares of the report to this process
        assert pool.call(os.getpid).result() == os.getpid()
        os.kill(slot.pid.result(), signal.SIGKILL)
        gone(slot.pid.result())
        runner.run(pool)  # before the pool hears of it
    assert table_of(tmp_path, runner.jobs)["outcome"].to_list() == ["converged", "converged"]


@pytest.mark.process
@pytest.mark.study
@pytest.mark.parametrize("later_s", [0.0, 1.0])  # before its pool hears of it, and after
def test_a_worker_that_dies_while_it_has_nothing_to_do_is_no_loss(
    quick: Path, tmp_path: Path, later_s: float
):
    runner = Runner(tmp_path, Jobs(controllers(Comparison(base=(str(quick),), seeds=2)), 2))
    with closing(LocalPool(1, tmp_path)) as pool:
        pool._start()
        pid = pool._slots[0].pid.result()
        os.kill(pid, signal.SIGKILL)
        gone(pid)
        time.sleep(later_s)
        runner.run(pool)
    assert table_of(tmp_path, runner.jobs)["outcome"].to_list() == ["converged", "converged"]


@pytest.mark.process
@pytest.mark.study
def test_shares_of_the_report_are_done_by_the_workers_which_end_with_the_pool(
    quick: Path, tmp_path: Path
):
    with closing(LocalPool(2, tmp_path)) as pool:
        pool._start()
        first, second = (slot.pid.result() for slot in pool._slots)
        assert {future.result() for future in [pool.call(os.getpid) for _ in range(8)]} <= {
            first,
            second,
        }
        os.kill(first, signal.SIGKILL)
        gone(first)
        assert {future.result() for future in [pool.call(os.getpid) for _ in range(8)]} <= {
            first,
            second,
            os.getpid(),
        }
        for _ in range(2):  # one for each worker: they end in the middle of a run
            pool.submit(
                Request(
                    "runs/a",
                    perform,
                    (
                        given_text(vs.load(quick, {"stop.duration_s": 30000, "law.gain": 1e-4})),
                        False,
                    ),
                )
            )
    gone(second)


@pytest.mark.process
@pytest.mark.study
def test_a_dask_worker_that_is_a_process_gives_the_same(
    quick: Path, tmp_path: Path, cluster_of_processes: str, monkeypatch: pytest.MonkeyPatch
):
    there = compare(
        [quick],
        GAINS,
        seeds=3,
        executor=cluster_of_processes,
        out=tmp_path / "dask",
        film=False,
        report=False,
    )
    run_here(monkeypatch)
    assert timeless(there).equals(
        timeless(compare([quick], GAINS, seeds=3, out=tmp_path / "one", film=False, report=False))
    )
    assert logs(tmp_path / "one") == logs(tmp_path / "dask")


@pytest.mark.process
def test_dask_counts_the_tries_of_one_comparison_alone(quick: Path, tmp_path: Path, cluster: str):
    for name in ("first", "second"):
        table = compare(
            [quick], seeds=2, executor=cluster, out=tmp_path / name, film=False, report=False
        )
        assert table["attempts"].to_list() == [1, 1]


@pytest.mark.process
@pytest.mark.study
def test_a_script_without_a_main_guard_is_told_so(
    quick: Path, tmp_path: Path, vstestbed_process: Any
):
    script = tmp_path / "script.py"
    script.write_text(
        (
            "import vstestbed as vs\n"
            "vs.compare(['arm_ibvs'], set={'stop.duration_s': 0.2}, jobs=1, film=False)\n"
        ),
        encoding="utf-8",
    )
    words, environment = vstestbed_process
    done = subprocess.run(
        [words[0], str(script)],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode != 0
    assert "under `if __name__ == '__main__':`" in done.stderr.splitlines()[-1]
    assert not list(tmp_path.glob("runs/compare/*/runs/*/*/*"))


def gone(pid: int) -> None:
    """Wait until a process is no more, or only its entry is."""
    for _ in range(200):
        try:
            if "State:\tZ" in Path(f"/proc/{pid}/status").read_text():
                return
        except (FileNotFoundError, ProcessLookupError):
            return
        time.sleep(0.05)
    raise AssertionError(f"process {pid} lives on")


class TestResume:
    def test_what_is_there_is_not_run_again(self, quick: Path, tmp_path: Path, here: None):
        out, done = tmp_path / "c", []
        whole = compare([quick], GAINS, seeds=2, jobs=1, out=out, film=False, report=False)
        (out / "runs/quick/law.gain=3.0/1").rename(tmp_path / "taken")
        # as a power cut leaves it
        (out / "runs/quick/law.gain=6.0/1").rename(
            out / f"runs/quick/law.gain=6.0/1.{16 * 'f'}.part"
        )
        kept = (out / "runs/quick/law.gain=3.0/0/summary.json").stat().st_mtime_ns
        # as a broken disk leaves it
        (out / "runs/quick/law.gain=6.0/0/summary.json").write_text("{", encoding="utf-8")
        again = compare(
            [],
            out=out,
            resume=True,
            jobs=1,
            film=False,
            report=False,
            on_done=lambda job, summary: done.append(job.folder),
        )
        assert sorted(done) == [
            "runs/quick/law.gain=3.0/1",
            "runs/quick/law.gain=6.0/0",
            "runs/quick/law.gain=6.0/1",
        ]
        assert (out / "runs/quick/law.gain=3.0/0/summary.json").stat().st_mtime_ns == kept
        assert timeless(again).equals(timeless(whole))
        assert not list(out.glob("**/*.part"))

    def test_it_goes_on_with_what_the_folder_compares(
        self, quick: Path, tmp_path: Path, here: None
    ):
        out = tmp_path / "c"
        compare([quick], GAINS, seeds=1, jobs=1, out=out, film=False, report=False)
        assert (
            len(
                compare(
                    [quick], GAINS, seeds=1, jobs=1, out=out, resume=True, film=False, report=False
                )
            )
            == 2
        )
        quick.write_text(quick.read_text().replace("side: 0.4", "side: 0.3"))
        with pytest.raises(ParameterError, match="--resume goes on with what the folder compares"):
            compare([quick], GAINS, seeds=1, out=out, resume=True)
        with pytest.raises(ParameterError, match="--resume goes on with what the folder compares"):
            compare([quick], {"law.gain": (1.0, 2.0)}, seeds=1, out=out, resume=True)

    @pytest.mark.process
    @pytest.mark.study
    @pytest.mark.parametrize("moments", [tuple(0.07 * i for i in range(10))])
    def test_killed_again_and_again(
        self, quick: Path, tmp_path: Path, vstestbed_process: Any, moments: tuple[float, ...]
    ):
        words, environment = vstestbed_process
        whole = compare(
            [quick],
            GAINS,
            seeds=30 * len(moments),
            jobs=2,
            out=tmp_path / "whole",
            film=False,
            report=False,
        )
        out, runs = tmp_path / "c", tmp_path / "c" / "runs"
        line = [
            *words,
            "compare",
            str(quick),
            "--vary",
            "law.gain=3.0,6.0",
            "--seeds",
            str(30 * len(moments)),
            "--no-film",
            "--out",
            str(out),
            "--quiet",
        ]
        stamps: dict[str, int] = {}
        for moment in moments:
            process = subprocess.Popen(
                [*line, *(["--resume"] if out.exists() else [])], cwd=tmp_path, env=environment
            )
            more = lambda: len(list(runs.glob("*/*/*[0-9]/summary.json"))) > len(stamps)  # noqa: B023, E731 - used at once
            wait_for(lambda: process.poll() is not None or more())  # noqa: B023 - used at once
            time.sleep(moment)
            process.kill()
            process.wait()
            now = {str(p): p.stat().st_mtime_ns for p in runs.glob("*/*/*[0-9]/summary.json")}
            assert all(now[p] == stamp for p, stamp in stamps.items())  # no run twice, nothing lost
            stamps = now
        subprocess.run([*line, "--resume"], cwd=tmp_path, env=environment, check=True)
        assert all(Path(p).stat().st_mtime_ns == stamp for p, stamp in stamps.items())
        assert timeless(pl.read_parquet(out / "comparison.parquet")).equals(timeless(whole))


def wait_for(true: Callable[[], bool], seconds: float = 60) -> None:
    end = time.monotonic() + seconds
    while not true():
        assert time.monotonic() < end
        time.sleep(0.02)


@pytest.mark.process
def test_ctrl_c_keeps_what_is_done_and_says_how_to_go_on(
    quick: Path, tmp_path: Path, vstestbed_process: Any
):
    words, environment = vstestbed_process
    out = tmp_path / "c"
    line = [
        *words,
        "compare",
        str(quick),
        "--seeds",
        "200",
        "--no-film",
        "--out",
        str(out),
        "--jobs",
        "1",
    ]
    process = subprocess.Popen(
        line, cwd=tmp_path, env=environment, stderr=subprocess.PIPE, text=True
    )
    wait_for(lambda: len(list(out.glob("runs/*/*/*[0-9]/summary.json"))) >= 3)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130
    done = pl.read_parquet(out / "comparison.parquet")
    assert 3 <= len(done) < 200
    assert (
        f"interrupted: {len(done)} of 200 runs are done;"
        f" go on with: vstestbed compare --resume --out {out}" in err
    )
    assert "Traceback" not in err


def test_ctrl_c_between_the_storing_of_a_run_and_its_count_counts_it(
    quick: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    def stored_then_interrupted(*given: Any) -> None:
        store(*given)
        raise KeyboardInterrupt

    runner = Runner(tmp_path, Jobs(controllers(Comparison(base=(str(quick),), seeds=2)), 2))
    monkeypatch.setattr("vstestbed.studies.comparison.runs.store", stored_then_interrupted)
    with pytest.raises(KeyboardInterrupt):
        runner.run(Here())
    assert runner.done == 1


@pytest.mark.parametrize("keep", [0, 2])
def test_runs_that_are_gone_when_all_are_done_are_told(
    quick: Path, tmp_path: Path, here: None, keep: int
):
    kept: list[str] = []

    def lose(job: Job, summary: dict[str, Any]) -> None:
        kept.append(job.folder)
        if len(kept) > keep:
            shutil.rmtree(tmp_path / "c" / job.folder)

    with pytest.raises(
        OutputError, match=rf"c: {3 - keep} of 3 runs are not there any more.*--resume"
    ) as lost:
        compare([quick], seeds=3, out=tmp_path / "c", film=False, on_done=lose)
    assert lost.value.exit_code == 4
    assert len(compare([], out=tmp_path / "c", resume=True, film=False, report=False)) == 3


def test_the_name_of_a_case_is_no_path(
    command: Any, quick: Path, tmp_path: Path, here: None, one_figure: None
):
    """It wrote runs outside of --out; or, with many slashes, found none of them again, and ended
    with 0.
    """
    (tmp_path / "deep").mkdir()
    cases = {
        "../../../../esc": {"../a": {"law.gain": 3}, "con": {"law.gain": 6}},
        "a/b/c/d/e/f": {"x": {}},
    }
    plan = {"base": ["quick.yaml"], "cases": cases, "seeds": 1}
    (tmp_path / "hostile.yaml").write_text(json.dumps(plan), encoding="utf-8")
    before = {p.name for p in tmp_path.iterdir()}
    ended = command("compare", "hostile.yaml", "--out", "deep/c", "--no-film")
    assert ended.code == 0, ended.err
    assert {p.name for p in tmp_path.iterdir()} == before
    assert [p.name for p in (tmp_path / "deep").iterdir()] == ["c"]
    assert sorted(p.name for p in tmp_path.glob("deep/c/runs/quick/*")) == [
        "esc=_con,a_b_c_d_e_f=x",
        "esc=a,a_b_c_d_e_f=x",
    ]
    table = pl.read_parquet(tmp_path / "deep/c/comparison.parquet")
    assert table["../../../../esc"].to_list() == ["../a", "con"]  # the names themselves stay
    assert (tmp_path / "deep/c/report.html").is_file()


def test_a_resumed_comparison_has_the_bytes_of_a_whole_one(
    quick: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """Whatever is missing, and in groups of any size."""
    run_here(monkeypatch)
    monkeypatch.setattr("vstestbed.studies.comparison.plan.SIDE_BY_SIDE", 8)
    monkeypatch.setattr("vstestbed.studies.comparison.folder.GROUP", 6)
    whole, cut, seeds = tmp_path / "whole", tmp_path / "cut", 12
    table = compare([quick], seeds=seeds, out=whole, film=False, report=False)
    shutil.copytree(whole, cut)
    every = Jobs(controllers(Comparison(base=(str(quick),), seeds=seeds)), seeds)
    monkeypatch.setattr("vstestbed.studies.comparison.folder.GROUP", 10_000)
    assert table.equals(table_of(whole, every))
    assert table.equals(pl.read_parquet(whole / "comparison.parquet"))
    for place in ("0/0", "0/3", "8/11"):
        (cut / f"runs/quick/as_it_is/{place}/summary.json").unlink()
    again = compare([], out=cut, resume=True, film=False, report=False)
    (cut / RUNNING).mkdir()  # of a process that was killed while it wrote the report
    assert timeless(compare([], out=cut, resume=True, film=False, report=False)).equals(
        timeless(again)
    )
    assert not (cut / RUNNING).exists()
    assert timeless(again).equals(timeless(table))
    assert logs(cut) == logs(whole)
    assert len(logs(whole)) == seeds


def test_what_crashed_has_a_folder_of_its_own(quick: Path):
    files = files_of_failure(given_text(vs.load(quick)), "no more")
    assert json.loads(files["summary.json"])["outcome"] == "crashed"
    assert set(files) == {"scenario.yaml", "summary.json"}


def test_a_task_needs_no_file_of_who_asks(
    quick: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    request = Request("runs/a", perform, (given_text(vs.load(quick)), False))
    quick.unlink()
    assert json.loads(request.perform()["summary.json"])["outcome"] == "converged"


def test_a_start_that_cannot_be_drawn_is_a_run_that_crashed(quick: Path, tmp_path: Path):
    away = {
        "robot.start.random": {"xyz": [0, 0, 0], "rpy_deg": [0, 0, 0]},
        "robot.start.nominal.xyz": [3, 0, 0],
    }
    comparison = Comparison(base=(str(quick),), set=away, seeds=2)
    runner = Runner(tmp_path, Jobs(controllers(comparison), 2))
    told: list[Any] = []
    runner.run(Here(), lambda job, summary: told.append((job.seed, summary["outcome"])))
    table = table_of(tmp_path, runner.jobs)
    assert table["outcome"].to_list() == ["crashed", "crashed"]
    assert told == [(0, "crashed"), (1, "crashed")]
    assert "has the whole target in view" in table["reason"][0]


@pytest.fixture(scope="module")
def cluster() -> Iterator[str]:
    """A dask scheduler and a worker that speak on the loopback as those of `dask scheduler` and
    `dask worker` do, in this process.
    """
    distributed = pytest.importorskip("distributed")
    one = {"n_workers": 1, "threads_per_worker": 1, "dashboard_address": None}
    with distributed.LocalCluster(**one, processes=False, protocol="tcp") as made:
        yield made.scheduler_address.replace("tcp://", "dask://")


@pytest.fixture(scope="module")
def cluster_of_processes() -> Iterator[str]:
    """The same with a process for the worker."""
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, processes=True, dashboard_address=None
    ) as made:
        yield made.scheduler_address.replace("tcp://", "dask://")


@pytest.mark.process
def test_nobody_at_the_address(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    distributed = pytest.importorskip("distributed")
    client = distributed.Client  # which waits for 5 s: here for less
    monkeypatch.setattr(
        distributed,
        "Client",
        lambda address, timeout, **more: client(address, timeout="0.5s", **more),
    )
    with pytest.raises(
        EnvironmentLackError, match=r"no dask scheduler answers at 127.0.0.1:9 .*dask worker"
    ):
        compare(
            ["ibvs_book"],
            out=tmp_path / "c",
            executor="dask://127.0.0.1:9",
            film=False,
            report=False,
        )


def test_a_word_that_is_no_executor(quick: Path, tmp_path: Path):
    with pytest.raises(
        ParameterError, match=r"--executor must be local.* or dask://HOST:PORT, got 'ray'"
    ):
        compare([quick], out=tmp_path / "c", executor="ray", film=False, report=False)
