"""How laws score and rank on the tasks of a suite: tables, figures and page, each number with its
interval.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import polars as pl

from vstestbed.core.files import make_folder, write_whole
from vstestbed.core.geometry import Array
from vstestbed.report.canvas import new_figure, panels, publish, style
from vstestbed.report.comparison.statistics import (
    CONFIDENCE,
    IntervalEstimate,
    holm,
    paired_difference,
    success_rate,
)
from vstestbed.report.marks import LINE_COLORS, RULE, line_color
from vstestbed.report.pages import text_of, write_page
from vstestbed.tasks.metrics import Metric

FIGURES = "figures"  # the page's figures for a paper
RESAMPLES = 2000  # of starts, and of tasks, for intervals of mean ranks
FARTHEST = 10.0  # right end of the profile: times the best law's number
MEAN_RANKS = ["law", "tasks", "place", "of", "mean_rank", "low", "high", "alike_low", "alike_high"]
COLOURED = 5  # laws that the profile draws in colours


@dataclass(frozen=True)
class TaskOfSuite:
    """A task as its scores show it: the metric by which laws are ranked, less is better, and what
    it asks of a law.
    """

    metric: Metric
    asks: str = ""
    without: Mapping[str, str] = field(default_factory=dict[str, str])
    """The laws that take no part in it, each with the reason."""


@dataclass(frozen=True)
class Score:
    """How a law did in a task.

    rate: of success, with its Wilson interval. value: mean of the task's metric, a failure at the
    task's limit, with Student's interval, as flown. rank: 1 is the best by that mean; its interval
    is from 1 + the laws that beat it to as many as it does not beat, in tests of all pairs
    (Mogstad, Romano, Shaikh & Wilhelm 2024, doi:10.1093/restud/rdad006). gap: how far the mean is
    from the best law's, with the p-value of that test. values: on the starts that all laws of the
    task flew.
    """

    task: str
    law: str
    rate: IntervalEstimate
    value: IntervalEstimate
    rank: IntervalEstimate
    gap: IntervalEstimate
    values: Array

    @property
    def reached(self) -> int:
        """How many of its runs reached the goal."""
        return round(self.rate.mean * self.rate.n)

    @property
    def behind(self) -> bool:
        """Whether the law is behind the best one beyond chance."""
        return _beyond_chance(self.gap)


def _beyond_chance(more: IntervalEstimate) -> bool:
    """Whether a difference is more than 0 by the test and by the interval."""
    return more.p < 1 - CONFIDENCE and more.low > 0


def scores(runs: pl.DataFrame) -> list[Score]:
    """The scores of all laws in all tasks, in the order of the table; runs: `task`, `law`, `start`,
    `success`, `value`, one row a run.
    """
    return [
        score
        for task in runs["task"].unique(maintain_order=True)
        for score in _of_task(runs.filter(pl.col("task") == task), task)
    ]


def _by_start(runs: pl.DataFrame, name: str, laws: Sequence[str]) -> Array:
    """A column as (laws, starts), NaN where a law has not flown, or has no number."""
    return (
        runs.pivot("law", index="start", values=name, aggregate_function="first")
        .select(laws)
        .to_numpy()
        .T.astype(float)
    )


def _of_task(runs: pl.DataFrame, task: str) -> Iterator[Score]:
    from scipy.stats import rankdata

    laws = runs["law"].unique(maintain_order=True).to_list()
    reached = _by_start(runs, "success", laws)
    values = _by_start(runs, "value", laws)
    flown = np.isfinite(reached).all(axis=0)  # starts that every law has flown
    # one that crashed counts as the worst
    values = np.where(np.isnan(values), np.nanmax(values, initial=0.0), values)[:, flown]
    n = values.shape[1]
    means = values.mean(axis=1)
    ranks = rankdata(means)
    first = int(np.argmin(means))
    behind = differences(values)
    beaten = [pair for pair, one in behind.items() if _beyond_chance(one)]
    for i, law in enumerate(laws):
        done = reached[i][np.isfinite(reached[i])]
        beaten_by = sum(pair[0] == i for pair in beaten)
        beats = sum(pair[1] == i for pair in beaten)
        yield Score(
            task,
            law,
            success_rate(int(done.sum()), len(done)),
            paired_difference(values[i], np.zeros(n)),
            IntervalEstimate(ranks[i], 1 + beaten_by, len(laws) - beats, n),
            IntervalEstimate(0.0, 0.0, 0.0, n) if i == first else behind[i, first],
            values[i],
        )


def differences(values: Array) -> dict[tuple[int, int], IntervalEstimate]:
    """Mean of each law's values (laws, starts) less each other's, with the p-value after Holm's
    correction over all pairs.
    """
    pairs = list(itertools.combinations(range(len(values)), 2))
    found = [paired_difference(values[i], values[j]) for i, j in pairs]
    adjusted = {
        pair: one._replace(p=p)
        for pair, one, p in zip(pairs, found, holm([one.p for one in found]), strict=True)
    }
    return adjusted | {(j, i): one.turned() for (i, j), one in adjusted.items()}


class Standing(NamedTuple):
    """Where a law stands over the tasks that it flew, among the `of` laws that flew all of these,
    by the mean of its ranks among them.

    rank: with the interval on these tasks, from other starts. alike: that on tasks like these, from
    other starts and of other tasks.
    """

    law: str
    rank: IntervalEstimate
    alike: IntervalEstimate
    tasks: int
    place: int
    of: int


def ranking(found: Sequence[Score]) -> Iterator[str]:
    """A line on each law: its mean rank, and its place."""
    for one in overall(found):
        rank = f"mean rank {one.rank.mean:.1f} [{one.rank.low:.1f}, {one.rank.high:.1f}]"
        yield (
            f"{one.law}: {rank} over {one.tasks} tasks,"
            f" place {one.place} of the {one.of} laws that flew them"
        )


def overall(found: Sequence[Score]) -> list[Standing]:
    """Where each law stands; those that flew the most tasks first, then by the mean rank. It stands
    beside its parts, never for them.

    Laws are compared on the same tasks alone: who declines a hard task does not pass a law that
    flew it, which keeps its place among those that flew it, too; and no law is placed over one that
    flew fewer tasks than itself.
    """
    by: dict[str, dict[str, Score]] = {}
    for score in found:
        by.setdefault(score.law, {})[score.task] = score
    standings = []
    for tasks in dict.fromkeys(tuple(own) for own in by.values()):
        named = {
            law: [own[task].values for task in tasks]
            for law, own in by.items()
            if own.keys() >= set(tasks)
        }
        standings += [one for one in _standings(named) if len(by[one.law]) == len(tasks)]
    return sorted(standings, key=lambda one: (-one.tasks, one.rank.mean))


def _standings(flown: Mapping[str, Sequence[Array]]) -> list[Standing]:
    """Where laws stand by their values in the same tasks, ties sharing their places; the intervals
    are bootstrap percentiles, and one task says nothing of others.
    """
    from scipy.stats import rankdata

    rng = np.random.default_rng(0)
    tail = 50 * (1 - CONFIDENCE)
    # each (laws, starts)
    tasks = [np.array(values) for values in zip(*flown.values(), strict=True)]
    mean = np.mean([rankdata(values.mean(axis=1)) for values in tasks], axis=0)
    resampled = []
    for values in tasks:
        # the same for all laws
        starts = rng.integers(0, values.shape[1], (RESAMPLES, values.shape[1]))
        resampled.append(rankdata(values[:, starts].mean(axis=2), axis=0).T)
    ranks = np.array(resampled)  # (tasks, RESAMPLES, laws)
    which = rng.integers(0, len(tasks), (RESAMPLES, len(tasks)))
    alike = (
        ranks[which, rng.integers(0, RESAMPLES, which.shape)]
        if len(tasks) > 1
        else np.swapaxes(ranks, 0, 1) * np.nan
    )
    here = np.percentile(ranks.mean(axis=0), [tail, 100 - tail], axis=0)
    there = np.percentile(alike.mean(axis=1), [tail, 100 - tail], axis=0)
    return [
        Standing(
            law,
            IntervalEstimate(mean[i], *here[:, i]),
            IntervalEstimate(mean[i], *there[:, i]),
            len(tasks),
            1 + int((mean < mean[i]).sum()),
            len(flown),
        )
        for i, law in enumerate(flown)
    ]


def profile(runs: pl.DataFrame) -> dict[str, Array]:
    """Of each law how many times the best law's number it had, sorted, of all starts of the tasks
    that it flew; infinity for a failure.

    The share of starts up to a factor is the law's performance profile: Dolan & More 2002,
    doi:10.1007/s101070100263.
    """
    best = pl.col("value").filter("success").min().over("task", "start")
    ratio = (
        pl.when("success").then((pl.col("value") + 1e-9) / (best + 1e-9)).otherwise(float("inf"))
    )
    known = runs.select("law", ratio=ratio).with_columns(pl.col("ratio").fill_null(float("inf")))
    return {
        str(law): np.sort(part["ratio"].to_numpy())
        for (law,), part in known.group_by("law", maintain_order=True)
    }


def write_scores(
    out: Path,
    runs: pl.DataFrame,
    tasks: Mapping[str, TaskOfSuite],
    heading: str,
    about: str,
    command: str,
) -> list[Score]:
    """Write `scores.csv`, `scores.tex`, `figures/` and `report.html` into a suite's folder; the
    scores.

    tasks: by name. heading, about, command: of the page.
    """
    found = scores(runs)
    ranked = overall(found)
    means = [(s.law, s.tasks, s.place, s.of, *s.rank[:3], *s.alike[1:3]) for s in ranked]
    ranks = pl.DataFrame(means, MEAN_RANKS, orient="row").fill_nan(None)
    write_whole(out / "scores.csv", _table(found, tasks).write_csv())
    write_whole(out / "scores.tex", latex(found, tasks))
    write_whole(out / "ranks.csv", ranks.write_csv())
    of_ranks = (
        "Rank by the mean of each task's number, 1 is the best,"
        " as tests of all pairs leave it open; no mark: not flown."
    )
    of_profile = (
        "Of the starts that a law flew:"
        " on which share it needed at most so many times the best law's number; a failure never."
    )
    place = make_folder(out / FIGURES)
    plots = [
        ("Ranks", _drawn_ranks(found, place), of_ranks),
        ("Profile", _drawn_profile(runs, [s.law for s in ranked], place), of_profile),
    ]
    tables = _page_tables(found, ranked, tasks)
    write_page(out, "study.html", heading, about=about, plots=plots, tables=tables, command=command)
    return found


def _page_tables(
    found: Sequence[Score], ranked: Sequence[Standing], tasks: Mapping[str, TaskOfSuite]
) -> list[tuple[str, list[str], list[list[Any]]]]:
    """The page's tables, each with title, heads and lines."""
    by = {(s.law, s.task): s for s in found}
    lines = []
    for s in ranked:
        small = [f"{_ends(s.rank)} on these", f"{_ends(s.alike)} on tasks like these"]
        mean = [f"{s.rank.mean:.1f} of {s.tasks} tasks", *small]
        cells = [_cell(by.get((s.law, task)), one) for task, one in tasks.items()]
        lines.append([s.law, mean, f"{s.place} of {s.of}", *cells])
    heads = ["law", "mean rank", "place among the laws that flew these tasks", *tasks]
    of_chances = ["task", "best mean", "not behind beyond chance", "behind"]
    asked = ["task", "what it asks of a law", "ranked by", "laws"]
    tables: list[tuple[str, list[str], list[list[Any]]]] = [
        ("Scores", heads, lines),
        ("Beyond chance", of_chances, _chances(found, tasks)),
        ("Tasks", asked, _asked(found, tasks)),
    ]
    blank = [[law, name, why] for name, t in tasks.items() for law, why in t.without.items()]
    if blank:
        tables.append(("Without part", ["law", "task", "why"], blank))
    return tables


