"""The search: trials in batches, each a small comparison whose runs go through a campaign; then the best one on fresh starts."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Protocol

from vstestbed.core.errors import ParameterError, RunFolderError, ScenarioError
from vstestbed.core.files import write_whole
from vstestbed.core.quantity import Narrower, Seed
from vstestbed.core.registry import to_mapping
from vstestbed.core.spec import spec
from vstestbed.report.comparison.columns import Metric
from vstestbed.scenario.dump import as_yaml, flow_text
from vstestbed.scenario.load import text_of
from vstestbed.scenario.plugins import load_named
from vstestbed.scenario.validation import build
from vstestbed.scenario.yaml_marks import plain_mapping
from vstestbed.studies.comparison import Campaign, workers
from vstestbed.studies.comparison.folder import kept_base, summary_of
from vstestbed.studies.comparison.plan import Comparison, changed, chosen
from vstestbed.studies.comparison.pools import Pool, clear, pool_of
from vstestbed.studies.comparison.runs import Job, controllers, jobs
from vstestbed.studies.tuning.space import (
    OPTION,
    Parameter,
    SearchSpace,
    Trial,
    best_of,
    checked,
    next_settings,
    parameter,
    read_record,
    write_record,
)
from vstestbed.tasks.metrics import FIGURES, own_titles

# Plan of a search for good settings: its file `tuning.yaml`, and the comparison that its trials are.


PLAN = "tuning.yaml"
SEEDS = 10
"""Random starts of a trial where none are asked for: a setting that fails on one start in five shows it in nine searches of ten."""
Count = Annotated[Seed, Narrower(ge=1, le=1000)]


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
        check: random starts that no trial has seen [1], on which the best trial is run beside the scenario as it is.
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
    check: Annotated[Seed, Narrower(le=1000)] = 20
    seed: Seed = 0

    def __post_init__(self) -> None:
        """Refuse a search over nothing, and a metric that no run has."""
        if not self.vary:
            raise ParameterError(OPTION, "is missing: it names what is tuned, such as --vary law.gain=0.2:2")
        if self.metric not in (known := (*FIGURES, *own_titles())):
            raise ParameterError("--metric", f"must be a figure of summary.json: {', '.join(known)}", self.metric)

    @property
    def shown(self) -> Metric:
        """The metric with its title and unit."""
        return Metric.of(self.metric)

    @property
    def higher(self) -> bool:
        """Whether more of the metric is better."""
        return self.shown.higher if self.maximise is None else self.maximise

    def comparison(self) -> Comparison:
        """The scenario with its settings; `axes` has the ends of the ranges and the choices.

        Raises:
            ScenarioError, ParameterError: bad input.
        """
        axes = {p.path: p.ends for p in self.parameters}
        found = chosen([self.scenario], self.set, axes, self.seeds, self.plugins)
        if len(found.base) != 1 or found.cases or found.tasks or set(found.axes) != set(axes):
            raise ParameterError("SCENARIO", "must be one scenario, and no comparison", self.scenario)
        return found

    @property
    def command(self) -> str:
        """The command that makes the search again."""
        options: list[tuple[str, object]] = [("--plugin", name) for name in self.plugins]
        options += [("--set", f"{path}={flow_text(value)}") for path, value in self.set.items()]
        options += [(OPTION, f"{p.path}={p}") for p in self.parameters]
        options += [(f"--{name}", getattr(self, name)) for name in ("metric", "trials", "batch", "check", "seed")]
        options += [("--seeds", self.seeds)] if self.seeds else []
        words = [word for option in options for word in map(str, option)] + ["--maximise"] * bool(self.maximise)
        return shlex.join(["vstestbed", "tune", self.scenario, *words])

    @property
    def parameters(self) -> list[Parameter]:
        """What is varied."""
        return [parameter(path, given) for path, given in self.vary.items()]


def read_plan(folder: Path, plugins: Sequence[str] = ()) -> Tuning:
    """The plan of a folder; `plugins`: besides its own.

    Raises:
        RunFolderError: it has none. ScenarioError, PluginError: the plan is damaged, or a plugin is not there.
    """
    path = folder / PLAN
    if not path.is_file():
        raise RunFolderError(folder, "holds no search" if folder.is_dir() else "no such folder", "`vstestbed tune --out DIR` makes one")
    plain, marks = plain_mapping(text_of(path), str(path), "a search needs scenario and vary")
    load_named(plain, marks, str(path), plugins)
    if isinstance(name := plain.get("scenario"), str) and (folder / name).is_file():
        plain["scenario"] = str(folder / name)
    return build(Tuning, plain, marks, str(path))


def write_plan(folder: Path, plan: Tuning) -> None:
    """Write `tuning.yaml`, and a copy of the scenario's file."""
    write_whole(folder / PLAN, as_yaml(to_mapping(plan) | {"scenario": kept_base(folder, plan.scenario)}))


