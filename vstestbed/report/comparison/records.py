"""The statistics of a comparison for other programs: a table of controllers, one of pairs, and the verdicts in words."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import polars as pl

from vstestbed.core.files import write_json, write_table
from vstestbed.report.comparison import statistics as stats
from vstestbed.report.comparison.pairs import SUCCESS, Pair
from vstestbed.report.comparison.results import ComparisonResults, Means
from vstestbed.report.comparison.sentences import Findings
from vstestbed.tasks.metrics import Metric

CONTROLLERS: Final = "controllers"
PAIRS: Final = "pairs"  # File names without suffix; each table, with one row per metric, is written as Parquet and as CSV
VERDICTS: Final = "verdicts.json"  # the verdicts in words
_OF_CONTROLLER: Final = (
    *("controller", "metric", "title", "unit", "better", "runs", "succeeded", "success", "success_low", "success_high"),
    *("median", "q1", "q3", "median_runs", "iqm", "iqm_low", "iqm_high", "iqm_runs"),
)
_OF_PAIR: Final = (
    *("controller", "against", "verdict", "better_one", "by", "sooner_one", "role", "metric", "title", "unit", "better"),
    *("difference", "low", "high", "seen_low", "seen_high", "pairs", "margin", "limit", "p_success", "p_time", "p_sooner"),
    *("only_a", "only_b", "both", "neither", "wins_a", "wins_b", "needs", "sentence"),
    *("p", "p_holm", "significant", "improvement", "improvement_low", "improvement_high", "improvement_pairs"),
    *("improvement_p", "improvement_p_holm", "improvement_significant"),
)
_COUNTS: Final = (
    *("runs", "succeeded", "median_runs", "iqm_runs", "pairs", "improvement_pairs"),
    *("only_a", "only_b", "both", "neither", "wins_a", "wins_b", "needs"),
)
_WORDS: Final = (
    "controller",
    "against",
    "verdict",
    "better_one",
    "by",
    "sooner_one",
    "role",
    "metric",
    "title",
    "unit",
    "better",
    "sentence",
)


def write_records(folder: Path, comparison: ComparisonResults, means: Means, all_pairs: Sequence[Pair], found: Findings) -> None:
    """Write `controllers` and `pairs`, each as `.parquet` and `.csv`, and `verdicts.json` into a comparison's folder.

    means: `interquartiles`. found: the sentences on all pairs.
    """
    every = pair_records(comparison, all_pairs, found.sentences)
    for name, table in ((CONTROLLERS, controller_records(comparison, means)), (PAIRS, every)):
        write_table(folder / name, table)
    write_json(folder / VERDICTS, verdicts(comparison, all_pairs, found))


def verdicts(comparison: ComparisonResults, all_pairs: Sequence[Pair], found: Findings) -> dict[str, Any]:
    """The overall sentence, cautions, and of each pair the verdict with its numbers and its sentence; null where one is unknown."""
    rows = [_of_pair(comparison, pair, words) for pair, words in zip(all_pairs, found.sentences, strict=True)]
    plain = [{name: _or_null(value) for name, value in row.items()} for row in rows]
    return {"overall": found.overall, "cautions": list(found.cautions), "pairs": plain}


def _or_null(value: Any) -> Any:
    """JSON has neither NaN nor infinity."""
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _of_pair(comparison: ComparisonResults, pair: Pair, sentence: str) -> dict[str, Any]:
    """What a pair has once: the verdict, what it rests on, and its words. The counts of a are those of `against`."""
    labels = [c.label for c in comparison.controllers]
    test, verdict = pair.test, pair.verdict
    by = [name for name, called in (("success", verdict.by_success), (pair.primary.name, verdict.by_cost)) if called]
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
        "limit": float(test.worst),
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
    """A row for each controller and metric in display units; an infinite `iqm` or end: a quarter of the runs failed, or could have."""
    rows: list[dict[str, Any]] = []
    for controller, found in zip(comparison.controllers, means, strict=True):
        rate = controller.rate
        for metric in comparison.shown:
            q1, median, q3, n = controller.quartiles(metric)
            rows.append(
                {"controller": controller.label, **_named(metric), "runs": rate.n, "succeeded": int(controller.success.sum())}
                | {"success": rate.mean, "success_low": rate.low, "success_high": rate.high}
                | {"median": median, "q1": q1, "q3": q3, "median_runs": n}
                | _estimate(found[metric.name], "iqm", "iqm_low", "iqm_high", "iqm_runs")
            )
    return _records(rows, _OF_CONTROLLER)


def pair_records(comparison: ComparisonResults, all_pairs: Sequence[Pair], sentences: Sequence[str]) -> pl.DataFrame:
    """A row for each pair and metric: the difference `controller` minus `against` with its interval and p-values.

    role: `primary` of success and of the primary metric, which make the verdict; `exploratory` of the others. Of the primary metric `low`
    and `high` are with failures not yet seen, `seen_low` and `seen_high` as flown. `improvement`: probability that `controller` is better.
    """
    rows: list[dict[str, Any]] = []
    for pair, sentence in zip(all_pairs, sentences, strict=True):
        of_pair, n = _of_pair(comparison, pair, sentence), pair.seeds
        test = pair.test
        more = stats.IntervalEstimate((test.only_b - test.only_a) / n, n=n) if n else stats.NOTHING
        share = stats.share_of((test.only_b + (test.both + test.neither) / 2) / n, n) if n else stats.NOTHING
        found = {SUCCESS: (more, share)}
        found |= {m: (pair.differences[m.name], pair.improvements.get(m.name, stats.NOTHING)) for m in _ordered(pair)}
        for metric, (d, i) in found.items():
            own: dict[str, Any] = {"role": "exploratory", "difference": d.mean, "low": d.low, "high": d.high, "p": d.p}
            own |= {"seen_low": d.low, "seen_high": d.high}
            if metric == SUCCESS:
                p = stats.sign_test(test.only_a, test.only_b)
                own |= {"role": "primary", "p": p, "p_holm": pair.verdict.p_success}
            elif metric == pair.primary:
                own |= {"role": "primary", "p": test.p_either, "p_holm": pair.verdict.p_cost}
                own |= {"low": of_pair["low"], "high": of_pair["high"]}
            else:
                own |= {"p_holm": pair.adjusted[metric.name, "difference"]}
            rows.append(
                of_pair
                | _named(metric)
                | own
                | {"pairs": d.n, "significant": pair.is_real(metric.name)}
                | _estimate(i, "improvement", "improvement_low", "improvement_high", "improvement_pairs")
                | {"improvement_p": i.p, "improvement_p_holm": pair.adjusted.get((metric.name, "improvement"))}
                | {"improvement_significant": metric.name in pair.improvements and pair.is_real(metric.name, "improvement")}
            )
    return _records(rows, _OF_PAIR)


def _ordered(pair: Pair) -> list[Metric]:
    return [Metric.named(name) for name in pair.differences]


def _named(metric: Metric) -> dict[str, Any]:
    return {"metric": metric.name, "title": metric.title, "unit": metric.unit, "better": "higher" if metric.better > 0 else "lower"}


def _estimate(found: stats.IntervalEstimate, *names: str) -> dict[str, Any]:
    return dict(zip(names, (found.mean, found.low, found.high, found.n), strict=True))


def _records(rows: list[dict[str, Any]], names: Sequence[str]) -> pl.DataFrame:
    """Rows as a table of these columns: words, counts, truths, and numbers, of which NaN is null."""

    def kind(name: str) -> Any:
        return pl.String if name in _WORDS else pl.Int64 if name in _COUNTS else pl.Boolean if "significant" in name else pl.Float64

    return pl.DataFrame(rows, schema={name: kind(name) for name in names}).with_columns(pl.col(pl.Float64).fill_nan(None))
