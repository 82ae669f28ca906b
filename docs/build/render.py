"""What pages ask of results, and how it is written: each function here is known to their marks."""

from __future__ import annotations

import functools
import math
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import polars as pl
import yaml
from typer.testing import CliRunner

import vstestbed as vs
from docs.build.conditions import comparison_of
from docs.build.kept import Row
from vstestbed.apps.bench.bench import BesideFloor
from vstestbed.cli.app import program
from vstestbed.core.named_files import bundled_comparisons, bundled_scenarios
from vstestbed.report.comparison.grid import ALL, ERROR, Grid, real
from vstestbed.report.comparison.pairs import pairs
from vstestbed.report.comparison.results import LIMIT, TIME, ComparisonResults
from vstestbed.report.comparison.sentences import findings
from vstestbed.report.comparison.statistics import (
    IntervalEstimate,
    paired_difference,
    quartiles,
    success_rate,
)
from vstestbed.report.comparison.tasks import AMOUNT, cells, markdown, over_all_tasks
from vstestbed.studies.comparison.folder import results_of


def scenarios(robots: Iterable[str]) -> list[tuple[str, str]]:
    """Name and description of the bundled scenarios with one of these robots."""
    return [(s.name, s.description.strip()) for s in _bundled() if s.robot.kind in robots]


@functools.cache
def _bundled() -> list[vs.Scenario]:
    """All bundled scenarios, loaded once for all pages."""
    return [vs.load(name) for name in bundled_scenarios()]


def plan(words: str) -> str:
    """What `vstestbed compare --plan` prints."""
    return CliRunner().invoke(program(), ["compare", "--plan", *words.split()]).stdout.rstrip()


def comparisons() -> list[tuple[str, str]]:
    """Name and description of the bundled comparisons."""
    return [
        (name, yaml.safe_load(file.read_text(encoding="utf-8")).get("description", ""))
        for name, file in bundled_comparisons().items()
    ]


def interval(
    found: IntervalEstimate, places: int = 2, sign: bool = False, scale: float = 1.0
) -> str:
    """An estimate with its 95 % interval: `1.20 (1.05 to 1.36)`."""
    words = [f"{scale * value:{'+' if sign else ''}.{places}f}" for value in found[:3]]
    return f"{words[0]} ({words[1]} to {words[2]})"


def gain_of(comparison: str, law: str) -> float:
    """The gain of a law that a bundled comparison names [1/s]."""
    given = yaml.safe_load(bundled_comparisons()[comparison].read_text(encoding="utf-8"))
    return float(given["cases"]["law"][law]["law"]["gain"])


def sentences(rows: Sequence[Row], command: str) -> str:
    """What a comparison has found, in the sentences that its report prints: on all laws, and on
    each pair.

    Raises:
        ValueError: the runs were kept without their limits, which are the price of a failure: fly
            them again.
    """
    table = pl.DataFrame([dict(row) for row in rows], infer_schema_length=None, strict=False)
    if LIMIT.name not in table.columns:
        raise ValueError(
            f"`vstestbed {command}` was kept without {LIMIT.name}:"
            f" python -m docs.build PAGE --again '{command}'"
        )
    results = results_of(table, comparison_of(command))
    found = findings(results, pairs(results))
    return "\n".join([f"> {found.overall}", *(f">\n> - {words}" for words in found.sentences)])


def judged(summary: Row) -> str:
    """The error that decides a run's outcome, with its unit and limit: `0.13 px (0.2)`."""
    error, unit, limit = summary["judged_error"], summary["judged_unit"], summary["judged_limit"]
    if error is None:
        return ""
    factor, word = {"m": (1000, "mm"), "rad": (math.degrees(1), "deg")}.get(unit, (1, unit))
    return f"{error * factor:.3g} {word} ({limit * factor:.3g})"


def number(value: float | None, places: int = 1) -> str:
    """A number to so many places; nothing for none."""
    return "" if value is None or not math.isfinite(value) else f"{value:.{places}f}"


