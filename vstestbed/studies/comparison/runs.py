"""The controllers and runs of a comparison: counted before any is made, and made when their turn comes."""

from __future__ import annotations

import functools
import itertools
import math
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple, TypeVar, overload

from vstestbed.core.errors import Mistake, ParameterError, ScenarioError, UnreachableError
from vstestbed.core.files import allowed, distinct, file_word
from vstestbed.scenario.load import find, load, seeded
from vstestbed.scenario.scenario import Scenario
from vstestbed.scenario.yaml_marks import Key, Marks, marks_under
from vstestbed.studies.comparison.plan import TASK, Comparison, StartTable, merged

# Sequences whose items are made when they are asked for: controllers, runs, starts.


T = TypeVar("T")
STARTS_KEPT = 100
"""Scenarios of a task's runs that are kept in memory; of more, each is made again when its turn comes."""


class Lazy(Sequence[T]):
    """A sequence whose items are made when they are asked for."""

    def item(self, i: int) -> T:
        """Item i, 0 <= i < len."""
        raise NotImplementedError

    @overload
    def __getitem__(self, i: int) -> T: ...
    @overload
    def __getitem__(self, i: slice) -> list[T]: ...
    def __getitem__(self, i: int | slice) -> T | list[T]:
        """Item i, or a list of the items of a slice."""
        places = range(len(self))[i]
        return self.item(places) if isinstance(places, int) else [self.item(place) for place in places]


class Starts(Lazy[Scenario]):
    """The scenarios of a task's runs, each made when it is asked for.

    Args:
        make: the scenario of run i, and why the robot cannot stand where it begins, "" where it can.
        runs: how many there are.
    """

    def __init__(self, make: Callable[[int], tuple[Scenario, str]], runs: int):
        self._made, self._runs = functools.lru_cache(maxsize=STARTS_KEPT)(make), runs

    def __len__(self) -> int:
        return self._runs

    def item(self, i: int) -> Scenario:
        """The scenario of run i; one that cannot begin as it is without its displacement."""
        return self._made(i)[0]

    def why_not(self, i: int) -> str:
        """Why the robot cannot stand where run i begins; "" where it can."""
        return self._made(i)[1]


AS_IT_IS = "as_it_is"
"""Name of the variant of a scenario where nothing is varied."""
MOST_RUNS = 100_000
"""Runs that need no `--force`: over an hour of the quickest scenario (50 ms a run) on one core, and tens of GB of run folders."""
MOST_KEPT = 10_000
"""Variants that are kept in memory (some 15 kB each); of more, each is loaded again when its turn comes."""


SIDE_BY_SIDE = 1000
"""Most folders in one: file browsers, and some file systems, are slow with more."""


def among(number: int, of: int, name: str = "") -> str:
    """The name of a folder with a number; of more than SIDE_BY_SIDE, in one that holds as many: `12000/12345`."""
    name = name or str(number)
    return name if of <= SIDE_BY_SIDE else f"{number // SIDE_BY_SIDE * SIDE_BY_SIDE}/{name}"


class Placed(NamedTuple):
    """A value for a dotted path, and the positions of it and of what is inside it, by key relative to the path."""

    value: object
    marks: Marks


@dataclass(frozen=True)
class Variant:
    """One scenario with one combination of cases and values, from its nominal start or, in a task, from each of its starts."""

    scenario: Scenario
    values: Mapping[str, object]
    folder: str
    """Folder of its runs, below the comparison's folder."""
    draws: bool
    """Whether a seed draws anything."""
    starts: Starts | None = None
    """The scenario of each run of a task; None if a seed draws it."""
    amounts: tuple[str, ...] = ()
    """Labels of the runs of a task: `20 deg`."""
    runs: int | None = None
    """Number of runs of a task; None without a task: the comparison's seeds."""

    @property
    def unreachable(self) -> Mapping[int, str]:
        """Why the robot cannot stand where a run of a task begins, by the run's number."""
        every = range(0 if self.starts is None else len(self.starts))
        return {i: why for i in every if self.starts is not None and (why := self.starts.why_not(i))}


@dataclass(frozen=True)
class Job:
    """One run of a comparison."""

    controller: Variant
    seed: int | None
    of: int = 1
    """Number of runs of the controller."""

    @property
    def folder(self) -> str:
        """Folder of the run, below the comparison's folder."""
        return f"{self.controller.folder}/{'nominal' if self.seed is None else among(self.seed, self.of)}"

    def scenario(self) -> Scenario:
        """The scenario with its start and its noise drawn from the seed.

        Raises:
            UnreachableError: the robot cannot stand there. ParameterError: no start can be drawn.
        """
        found = self.controller
        if found.starts is not None and self.seed is not None:
            if why := found.starts.why_not(self.seed):
                raise UnreachableError("robot.start", why)
            return found.starts[self.seed].with_seed(self.seed)
        return found.scenario if self.seed is None or not found.draws else seeded(found.scenario, self.seed)


