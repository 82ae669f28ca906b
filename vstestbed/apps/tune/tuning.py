"""Search for the settings with which a scenario does best: trials over varied fields, each over the
same random starts.
"""

from __future__ import annotations

import math
import shlex
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Protocol

import polars as pl

from vstestbed.apps.tune.search_space import (
    OPTION,
    Choice,
    Parameter,
    Range,
    SearchSpace,
    Trial,
    best_of,
    checked,
    must_be_installed,
    next_settings,
    parameter,
    read_record,
    write_record,
)
from vstestbed.core.errors import ParameterError, RunFolderError, ScenarioError
from vstestbed.core.files import study_folder, write_table
from vstestbed.core.planar import block_of
from vstestbed.core.quantity import Seed, TighterBounds
from vstestbed.core.spec import spec
from vstestbed.report.comparison.statistics import paired_difference
from vstestbed.report.studies import ParameterAxis, TrialRow, TuningPage, write_tuning
from vstestbed.scenario.dump import dump, flow_text
from vstestbed.scenario.load import load
from vstestbed.scenario.plugins import absolute_files, load_named, load_plugins
from vstestbed.scenario.scenario import Scenario
from vstestbed.scenario.yaml_marks import build, plain_mapping, text_of
from vstestbed.studies.comparison.folder import summary_of
from vstestbed.studies.comparison.plan import (
    CHECKED,
    TUNED,
    Comparison,
    Job,
    Jobs,
    changed,
    chosen,
    controllers,
)
from vstestbed.studies.comparison.runs import Runner
from vstestbed.studies.folder import RESUMABLE, resumed_folder, write_plan
from vstestbed.studies.pools import Pool, clear, must_be_known, must_not_be_worker, pool_of, workers
from vstestbed.tasks.metrics import FIGURES, METRICS, Metric, own_metrics

__all__ = [
    "Listener",
    "Search",
    "Tuning",
    "TuningResult",
    "begun",
    "finished",
    "planned",
    "report_again",
    "tune",
]

PLAN = "tuning.yaml"
# random starts of a trial where none are asked for: a setting that fails on one start in five shows
# it in nine searches of ten
SEEDS = 10
Count = Annotated[Seed, TighterBounds(ge=1, le=1000)]


@spec
class Tuning:
    """A search for the settings with which a scenario does best.

    Args:
        scenario: by path or bundled name.
        plugins: files or modules that add kinds.
        set: values by dotted path, for all trials.
        vary: by dotted path what is varied: a range `0.2:2` or `10:80:log`, or a list of values.
        metric: name of `summary.json` by which trials are compared.
        maximise: whether more of the metric is better; none: as it is known of the metric.
        trials: number of settings that are tried [1].
        seeds: random starts of each trial [1]; none: the nominal start alone.
        batch: trials that are chosen together [1], before any of them has run.
        check: random starts that no trial has seen [1], on which the best trial is run beside the
            scenario as it is.
        seed: of the search.
    """

    scenario: str
    plugins: tuple[str, ...] = ()
    set: dict[str, Any] = field(default_factory=dict)
    vary: dict[str, Any]
    metric: str = "time_to_converge_s"
    maximise: bool | None = None
    trials: Count = 30
    seeds: Count | None = None
    batch: Count = 4
    check: Annotated[Seed, TighterBounds(le=1000)] = 20
    seed: Seed = 0

    def __post_init__(self) -> None:
        """Refuse a search over nothing, and a metric that no run has."""
        if not self.vary:
            raise ParameterError.missing(
                OPTION, "it names what is tuned, such as --vary law.gain=0.2:2"
            )
        if self.metric not in (known := (*FIGURES, *own_metrics())):
            raise ParameterError.choice("--metric", known, self.metric)

    @property
    def shown(self) -> Metric:
        """The metric with its title and unit."""
        return Metric.named(self.metric)

    @property
    def higher(self) -> bool:
        """Whether more of the metric is better."""
        return self.shown.better > 0 if self.maximise is None else self.maximise

    def comparison(self) -> Comparison:
        """The scenario with its settings; `axes` has the ends of the ranges and the choices."""
        axes = {p.path: p.ends for p in self.parameters}
        found = chosen([self.scenario], self.set, axes, self.plugins, seeds=self.seeds)
        if len(found.base) != 1 or found.cases or found.tasks or set(found.axes) != set(axes):
            raise ParameterError(
                "SCENARIO", "must be one scenario, and no comparison", self.scenario
            )
        return found

    @property
    def command(self) -> str:
        """The command that makes the search again."""
        options: list[tuple[str, object]] = [("--plugin", name) for name in self.plugins]
        options += [("--set", f"{path}={flow_text(value)}") for path, value in self.set.items()]
        options += [(OPTION, f"{p.path}={p}") for p in self.parameters]
        options += [
            (f"--{name}", getattr(self, name))
            for name in ("metric", "trials", "batch", "check", "seed")
        ]
        options += [("--seeds", self.seeds)] if self.seeds else []
        words = [word for option in options for word in map(str, option)] + ["--maximise"] * bool(
            self.maximise
        )
        return shlex.join(["vstestbed", "tune", self.scenario, *words])

    @property
    def parameters(self) -> list[Parameter]:
        """What is varied."""
        return [parameter(path, given) for path, given in self.vary.items()]


