"""The search: trials in batches, each a small comparison whose runs go through a campaign; then the best one on fresh starts."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack, closing
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Protocol

from vstestbed.core.errors import ParameterError, RunFolderError, ScenarioError
from vstestbed.experiments.comparison import Campaign, workers
from vstestbed.experiments.comparison.folder import summary_of
from vstestbed.experiments.comparison.plan import Comparison, changed
from vstestbed.experiments.comparison.pools import Pool, clear, pool_of
from vstestbed.experiments.comparison.runs import Job, controllers, jobs
from vstestbed.experiments.tuning.plan import Tuning
from vstestbed.experiments.tuning.sampler import next_settings
from vstestbed.experiments.tuning.space import SearchSpace
from vstestbed.experiments.tuning.trials import Trial, best_of, read_record, write_record

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
