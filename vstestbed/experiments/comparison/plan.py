"""Plan of a comparison: scenarios, varied values, seeds or tasks; and the controllers and runs that follow from it."""

from __future__ import annotations

import itertools
import re
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

from annotated_types import Ge, Le, Len

from vstestbed.core.assets import bundled_comparisons
from vstestbed.core.errors import ParameterError, ScenarioError
from vstestbed.core.spec import spec
from vstestbed.experiments.comparison.starts import StartTable
from vstestbed.loop.metrics import FIGURES
from vstestbed.scenario.load import load, seeded, text_of
from vstestbed.scenario.scenario import Scenario
from vstestbed.scenario.validation import build
from vstestbed.scenario.yaml_marks import plain_mapping

AS_IT_IS = "as_it_is"
"""Name of the variant of a scenario where nothing is varied."""
TASK, AMOUNT = "task", "amount"
"""Columns that only a comparison with tasks has."""
OWN_COLUMNS = ("scenario", "seed", "folder", TASK, AMOUNT, "attempts", "outcome", "success", "reason", *FIGURES)
"""Columns of the table, whose names no case may have."""


@spec
class Comparison:
    """Every scenario with every combination of the cases and of the axes' values, in each task or from each seed.

    Args:
        base: scenarios, by path or bundled name.
        set: values by dotted path, for all scenarios.
        cases: named settings of several fields at once: `law: {points: {law: {kind: ibvs}}, pose: {law: {kind: pbvs}}}` is an
            axis `law` with the values `points` and `pose`. They are applied after `set`, in their order.
        axes: lists of values (or of whole blocks) by dotted path; every combination is run. They are applied last.
        tasks: start tables by name, in place of seeds.
        seeds: number of seeds; seed i draws the start, the noise and the delays of run i, the same for every controller.
            None: the nominal start, once.
        metrics: names of `summary.json` that the report shows; none: those of `report`.
    """

    description: str = ""
    base: Annotated[tuple[str, ...], Len(1)]
    set: dict[str, Any] = field(default_factory=dict)
    cases: dict[str, dict[str, dict[str, Any]]] = field(default_factory=dict)
    axes: dict[str, tuple[Any, ...]] = field(default_factory=dict)
    tasks: dict[str, StartTable] = field(default_factory=dict)
    seeds: Annotated[int, Ge(1), Le(1_000_000)] | None = None
    metrics: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Refuse controllers that could not be distinguished, and metrics that no run has."""
        # the stem is the folder of the scenario's runs
        if len({Path(name).stem for name in self.base}) < len(self.base):
            raise ParameterError("base", "must name each scenario once, and no two of one file name", list(self.base))
        self._check_axes()
        for name, cases in self.cases.items():
            if name in (*self.axes, *OWN_COLUMNS) or not cases:
                raise ParameterError(f"cases.{name}", "must have a name of its own, and one case or more")
        if self.tasks and self.seeds is not None:
            raise ParameterError("seeds", "stand beside `tasks`, which have runs of their own; leave one of the two out", self.seeds)
        for name in self.metrics:
            if name not in FIGURES:
                raise ParameterError("metrics", f"must be figures of summary.json: {', '.join(FIGURES)}", name)

    def _check_axes(self) -> None:
        for path, values in self.axes.items():
            if not values or any(_same(a, b) for a, b in itertools.combinations(values, 2)):
                raise ParameterError(f"axes.{path}", "must be a list of different values", list(values))
            if path in self.set:
                raise ParameterError(f"axes.{path}", "is also in `set`; leave one of the two out")

    @property
    def varied(self) -> tuple[str, ...]:
        """The columns of the table that distinguish the controllers of one scenario."""
        return (*self.cases, *self.axes, *((TASK,) if self.tasks else ()))


@dataclass(frozen=True)
class Controller:
    """One scenario with one combination of cases and values, from its nominal start or, in a task, from each of its starts."""

    scenario: Scenario
    values: Mapping[str, object]
    folder: str
    """Folder of its runs, below the comparison's folder."""
    draws: bool
    """Whether a seed draws anything."""
    starts: tuple[Scenario, ...] | None = None
    """The scenario of each run of a task; None if a seed draws it."""
    amounts: tuple[str, ...] = ()
    """Labels of the runs of a task: `20 deg`."""
    runs: int | None = None
    """Number of runs of a task; None without a task: the comparison's seeds."""


@dataclass(frozen=True)
class Job:
    """One run of a comparison."""

    controller: Controller
    seed: int | None

    @property
    def folder(self) -> str:
        """Folder of the run, below the comparison's folder."""
        return f"{self.controller.folder}/{'nominal' if self.seed is None else self.seed}"

    def scenario(self) -> Scenario:
        """The scenario with its start and its noise drawn from the seed."""
        found = self.controller
        if found.starts is not None and self.seed is not None:
            return replace(found.starts[self.seed], seed=self.seed)
        return found.scenario if self.seed is None or not found.draws else seeded(found.scenario, self.seed)


def controllers(comparison: Comparison) -> list[Controller]:
    """All controllers, each loaded and checked: bad input is found before anything runs.

    Raises:
        ScenarioError: a scenario is invalid, or becomes so with a value of an axis.
        ParameterError: more than one seed for a scenario in which a seed draws nothing.
    """
    found: list[Controller] = []
    for name in comparison.base:
        for shown, settings in _combinations(comparison):
            for task_name, task in comparison.tasks.items() or ((None, None),):  # one pass without a task
                values = shown if task_name is None else shown | {TASK: task_name}
                folder = f"runs/{_word(Path(name).stem)}/{_variant(values)}"
                while folder in {c.folder for c in found}:
                    folder += "_"  # values that differ only in characters that a file name cannot hold
                found.append(_controller(name, settings, values, folder, comparison.seeds, task))
    return found