def prepared(plan: Tuning, seeds: int | None) -> tuple[Comparison, SearchSpace, int | None]:
    """The comparison of a plan, its space, and the number of random starts of each trial: as asked for, else SEEDS where any are drawn.

    Raises:
        ScenarioError, ParameterError: bad input, found before anything runs.
    """
    comparison = plan.comparison()
    space = checked(comparison, plan.parameters)
    bare = changed(comparison, axes={}, seeds=seeds)
    scenario = controllers(bare)[0].scenario
    _check_metric(plan, scenario.metrics)
    return bare, space, seeds if seeds is not None else SEEDS if scenario.draws else None


def _check_metric(plan: Tuning, own: Sequence[Any]) -> None:
    """Refuse a figure of a metric that the scenario does not have."""
    if plan.metric in FIGURES or any(plan.metric in metric.titles for metric in own):
        return
    from vstestbed.tasks.metrics import METRICS

    kinds: Mapping[str, Any] = METRICS.members
    kind = next(kind for kind, cls in kinds.items() if plan.metric in cls.titles)
    raise ParameterError("--metric", f"is of the metric {kind}, which the scenario does not have; --set metrics=[{kind}]", plan.metric)


CASE, AS_IT_IS = "trial", "as_it_is"


class Listener(Protocol):
    """What a search tells while it goes on."""

    def run_done(self, job: Job, summary: dict[str, Any]) -> None:
        """A run is done."""
        ...

    def were_done(self, runs: int) -> None:
        """So many runs were done before the search was interrupted."""
        ...

    def say(self, words: str) -> None:
        """What is being done."""
        ...


class NoListener:
    """A listener that does nothing."""

    def run_done(self, job: Job, summary: dict[str, Any]) -> None:
        """See `Listener`."""

    def were_done(self, runs: int) -> None:
        """See `Listener`."""

    def say(self, words: str) -> None:
        """See `Listener`."""