def prepared(plan: Tuning, seeds: int | None) -> tuple[Comparison, SearchSpace, int | None]:
    """The comparison of a plan, its space, and the number of random starts of each trial: as asked
    for, else SEEDS where any are drawn.
    """
    comparison = plan.comparison()
    space = checked(comparison, plan.parameters)
    bare = changed(comparison, axes={}, seeds=seeds)
    scenario = controllers(bare)[0].scenario
    own: Sequence[Any] = scenario.metrics
    if plan.metric not in FIGURES and not any(plan.metric in metric.titles for metric in own):
        kinds: Mapping[str, Any] = METRICS.members
        kind = next(kind for kind, cls in kinds.items() if plan.metric in cls.titles)
        raise ParameterError(
            "--metric",
            f"is of the metric {kind}, which the scenario does not have; --set metrics=[{kind}]",
            plan.metric,
        )
    return bare, space, seeds if seeds is not None else SEEDS if scenario.draws else None


CASE, AS_IT_IS = "trial", "as_it_is"


class Listener(Protocol):
    """What a search tells while it goes on."""

    def run_done(self, job: Job, summary: dict[str, Any]) -> None:
        """A run is done."""

    def were_done(self, runs: int) -> None:
        """So many runs were done before the search was interrupted."""

    def say(self, words: str) -> None:
        """What is being done."""


class NoListener(Listener):
    """A listener that does nothing."""