def _controller(
    name: str,
    settings: Mapping[str, object],
    values: Mapping[str, object],
    folder: str,
    seeds: int | None,
    task: StartTable | None,
) -> Controller:
    if task is None:
        scenario = load(name, settings)
        return Controller(scenario, values, folder, _seeds_draw(scenario, seeds or 1))
    settings = merged(settings, task.set)
    if not task.each:
        scenario = load(name, settings)
        return Controller(scenario, values, folder, _seeds_draw(scenario, task.runs), None, task.labels(), task.runs)
    starts = tuple(load(name, merged(settings, one)) for one in task.settings())
    return Controller(starts[0], values, folder, _draws(starts[0]), starts, task.labels(), task.runs)


def _draws(scenario: Scenario) -> bool:
    """Whether anything of a scenario is random: its start, pixel or image noise, delays, or the calibration of depth."""
    noise = scenario.noise.pixel_sigma_px > 0 or (scenario.noise.image_sigma > 0 and scenario.detector.needs_image)
    return scenario.robot.start.random is not None or noise or scenario.timing.draws or scenario.calibration.depth_spread > 0


def _seeds_draw(scenario: Scenario, runs: int) -> bool:
    """As `_draws`, but an error where several runs would all be the same."""
    draws = _draws(scenario)
    if runs > 1 and not draws:
        problem = "is missing, and there is no noise: every seed would give the same run; add one of them, or leave --seeds out"
        raise ParameterError(f"{scenario.name}: robot.start.random", problem)
    return draws


def merged(*settings: Mapping[str, object]) -> dict[str, object]:
    """Values by dotted path, later mappings over earlier ones.

    A repeated path moves to the end, since settings are applied in order: a whole block such as `law` in between would overwrite it.
    """
    out: dict[str, object] = {}
    for one in settings:
        for path, value in one.items():
            out.pop(path, None)
            out[path] = value
    return out


def _same(a: object, b: object) -> bool:
    """Whether two values are equal in YAML: 3 and 3.0 are, 1 and true (equal in Python) are not."""
    return a == b and isinstance(a, bool) == isinstance(b, bool)


def _combinations(comparison: Comparison) -> Iterator[tuple[dict[str, object], dict[str, object]]]:
    """Every combination: its values as the table shows them, and all its settings by dotted path."""
    cases = [list(cases.items()) for cases in comparison.cases.values()]
    for chosen_cases in itertools.product(*cases):
        for values in itertools.product(*comparison.axes.values()):
            of_axes = dict(zip(comparison.axes, values, strict=True))
            names: dict[str, object] = dict(zip(comparison.cases, (name for name, _ in chosen_cases), strict=True))
            yield names | of_axes, merged(comparison.set, *(settings for _, settings in chosen_cases), of_axes)


def _variant(values: Mapping[str, object]) -> str:
    return ",".join(f"{path}={_word(str(value))}" for path, value in values.items()) or AS_IT_IS


def _word(text: str) -> str:
    """A text as part of a file name, short enough for file systems (a checksum keeps shortened ones distinct)."""
    word = re.sub(r"[^\w.+-]+", "_", text).strip("._") or "value"
    return word if len(word) <= 60 else f"{word[:48]}_{zlib.crc32(text.encode()):08x}"


def jobs(found: list[Controller], seeds: int | None) -> list[Job]:
    """All runs, seed by seed, so that the controllers can be compared at any time; a task has as many runs as its table."""
    counts = [(c, seeds if c.runs is None else c.runs) for c in found]
    nominal = [Job(c, None) for c, n in counts if n is None]
    by_controller = [Job(c, seed) for c, n in counts for seed in range(n or 0)]
    return nominal + sorted(by_controller, key=lambda job: job.seed or 0)  # stable: the order of controllers within a seed


def read_comparison(path: Path) -> Comparison:
    """Read a comparison's YAML file; scenario files in `base` are searched beside it first.

    Raises:
        ScenarioError: all mistakes in it, at once.
    """
    plain, marks = plain_mapping(text_of(path), str(path), "a comparison needs base")
    read = build(Comparison, plain, marks, str(path))
    return replace(read, base=tuple(str(path.parent / n) if (path.parent / n).is_file() else n for n in read.base))


def chosen(names: list[str], settings: Mapping[str, object], axes: Mapping[str, tuple[object, ...]], seeds: int | None) -> Comparison:
    """The comparison that a command line requests: of scenarios, or a comparison by its file or bundled name, with the options applied.

    Raises:
        ScenarioError, ParameterError: invalid input.
    """
    path = bundled_comparisons().get(names[0], Path(names[0])) if len(names) == 1 else None
    if path is None or not _is_comparison(path):
        return Comparison(base=tuple(names), set=dict(settings), axes=dict(axes), seeds=seeds)
    read = read_comparison(path)
    return replace(read, set=read.set | dict(settings), axes=read.axes | dict(axes), seeds=read.seeds if seeds is None else seeds)


def _is_comparison(path: Path) -> bool:
    """Whether a file is a comparison: it has the key `base` at its top level."""
    if not path.is_file():
        return False
    try:
        return "base" in plain_mapping(text_of(path), str(path), "")[0]
    except ScenarioError:
        return False