def where(rows: Iterable[Row], **wanted: Any) -> list[Row]:
    """The rows that have these values.

    Raises:
        ValueError: none has.
    """
    found = [
        row
        for row in rows
        if all(row.get(name.replace("__", ".")) == value for name, value in wanted.items())
    ]
    if not found:
        raise ValueError(f"no run has {wanted}")
    return found


def each(rows: Iterable[Row], name: str) -> list[Any]:
    """The values that a column has, in the order of their first rows."""
    return list(dict.fromkeys(row[name] for row in rows))


def reached(rows: Iterable[Row], interval: bool = True) -> str:
    """Runs that reached the goal, `19 of 20 [76, 99] %`, with the Wilson interval."""
    good = [bool(row["success"]) for row in rows]
    rate = success_rate(sum(good), len(good))
    return f"{sum(good)} of {len(good)}" + (
        f" [{100 * rate.low:.0f}, {100 * rate.high:.0f}] %" if interval else ""
    )


def failed(rows: Iterable[Row], by: str = "seed") -> str:
    """The runs that did not reach the goal, by outcome: `joint_limit: 7, 15`; `random (2)` where
    two are called alike.
    """
    outcomes: dict[str, list[str]] = {}
    for row in rows:
        if not row["success"]:
            outcomes.setdefault(f"`{row['outcome']}`", []).append(str(row[by]))
    each_of = {
        outcome: [name if n == 1 else f"{name} ({n})" for name, n in Counter(those).items()]
        for outcome, those in outcomes.items()
    }
    return "; ".join(f"{outcome}: {', '.join(those)}" for outcome, those in each_of.items())


def failed_seeds(rows: Iterable[Row]) -> str:
    """The seeds that did not reach the goal: `7, 15`."""
    return ", ".join(str(row["seed"]) for row in rows if not row["success"]) or "none"


def same_starts(rows: Iterable[Row], others: Iterable[Row]) -> list[Row]:
    """The rows whose seed is one of the others'."""
    seeds = {row["seed"] for row in others}
    return [row for row in rows if row["seed"] in seeds]


def typical(
    rows: Iterable[Row], name: str, places: int = 1, factor: float = 1, every: bool = False
) -> str:
    """Median and quartiles over the runs that reached the goal, or over all: `12.7 [11.9, 13.1]`;
    one number where they are alike.
    """
    q1, median, q3, _ = quartiles(_values(rows, name, factor, every))
    text = number(median, places)
    if text == number(q1, places) == number(q3, places):
        return text
    return _within(median, q1, q3, places)


def median(rows: Iterable[Row], name: str, factor: float = 1, every: bool = False) -> float:
    """The median over the runs that reached the goal, or over all."""
    return quartiles(_values(rows, name, factor, every))[1]


def worst(rows: Iterable[Row], name: str, factor: float = 1) -> float:
    """The largest value of the runs that reached the goal."""
    return max(_values(rows, name, factor))


def span(
    rows: Iterable[Row], name: str, places: int = 1, factor: float = 1, every: bool = False
) -> str:
    """From the smallest to the largest value of the runs that reached the goal, or of all:
    `11.6 to 19.7`.
    """
    values = list(_values(rows, name, factor, every))
    low, high = number(min(values), places), number(max(values), places)
    return low if low == high else f"{low} to {high}"


def differs(
    rows: Iterable[Row], others: Iterable[Row], name: str, places: int = 1, every: bool = False
) -> str:
    """Mean of the paired differences of both's successful seeds, or of all, with its 95 % interval:
    `-0.9 [-1.5, -0.4]`.
    """
    found = paired_difference(*_pairs(rows, others, name, every))
    return _within(found.mean, found.low, found.high, places)


