"""A comparison against an earlier one: which runs are the same, what changed,
what counts as worse.
"""

from __future__ import annotations

import io
import json
import re
from pathlib import Path

import polars as pl
import pytest
from ruamel.yaml import YAML

from vstestbed.core.errors import RunFolderError
from vstestbed.core.files import write_json
from vstestbed.report.comparison import baseline
from vstestbed.report.comparison.baseline import FILE, BaselineChanges, read_changes
from vstestbed.studies.comparison import Comparison, Jobs, controllers
from vstestbed.studies.comparison.folder import Baseline

GUIDE = Path(__file__).resolve().parents[3] / "docs/guides/comparing.md"
PLAN = Comparison(
    base=("quick",),
    axes={"law.gain": (1, 2)},
    metrics=("time_to_converge_s", "min_border_margin_px", "sim_time_s"),
)


def table(
    time_s: float = 4.0,
    margin_px: float = 50.0,
    lost: int = 0,
    runs: int = 6,
    gains: tuple[float, ...] = (1, 2),
) -> pl.DataFrame:
    """Runs of two gains; those of the second one take `time_s` and more, and the first `lost` of
    them fail.
    """
    rows = []
    for seed in range(runs):
        for gain in gains:
            failed = gain == 2 and seed < lost
            row = {
                "scenario": "quick",
                "law.gain": gain,
                "seed": seed,
                "folder": f"runs/quick/{gain}/{seed}",
            }
            row |= {"outcome": "timed_out" if failed else "converged", "success": not failed}
            own = time_s if gain == 2 else 9.0
            row |= {
                "time_to_converge_s": None if failed else own * (1 + 0.01 * seed),
                "min_border_margin_px": margin_px + seed,
            }
            rows.append(row | {"sim_time_s": own + 1})
    return pl.DataFrame(rows)


def changed(
    tmp_path: Path, before: pl.DataFrame, now: pl.DataFrame, suffix: str = "parquet"
) -> BaselineChanges:
    (tmp_path / "old").mkdir(exist_ok=True)
    path = tmp_path / f"old/comparison.{suffix}"
    path.write_bytes(before.write_csv().encode()) if suffix == "csv" else before.write_parquet(path)
    changes = Baseline.read(tmp_path / "old").changes(PLAN, now, tmp_path)
    write_json(tmp_path / FILE, changes.plain())
    # as it is, but for infinities and NaN, which are no JSON
    assert json.dumps(read_changes(tmp_path).plain()) == json.dumps(changes.plain())
    return changes


@pytest.mark.parametrize("suffix", ["parquet", "csv"])
def test_the_same_again_differs_in_nothing(tmp_path: Path, suffix: str) -> None:
    changes = changed(tmp_path, table(), table(), suffix)
    assert (changes.matched, changes.only_now, changes.only_before) == (12, (), ())
    assert {m.difference for c in changes.controllers for m in c.metrics} == {0.0}
    assert changes.regressions(0.0) == []
    assert "6 runs without any difference" in baseline.text(changes)
    assert baseline.section(tmp_path)["verdict"] == ["Nothing got worse."]


def test_a_slower_law_is_worse_beyond_the_tolerance_only(tmp_path: Path) -> None:
    changes = changed(tmp_path, table(), table(time_s=4.2))
    assert changes.regressions(0.06) == []
    (words,) = changes.regressions()
    assert re.fullmatch(
        (
            r"gain=2: time to converge 4\.305 s, before 4\.1 s:"
            r" \+0\.205 \[.*\], 5 % worse \(tolerance 2 %\)"
        ),
        words,
    )
    assert changed(tmp_path, table(time_s=4.2), table()).regressions() == []  # sooner is not worse
    assert "    time to converge 4.305 s, before 4.1 s" in baseline.text(changes)


def test_of_a_margin_less_is_worse_and_the_simulated_time_judges_nothing(tmp_path: Path) -> None:
    worse = changed(tmp_path, table(), table(margin_px=40.0)).regressions()
    assert len(worse) == 2
    assert all("smallest margin to the border 42.5 px, before 52.5 px" in words for words in worse)


@pytest.mark.parametrize(
    ("lost", "runs", "worse"), [(4, 12, False), (5, 12, True), (1, 4, True), (0, 4, False)]
)
def test_lost_runs_count_where_a_test_tells_or_there_are_few(
    tmp_path: Path, lost: int, runs: int, worse: bool
) -> None:
    changes = changed(tmp_path, table(runs=runs), table(lost=lost, runs=runs))
    assert changes.controllers[1].lost == tuple(f"seed {i}: timed_out" for i in range(lost))
    assert any("runs reached the goal, before" in words for words in changes.regressions()) == worse
    assert changed(tmp_path, table(lost=lost, runs=runs), table(runs=runs)).regressions() == []


