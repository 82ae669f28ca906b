"""Search for the settings with which a scenario does best: trials over varied fields, each over the same random starts."""

from __future__ import annotations

import multiprocessing
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from vstestbed.core.errors import ParameterError
from vstestbed.core.files import only_writer, study_folder
from vstestbed.core.planar import block_of
from vstestbed.scenario.plugins import absolute_files, load_plugins
from vstestbed.studies.comparison import must_be_known
from vstestbed.studies.tuning.search import Listener, Search, Tuning, prepared, read_plan, write_plan
from vstestbed.studies.tuning.space import Choice, Parameter, must_be_installed, parameter

if TYPE_CHECKING:
    from vstestbed.studies.tuning.result import TuningResult

__all__ = ["Listener", "Search", "Tuning", "begun", "finished", "planned", "report_again", "tune"]


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

    A trial is one setting, run from the same random starts as all others. The best has the fewest failed runs and, among those, the best
    mean of the metric over its runs. In a script, call it under `if __name__ == "__main__":`, since worker processes import the script.

    Args:
        scenario: path or bundled name. vary: by dotted path a range, "0.2:2" or "10:80:log", or a list of values.
        metric: name of `summary.json`. maximise: whether more is better; None: as is known of the metric.
        trials: settings that are tried; None: 30. seeds: random starts of each; None: 10 where anything is random, else the nominal start.
        batch: trials that are chosen together. check: fresh starts on which the best is run beside the scenario as it is.
        seed: of the search. The result depends on it and on `batch`, but not on `jobs`, nor on interruptions.
        jobs, executor: as of `compare`. out: the folder; None: `runs/tune/<number>`.
        resume: go on with the search in `out`, of which `trials` alone may be changed.
        set: values by dotted path for all trials. plugins: files or modules that add kinds. listener: is told of each run.

    Raises:
        ScenarioError, ParameterError: bad input, found before anything runs.
        OutputError: `out` is taken, or another process writes into it. RunFolderError: `out` holds no search.
        EnvironmentLackError: no optuna, no OpenGL where a run needs it, no space, no cluster.
    """
    # without this check every worker would start workers of its own
    if getattr(multiprocessing.current_process(), "_inheriting", False):  # a worker that imports the script
        raise ParameterError("tune", "must stand under `if __name__ == '__main__':` in a script, which worker processes import")
    plan = None
    if not resume:
        plan = planned(scenario, vary or {}, metric, maximise, trials or 30, seeds, batch, check, seed, set or {}, plugins)
    with begun(plan, None if out is None else Path(out), trials, plugins) as search:
        search.jobs, search.executor = jobs, executor
        search.listener = listener or search.listener
        return finished(search)


def planned(
    scenario: str | Path | None,
    vary: Mapping[str, str | Sequence[object]],
    metric: str,
    maximise: bool | None,
    trials: int,
    seeds: int | None,
    batch: int,
    check: int,
    seed: int,
    settings: Mapping[str, object],
    plugins: Sequence[str],
) -> Tuning:
    """The plan of a search; arguments and errors as of `tune`."""
    if scenario is None:
        raise ParameterError("SCENARIO", "is missing: name the scenario that is to be tuned")
    loaded, here = load_plugins(plugins), Path.cwd()  # first: a metric may be one of theirs
    varied = {path: _plain(parameter(path, given)) for path, given in vary.items()}
    own = {path: block_of(value) for path, value in settings.items()}
    own, varied = absolute_files(own, here), absolute_files(varied, here)
    numbers = {"trials": trials, "seeds": seeds, "batch": batch, "check": check, "seed": seed}
    return Tuning(scenario=str(scenario), plugins=loaded, set=own, vary=varied, metric=metric, maximise=maximise, **numbers)


def _plain(one: Parameter) -> object:
    """A range as its text, a choice as a list."""
    return [block_of(value) for value in one.values] if isinstance(one, Choice) else str(one)


@contextmanager
def begun(plan: Tuning | None, out: Path | None, trials: int | None = None, plugins: Sequence[str] = ()) -> Iterator[Search]:
    """Check a plan, make its folder, and hold it until the block ends; without a plan, go on with the search of a folder.

    Args:
        plan: of a new search. out: its folder, or that of the search that goes on. trials: new number of trials of that one.
        plugins: for that one, besides its own.

    Raises:
        ParameterError: as of `tune`. RunFolderError: the folder holds no search.
    """
    must_be_installed()
    if plan is not None:
        comparison, space, seeds = prepared(plan, plan.seeds)  # before the folder is made: bad input leaves no folder
        plan = replace(plan, seeds=seeds)
        with study_folder("tune", out, "give a new one, or --resume to go on with what is there") as folder:
            write_plan(folder, plan)
            yield Search(folder, plan, comparison, space)
        return
    if out is None:
        raise ParameterError("--resume", "needs the folder of the search: --out DIR")
    found = read_plan(out, plugins)
    with only_writer(out):
        if trials is not None and trials != found.trials:
            found = replace(found, trials=trials)
            write_plan(out, found)
        comparison, space, _ = prepared(found, found.seeds)
        yield Search(out, found, comparison, space)


def finished(search: Search) -> TuningResult:
    """Do what is missing of a search, and write its results."""
    from vstestbed.studies.tuning.result import TuningResult  # here: polars is imported only where there is a table

    must_be_known(search.executor)
    check = search.carry_out()
    search.listener.say("writing the report")
    result = TuningResult(search.folder, search.plan, search.space, tuple(search.trials), check)
    result.write()
    return result


def report_again(folder: Path, plugins: Sequence[str] = ()) -> Path:
    """Write the results of a finished search again from its runs; `plugins`: besides those that it remembers.

    Raises:
        RunFolderError: a run is missing, or a file is damaged.
    """
    with begun(None, folder, plugins=plugins) as search:
        search.stored_alone = True
        return finished(search).folder / "report.html"
