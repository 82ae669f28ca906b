"""What `compare` does once its options are read: it flies, tells, plans, merges and repeats."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Iterator
from pathlib import Path

import polars as pl
import typer

from vstestbed.cli.ending import INTERRUPTED, REGRESSED
from vstestbed.cli.progress import Counter, show_notes
from vstestbed.core.errors import ParameterError
from vstestbed.report.comparison import baseline
from vstestbed.report.comparison.pairs import has_every_pair
from vstestbed.report.comparison.planning import plan_lines
from vstestbed.report.comparison.records import VERDICTS
from vstestbed.report.comparison.tables import statistics_text
from vstestbed.studies import comparison
from vstestbed.studies.comparison.record import must_be_comparison

__all__ = ["again", "flown", "lines_of_plan", "merge", "tell", "tell_changes"]


def flown(
    campaign: comparison.Campaign,
    jobs: int | None,
    executor: str,
    figures: bool,
    quiet: bool,
    shown: bool,
) -> comparison.ComparisonTable:
    """Fly what is missing; Ctrl-C ends it with a word on how to go on."""
    show_notes(not quiet)
    runner = campaign.runner
    total = len(runner.jobs)
    try:
        with Counter(total, runner.done, shown) as counter:
            return campaign.carry_out(
                jobs, executor, counter.run_done, counter.say, figures=figures
            )
    except KeyboardInterrupt:
        # counted in the folder: finished runs are there in full, others not at all
        words = (
            f"interrupted: {runner.done} of {total} runs are done;"
            f" go on with: vstestbed compare --resume --out {runner.folder}"
        )
        typer.echo(words, err=True)
        raise typer.Exit(INTERRUPTED) from None


def lines_of_plan(asked: comparison.Comparison, force: bool) -> Iterator[str]:
    """How many starts a comparison needs, and how many it plans."""
    variants = comparison.controllers(asked, force)
    laws = len(variants) // len(variants.task_runs)  # each law flies every task
    pairs = math.comb(laws, 2) if has_every_pair(laws, asked.reference) else laws - 1
    limit = min(variant.scenario.stop.duration_s for variant in variants)
    starts = asked.seeds
    if any(variants.task_runs):
        starts = sum(len(runs) for runs in variants.task_runs if runs)
    return plan_lines(laws, pairs, limit, starts, asked.margin)


def tell(table: comparison.ComparisonTable, as_json: bool, quiet: bool) -> None:
    """The runs as JSON, or what the comparison has found, in words."""
    if as_json:
        sys.stdout.write(_as_json(table) + "\n")
    elif not quiet:
        typer.echo(_summary_text(table), err=True)


def _as_json(table: comparison.ComparisonTable) -> str:
    """The runs, the verdicts as they stand in `verdicts.json`, and the changes against a baseline
    where one was given.
    """
    parts = {"runs": table.write_json()}
    if (table.folder / VERDICTS).is_file():
        parts["verdicts"] = (table.folder / VERDICTS).read_text(encoding="utf-8")
    if table.baseline is not None:
        parts["baseline"] = json.dumps(table.baseline.plain())
    return "{" + ", ".join(f'"{name}": {text.strip()}' for name, text in parts.items()) + "}"


def tell_changes(
    changes: baseline.BaselineChanges, tolerance: float | None, fail: bool, shown: bool
) -> None:
    """Say what changed against the baseline;
    exit 5 where something got worse and that is to fail.
    """
    allowed = baseline.TOLERANCE if tolerance is None else tolerance
    worse = [f"worse: {words}" for words in changes.regressions(allowed)]
    lines: list[str] = []
    if shown:
        lines = [baseline.text(changes), *(worse or ["nothing got worse"])]
    elif fail:  # the reason for 5 is always told
        lines = worse
    for line in lines:
        typer.echo(line, err=True)
    if fail and worse:
        raise typer.Exit(REGRESSED)


def merge(places: list[Path], out: Path | None, figures: bool, as_json: bool, quiet: bool) -> None:
    """Put shards together, and say what a comparison says."""
    if not places:
        raise ParameterError.missing("--merge", "name the shards' folders, e.g. shards/*")
    show_notes(not quiet)

    def say(words: str) -> None:
        if not (quiet or as_json):
            typer.echo(f"{words} ...", err=True)

    tell(comparison.merge(places, out, say, figures), as_json, quiet)


def again(
    places: list[Path], out: Path | None, jobs: int | None, executor: str, shown: bool
) -> None:
    """Fly a folder again, and say which rows agree; exit 5 where some do not."""
    if len(places) != 1:
        raise ParameterError.count(
            "--again", "one", "folder of a comparison, as the argument", list(map(str, places))
        )
    must_be_comparison(places[0])
    runs = pl.scan_parquet(places[0] / "comparison.parquet")
    with Counter(runs.select(pl.len()).collect().item(), 0, shown) as counter:
        folder, found = comparison.again(places[0], out, jobs, executor, counter.run_done)
    for line in (*found.lines(), f"  results   {folder}"):
        typer.echo(line, err=True)
    if found.differ:
        raise typer.Exit(REGRESSED)


def _summary_text(table: comparison.ComparisonTable) -> str:
    done = len(table)
    good = int(table["success"].sum())
    lines = [f"{good} of {done} runs reached the goal"]
    if good < done:
        lines[0] += f"; {done - good} did not reach the goal"
    if said := statistics_text(table.folder):
        lines.append(said)
    opened = " (open report.html)" if (table.folder / "report.html").exists() else ""
    return "\n".join([*lines, f"  results   {table.folder}{opened}"])