@dataclass
class Search:
    """A search in its folder, which this process holds.

    Args:
        folder: of the search. plan: of the search. comparison: the scenario with its settings. space: what is varied.
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
        """Do all trials, and the check; returns the best one and the scenario as it is on the fresh starts, None without any.

        Raises:
            ParameterError: no run has the metric; the first trials are all refused. EnvironmentLackError, OutputError: see `Campaign.run`.
        """
        with ExitStack() as stack:
            self._stack = stack
            self._search()
            self.listener.say("checking the best on fresh starts")
            return self._check()

    @cached_property
    def _pool(self) -> Pool:
        """Started with the first run that is missing."""
        most = max(self.plan.batch * self.runs, 2 * self.fresh)
        return self._stack.enter_context(closing(pool_of(self.executor, workers(self.jobs, most), self.folder)))

    def _search(self) -> None:
        clear(self.folder)  # of a process that was killed
        recorded = read_record(self.folder, [p.path for p in self.space.parameters])
        while (place := len(self.trials)) < self.plan.trials:
            size = min(self.plan.batch, self.plan.trials - place)
            if len(recorded) <= place:
                recorded += next_settings(self.space, self.trials, self.plan.higher, self.runs, size, self.plan.seed)
                write_record(self.folder, recorded)
            batch = recorded[place : place + size]
            if not batch:  # all there is has been tried
                return
            best = self.best
            found = "" if best is None else f", best {best.mean:.3g} {self.plan.shown.unit}".rstrip()
            self.listener.say(f"trial {place + 1} of {self.plan.trials}{found}")
            self.trials += self._tried(dict(enumerate(batch, place)))
            self._check_metric()

    def _tried(self, settings: Mapping[int, dict[str, object]]) -> list[Trial]:
        """The trials with these settings, done at once."""
        refused = {number: words for number, values in settings.items() if (words := self._refusal(number, values))}
        if not self.trials and len(refused) == len(settings):
            raise ParameterError("--vary", f"gives settings that the scenario does not take: {next(iter(refused.values()))}")
        good = {str(number): values for number, values in settings.items() if number not in refused}
        found = self._run(good, 0, self.runs) if good else {}
        metric = self.plan.shown
        return [
            Trial(number, values, refused=refused[number]) if number in refused else Trial.of(number, values, found[str(number)], metric)
            for number, values in settings.items()
        ]

    def _refusal(self, number: int, values: dict[str, object]) -> str:
        """Why the scenario does not take a setting, each value of which it takes; "" where it does."""
        try:
            controllers(self._comparison({str(number): values}, self.plan.seeds))
        except (ScenarioError, ParameterError) as error:
            return str(error).splitlines()[0]
        return ""

    def _comparison(self, settings: Mapping[str, dict[str, object]], seeds: int | None) -> Comparison:
        # an outer block first, which would overwrite what is in it
        cases = {name: dict(sorted(values.items(), key=lambda item: item[0].count("."))) for name, values in settings.items()}
        return changed(self.comparison, axes={}, cases={CASE: cases}, seeds=seeds)

    def _run(self, settings: Mapping[str, dict[str, object]], first: int, seeds: int) -> dict[str, list[dict[str, Any]]]:
        """The summaries of runs from the seeds `first` to `seeds` - 1, by name of the setting; those that are missing are done."""
        comparison = self._comparison(settings, seeds if self.plan.seeds else None)
        wanted = [job for job in jobs(controllers(comparison), comparison.seeds) if (job.seed or 0) >= first]
        campaign = Campaign(self.folder, wanted)
        self.listener.were_done(campaign.done)
        if self.stored_alone and campaign.done < len(wanted):
            works = f"`vstestbed tune --resume --out {self.folder}` does what is missing"
            raise RunFolderError(self.folder, "holds a search that is not finished", works)
        if campaign.done < len(wanted):
            campaign.run(self._pool, self.listener.run_done)
        found: dict[str, list[dict[str, Any]]] = {name: [] for name in settings}
        for job in wanted:
            found[str(job.controller.values[CASE])].append(summary_of(self.folder, job))
        return found

    def _check_metric(self) -> None:
        """Refuse a metric that no run that reached the goal has, as soon as there is one."""
        reached = [x for trial in self.trials for x, good in zip(trial.found, trial.reached, strict=True) if good]
        if reached and not any(x == x for x in reached):
            words = "is no number of the runs that reached the goal; take another, such as final_error_px or path_length_m"
            raise ParameterError("--metric", words, self.plan.metric)

    def _check(self) -> tuple[Trial, Trial] | None:
        best = self.best
        if best is None or not self.fresh:
            return None
        name, metric = str(best.number), self.plan.shown
        found = self._run({name: best.values, AS_IT_IS: {}}, self.runs, self.runs + self.fresh)
        return Trial.of(best.number, best.values, found[name], metric), Trial.of(None, {}, found[AS_IT_IS], metric)
