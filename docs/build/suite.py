"""The suite's kept runs, and what the pages make of them.

    vstestbed suite --out flown
    python -m docs.build.suite flown/runs.csv      # keeps them as scenarios/suite/VS-1.csv, and makes docs/research/VS-1/ again

Several files are one after the other: of laws that were flown apart.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
from pathlib import Path

import numpy as np
import polars as pl

from vstestbed.core.files import make_folder, write_whole
from vstestbed.core.geometry import Array
from vstestbed.report.comparison.statistics import IntervalEstimate, paired_difference
from vstestbed.report.scores import RESAMPLES, Score, overall, scores
from vstestbed.studies.suite import fingerprint, kept_runs, opened, read_suite

PLACE = Path(__file__).resolve().parents[1] / "research" / "VS-1"


class Suite:
    """The kept runs with their scores."""

    def __init__(self):
        """Read them. ValueError: they are of other tasks than those of now."""
        found = kept_runs(*read_suite())
        if found is None:
            raise ValueError("the kept runs are of other tasks: vstestbed suite, then python -m docs.build.suite runs.csv")
        self.runs, self.scores = found, scores(found)
        beside = pl.read_csv(PLACE / "cns.csv", schema_overrides={"start": pl.String})  # CNS's network, by its own weights
        self.all = pl.concat([found, beside.cast({"value": pl.Float64})])
        self.tasks = list(dict.fromkeys(s.task for s in self.scores))
        self.laws = [s.law for s in overall(self.scores)]
        self.overall = overall(self.scores)
        self.sha256 = fingerprint(*read_suite())

    def of(self, law: str, task: str) -> Score | None:
        """The score of a law in a task; None where it took no part."""
        return next((s for s in self.scores if (s.law, s.task) == (law, task)), None)

    def best(self, task: str, but: str = "") -> Score:
        """The score of the law with the best mean in a task, without one of them."""
        return min((s for s in self.scores if s.task == task and s.law != but), key=lambda s: s.value.mean)

    def place(self, law: str, task: str) -> int:
        """The place of a law in a task by its mean, from 1."""
        of_task = sorted((s for s in self.scores if s.task == task), key=lambda s: s.value.mean)
        return [s.law for s in of_task].index(law) + 1

    def difference(self, task: str, one: str, other: str, start: str = "") -> IntervalEstimate:
        """Mean of one law's number less the other's on the starts whose words have `start` in them, with interval and p-value."""
        part = self.all.filter((pl.col("task") == task) & pl.col("start").str.contains(start, literal=True))
        wide = part.pivot("law", index="start", values="value")
        return paired_difference(wide[one].to_numpy(), wide[other].to_numpy())

    def success(self, task: str, law: str, start: str = "") -> tuple[int, int]:
        """Successes and runs of a law on those starts."""
        part = self.all.filter((pl.col("task") == task) & (pl.col("law") == law) & pl.col("start").str.contains(start, literal=True))
        return int(part["success"].sum()), len(part)

    def mean(self, task: str, law: str) -> float:
        """Mean of a law's number in a task."""
        return float(self.all.filter((pl.col("task") == task) & (pl.col("law") == law))["value"].mean())  # type: ignore[arg-type]  # numbers

    def agreement(self, one: str, other: str) -> IntervalEstimate:
        """Spearman's rank correlation of two tasks' means over the laws that flew both, with the interval of resampled starts."""
        laws = [law for law in self.laws if self.of(law, one) and self.of(law, other)]
        a, b = self._means(one, laws), self._means(other, laws)
        low, high = np.percentile(_spearman(a[1], b[1]), [2.5, 97.5])
        return IntervalEstimate(float(_spearman(a[0], b[0])), float(low), float(high), len(laws))

    def _means(self, task: str, laws: list[str]) -> tuple[Array, Array]:
        wide = self.runs.filter(pl.col("task") == task).pivot("law", index="start", values="value").select(laws).to_numpy()
        picked = np.random.default_rng([len(task), len(wide)]).integers(0, len(wide), (RESAMPLES, len(wide)))
        return np.nanmean(wide, axis=0), np.nanmean(wide[picked], axis=1)


def _spearman(a: Array, b: Array) -> Array:
    """Rank correlations along the last axis."""
    from scipy.stats import rankdata

    x, y = (rankdata(values, axis=-1) for values in (a, b))
    x, y = (ranks - ranks.mean(axis=-1, keepdims=True) for ranks in (x, y))
    return (x * y).sum(axis=-1) / np.sqrt((x * x).sum(axis=-1) * (y * y).sum(axis=-1))


def keep(files: list[Path]) -> None:
    """Keep runs beside the suite's file."""
    suite, path = read_suite()
    runs = pl.concat([pl.read_csv(file, schema_overrides={"start": pl.String, "value": pl.Float64}) for file in files])
    order = {name: i for i, name in enumerate([*suite.tasks, *suite.laws])}
    by = [pl.col(name).replace_strict(order, return_dtype=pl.Int64) for name in ("task", "law")]
    runs = runs.sort(*by, maintain_order=True).with_columns(pl.col("value").round_sig_figs(6))
    write_whole(path.with_suffix(".csv"), f"# {fingerprint(suite, path)}\n{runs.write_csv()}")


def draw() -> None:
    """Make page, tables and figures of the kept runs."""
    with tempfile.TemporaryDirectory() as made:
        entry = opened(None)
        entry.plans  # noqa: B018 - says which laws take no part
        entry.write(Path(made), Suite().runs)
        for name in ("report.html", "scores.csv", "scores.tex", "figures/ranks.png", "figures/profile.png"):
            shutil.copyfile(Path(made) / name, make_folder(PLACE) / Path(name).name)


if __name__ == "__main__":
    if len(sys.argv) > 1:
        keep([Path(name) for name in sys.argv[1:]])
    draw()