@dataclass
class Search:
    """A search in its folder, which this process holds.

    Args:
        folder: of the search. plan: of the search. comparison: the scenario with its settings.
            space: what is varied.
        jobs, executor: as of `compare`. stored_alone: do no run. listener: is told of each run.
    """

    folder: Path
    plan: Tuning
    comparison: Comparison
    space: SearchSpace
    jobs: int | None = None
    executor: str = "local"
    stored_alone: bool = False
    listener: Listener = field(default_factory=NoListener)
    trials: list[Trial] = field(default_factory=list, init=False)

    @property
    def runs(self) -> int:
        """Runs of a trial."""
        return self.plan.seeds or 1

    @property
    def total(self) -> int:
        """Runs of the whole search, if the space has as many settings."""
        return int(min(self.plan.trials, self.space.size)) * self.runs + 2 * self.fresh

    @property
    def fresh(self) -> int:
        """Starts that no trial has seen; none where nothing is drawn."""
        return self.plan.check if self.plan.seeds else 0

    @property
    def best(self) -> Trial | None:
        """The best trial so far."""
        return best_of(self.trials, self.plan.higher)

    def carry_out(self) -> tuple[Trial, Trial] | None:
        """Do all trials, and the check; returns the best one and the scenario as it is on the fresh
        starts, None without any. Raises ParameterError: no run has the metric; the first trials are
        all refused. EnvironmentLackError, OutputError: see `Runner.run`.
        """
        with ExitStack() as stack:
            self._stack = stack
            self._search()
            self.listener.say("checking the best on fresh starts")
            best = self.best
            if best is None or not self.fresh:
                return None
            name, metric = str(best.number), self.plan.shown
            found = self._run({name: best.values, AS_IT_IS: {}}, CHECKED, self.fresh)
            return Trial.of(best.number, best.values, found[name], metric), Trial.of(
                None, {}, found[AS_IT_IS], metric
            )

    @cached_property
    def _pool(self) -> Pool:
        """Started with the first run that is missing."""
        most = max(self.plan.batch * self.runs, 2 * self.fresh)
        return self._stack.enter_context(
            closing(pool_of(self.executor, workers(self.jobs, most), self.folder, self._flown))
        )

    def _flown(self) -> list[Scenario]:
        return [controllers(self.comparison)[0].scenario]

    def _search(self) -> None:
        clear(self.folder)  # of a process that was killed
        recorded = read_record(self.folder, [p.path for p in self.space.parameters])
        while (place := len(self.trials)) < self.plan.trials:
            size = min(self.plan.batch, self.plan.trials - place)
            if len(recorded) <= place:
                recorded += next_settings(
                    self.space, self.trials, self.plan.higher, self.runs, size, self.plan.seed
                )
                write_record(self.folder, recorded)
            batch = recorded[place : place + size]
            if not batch:  # all there is has been tried
                return
            best = self.best
            unit = self.plan.shown.unit
            found = "" if best is None else f", best {best.mean:.3g} {unit}".rstrip()
            self.listener.say(f"trial {place + 1} of {self.plan.trials}{found}")
            self.trials += self._tried(dict(enumerate(batch, place)))
            self._must_have_metric()

    def _must_have_metric(self) -> None:
        """Refuse a metric that no run has which reached the goal."""
        reached: list[float] = []
        for trial in self.trials:
            reached += [x for x, good in zip(trial.found, trial.reached, strict=True) if good]
        if reached and all(map(math.isnan, reached)):
            words = (
                "is no number of the runs that reached the goal;"
                " take another, such as final_error_px or path_length_m"
            )
            raise ParameterError("--metric", words, self.plan.metric)

    def _tried(self, settings: Mapping[int, dict[str, object]]) -> list[Trial]:
        refused = dict[int, str]()
        # the scenario takes each of its values, but maybe not together
        for number, values in settings.items():
            try:
                controllers(self._comparison({str(number): values}, self.plan.seeds))
            except (ScenarioError, ParameterError) as error:
                refused[number] = str(error).splitlines()[0]
        if not self.trials and len(refused) == len(settings):
            raise ParameterError(
                "--vary",
                f"gives settings that the scenario does not take: {next(iter(refused.values()))}",
            )
        good = {str(number): values for number, values in settings.items() if number not in refused}
        found = self._run(good, TUNED, self.runs) if good else {}
        metric = self.plan.shown
        return [
            Trial(number, values, refused=refused[number])
            if number in refused
            else Trial.of(number, values, found[str(number)], metric)
            for number, values in settings.items()
        ]

    def _comparison(
        self, settings: Mapping[str, dict[str, object]], seeds: int | None
    ) -> Comparison:
        # an outer block first, which would overwrite what is in it
        cases = {
            name: dict(sorted(values.items(), key=lambda item: item[0].count(".")))
            for name, values in settings.items()
        }
        return changed(self.comparison, axes={}, cases={CASE: cases}, seeds=seeds)

    def _run(
        self, settings: Mapping[str, dict[str, object]], first: int, seeds: int
    ) -> dict[str, list[dict[str, Any]]]:
        """The summaries of runs from so many seeds, by name of the setting; those that are missing
        are done. first: TUNED or CHECKED.
        """
        comparison = self._comparison(settings, seeds if self.plan.seeds else None)
        wanted = list(Jobs(controllers(comparison), comparison.seeds, first))
        runner = Runner(self.folder, wanted)
        self.listener.were_done(runner.done)
        if self.stored_alone and runner.done < len(wanted):
            works = f"`vstestbed tune --resume --out {self.folder}` does what is missing"
            raise RunFolderError(self.folder, "holds a search that is not finished", works)
        if runner.done < len(wanted):
            runner.run(self._pool, self.listener.run_done)
        found: dict[str, list[dict[str, Any]]] = {name: [] for name in settings}
        for job in wanted:
            found[str(job.controller.values[CASE])].append(summary_of(self.folder, job))
        return found


