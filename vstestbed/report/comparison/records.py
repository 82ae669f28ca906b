"""The statistics of a comparison as two tables for other programs: of each controller, and of each pair, with one row per metric."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import polars as pl

from vstestbed.core.files import write_whole
from vstestbed.report.comparison.columns import ComparisonResults, Metric
from vstestbed.report.comparison.interquartile import Interquartile
from vstestbed.report.comparison.pairs import SUCCESS, Pair
from vstestbed.report.comparison.statistics import Improvement, spread, success_rate, wilson

CONTROLLERS: Final = "controllers"
PAIRS: Final = "pairs"
"""File names without suffix; each table is written as Parquet and as CSV."""
_NUMBER, _TEXT, _COUNT = pl.Float64(), pl.String(), pl.Int64()
_OF_CONTROLLER: Final[dict[str, Any]] = (
    dict.fromkeys(("controller", "metric", "title", "unit", "better"), _TEXT)
    | dict.fromkeys(("runs", "succeeded"), _COUNT)
    | dict.fromkeys(("success", "success_low", "success_high", "median", "q1", "q3"), _NUMBER)
    | {"median_runs": _COUNT}
    | dict.fromkeys(("iqm", "iqm_low", "iqm_high"), _NUMBER)
    | {"iqm_runs": _COUNT}
)
_OF_PAIR: Final[dict[str, Any]] = (
    dict.fromkeys(("controller", "against", "metric", "title", "unit", "better"), _TEXT)
    | dict.fromkeys(("difference", "low", "high"), _NUMBER)
    | {"pairs": _COUNT, "skewness": _NUMBER, "p": _NUMBER, "p_holm": _NUMBER, "significant": pl.Boolean()}
    | dict.fromkeys(("improvement", "improvement_low", "improvement_high"), _NUMBER)
    | {"improvement_pairs": _COUNT, "improvement_p": _NUMBER, "improvement_p_holm": _NUMBER, "improvement_significant": pl.Boolean()}
)


def write_records(
    folder: Path, comparison: ComparisonResults, means: Sequence[Mapping[str, Interquartile]], all_pairs: Sequence[Pair]
) -> None:
    """Write `controllers` and `pairs`, each as `.parquet` and `.csv`, into a comparison's folder.

    Args:
        folder: the comparison's. comparison: the runs. means: `interquartiles` of them. all_pairs: their pairs.

    Raises:
        OutputError: a file cannot be written.
    """
    for name, table in ((CONTROLLERS, controller_records(comparison, means)), (PAIRS, pair_records(comparison, all_pairs))):
        parquet = io.BytesIO()
        table.write_parquet(parquet)
        write_whole(folder / f"{name}.parquet", parquet.getvalue())
        write_whole(folder / f"{name}.csv", table.write_csv())


def controller_records(comparison: ComparisonResults, means: Sequence[Mapping[str, Interquartile]]) -> pl.DataFrame:
    """A row for each controller and metric: successes with their interval, median and quartiles, interquartile mean; display units.

    An infinite `iqm`, or end of its interval: more than a quarter of the runs failed, or could have.
    """
    rows: list[dict[str, Any]] = []
    for controller, found in zip(comparison.controllers, means, strict=True):
        rate = success_rate(int(controller.success.sum()), len(controller.success))
        for metric in comparison.shown:
            middle, mean = spread(controller.counted(metric)), found[metric.name]
            rows.append(
                {"controller": controller.label, **_named(metric), "runs": rate.n, "succeeded": rate.successes}
                | {"success": rate.rate, "success_low": rate.low, "success_high": rate.high}
                | {"median": middle.median, "q1": middle.q1, "q3": middle.q3, "median_runs": middle.n}
                | {"iqm": mean.mean, "iqm_low": mean.low, "iqm_high": mean.high, "iqm_runs": mean.n}
            )
    return pl.DataFrame(rows, schema=_OF_CONTROLLER).with_columns(pl.col(pl.Float64).fill_nan(None))


def pair_records(comparison: ComparisonResults, all_pairs: Sequence[Pair]) -> pl.DataFrame:
    """A row for each pair and metric, success first: the difference `controller` minus `against` with its interval and p-values.

    `improvement` is the probability that `controller` is better than `against`. The difference of successes is that of the rates over the
    common seeds, and has no interval.
    """
    labels = [c.label for c in comparison.controllers]
    rows: list[dict[str, Any]] = []
    for pair in all_pairs:
        names: dict[str, Any] = {"controller": labels[pair.b], "against": labels[pair.a]}
        rows.append(names | _success_of(pair))
        for metric in comparison.shown:
            d = pair.differences[metric.name]
            rows.append(
                names
                | _named(metric)
                | {"difference": d.mean, "low": d.low, "high": d.high, "pairs": d.n, "skewness": d.skewness}
                | _tested(pair, metric.name)
                | _improved(pair.improvements[metric.name])
                | {"improvement_p_holm": pair.adjusted[metric.name, "improvement"]}
                | {"improvement_significant": pair.is_real(metric.name, "improvement")}
            )
    return pl.DataFrame(rows, schema=_OF_PAIR).with_columns(pl.col(pl.Float64).fill_nan(None))


def _named(metric: Metric) -> dict[str, Any]:
    return {"metric": metric.name, "title": metric.title, "unit": metric.unit, "better": "higher" if metric.higher else "lower"}


def _tested(pair: Pair, name: str) -> dict[str, Any]:
    test = (name, "difference")
    return {"p": pair.tests[test], "p_holm": pair.adjusted[test], "significant": pair.is_real(name)}


def _improved(found: Improvement) -> dict[str, Any]:
    names = ("improvement", "improvement_low", "improvement_high", "improvement_pairs", "improvement_p")
    return dict(zip(names, (found.share, found.low, found.high, found.n, found.p), strict=True))


def _success_of(pair: Pair) -> dict[str, Any]:
    s, n = pair.success, pair.seeds
    named = {"metric": SUCCESS, "title": "Reached the goal", "unit": "", "better": "higher", "pairs": n}
    if not n:
        return named | _tested(pair, SUCCESS) | {"improvement_pairs": 0}
    share = (s.only_b + (s.both + s.neither) / 2) / n
    low, high = wilson(share, n)
    return (
        named
        | {"difference": (s.only_b - s.only_a) / n}
        | _tested(pair, SUCCESS)
        | _improved(Improvement(share, float(low), float(high), n))
    )