class Variants(Lazy[Variant]):
    """All controllers of a comparison: scenarios, cases, axes and tasks, the last varying fastest."""

    def __init__(self, comparison: Comparison):
        c = self._comparison = comparison
        axes = [list(cases) for cases in c.cases.values()] + [list(values) for values in c.axes.values()]
        self._words = [distinct([file_word(str(value)) for value in values]) for values in (*axes, *([list(c.tasks)] if c.tasks else []))]
        self._bases = distinct([file_word(Path(name).stem) for name in c.base])
        self._sizes = [len(c.base), *map(len, axes), max(len(c.tasks), 1)]
        self.task_runs = tuple(task.numbers(c.limit) for task in c.tasks.values()) or (None,)
        """Numbers of the runs of the controllers of each task; controller i is of task i modulo their number."""
        self._made = functools.lru_cache(maxsize=MOST_KEPT)(self._make)

    def __len__(self) -> int:
        return min(math.prod(self._sizes), sys.maxsize)

    def item(self, i: int) -> Variant:
        """Variant i."""
        return self._made(i)

    def _make(self, i: int) -> Variant:
        c = self._comparison
        base, *varied = self._places(i)
        of_cases, of_axes = varied[: len(c.cases)], varied[len(c.cases) : -1]
        task = list(c.tasks)[varied[-1]] if c.tasks else None
        cases = {name: list(those)[place] for (name, those), place in zip(c.cases.items(), of_cases, strict=True)}
        axes = {
            path: Placed(those[place], marks_under(("axes", path, place), c.places))
            for (path, those), place in zip(c.axes.items(), of_axes, strict=True)
        }
        blocks = [_settings(c, c.set, ("set",))]
        blocks += [_settings(c, c.cases[name][case], ("cases", name, case)) for name, case in cases.items()]
        values = cases | {path: setting.value for path, setting in axes.items()} | ({TASK: task} if task else {})
        words = [words[place] for words, place in zip(self._words, varied, strict=False)]  # without tasks the last place has no word
        # paths of fields are words of files, but the name of a case may be anything
        variant = allowed(",".join(f"{file_word(name, 150)}={word}" for name, word in zip(values, words, strict=True)) or AS_IT_IS)
        variants = math.prod(self._sizes[1:])
        place = f"runs/{self._bases[base]}/{among(i % variants, variants, variant)}"
        outer_first = dict(sorted(axes.items(), key=lambda axis: axis[0].count(".")))  # a whole block would overwrite its fields
        return _controller(c, base, merged(*blocks, outer_first), values, place, task)

    def _places(self, i: int) -> list[int]:
        """The place of controller i on each axis."""
        places = []
        for size in reversed(self._sizes):
            i, place = divmod(i, size)
            places.append(place)
        return places[::-1]


def _settings(c: Comparison, block: Mapping[str, object], key: Key) -> dict[str, Placed]:
    return {path: Placed(value, marks_under((*key, path), c.places)) for path, value in block.items()}


def controllers(comparison: Comparison, force: bool = False) -> Variants:
    """All controllers, the first MOST_RUNS of them loaded and checked: bad input is found before anything runs.

    Args:
        comparison: the plan. force: allow more than MOST_RUNS runs.

    Raises:
        ScenarioError: a scenario is invalid, or becomes so with a value of an axis.
        ParameterError: too many runs, or more than one seed for a scenario in which a seed draws nothing.
    """
    must_be_few(comparison, force)
    for i, name in enumerate(comparison.base):
        try:
            find(name)
        except ScenarioError as error:
            where = comparison.places.get(("base", i))
            raise (error if where is None else ScenarioError([Mistake(where, f"base.{i}", str(error))])) from None
    found = Variants(comparison)
    for _ in itertools.islice(found, MOST_RUNS):  # loads them
        pass
    return found


def must_be_few(comparison: Comparison, force: bool = False) -> None:
    """Refuse more than MOST_RUNS runs, unless by force.

    Raises:
        ParameterError: with the product of which the runs come.
    """
    c = comparison
    counts = [(len(c.base), "scenarios"), *((len(those), f"of {name}") for name, those in (c.cases | c.axes).items())]
    counts.append(
        (sum(len(task.numbers(c.limit)) for task in c.tasks.values()), "starts of the tasks") if c.tasks else (c.seeds or 1, "seeds")
    )
    total = math.prod(n for n, _ in counts)
    if total > MOST_RUNS and not force:
        product = " x ".join(f"{n:,} {what}" for n, what in counts if n > 1)
        raise ParameterError("comparison", f"would make {total:,} runs ({product}); more than {MOST_RUNS:,} need --force")


