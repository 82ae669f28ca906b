"""A comparison beside an earlier one: the same runs then and now, paired, and what got worse; on
one machine runs repeat exactly.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import polars as pl
from pydantic import BeforeValidator, TypeAdapter, ValidationError

from vstestbed.core.errors import RunFolderError
from vstestbed.report.comparison.results import ControllerResults
from vstestbed.report.comparison.statistics import paired_difference, sign_test
from vstestbed.report.marks import number, signed
from vstestbed.report.pages import NO_CELL, Cell
from vstestbed.tasks.metrics import Metric

FILE = "baseline.json"  # File of a comparison's folder that holds its `BaselineChanges`
TOLERANCE = 0.02
"""Default share of the earlier mean by which a metric may get worse. Another version of a library
or another processor changes the last digits of pixels, and lets a run converge a frame earlier or
later, and 40 ms are a hundredth of 4 s: a real difference of that size is no fault of a law.
"""
LEVEL = 0.05  # Level of the one-sided test on lost runs
FEWEST = 5  # Fewest runs of which that test can find a loss: 1/2^5 is under LEVEL, 1/2^4 is not

# NaN, which JSON has not, is null there
Number = Annotated[float, BeforeValidator(lambda value: math.nan if value is None else value)]


@dataclass(frozen=True)
class MetricChange:
    """A metric over the matched runs of a controller, in its display unit."""

    name: str  # key in `summary.json`
    title: str  # title, unit: as printed
    unit: str
    before: Number  # before, now: means over the same runs
    now: Number
    # difference, low, high: mean of now - before with its 95 % interval, NaN where there is none
    difference: Number
    low: Number
    high: Number
    n: int  # number of these runs
    real: bool  # the interval excludes zero
    better: int  # 1 where more is better, -1 where less is, 0 where neither

    @property
    def share(self) -> float:
        """The difference as a share of the earlier mean; infinite where that is 0."""
        if not self.difference:
            return 0.0
        if not self.before:
            return math.copysign(math.inf, self.difference)
        return self.difference / abs(self.before)

    def worse(self, tolerance: float) -> bool:
        """Whether it got worse by more than a share of the earlier mean; of several runs, with an
        interval that excludes zero.
        """
        return (
            self.better * self.difference < 0
            and abs(self.share) > tolerance
            and (self.real or self.n == 1)
        )

    @property
    def loss(self) -> str:
        """By how much it got worse, in words."""
        share = f"{100 * abs(self.share):.3g} %" if math.isfinite(self.share) else "from nothing"
        return f"{self.title.lower()} {difference_text(self)}, {share} worse"


@dataclass(frozen=True)
class ControllerChange:
    """The matched runs of one controller, then and now."""

    label: str  # its name
    runs: int
    reached_before: int  # reached_before, reached_now: how many of the `runs` reached the goal
    reached_now: int
    # lost, gained: the runs that reached it only then, and only now, each in words:
    # `seed 3: target_lost`
    lost: tuple[str, ...]
    gained: tuple[str, ...]
    chance: (
        Number  # p-value of the one-sided exact sign test, that it reaches the goal less often now
    )
    metrics: tuple[MetricChange, ...]  # the metrics
    settings: tuple[str, ...] = ()  # fields of the scenario that differ, of its first run

    @property
    def fails_more(self) -> bool:
        """Whether it reaches the goal in significantly fewer runs; with fewer than 5 runs no test
        could tell, and any net loss counts.
        """
        fewer = len(self.lost) > len(self.gained)
        return fewer and (self.chance < LEVEL or self.runs < FEWEST)

    @property
    def loss(self) -> str:
        """That it fails more often, in words."""
        why = f"fewer than {FEWEST} runs, so that any loss counts"
        if self.chance < LEVEL:
            why = f"p = {self.chance:.2g}"
        return (
            f"{self.label}: {self.reached_now} of {self.runs} runs reached the goal,"
            f" before {self.reached_before} ({why})"
        )

    @property
    def changed(self) -> bool:
        """Whether anything differs."""
        return bool(self.lost or self.gained or any(m.difference for m in self.metrics if m.n))


@dataclass(frozen=True)
class BaselineChanges:
    """A comparison beside an earlier one."""

    place: str  # of the earlier results
    matched: int  # number of runs that both have
    # only_now, only_before: controllers without a counterpart, or with some runs only; in words
    only_now: tuple[str, ...]
    only_before: tuple[str, ...]
    controllers: tuple[ControllerChange, ...]  # those with matched runs

    def regressions(self, tolerance: float = TOLERANCE) -> list[str]:
        """A sentence for each thing that got worse; `tolerance`: share of the earlier mean by which
        a metric may get worse.
        """
        found = []
        for c in self.controllers:
            if c.fails_more:
                found.append(c.loss)
            found += [
                f"{c.label}: {m.loss} (tolerance {100 * tolerance:g} %)"
                for m in c.metrics
                if m.worse(tolerance)
            ]
        return found

    def plain(self) -> dict[str, Any]:
        """The changes as plain values for JSON, null where a number is unknown."""
        return json.loads(TypeAdapter(BaselineChanges).dump_json(self))


def change_of(
    label: str,
    before: pl.DataFrame,
    now: pl.DataFrame,
    metrics: Sequence[Metric],
    settings: Sequence[str],
) -> ControllerChange:
    """The changes of one controller, of which both tables have the same runs in every row."""
    old, new = ControllerResults(label, before), ControllerResults(label, now)
    lost = _runs(new, old.success & ~new.success)
    gained = _runs(old, ~old.success & new.success)
    chance = sign_test(len(lost), len(gained), "greater")
    return ControllerChange(
        label,
        len(now),
        int(old.success.sum()),
        int(new.success.sum()),
        lost,
        gained,
        chance,
        tuple(_metric_change(old, new, metric) for metric in metrics),
        tuple(settings),
    )


def _metric_change(old: ControllerResults, new: ControllerResults, metric: Metric) -> MetricChange:
    x = old.values(metric)
    y = new.values(metric)
    used = ((old.success & new.success) | metric.every_pair) & np.isfinite(x) & np.isfinite(y)
    d = paired_difference(y[used], x[used])
    return MetricChange(
        metric.name,
        metric.title,
        metric.unit,
        float(x[used].mean()) if used.any() else math.nan,
        float(y[used].mean()) if used.any() else math.nan,
        d.mean,
        d.low,
        d.high,
        d.n,
        d.excludes_zero,
        metric.better,
    )


def _runs(ended: ControllerResults, chosen: np.ndarray) -> tuple[str, ...]:
    """The chosen runs with the outcome that they have in one of the two comparisons, the one in
    which they failed.
    """
    outcomes = ended.runs["outcome"].to_list()
    return tuple(f"seed {seed}: {outcomes[i]}" for i, seed in enumerate(ended.seeds) if chosen[i])


def difference_text(m: MetricChange) -> str:
    """A difference as text: `4.12 s, before 3.64 s: +0.48 [0.3, 0.66]`."""
    interval = f" [{m.low:+.3g}, {m.high:+.3g}]" if math.isfinite(m.low) else ""
    unit = f" {m.unit}" if m.unit else ""
    return f"{m.now:.4g}{unit}, before {m.before:.4g}{unit}: {m.difference:+.3g}{interval}"


def read_changes(folder: Path) -> BaselineChanges | None:
    """What `baseline.json` of a comparison's folder holds; None where there is none.
    RunFolderError: it is damaged.
    """
    path = folder / FILE
    if not path.is_file():
        return None
    try:
        return TypeAdapter(BaselineChanges).validate_json(path.read_bytes())
    except (OSError, ValidationError) as error:
        raise RunFolderError(
            path, f"is damaged ({error})", "remove it, or compare again with --baseline"
        ) from None


# How a comparison differs from an earlier one, in words for the terminal and as a section of the
# page.

# Differing metrics, and lost runs, that a line of the terminal names; the page has all of them
MOST = 4


def text(changes: BaselineChanges) -> str:
    """The differences in a few lines: each controller's successes and its metrics that differ most
    surely.
    """
    lines = [f"against {changes.place}: {changes.matched} runs in both"]
    lines += [f"  only now: {words}" for words in changes.only_now]
    lines += [f"  only then: {words}" for words in changes.only_before]
    for c in changes.controllers:
        lines += _lines(c)
    return "\n".join(lines)


def _lines(c: ControllerChange) -> list[str]:
    settings = f"; its scenario differs in {_named(c.settings)}" if c.settings else ""
    if not c.changed:
        return [f"  {c.label}: {c.runs} runs without any difference{settings}"]
    runs = ""
    for what, those in (("lost", c.lost), ("gained", c.gained)):
        if those:
            runs += f" ({what}: {_named(those)})"
    differ = [m for m in c.metrics if m.n and m.difference]
    differ.sort(key=lambda m: (not m.real, -abs(m.share)))
    reached = f"{c.reached_now} of {c.runs} reached the goal, before {c.reached_before}"
    lines = [f"  {c.label}: {reached}{runs}{settings}"]
    lines += [f"    {m.title.lower()} {difference_text(m)}" for m in differ[:MOST]]
    if len(differ) > MOST:
        lines.append(f"    {len(differ) - MOST} more numbers differ (report.html)")
    return lines


def _named(words: Sequence[str]) -> str:
    return ", ".join(words[:MOST]) + (f" and {len(words) - MOST} more" if len(words) > MOST else "")


def section(folder: Path) -> dict[str, Any] | None:
    """The section of a comparison's page (`baseline.html`); None where it was not compared with an
    earlier one.
    """
    changes = read_changes(folder)
    if changes is None:
        return None
    metrics = [m for c in changes.controllers for m in c.metrics]
    names = dict.fromkeys(f"{m.title} [{m.unit}]" if m.unit else m.title for m in metrics)
    return {
        "changes": changes,
        "tolerance": f"{100 * TOLERANCE:g}",
        "verdict": changes.regressions() or ["Nothing got worse."],
        "heads": ["Controller", "Reached the goal", *names],
        "lines": [
            [Cell.named(c.label), _goals(c), *map(_cell, c.metrics)] for c in changes.controllers
        ],
    }


def _goals(c: ControllerChange) -> Cell:
    change = c.reached_now - c.reached_before
    small = [f"{c.reached_now} of {c.runs}, before {c.reached_before}"]
    small += [f"lost {run}" for run in c.lost]
    small += [f"gained {run}" for run in c.gained]
    return Cell(change, signed(change), c.fails_more, small)


def _cell(m: MetricChange) -> Cell:
    if not m.n:
        return NO_CELL
    interval = [f"[{signed(m.low)},", f"{signed(m.high)}]"] if math.isfinite(m.low) else []
    small = [*interval, f"before {number(m.before)}"]
    return Cell(m.difference, signed(m.difference), m.real and m.difference != 0, small)
