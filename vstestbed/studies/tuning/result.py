"""The result of a search: the best setting, how sure it is, and the files of its folder."""

from __future__ import annotations

import io
import math
import shlex
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import polars as pl

from vstestbed.core.files import write_whole
from vstestbed.report.comparison.statistics import paired_difference
from vstestbed.report.studies.tuning import ParameterAxis, TrialRow, TuningPage, write_page
from vstestbed.scenario.dump import dump, flow_text
from vstestbed.scenario.load import load
from vstestbed.scenario.scenario import Scenario
from vstestbed.studies.tuning.search import Tuning
from vstestbed.studies.tuning.space import Choice, Parameter, Range, SearchSpace, Trial, best_of

BEST, TABLE = "best.yaml", "trials"


@dataclass(frozen=True)
class TuningResult:
    """What a search has found.

    Attributes:
        folder: of the search. plan: of the search. space: what was varied. trials: all of them, in their order.
        check: the best trial, and the scenario as it is, each on starts that no trial has seen; None where nothing is random.
    """

    folder: Path
    plan: Tuning
    space: SearchSpace
    trials: tuple[Trial, ...]
    check: tuple[Trial, Trial] | None

    @property
    def best(self) -> Trial | None:
        """The best trial: with the fewest failed runs, and among those with the best mean; None where no run reached the goal."""
        return best_of(self.trials, self.plan.higher)

    @property
    def settings(self) -> dict[str, object]:
        """The best values by dotted path, as `load` takes them; empty without a best trial."""
        return dict(self.best.values) if self.best else {}

    @property
    def scenario(self) -> Scenario:
        """The scenario with the best values."""
        return load(self.plan.scenario, self.plan.set | self.settings, plugins=self.plan.plugins)

    @property
    def command(self) -> str:
        """The command that runs the scenario with the best values."""
        plan, given = self.plan, self.plan.set | self.settings
        words = ["vstestbed", "run", plan.scenario, *(f"--plugin={name}" for name in plan.plugins)]
        return shlex.join([*words, *(w for path, value in given.items() for w in ("--set", f"{path}={flow_text(value)}"))])

    @property
    def table(self) -> pl.DataFrame:
        """A row for each trial: its number, the varied values, how many runs reached the goal, the mean of the metric, how others ended."""
        return pl.DataFrame(self.rows(), infer_schema_length=None, strict=False)

    def rows(self) -> list[dict[str, Any]]:
        """As `table`, in plain values."""
        shown = [{p.path: _shown(p, t.values[p.path]) for p in self.space.parameters} for t in self.trials]
        return [{"trial": t.number, **one, **self._row(t), "best": t is self.best} for t, one in zip(self.trials, shown, strict=True)]

    def _row(self, trial: Trial) -> dict[str, Any]:
        mean = trial.mean / self.plan.shown.scale if math.isfinite(trial.mean) else None
        reached = {"runs": len(trial.reached), "reached": sum(trial.reached)}
        return reached | {f"mean_{self.plan.metric}": mean, "outcomes": _ended(trial)}

    def plain(self) -> dict[str, Any]:
        """The result as plain values for JSON."""
        best = self.best
        found = {"scenario": self.plan.scenario, "metric": self.plan.metric, "best": None if best is None else best.number}
        names = ("best", "as_it_is")
        check = None if self.check is None else {name: self._row(one) for name, one in zip(names, self.check, strict=True)}
        words = {"settings": self.settings, "command": self.command, "sentences": self.sentences()}
        return found | words | {"check": check, "trials": self.rows()}

    @property
    def headline(self) -> str:
        """The best values in a line."""
        if self.best is None:
            return "No run of any trial reached the goal"
        return ", ".join(f"{path}={flow_text(value)}" for path, value in self.settings.items())

    def sentences(self) -> list[str]:
        """How good the best trial is, how that holds on other starts, and what speaks against it."""
        best = self.best
        if best is None:
            ended = Counter(outcome for trial in self.trials for outcome in trial.outcomes)
            return [f"The runs ended with: {', '.join(f'{name} ({n})' for name, n in ended.most_common())}."]
        own = f"Trial {best.number} of {len(self.trials)}: {self._numbers(best)}."
        return [own, *self._on_fresh_starts(), *(f"Caution: {words}" for words in self.cautions())]

    def _numbers(self, trial: Trial) -> str:
        metric = self.plan.shown
        mean = f"{metric.title.lower()} {trial.mean:.4g} {metric.unit}".rstrip() if math.isfinite(trial.mean) else "no number"
        return f"{mean}, {sum(trial.reached)} of {len(trial.reached)} runs reached the goal"

    def _on_fresh_starts(self) -> list[str]:
        if self.check is None:
            return []
        best, now = self.check
        words = f"On {len(best.reached)} starts that no trial has seen: {self._numbers(best)}"
        if self.best and self.best.values == self.space.now:
            return [f"{words}. The scenario as it is was the best."]
        return [f"{words}; the scenario as it is: {self._numbers(now)}{self._change(best, now)}."]

    def _change(self, best: Trial, now: Trial) -> str:
        """The paired difference of two trials over the starts on which both reached the goal."""
        both = [(x, y) for x, y, a, b in zip(best.found, now.found, best.reached, now.reached, strict=True) if a and b]
        d = paired_difference([x for x, _ in both], [y for _, y in both])
        interval = f" [{d.low:+.3g}, {d.high:+.3g}]" if math.isfinite(d.low) else ""
        return f" (difference {d.mean:+.3g}{interval} {self.plan.shown.unit})".replace(" )", ")") if math.isfinite(d.mean) else ""

    def cautions(self) -> list[str]:
        """What speaks against the best trial."""
        best, found = self.best, list[str]()
        if best is None:
            return found
        if best.failed:
            found.append(f"{best.failed} of its {len(best.reached)} runs failed ({_ended(best)}), and no trial had fewer.")
        if self.check is not None and self.check[0].failed:
            failed = f"{self.check[0].failed} of {len(self.check[0].reached)} runs failed ({_ended(self.check[0])})"
            found.append(f"on fresh starts {failed}; a search with more --seeds finds settings that hold.")
        for p in self.space.at_an_end(best.values):
            found.append(f"{p.path}={flow_text(best.values[p.path])} is at an end of {p}; a wider range may hold a better value.")
        if (self.plan.seeds or 1) == 1:
            found.append(
                "one start decides; from other starts these values may fail. Give the scenario random starts, and --seeds 5 or more."
            )
        return found

    def write(self) -> Path:
        """Write the table of trials, `best.yaml`, the page and its figures; returns the page's path.

        Raises:
            OutputError, EnvironmentLackError: a file cannot be written.
        """
        parquet = io.BytesIO()
        self.table.write_parquet(parquet)
        write_whole(self.folder / f"{TABLE}.parquet", parquet.getvalue())
        write_whole(self.folder / f"{TABLE}.csv", self.table.write_csv())
        if self.best is not None:
            dump(self.scenario, self.folder / BEST)
        return write_page(self.folder, self._page())

    def _page(self) -> TuningPage:
        plan, best = self.plan, self.best
        return TuningPage(
            Path(plan.scenario).stem,
            self.headline,
            self.sentences(),
            self.command if best else "",
            plan.shown,
            plan.higher,
            not self.cautions(),
            [_axis(p) for p in self.space.parameters],
            [_row(t, self.space.parameters) for t in self.trials],
            None if best is None else best.number,
            plan.command,
        )


def _axis(p: Parameter) -> ParameterAxis:
    return ParameterAxis(p.path, (p.low, p.high), log=p.log) if isinstance(p, Range) else ParameterAxis(p.path, words=tuple(p.words))


def _row(trial: Trial, parameters: Sequence[Parameter]) -> TrialRow:
    values = tuple(_shown(p, trial.values[p.path]) for p in parameters)
    return TrialRow(int(trial.number or 0), values, sum(trial.reached), len(trial.reached), trial.mean, _ended(trial))


def _shown(p: Parameter, value: object) -> float | str:
    """A value as the table has it: a number of a range, a word of a choice."""
    return flow_text(value) if isinstance(p, Choice) else float(str(value))


def _ended(trial: Trial) -> str:
    """How the failed runs ended: `target_lost (2), timed_out`."""
    ended = Counter(outcome for outcome, good in zip(trial.outcomes, trial.reached, strict=True) if not good)
    return trial.refused or ", ".join(f"{name} ({n})" if n > 1 else name for name, n in ended.most_common())
