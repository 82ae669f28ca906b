"""The statistics of a comparison for other programs: a table of controllers, one of pairs, and the
verdicts in words.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import polars as pl

from vstestbed.core.files import write_json, write_table
from vstestbed.report.comparison import statistics as stats
from vstestbed.report.comparison.pairs import SUCCESS, Pair
from vstestbed.report.comparison.results import ComparisonResults, Means
from vstestbed.report.comparison.sentences import Findings
from vstestbed.tasks.metrics import Metric

CONTROLLERS = "controllers"
# File names without suffix; each table, with one row per metric, is written as Parquet and as CSV
PAIRS = "pairs"
VERDICTS = "verdicts.json"  # the verdicts in words
_OF_CONTROLLER = (
    *(
        "controller",
        "metric",
        "title",
        "unit",
        "better",
        "runs",
        "succeeded",
        "success",
        "success_low",
        "success_high",
    ),
    *("median", "q1", "q3", "median_runs", "iqm", "iqm_low", "iqm_high", "iqm_runs"),
)
_WORDS_OF_PAIR = (
    *("controller", "against", "verdict", "better_one", "by", "sooner_one"),
    *("role", "metric", "title", "unit", "better"),
)
_COUNTS_OF_PAIR = ("only_a", "only_b", "both", "neither", "wins_a", "wins_b", "needs")
_OF_PAIR = (
    *_WORDS_OF_PAIR,
    *(
        "difference",
        "low",
        "high",
        "seen_low",
        "seen_high",
        "pairs",
        "margin",
        "limit",
        "p_success",
        "p_time",
        "p_sooner",
    ),
    *(*_COUNTS_OF_PAIR, "sentence"),
    *(
        "p",
        "p_holm",
        "significant",
        "improvement",
        "improvement_low",
        "improvement_high",
        "improvement_pairs",
    ),
    *("improvement_p", "improvement_p_holm", "improvement_significant"),
)
_COUNTS = (
    *_COUNTS_OF_PAIR,
    "runs",
    "succeeded",
    "median_runs",
    "iqm_runs",
    "pairs",
    "improvement_pairs",
)
_WORDS = (*_WORDS_OF_PAIR, "sentence")


def write_records(
    folder: Path,
    comparison: ComparisonResults,
    means: Means,
    all_pairs: Sequence[Pair],
    found: Findings,
) -> None:
    """Write `controllers` and `pairs`, each as `.parquet` and `.csv`, and `verdicts.json` into a
    comparison's folder.

    means: `interquartiles`. found: the sentences on all pairs.
    """
    every = pair_records(comparison, all_pairs, found.sentences)
    for name, table in ((CONTROLLERS, controller_records(comparison, means)), (PAIRS, every)):
        write_table(folder / name, table)
    write_json(folder / VERDICTS, verdicts(comparison, all_pairs, found))


def verdicts(
    comparison: ComparisonResults, all_pairs: Sequence[Pair], found: Findings
) -> dict[str, Any]:
    """The overall sentence, cautions, and of each pair the verdict with its numbers and its
    sentence; null where one is unknown.
    """
    rows = [
        _of_pair(comparison, pair, words)
        for pair, words in zip(all_pairs, found.sentences, strict=True)
    ]
    plain = [{name: _or_null(value) for name, value in row.items()} for row in rows]
    return {"overall": found.overall, "cautions": list(found.cautions), "pairs": plain}


def _or_null(value: Any) -> Any:
    """JSON has neither NaN nor infinity."""
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _of_pair(comparison: ComparisonResults, pair: Pair, sentence: str) -> dict[str, Any]:
    """What a pair has once: the verdict, what it rests on, and its words. The counts of a are those
    of `against`.
    """
    labels = comparison.labels
    test, verdict = pair.test, pair.verdict
    by = [
        name
        for name, called in (("success", verdict.by_success), (pair.primary.name, verdict.by_cost))
        if called
    ]
    low, high = pair.deciding
    seen = pair.differences[pair.primary.name]
    return {
        "controller": labels[pair.b],
        "against": labels[pair.a],
        "verdict": verdict.decision,
        "better_one": None if pair.better is None else labels[pair.better],
        "by": " and ".join(by) or None,
        "sooner_one": None if pair.sooner is None else labels[pair.sooner],
        "margin": test.margin,
        "limit": pair.worst,
        "p_success": verdict.p_success,
        "p_time": verdict.p_cost,
        "p_sooner": verdict.p_sooner,
        "only_a": test.only_a,
        "only_b": test.only_b,
        "both": test.both,
        "neither": test.neither,
        "wins_a": test.wins_a,
        "wins_b": test.wins_b,
        "difference": seen.mean,
        "low": low,
        "high": high,
        "seen_low": seen.low,
        "seen_high": seen.high,
        "needs": verdict.needs,
        "sentence": sentence,
    }


def controller_records(comparison: ComparisonResults, means: Means) -> pl.DataFrame:
    """A row for each controller and metric in display units; an infinite `iqm` or end: a quarter of
    the runs failed, or could have.
    """
    rows = []
    for controller, found in zip(comparison.controllers, means, strict=True):
        rate = controller.rate
        for metric in comparison.shown:
            q1, median, q3, n = controller.quartiles(metric)
            rows.append(
                {
                    "controller": controller.label,
                    **_named(metric),
                    "runs": rate.n,
                    "succeeded": int(controller.success.sum()),
                }
                | {"success": rate.mean, "success_low": rate.low, "success_high": rate.high}
                | {"median": median, "q1": q1, "q3": q3, "median_runs": n}
                | _estimate(found[metric.name], "iqm", "iqm_low", "iqm_high", "iqm_runs")
            )
    return _records(rows, _OF_CONTROLLER)


def pair_records(
    comparison: ComparisonResults, all_pairs: Sequence[Pair], sentences: Sequence[str]
) -> pl.DataFrame:
    """A row for each pair and metric: the difference `controller` minus `against` with its interval
    and p-values.

    role: `primary` of success and of the primary metric, which make the verdict; `exploratory` of
    the others. Of the primary metric `low` and `high` are with failures not yet seen, `seen_low`
    and `seen_high` as flown. `improvement`: probability that `controller` is better.
    """
    rows = [
        _of_pair(comparison, pair, sentence) | _of_metric(pair, metric)
        for pair, sentence in zip(all_pairs, sentences, strict=True)
        for metric in (SUCCESS, *map(Metric.named, pair.differences))
    ]
    return _records(rows, _OF_PAIR)


def _of_metric(pair: Pair, metric: Metric) -> dict[str, Any]:
    """What a pair has of a metric: its difference, with that of the primary one also the interval
    that decides; tests; improvement.
    """
    name = metric.name
    difference, improvement = (
        pair.differences.get(name, stats.NOTHING),
        pair.improvements.get(name, stats.NOTHING),
    )
    if metric == SUCCESS:
        difference, improvement = _of_success(pair)
    decides = {SUCCESS.name: pair.verdict.p_success, pair.primary.name: pair.verdict.p_cost}
    low, high = pair.deciding if metric == pair.primary else (difference.low, difference.high)
    return {
        **_named(metric),
        "role": "primary" if name in decides else "exploratory",
        "difference": difference.mean,
        "low": low,
        "high": high,
        "seen_low": difference.low,
        "seen_high": difference.high,
        "pairs": difference.n,
        "p": difference.p,
        "p_holm": decides[name] if name in decides else pair.adjusted[name, "difference"],
        "significant": pair.is_real(name),
        **_estimate(
            improvement, "improvement", "improvement_low", "improvement_high", "improvement_pairs"
        ),
        "improvement_p": improvement.p,
        "improvement_p_holm": pair.adjusted.get((name, "improvement")),
        "improvement_significant": name in pair.improvements and pair.is_real(name, "improvement"),
    }


def _of_success(pair: Pair) -> tuple[stats.IntervalEstimate, stats.IntervalEstimate]:
    """The difference in the share of the starts from which both reached the goal, and the
    probability that b does better, ties one half.
    """
    test, n = pair.test, pair.seeds
    if not n:
        return stats.NOTHING, stats.NOTHING
    difference = stats.IntervalEstimate(
        (test.only_b - test.only_a) / n, n=n, p=stats.sign_test(test.only_a, test.only_b)
    )
    return difference, stats.share_of((test.only_b + (test.both + test.neither) / 2) / n, n)


def _named(metric: Metric) -> dict[str, Any]:
    return {
        "metric": metric.name,
        "title": metric.title,
        "unit": metric.unit,
        "better": "higher" if metric.better > 0 else "lower",
    }


def _estimate(found: stats.IntervalEstimate, *names: str) -> dict[str, Any]:
    return dict(zip(names, (found.mean, found.low, found.high, found.n), strict=True))


def _records(rows: list[dict[str, Any]], names: Sequence[str]) -> pl.DataFrame:
    """Rows as a table of these columns: words, counts, truths, and numbers,
    of which NaN is null.
    """

    def kind(name: str) -> Any:
        return (
            pl.String
            if name in _WORDS
            else pl.Int64
            if name in _COUNTS
            else pl.Boolean
            if "significant" in name
            else pl.Float64
        )

    return pl.DataFrame(rows, schema={name: kind(name) for name in names}).with_columns(
        pl.col(pl.Float64).fill_nan(None)
    )