def shifted(rows: Iterable[Row], others: Iterable[Row], name: str, places: int = 1) -> str:
    """Median and quartiles of the paired differences of both's successful seeds:
    `-0.20 [-0.24, -0.16]`.
    """
    q1, median, q3, _ = quartiles([a - b for a, b in zip(*_pairs(rows, others, name), strict=True)])
    return _within(median, q1, q3, places)


def _within(middle: float, low: float, high: float, places: int) -> str:
    return f"{number(middle, places)} [{number(low, places)}, {number(high, places)}]"


def _pairs(
    rows: Iterable[Row], others: Iterable[Row], name: str, every: bool = False
) -> tuple[list[float], list[float]]:
    """The values of the seeds that both have."""
    a, b = (
        {row["seed"]: row[name] for row in those if every or row["success"]}
        for those in (rows, others)
    )
    both = sorted(a.keys() & b.keys())
    return [a[seed] for seed in both], [b[seed] for seed in both]


def tasks(rows: Sequence[Row]) -> str:
    """Laws by tasks, as in a comparison's `tasks.md`."""
    return markdown(cells(over_all_tasks(comparison(rows))))


def effects(rows: Sequence[Row]) -> str:
    """Effects by laws: runs that reached the goal, change of the time to converge [s], median final
    error [mm]; as the grid of a report.

    The first row has the median time, and the last column the mean change over all laws; a change
    is in bold where it is beyond chance after Holm's correction over all cells, or over all rows of
    the last column.
    """
    found = Grid.of(comparison(rows))
    assert found is not None
    by_cell, overall = found.changes(TIME), found.overall(TIME)
    changes = by_cell | overall
    marked = real(by_cell) | real(overall)
    most = max(len(c.success) for c in found.cells.values())

    def change(at: int | tuple[int, int]) -> str:
        if at not in changes or not math.isfinite(changes[at].mean):
            return "-"
        words = f"{changes[at].mean:+.2f} s"
        return f"**{words}**" if at in marked else words

    def cell(i: int, j: int) -> str:
        c = found.cells[i, j]
        good = int(c.success.sum())
        n = len(c.success)
        time_s = c.quartiles(TIME)[1]
        error_mm = c.quartiles(ERROR)[1]
        words = f"{good} of {n}: " if good < n or n < most else ""
        if i or not math.isfinite(time_s):
            words += change((i, j))
        else:
            words += f"{time_s:.1f} s"
        return words + (f", {error_mm:.2g} mm" if math.isfinite(error_mm) else "")

    head = "".join(f" `{name}` |" for name in found.columns)
    lines = [f"| |{head} {ALL} |", "|---" * (len(found.columns) + 2) + "|"]
    for i, name in enumerate(found.rows):
        row = [name, *(cell(i, j) for j in range(len(found.columns))), change(i) if i else ""]
        lines.append(f"| {' | '.join(row)} |")
    return "\n".join(lines)


def comparison(rows: Sequence[Row]) -> ComparisonResults:
    """The rows as a comparison, whose axes are the columns before the seed."""
    names = list(rows[0])
    axes = [name for name in names[1 : names.index("seed")] if name != AMOUNT]
    return ComparisonResults(pl.DataFrame(rows, infer_schema_length=None), tuple(axes))


def least_gain(rows: Iterable[Row], plain: Iterable[Row], name: str) -> float:
    """The smallest factor by which a seed's value is less than that of the first variant among
    `plain`.
    """
    first: dict[int, float] = {}
    for row in plain:
        first.setdefault(row["seed"], row[name])
    return min(first[row["seed"]] / row[name] for row in rows)


def ratios(timing: Row) -> tuple[float, ...]:
    """Ratios of a benchmark to its floor, pair by pair, the smallest first."""
    return BesideFloor(**timing).ratios


def _values(rows: Iterable[Row], name: str, factor: float, every: bool = False) -> Iterator[float]:
    for row in rows:
        if (every or row["success"]) and row.get(name) is not None:
            yield factor * row[name]
