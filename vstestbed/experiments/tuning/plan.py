"""Plan of a search for good settings: its file `tuning.yaml`, and the comparison that its trials are."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import field
from pathlib import Path
from typing import Annotated, Any

from vstestbed.core.errors import ParameterError, RunFolderError
from vstestbed.core.files import write_whole
from vstestbed.core.mapping import to_mapping
from vstestbed.core.quantity import Narrower, Seed
from vstestbed.core.spec import spec
from vstestbed.experiments.comparison.folder import kept_base
from vstestbed.experiments.comparison.plan import Comparison, changed, chosen
from vstestbed.experiments.comparison.runs import controllers
from vstestbed.experiments.tuning.space import OPTION, Parameter, SearchSpace, checked, parameter
from vstestbed.report.comparison.columns import Metric
from vstestbed.scenario.dump import as_yaml, flow_text
from vstestbed.scenario.load import text_of
from vstestbed.scenario.plugins import load_named
from vstestbed.scenario.validation import build
from vstestbed.scenario.yaml_marks import plain_mapping
from vstestbed.tasks.metrics import FIGURES, own_titles

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