def _table(found: Sequence[Score], tasks: Mapping[str, TaskOfSuite]) -> pl.DataFrame:
    """The scores as a table, a row a law and task, numbers in the metric's unit of display."""
    rows = []
    for s in found:
        row: dict[str, Any] = {
            "task": s.task,
            "law": s.law,
            "metric": tasks[s.task].metric.label,
            "reached": s.reached,
            "runs": s.rate.n,
        }
        for name in ("rate", "value", "rank", "gap"):
            for end in ("mean", "low", "high"):
                row[f"{name}_{end}"] = getattr(getattr(s, name), end)
        rows.append(row | {"gap_p": s.gap.p})
    return pl.DataFrame(rows).with_columns(pl.selectors.float().fill_nan(None))


def _ends(one: IntervalEstimate) -> str:
    return f"[{one.low:.1f}, {one.high:.1f}]" if one.low == one.low else "-"


def _chances(found: Sequence[Score], tasks: Mapping[str, TaskOfSuite]) -> list[list[str]]:
    """Of each task: the law with the best mean, those that are not behind it beyond chance, and how
    many are.
    """
    lines = []
    for task in tasks:
        of_task = sorted((s for s in found if s.task == task), key=lambda s: s.value.mean)
        if of_task:
            close = [s.law for s in of_task[1:] if not s.behind]
            behind = f"{sum(s.behind for s in of_task)} of {len(of_task) - 1}"
            lines.append([task, of_task[0].law, ", ".join(close) or "-", behind])
    return lines