def test_a_single_run_counts_as_it_is(tmp_path: Path) -> None:
    assert len(changed(tmp_path, table(runs=1), table(time_s=4.2, runs=1)).regressions()) == 1


def test_what_has_no_counterpart_is_said(tmp_path: Path) -> None:
    changes = changed(tmp_path, table(gains=(2, 3)), table())
    assert changes.matched == 6
    assert changes.only_now == ("gain=1, 6 of 6 runs",)
    assert changes.only_before == ("quick, law.gain=3, 6 runs",)
    assert "only then: quick, law.gain=3, 6 runs" in baseline.text(changes)


def test_a_baseline_of_something_else_is_refused_before_anything_runs(
    quick: Path, tmp_path: Path
) -> None:
    plan = Comparison(base=(str(quick),), axes={"law.gain": (5, 6)}, seeds=2)
    planned = Jobs(controllers(plan), plan.seeds)
    place = tmp_path / "old.parquet"
    table(gains=(5,)).write_parquet(place)
    Baseline.read(place).must_match(plan, planned)
    table().write_parquet(place)
    words = (
        r"has no run of this comparison; it has quick, law.gain=1; quick, law.gain=2, seeds 0 to 5;"
        r" compare the same scenarios"
    )
    with pytest.raises(RunFolderError, match=words):
        Baseline.read(place).must_match(plan, planned)
    table().drop("law.gain").write_parquet(place)  # its runs would all be the same one here
    with pytest.raises(RunFolderError, match="has no run"):
        Baseline.read(place).must_match(plan, planned)


def test_what_is_no_baseline(tmp_path: Path, command) -> None:
    (tmp_path / "notes.csv").write_text("a,b\n1,2\n")
    (tmp_path / "notes.parquet").write_text("none")
    for place, words in (
        ("nowhere", "no such folder or file; give the folder of a comparison"),
        (".", "holds no comparison's results"),
        ("notes.csv", "it has no column scenario"),
        ("notes.parquet", "notes.parquet: parquet: File out of specification"),
    ):
        ended = command("compare", "ibvs_book", "--baseline", place)
        assert (ended.code, Path("runs").exists()) == (2, False) and words in ended.err
    for option in (["--fail-on-regression"], ["--tolerance", "0.1"]):
        ended = command("compare", "ibvs_book", *option)
        assert (
            ended.code == 2
            and ended.err
            == f"{option[0]} needs the earlier results: --baseline OLD, a comparison's folder\n"
        )
    (tmp_path / FILE).write_text('{"place": "x"}')
    with pytest.raises(RunFolderError, match="is damaged"):
        read_changes(tmp_path)


@pytest.mark.study
def test_the_workflow_of_the_guide_passes_and_fails(command, quick: Path) -> None:
    """Its two comparisons, as they stand there: first of the same scenario, then of one that is
    slower.
    """
    (block,) = re.findall(
        r"```yaml\n(name: .*?)```", GUIDE.read_text(encoding="utf-8"), flags=re.DOTALL
    )
    steps = YAML(typ="safe").load(io.StringIO(block))["jobs"]["compare"]["steps"]
    lines = [
        line.split()[1:]
        for step in steps
        for line in step.get("run", "").splitlines()
        if line.startswith("vstestbed ")
    ]
    assert len(lines) == 2
    place = Path(lines[0][1])
    for name in (place, lines[1][1]):
        Path(name).parent.mkdir(exist_ok=True)
        Path(name).write_text(quick.read_text())
    assert command(*lines[0]).code == 0
    same = command(*lines[1])
    assert same.code == 0
    assert same.err.endswith("20 runs without any difference\nnothing got worse\n")
    Path(lines[1][1]).write_text(quick.read_text().replace("gain: 6", "gain: 4"))
    slower = command(*[word.replace("now", "later") for word in lines[1]], "--json")
    assert slower.code == 5 and "worse: mine: time to converge" in slower.err
    found = json.loads(slower.out)
    assert len(found["runs"]) == found["baseline"]["matched"] == 20
    assert found["baseline"]["controllers"][0]["settings"] == ["law.gain.value"]
    assert "Against before" in Path("later/report.html").read_text(encoding="utf-8")
    assert command("report", "later").code == 0
    assert "Against before" in Path("later/report.html").read_text(encoding="utf-8")