@dataclass(frozen=True)
class TuningResult:
    """What a search has found.

    Attributes:
        folder: of the search. plan: of the search. space: what was varied. trials: all of them, in
            their order.
        check: the best trial, and the scenario as it is, each on starts that no trial has seen;
            None where nothing is random.
    """

    folder: Path
    plan: Tuning
    space: SearchSpace
    trials: tuple[Trial, ...]
    check: tuple[Trial, Trial] | None

    @property
    def best(self) -> Trial | None:
        """The best trial: with the fewest failed runs, and among those with the best mean; None
        where no run reached the goal.
        """
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
        return shlex.join(
            [
                *words,
                *(
                    w
                    for path, value in given.items()
                    for w in ("--set", f"{path}={flow_text(value)}")
                ),
            ]
        )

    @property
    def table(self) -> pl.DataFrame:
        """A row for each trial: its number, the varied values, how many runs reached the goal, the
        mean of the metric, how others ended.
        """
        return pl.DataFrame(self.rows(), infer_schema_length=None, strict=False)

    def rows(self) -> list[dict[str, Any]]:
        """As `table`, in plain values."""
        shown = [
            {p.path: _shown(p, t.values[p.path]) for p in self.space.parameters}
            for t in self.trials
        ]
        return [
            {"trial": t.number, **one, **self._row(t), "best": t is self.best}
            for t, one in zip(self.trials, shown, strict=True)
        ]

    def _row(self, trial: Trial) -> dict[str, Any]:
        mean = trial.mean / self.plan.shown.scale if math.isfinite(trial.mean) else None
        reached = {"runs": len(trial.reached), "reached": sum(trial.reached)}
        return reached | {f"mean_{self.plan.metric}": mean, "outcomes": _ended(trial)}

    def plain(self) -> dict[str, Any]:
        """The result as plain values for JSON."""
        best = self.best
        found = {
            "scenario": self.plan.scenario,
            "metric": self.plan.metric,
            "best": None if best is None else best.number,
        }
        names = ("best", "as_it_is")
        check = (
            None
            if self.check is None
            else {name: self._row(one) for name, one in zip(names, self.check, strict=True)}
        )
        words = {"settings": self.settings, "command": self.command, "sentences": self.sentences()}
        return found | words | {"check": check, "trials": self.rows()}

    @property
    def headline(self) -> str:
        """The best values in a line."""
        if self.best is None:
            return "No run of any trial reached the goal"
        return ", ".join(f"{path}={flow_text(value)}" for path, value in self.settings.items())

    def sentences(self) -> list[str]:
        """How good the best trial is, how that holds on other starts,
        and what speaks against it.
        """
        best = self.best
        if best is None:
            ended = Counter(outcome for trial in self.trials for outcome in trial.outcomes)
            return [
                "The runs ended with:"
                f" {', '.join(f'{name} ({n})' for name, n in ended.most_common())}."
            ]
        own = f"Trial {best.number} of {len(self.trials)}: {self._numbers(best)}."
        fresh = list[str]()
        if self.check is not None:
            tried, now = self.check
            words = f"On {len(tried.reached)} starts that no trial has seen: {self._numbers(tried)}"
            as_it_is = (
                f"{words}; the scenario as it is: {self._numbers(now)}{self._change(tried, now)}."
            )
            fresh = [
                f"{words}. The scenario as it is was the best."
                if best.values == self.space.now
                else as_it_is
            ]
        return [own, *fresh, *(f"Caution: {words}" for words in self.cautions())]

    def _numbers(self, trial: Trial) -> str:
        metric = self.plan.shown
        mean = (
            f"{metric.title.lower()} {trial.mean:.4g} {metric.unit}".rstrip()
            if math.isfinite(trial.mean)
            else "no number"
        )
        return f"{mean}, {sum(trial.reached)} of {len(trial.reached)} runs reached the goal"

    def _change(self, best: Trial, now: Trial) -> str:
        """The paired difference of two trials over the starts on which both reached the goal."""
        both = [
            (x, y)
            for x, y, a, b in zip(best.found, now.found, best.reached, now.reached, strict=True)
            if a and b
        ]
        d = paired_difference([x for x, _ in both], [y for _, y in both])
        interval = f" [{d.low:+.3g}, {d.high:+.3g}]" if math.isfinite(d.low) else ""
        return (
            f" (difference {d.mean:+.3g}{interval} {self.plan.shown.unit})".replace(" )", ")")
            if math.isfinite(d.mean)
            else ""
        )

    def cautions(self) -> list[str]:
        """What speaks against the best trial."""
        best, found = self.best, list[str]()
        if best is None:
            return found
        if best.failed:
            found.append(
                f"{best.failed} of its {len(best.reached)} runs failed ({_ended(best)}),"
                " and no trial had fewer."
            )
        if self.check is not None and self.check[0].failed:
            failed = (
                f"{self.check[0].failed} of {len(self.check[0].reached)} runs failed"
                f" ({_ended(self.check[0])})"
            )
            found.append(
                f"on fresh starts {failed}; a search with more --seeds finds settings that hold."
            )
        for p in self.space.parameters:
            # the first and the last fiftieth of a range count as its ends
            if isinstance(p, Range) and not 0.02 < p.place(best.values[p.path]) < 0.98:
                found.append(
                    f"{p.path}={flow_text(best.values[p.path])} is at an end of {p};"
                    " a wider range may hold a better value."
                )
        if (self.plan.seeds or 1) == 1:
            found.append(
                "one start decides; from other starts these values may fail."
                " Give the scenario random starts, and --seeds 5 or more."
            )
        return found

    def write(self) -> Path:
        """Write the table of trials, `best.yaml`, the page and its figures; returns the page's
        path.
        """
        plan, best = self.plan, self.best
        write_table(self.folder / "trials", self.table)
        if best is not None:
            dump(self.scenario, self.folder / "best.yaml")
        page = TuningPage(
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
        return write_tuning(self.folder, page)


def _axis(p: Parameter) -> ParameterAxis:
    return (p.path, (), p.log) if isinstance(p, Range) else (p.path, tuple(p.words), False)


def _row(trial: Trial, parameters: Sequence[Parameter]) -> TrialRow:
    values = tuple(_shown(p, trial.values[p.path]) for p in parameters)
    return TrialRow(
        int(trial.number or 0),
        values,
        sum(trial.reached),
        len(trial.reached),
        trial.mean,
        _ended(trial),
    )


def _shown(p: Parameter, value: object) -> float | str:
    """A value as the table has it: a number of a range, a word of a choice."""
    return flow_text(value) if isinstance(p, Choice) else float(str(value))


def _ended(trial: Trial) -> str:
    """How the failed runs ended: `target_lost (2), timed_out`."""
    ended = Counter(
        outcome for outcome, good in zip(trial.outcomes, trial.reached, strict=True) if not good
    )
    return trial.refused or ", ".join(
        f"{name} ({n})" if n > 1 else name for name, n in ended.most_common()
    )


def tune(
    scenario: str | Path | None = None,
    vary: Mapping[str, str | Sequence[object]] | None = None,
    metric: str = "time_to_converge_s",
    maximise: bool | None = None,
    trials: int | None = None,
    seeds: int | None = None,
    batch: int = 4,
    check: int = 20,
    seed: int = 0,
    jobs: int | None = None,
    executor: str = "local",
    out: str | Path | None = None,
    resume: bool = False,
    set: Mapping[str, object] | None = None,
    plugins: Sequence[str] = (),
    listener: Listener | None = None,
) -> TuningResult:
    """Search for the values with which a scenario does best, and write the folder of the search.

    A trial is one setting, run from the same random starts as all others. The best has the fewest
    failed runs and, among those, the best mean of the metric over its runs. In a script, call it
    under `if __name__ == "__main__":`, since worker processes import the script.

    Args:
        scenario: path or bundled name. vary: by dotted path a range, "0.2:2" or "10:80:log", or a
            list of values.
        metric: name of `summary.json`. maximise: whether more is better; None: as is known of the
            metric.
        trials: settings that are tried; None: 30. seeds: random starts of each; None: 10 where
            anything is random, else the nominal start.
        batch: trials that are chosen together. check: fresh starts on which the best is run beside
            the scenario as it is.
        seed: of the search. The result depends on it and on `batch`, but not on `jobs`, nor on
            interruptions.
        jobs, executor: as of `compare`. out: the folder; None: `runs/tune/<number>`.
        resume: go on with the search in `out`, of which `trials` alone may be changed.
        set: values by dotted path for all trials. plugins: files or modules that add kinds.
            listener: is told of each run.

    Raises ScenarioError, ParameterError: bad input, found before anything runs. OutputError: `out`
    is taken, or another process writes into it. RunFolderError: `out` holds no search.
    EnvironmentLackError: no optuna, no OpenGL where a run needs it, no space, no cluster.
    """
    must_not_be_worker("tune")
    plan = None
    if not resume:
        numbers = {
            "trials": trials or 30,
            "seeds": seeds,
            "batch": batch,
            "check": check,
            "seed": seed,
        }
        plan = planned(
            scenario, vary or {}, set or {}, plugins, metric=metric, maximise=maximise, **numbers
        )
    with begun(plan, None if out is None else Path(out), trials, plugins) as search:
        search.jobs, search.executor = jobs, executor
        search.listener = listener or search.listener
        return finished(search)


def planned(
    scenario: str | Path | None,
    vary: Mapping[str, str | Sequence[object]],
    settings: Mapping[str, object],
    plugins: Sequence[str],
    **others: Any,
) -> Tuning:
    """The plan of a search; arguments and errors as of `tune`,
    the others by the names of `Tuning`.
    """
    if scenario is None:
        raise ParameterError.missing("SCENARIO", "name the scenario that is to be tuned")
    loaded, here = load_plugins(plugins), Path.cwd()  # first: a metric may be one of theirs
    asked = [parameter(path, given) for path, given in vary.items()]
    varied = {
        p.path: [block_of(value) for value in p.values] if isinstance(p, Choice) else str(p)
        for p in asked
    }
    own = {path: block_of(value) for path, value in settings.items()}
    own, varied = absolute_files(own, here), absolute_files(varied, here)
    return Tuning(scenario=str(scenario), plugins=loaded, set=own, vary=varied, **others)


@contextmanager
def begun(
    plan: Tuning | None, out: Path | None, trials: int | None = None, plugins: Sequence[str] = ()
) -> Iterator[Search]:
    """Check a plan, make its folder, and hold it until the block ends; without a plan, go on with
    the search of a folder.

    plan: of a new search. out: its folder, or that of the search that goes on. trials: new number
    of trials of that one. plugins: for that one, besides its own. Raises ParameterError: as of
    `tune`. RunFolderError: the folder holds no search.
    """
    must_be_installed()
    if plan is not None:
        # before the folder is made: bad input leaves no folder
        comparison, space, seeds = prepared(plan, plan.seeds)
        plan = replace(plan, seeds=seeds)
        with study_folder("tune", out, RESUMABLE) as folder:
            write_plan(folder / PLAN, plan, "scenario")
            yield Search(folder, plan, comparison, space)
        return
    with resumed_folder("tune", out, PLAN) as folder:
        path = folder / PLAN
        plain, marks = plain_mapping(text_of(path), str(path), "a search needs scenario and vary")
        load_named(plain, marks, str(path), plugins)
        if isinstance(name := plain.get("scenario"), str) and (folder / name).is_file():
            plain["scenario"] = str(folder / name)
        found = build(Tuning, plain, marks, str(path))
        if trials is not None and trials != found.trials:
            found = replace(found, trials=trials)
            write_plan(folder / PLAN, found, "scenario")
        comparison, space, _ = prepared(found, found.seeds)
        yield Search(folder, found, comparison, space)


def finished(search: Search) -> TuningResult:
    """Do what is missing of a search, and write its results."""
    must_be_known(search.executor)
    check = search.carry_out()
    search.listener.say("writing the report")
    result = TuningResult(search.folder, search.plan, search.space, tuple(search.trials), check)
    result.write()
    return result


def report_again(folder: Path, plugins: Sequence[str] = ()) -> Path:
    """Write the results of a finished search again from its runs; `plugins`: besides those that it
    remembers.
    """
    with begun(None, folder, plugins=plugins) as search:
        search.stored_alone = True
        return finished(search).folder / "report.html"