def _asked(found: Sequence[Score], tasks: Mapping[str, TaskOfSuite]) -> list[list[str]]:
    return [
        [task, one.asks, one.metric.label, str(len({s.law for s in found if s.task == task}))]
        for task, one in tasks.items()
    ]


def _cell(score: Score | None, task: TaskOfSuite) -> list[str]:
    """A score in words: successes, number, rank, each with its interval; blank for a law that took
    no part.
    """
    if score is None:
        return ["-"]
    rate = score.rate
    value = score.value
    rank = score.rank
    return [
        f"{score.reached} of {rate.n} ({100 * rate.low:.0f} to {100 * rate.high:.0f} %)",
        f"{value.mean:.3g} {task.metric.unit} ({value.low:.3g} to {value.high:.3g})",
        f"rank {rank.mean:.3g} ({rank.low:.3g} to {rank.high:.3g})",
    ]


def _drawn_ranks(found: Sequence[Score], place: Path) -> str:
    tasks = list(dict.fromkeys(s.task for s in found))
    order = [s.law for s in overall(found)]
    down = -(-len(tasks) // 6)
    across = -(-len(tasks) // down)
    with style():
        drawn = new_figure((0.2 * len(order) + 0.7) * down, 1.4 * across + 1.2)
        for axes, task in zip(panels(drawn, len(tasks), across, sharey=True), tasks, strict=True):
            for s in (s for s in found if s.task == task):
                y = order.index(s.law)
                axes.plot([s.rank.low, s.rank.high], [y, y], color=LINE_COLORS[0], lw=1.2)
                axes.plot(s.rank.mean, y, "o", color=LINE_COLORS[0], ms=4)
            axes.set_title(task)
            axes.set_xlabel("rank")
            axes.set_xlim(0.5, len(order) + 0.5)
            axes.set_xticks(range(1, len(order) + 1, 3))
            axes.set_yticks(range(len(order)), order)
            axes.set_ylim(len(order) - 0.5, -0.5)
        return publish(drawn, "ranks", "Ranks of the laws in each task", place)


def _drawn_profile(runs: pl.DataFrame, order: Sequence[str], place: Path) -> str:
    curves = profile(runs)
    with style():
        drawn = new_figure(3.2, 7.0)
        (axes,) = panels(drawn, 1, 1)
        for i, law in reversed(list(enumerate(order))):
            ratios = curves[law]
            share = np.arange(1, len(ratios) + 1) / len(ratios)
            look: dict[str, Any] = (
                {"color": line_color(i), "label": law}
                if i < COLOURED
                else {"color": RULE, "lw": 0.8}
            )
            axes.step([1.0, *np.clip(ratios, 1, 2 * FARTHEST)], [0.0, *share], where="post", **look)
        axes.set_xscale("log")
        axes.set_xlim(1, FARTHEST)
        axes.set_ylim(0, 1)
        axes.set_xticks([1, 2, 5, 10], ["1", "2", "5", "10"])
        axes.minorticks_off()
        axes.set_xlabel("times the best law's number")
        axes.set_ylabel("share of the starts")
        handles, names = axes.get_legend_handles_labels()
        axes.legend(
            handles[::-1],
            names[::-1],
            loc="center left",
            bbox_to_anchor=(1.0, 0.5),
            title="the others are grey" * (len(order) > COLOURED),
        )
        return publish(drawn, "profile", "Performance profile of the laws over all starts", place)


def latex(found: Sequence[Score], tasks: Mapping[str, TaskOfSuite]) -> str:
    """The table of a paper: laws by tasks, their mean rank, successes and the mean of each task's
    number.
    """
    by = {(s.law, s.task): s for s in found}
    lines = [[_ends(s.rank), s, [by.get((s.law, task)) for task in tasks]] for s in overall(found)]
    return text_of("scores.tex", tasks=tasks, lines=lines) + "\n"