def _controller(
    c: Comparison, base: int, settings: Mapping[str, Placed], values: Mapping[str, object], folder: str, task_name: str | None
) -> Variant:
    name = c.base[base]
    if task_name is None:
        scenario = _load(c, name, settings)
        return Variant(scenario, values, folder, _seeds_draw(scenario, c.seeds or 1))
    task = c.tasks[task_name]
    settings = merged(settings, _settings(c, task.set, ("tasks", task_name, "set")))
    if task.seeds is not None:
        scenario = _load(c, name, settings)
        return Variant(scenario, values, folder, _seeds_draw(scenario, task.runs), None, task.labels(), task.runs)
    scenario = _load(c, name, merged(settings, _setting(c, task_name, task, 0)))
    starts = Starts(functools.partial(_start, c, scenario, name, settings, task_name), task.runs)
    if task.file is None:  # written by hand: mistakes are told before anything runs
        for _ in starts:
            pass
    return Variant(scenario, values, folder, scenario.draws, starts, task.labels(), task.runs)


def _start(c: Comparison, first: Scenario, name: str, settings: Mapping[str, Placed], task_name: str, i: int) -> tuple[Scenario, str]:
    """The scenario of run i of a task, and why the robot cannot stand where it begins; first: that of run 0."""
    task = c.tasks[task_name]
    scenario = _load(c, name, merged(settings, _setting(c, task_name, task, i))) if i and task.lists.each else first
    if not task.displacements:
        return scenario, ""
    try:
        return scenario.displaced(task.displacements[i], "camera" if task.lists.camera_from_goal else "target"), ""
    except UnreachableError as error:
        return scenario, error.problem


def _setting(c: Comparison, name: str, task: StartTable, i: int) -> dict[str, Placed]:
    """The settings of run i of a task with lists."""
    return {path: Placed(value, marks_under(("tasks", name, "each", path, i), c.places)) for path, value in task.setting(i).items()}


def _load(c: Comparison, name: str, settings: Mapping[str, Placed]) -> Scenario:
    values = {path: setting.value for path, setting in settings.items()}
    return load(name, values, places={path: setting.marks for path, setting in settings.items()}, plugins=c.plugins)


def _seeds_draw(scenario: Scenario, runs: int) -> bool:
    """Whether a seed draws anything, but an error where several runs would all be the same."""
    if runs > 1 and not scenario.draws:
        problem = "is missing, and nothing else is random: every seed would give the same run; add it, or noise, or leave --seeds out"
        raise ParameterError(f"{scenario.name}: robot.start.random", problem)
    return scenario.draws


class Jobs(Lazy[Job]):
    """All runs, seed by seed, so that the controllers can be compared at any time; a task has those of its table, or some of them."""

    def __init__(self, found: Sequence[Variant], seeds: int | None):
        self._found = found
        # the controllers of a comparison tell without being loaded
        numbers = found.task_runs if isinstance(found, Variants) else tuple(None if c.runs is None else tuple(range(c.runs)) for c in found)
        without_task = None if seeds is None else range(seeds)
        self._numbers = tuple(without_task if of_task is None else of_task for of_task in numbers)

    def __len__(self) -> int:
        if not self._numbers:
            return 0
        runs = sum(1 if n is None else len(n) for n in self._numbers)
        return min(runs * (len(self._found) // len(self._numbers)), sys.maxsize)

    def __iter__(self) -> Iterator[Job]:
        every = range(len(self._found))
        if None in self._numbers:
            yield from (Job(self._found[i], None) for i in every if self._numbers_of(i) is None)
        for turn in range(max(map(len, filter(None, self._numbers)), default=0)):
            yield from (job for i in every if (job := self._job(i, turn)))

    def _job(self, i: int, turn: int) -> Job | None:
        """The run of controller i in a turn; None where it has no more."""
        numbers = self._numbers_of(i) or ()
        return Job(self._found[i], numbers[turn], self._found[i].runs or len(numbers)) if turn < len(numbers) else None

    def _numbers_of(self, i: int) -> Sequence[int] | None:
        return self._numbers[i % len(self._numbers)]

    def item(self, i: int) -> Job:
        """Run i."""
        return next(itertools.islice(self, i, None))


def jobs(found: Sequence[Variant], seeds: int | None) -> Jobs:
    """All runs of controllers; `seeds` for those without a task, None for the nominal start."""
    return Jobs(found, seeds)
