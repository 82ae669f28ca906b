"""Plan of a comparison: scenarios, varied values, seeds or tasks; its controllers and runs, made
when their turn comes.
"""

from __future__ import annotations

import functools
import itertools
import json
import math
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, NamedTuple, TypeVar, overload

from annotated_types import Ge, Le, Len

from vstestbed.core.errors import Mistake, ParameterError, ScenarioError, UnreachableError
from vstestbed.core.files import allowed, distinct, file_word
from vstestbed.core.geometry import Pose
from vstestbed.core.named_files import bundled_comparisons, is_there, place_of_file
from vstestbed.core.quantity import Seed, TighterBounds
from vstestbed.core.spec import spec
from vstestbed.report.comparison.verdict import MARGIN
from vstestbed.scenario.load import find, load, seeded
from vstestbed.scenario.plugins import absolute_files, load_named, load_plugins
from vstestbed.scenario.scenario import Scenario
from vstestbed.scenario.yaml_marks import (
    Key,
    Marks,
    build,
    marks_under,
    place_of,
    plain_mapping,
    text_of,
)
from vstestbed.tasks.metrics import FIGURES, SOME_FIGURES, Metric, comparable, own_metrics

__all__ = [
    "AMOUNT",
    "CHECKED",
    "TASK",
    "TUNED",
    "Comparison",
    "Job",
    "Jobs",
    "Tuned",
    "Variant",
    "Variants",
    "changed",
    "chosen",
    "controllers",
    "must_be_few",
    "read_comparison",
]


class StartLists(NamedTuple):
    """The lists of a start table, one entry a run: values by dotted path, and displacements of the
    camera or of the target.
    """

    each: dict[str, tuple[Any, ...]]
    camera_from_goal: tuple[Pose, ...] = ()
    target_from_goal: tuple[Pose, ...] = ()


STARTS = 'JSON like {"camera_from_goal": [{"xyz": [0, 0, 0.1], "rpy_deg": [0, 0, 20]}]}'


@spec
class StartTable:
    """The starts of a task: run i has the i-th value of every list in `each`, the i-th
    displacement, or the start that seed i draws.

    Args:
        set: values by dotted path, for all runs of the task.
        each: lists of values by dotted path, all of the same length, one value per run.
        camera_from_goal: in place of `each`, or beside it: poses of the camera in the frame of the
            camera at its goal, for any arm, whose joints follow by inverse kinematics
            (`Scenario.displaced`).
        target_from_goal: in place of `camera_from_goal`: poses of the target in its frame at the
            goal, as the camera is to see it.
        seeds: in place of these lists: number of random starts.
        file: in place of these lists: a JSON file, relative to the comparison's, with one or more
            of `each`, `camera_from_goal` and `target_from_goal` as they are written here; e.g.
            `my_starts.json`.
        amounts: label of each run [unit as in `unit`]: 20 (deg), 40, ...; by default its number
            from 0, as in `seed` and in the name of its folder.
        unit: unit of the amounts.
    """

    set: dict[str, Any] = field(default_factory=dict)
    each: dict[str, tuple[Any, ...]] = field(default_factory=dict)
    camera_from_goal: tuple[Pose, ...] = ()
    target_from_goal: tuple[Pose, ...] = ()
    seeds: Annotated[int, Ge(1), Le(1_000_000)] | None = None
    file: str | None = None
    amounts: tuple[float, ...] = ()
    unit: str = ""

    def __post_init__(self) -> None:
        """Refuse lists of different lengths."""
        given = [
            bool(self.each or self.camera_from_goal or self.target_from_goal),
            self.file is not None,
            self.seeds is not None,
        ]
        if sum(given) != 1 or (self.camera_from_goal and self.target_from_goal):
            words = (
                "or camera_from_goal, target_from_goal,"
                " seeds or file must say what the runs of a task are"
            )
            raise ParameterError(
                "each",
                f"{words}; give one of the five, or each beside one of the two displacements",
            )
        self._check_lists()
        if self.amounts and len(self.amounts) != self.runs:
            raise ParameterError.count(
                "amounts", self.runs, "names, one for each run", list(self.amounts)
            )

    def _check_lists(self) -> None:
        found = self.lists
        lengths = {path: len(values) for path, values in found.each.items()}
        lengths |= {
            name: len(poses) for name, poses in found._asdict().items() if name != "each" and poses
        }
        where = "each" if self.file is None else "file"
        if 0 in lengths.values() or len(set(lengths.values())) > 1:
            raise ParameterError(
                where,
                "must have one value or more for each run in every list; their lengths are",
                lengths,
            )
        if not lengths and self.seeds is None:
            raise ParameterError(
                where, f"must hold one or more of {', '.join(StartLists._fields)}", self.file
            )

    @cached_property
    def lists(self) -> StartLists:
        """The lists given here, or those of the file."""
        if self.file is None:
            return StartLists(self.each, self.camera_from_goal, self.target_from_goal)
        return _read_lists(self.file)

    @property
    def runs(self) -> int:
        """Number of runs."""
        if self.seeds is not None:
            return self.seeds
        return len(self.displacements or next(iter(self.lists.each.values())))

    @property
    def displacements(self) -> tuple[Pose, ...]:
        """Those of the camera or of the target."""
        return self.lists.camera_from_goal or self.lists.target_from_goal

    def numbers(self, limit: int | None) -> tuple[int, ...]:
        """The numbers of the runs that are made, from 0: all, or `limit` of them, spread evenly; of
        random starts the first ones.
        """
        if limit is None or limit >= self.runs:
            return tuple(range(self.runs))
        if self.seeds is not None:
            return tuple(range(limit))
        # in the middle of equal parts
        return tuple((2 * i + 1) * self.runs // (2 * limit) for i in range(limit))

    def labels(self) -> tuple[str, ...]:
        """The label of each run; without amounts its number from 0, by which table and folder have
        it.
        """
        return tuple(
            f"{amount:g} {self.unit}".strip() for amount in self.amounts or range(self.runs)
        )


def _read_lists(file: str) -> StartLists:
    """The lists of a table's file. Raises ParameterError: it is not there, is no JSON, or holds
    something else.
    """
    path = place_of_file(file)
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
        unknown = set(found) - {*StartLists._fields, "about"}
        if unknown:
            raise ParameterError(
                "file",
                (
                    f"may have {', '.join(StartLists._fields)} and about;"
                    f" it also has {', '.join(unknown)}"
                ),
                file,
            )
        poses = {
            name: tuple(Pose(**pose) for pose in found.get(name, ()))
            for name in StartLists._fields[1:]
        }
        each = {str(key): tuple(values) for key, values in found.get("each", {}).items()}
    except (OSError, UnicodeDecodeError) as error:
        raise ParameterError.unreadable(
            "file", getattr(error, "strerror", None) or error, STARTS, file
        ) from None
    except RecursionError:
        raise ParameterError.unreadable("file", "it is nested too deeply", STARTS, file) from None
    except (ValueError, TypeError, AttributeError) as error:
        # a Pose of something else raises a ValueError, too
        raise ParameterError.unreadable("file", error, STARTS, file) from None
    return StartLists(each, **poses)


T = TypeVar("T")
# first seeds of the trials of a search, and of its check; comparisons have those below
TUNED, CHECKED = 2_000_000_000, 3_000_000_000
TASK, AMOUNT = "task", "amount"  # columns that only a comparison with tasks has
OWN_COLUMNS = (
    "scenario",
    "seed",
    "folder",
    TASK,
    AMOUNT,
    "attempts",
    "outcome",
    "success",
    "reason",
    *FIGURES,
    *SOME_FIGURES,
)
"""Columns of the table, whose names no case may have."""


@spec
class Tuned:
    """How the gains of a law were found: by a search over a range of each, from starts that no
    comparison has.

    Args:
        law: with what was found; e.g. `{kind: ibvs, gain: 2.889}`.
        scenario: its name, without a folder; e.g. `arm_ibvs`.
        set: values by dotted path that the comparison had for all laws; e.g.
            `{camera.latency_s: 0.04}`.
        vary: the range of each gain by dotted path, as of `tune`; e.g. `{law.gain: "0.3:8:log"}`.
        metric: name of `summary.json` by which trials were compared.
        trials: number of settings that were tried [1]; e.g. `12`.
        seeds: random starts of each trial [1]; none: the nominal start alone; e.g. `5`.
        first_seed: the first of their seeds.
    """

    law: dict[str, Any]
    scenario: str
    set: dict[str, Any] = field(default_factory=dict)
    vary: dict[str, Any]
    metric: str = "time_to_converge_s"
    trials: Annotated[Seed, TighterBounds(ge=1)]
    seeds: Annotated[Seed, TighterBounds(ge=1)] | None = None
    first_seed: Annotated[Seed, TighterBounds(ge=TUNED)] = TUNED

    @property
    def budget(self) -> str:
        """What a search may cost, and by what it judges: the same for all laws, or they are not
        compared fairly.
        """
        starts = (
            f"the seeds {self.first_seed} to {self.first_seed + self.seeds - 1}"
            if self.seeds
            else "the nominal start"
        )
        return f"{self.trials} trials from {starts} by {self.metric}"


@spec
class Comparison:
    """Every scenario with every combination of the cases and of the axes' values, in each task or
    from each seed.

    Args:
        description: one line for lists and reports.
        plugins: files or modules that add kinds, for all scenarios, besides their own; e.g.
            `[my_law.py]`.
        base: scenarios, by path or bundled name.
        set: values by dotted path, for all scenarios.
        cases: named settings of several fields at once:
            `law: {points: {law: {kind: ibvs}}, pose: {law: {kind: pbvs}}}` is an axis `law` with
            the values `points` and `pose`. They are applied after `set`, in their order.
        axes: lists of values (or of whole blocks) by dotted path; every combination is run. They
            are applied last, and a block before the fields within it.
        tasks: start tables by name, in place of seeds.
        seeds: number of seeds; seed i draws the start, the noise and the delays of run i, the same
            for every controller. None: the nominal start, once.
        first_seed: the first of these numbers. Searches (`tune`) use those from 2,000,000,000 on:
            no comparison shares a start with one.
        limit: of each task only so many runs, spread evenly over its list: a first look at a long
            one, 20 of 500; e.g. `20`.
        metrics: names of `summary.json` that the report shows; none: those of `report`, and the
            scenarios' own.
        primary: name of `summary.json` that decides a pair whose successes do not; without one the
            time to the goal, in which a run that failed counts with its limit (`time_to_goal_s`).
            Every other metric is exploratory; e.g. `final_position_error_m`.
        reference: the controller, by its name in the report, with which each other one is compared;
            without one all pairs are; e.g. `pbvs`.
        margin: share of the starts by which a law that is better by its time may reach the goal
            less often; declared before flying [1].
        tuned: how each law was tuned, by its name: a case, or a scenario. Without it for each, a
            comparison of laws is one of settings.
    """

    description: str = ""
    plugins: tuple[str, ...] = ()
    base: Annotated[tuple[str, ...], Len(1)]
    set: dict[str, Any] = field(default_factory=dict)
    cases: dict[str, dict[str, dict[str, Any]]] = field(default_factory=dict)
    axes: dict[str, tuple[Any, ...]] = field(default_factory=dict)
    tasks: dict[str, StartTable] = field(default_factory=dict)
    seeds: Annotated[Seed, TighterBounds(ge=1)] | None = None
    first_seed: Seed = 0
    limit: Annotated[Seed, TighterBounds(ge=1)] | None = None
    metrics: tuple[str, ...] = ()
    primary: str = ""
    reference: str = ""
    margin: Annotated[float, Ge(0), Le(0.5)] = MARGIN
    tuned: dict[str, Tuned] = field(default_factory=dict)
    places: Marks = field(default_factory=dict, init=False, repr=False, compare=False)
    """Position of each value in its file, or the option that it comes from; a value without one
    counts as of `--set`.
    """

    def __post_init__(self) -> None:
        """Refuse controllers that could not be distinguished, and metrics that no run has."""
        # the stem is the folder of the scenario's runs
        if len({Path(name).stem.casefold() for name in self.base}) < len(self.base):
            raise ParameterError.twice("base", "a scenario, or a file name,", list(self.base))
        self._check_axes()
        self._check_cases()
        self._check_starts()
        self._check_metrics()

    def _check_cases(self) -> None:
        taken = {*self.axes, *OWN_COLUMNS, *own_metrics(), ""}
        for name, cases in self.cases.items():
            if name in taken or not cases:
                raise ParameterError(
                    f"cases.{name}", "must have a name of its own, and one case or more"
                )

    def _check_starts(self) -> None:
        if self.tasks and self.seeds is not None:
            raise ParameterError.conflict(
                "seeds", "tasks, which say themselves how many runs there are,", self.seeds
            )
        if (self.seeds or 0) + self.first_seed > TUNED:
            most = TUNED - self.first_seed
            why = "the seeds from there on are those of searches"
            raise ParameterError.bound("seeds", "at most", most, self.seeds, why)
        if self.limit is not None and not self.tasks:
            what = "a comparison with `tasks`; of random starts `seeds` says how many"
            raise ParameterError.only_for("limit", what, self.limit)

    def _check_metrics(self) -> None:
        named = [("metrics", name) for name in self.metrics]
        if self.primary:
            named.append(("primary", self.primary))
        for place, name in named:
            known = comparable()
            if name not in known:
                raise ParameterError.choice(place, known, name)
        if self.primary and Metric.named(self.primary).better == 0:
            raise ParameterError(
                "primary",
                "must be a number of which more is better, or less; this one describes a run",
                self.primary,
            )

    def _check_axes(self) -> None:
        for path, values in self.axes.items():
            if not values or any(_same(a, b) for a, b in itertools.combinations(values, 2)):
                raise ParameterError(
                    f"axes.{path}", "must be a list of different values", list(values)
                )
            if path in self.set:
                raise ParameterError.conflict(f"axes.{path}", "the same field in `set`")
            for inner in (own for own in self.set if own.startswith(f"{path}.")):
                words = (
                    f"replaces the whole block, so that {inner} of `set` has no effect;"
                    f" vary {inner} as well (one value will do)"
                )
                raise ParameterError(f"axes.{path}", words)

    @property
    def varied(self) -> tuple[str, ...]:
        """The columns of the table that distinguish the controllers of one scenario."""
        return (*self.cases, *self.axes, *((TASK,) if self.tasks else ()))


def merged(*settings: Mapping[str, T]) -> dict[str, T]:
    """Values by dotted path, later mappings over earlier ones.

    A repeated path moves to the end, since settings are applied in order: a whole block such as
    `law` in between would overwrite it.
    """
    out: dict[str, T] = {}
    for one in settings:
        for path, value in one.items():
            out.pop(path, None)
            out[path] = value
    return out


def _same(a: object, b: object) -> bool:
    """Whether two values are equal in YAML: 3 and 3.0 are, 1 and true (equal in Python) are not."""
    return a == b and isinstance(a, bool) == isinstance(b, bool)


def read_comparison(path: Path, plugins: Sequence[str] = ()) -> Comparison:
    """Read a comparison's YAML file; scenario files in `base` are searched beside it first.
    `plugins`: besides its own.
    Raises ScenarioError: all mistakes in it, at once. PluginError: a plugin is not there or cannot
    be imported.
    """
    plain, marks = plain_mapping(text_of(path), str(path), "a comparison needs base")
    load_named(plain, marks, str(path), plugins)
    read = build(Comparison, absolute_files(plain, path.absolute().parent), marks, str(path))
    beside = tuple(str(path.parent / n) if is_there(path.parent / n) else n for n in read.base)
    return changed(read, marks, base=beside)


def changed(comparison: Comparison, places: Marks | None = None, **changes: Any) -> Comparison:
    """The comparison with other values, as by dataclasses.replace, and the positions of its values,
    or other ones.
    """
    new = replace(comparison, **changes)
    # no YAML field, and lost by `replace`
    object.__setattr__(new, "places", dict(comparison.places if places is None else places))
    return new


def chosen(
    names: list[str],
    settings: Mapping[str, object],
    axes: Mapping[str, tuple[object, ...]],
    plugins: Sequence[str] = (),
    **fields: Any,
) -> Comparison:
    """The comparison that a command line requests: of scenarios, or a comparison by its file or
    bundled name, with the options applied.

    Scenarios after a comparison's name take the place of its own. fields: other fields of it, such
    as `seeds`; one that is None is not given.

    Raises ScenarioError, ParameterError, PluginError: invalid input.
    """
    settings = absolute_files(settings, Path.cwd())
    axes = absolute_files(axes, Path.cwd())
    given = {name: value for name, value in fields.items() if value is not None}
    options: Marks = {("set", dotted): "--set" for dotted in settings}
    options |= {("axes", dotted): "--vary" for dotted in axes}
    if names[1:]:
        options[("base",)] = "SCENARIO"
    path = _comparison_file(names)
    if path is None:
        given |= {"set": dict(settings), "axes": dict(axes), "plugins": load_plugins(plugins)}
        return changed(Comparison(base=tuple(names), **given), options)
    read = read_comparison(path, plugins)
    _must_have_effect(read, settings)
    places = {key: where for key, where in read.places.items() if key[:2] not in options}
    return changed(
        read,
        places | options,
        base=tuple(names[1:]) or read.base,
        set=merged(read.set, settings),
        axes=read.axes | dict(axes),
        **given,
    )


def _comparison_file(names: Sequence[str]) -> Path | None:
    """The file of the comparison that the first of some names is; None where it is a scenario."""
    path = bundled_comparisons().get(names[0], Path(names[0])) if names else None
    if path is None or not is_there(path):
        return None
    needs = "a comparison needs base, a scenario robot, target, law and goal"
    plain, _ = plain_mapping(text_of(path), str(path), needs)
    return path if "base" in plain else None


def _must_have_effect(read: Comparison, paths: Iterable[str]) -> None:
    """Refuse a setting that whatever is applied after it writes over, in every run."""
    for path, blocks in itertools.product(paths, _after_set(read)):
        over = [
            (key, own)
            for key, block in blocks
            for own in block
            if path == own or path.startswith(f"{own}.")
        ]
        if over and len({key for key, _ in over}) == len(blocks):
            key, own = over[0]
            words = (
                f"has no effect: {'.'.join(map(str, key))} sets {own} after it"
                f" ({place_of((*key, own), read.places, '')})"
            )
            raise ScenarioError(
                [
                    Mistake(
                        "--set",
                        path,
                        (
                            f"{words}; --vary {path}=VALUE is applied last,"
                            " or change a copy of the file"
                        ),
                    )
                ]
            )


def _after_set(read: Comparison) -> Iterator[list[tuple[Key, Mapping[str, object]]]]:
    """What is applied after `set`: for each case and axis, and for the tasks, the alternatives with
    their keys, one of which a run has.
    """
    for name, cases in read.cases.items():
        yield [(("cases", name, case), settings) for case, settings in cases.items()]
    for path in read.axes:
        yield [(("axes",), {path: None})]
    if read.tasks:
        yield [
            (("tasks", name, "each" if task.each else "set"), task.set | task.each)
            for name, task in read.tasks.items()
        ]


# The controllers and runs of a comparison: counted before any is made, and made when their turn
# comes.

# scenarios of a task's runs that are kept in memory; of more, each is made again when its turn
# comes
STARTS_KEPT = 100


Start = Callable[[int], tuple[Scenario, str]]
"""The scenario of run i of a task, and why the robot cannot stand where it begins: "" where it can,
else it is not displaced.
"""


AS_IT_IS = "as_it_is"  # name of the variant of a scenario where nothing is varied
MOST_RUNS = 100_000
"""Runs that need no `--force`: over an hour of the quickest scenario (50 ms a run) on one core, and
tens of GB of run folders.
"""
# variants that are kept in memory (some 15 kB each); of more, each is loaded again when its turn
# comes
MOST_KEPT = 10_000


SIDE_BY_SIDE = 1000  # most folders in one: file browsers, and some file systems, are slow with more


def among(number: int, of: int, name: str = "") -> str:
    """The name of a folder with a number; of more than SIDE_BY_SIDE, in one that holds as many:
    `12000/12345`.
    """
    name = name or str(number)
    return name if of <= SIDE_BY_SIDE else f"{number // SIDE_BY_SIDE * SIDE_BY_SIDE}/{name}"


Positioned = tuple[object, Marks]
"""A value with position: for a dotted path, and the positions of it and of what is inside it, by
key relative to the path.
"""


@dataclass(frozen=True)
class Variant:
    """One scenario with one combination of cases and values, from its nominal start or, in a task,
    from each of its starts.
    """

    scenario: Scenario
    values: Mapping[str, object]
    folder: str  # Folder of its runs, below the comparison's folder
    draws: bool  # Whether a seed draws anything
    start: Start | None = None  # Makes the scenario of each run of a task; None if a seed draws it
    amounts: tuple[str, ...] = ()  # Labels of the runs of a task: `20 deg`
    runs: int | None = None  # Number of runs of a task; None without a task: the comparison's seeds

    @property
    def unreachable(self) -> Mapping[int, str]:
        """Why the robot cannot stand where a run of a task begins, by the run's number."""
        return (
            {}
            if self.start is None
            else {i: why for i in range(self.runs or 0) if (why := self.start(i)[1])}
        )

    @property
    def starts(self) -> list[Scenario]:
        """The scenario of each run of a task that has a list of them, also where it is
        `unreachable`.
        """
        return [] if self.start is None else [self.start(i)[0] for i in range(self.runs or 0)]


@dataclass(frozen=True)
class Job:
    """One run of a comparison."""

    controller: Variant
    seed: int | None
    of: int = 1  # Number of runs of the controller

    @property
    def folder(self) -> str:
        """Folder of the run, below the comparison's folder."""
        run = "nominal" if self.seed is None else among(self.seed, self.of)
        return f"{self.controller.folder}/{run}"

    def scenario(self) -> Scenario:
        """The scenario with its start and its noise drawn from the seed.
        Raises UnreachableError: the robot cannot stand there. ParameterError: no start can be
        drawn.
        """
        found = self.controller
        if found.start is not None and self.seed is not None:
            scenario, why = found.start(self.seed)
            if why:
                raise UnreachableError("robot.start", why)
            return scenario.with_seed(self.seed)
        return (
            found.scenario
            if self.seed is None or not found.draws
            else seeded(found.scenario, self.seed)
        )


class Variants(Sequence[Variant]):
    """All controllers of a comparison: scenarios, cases, axes and tasks,
    the last varying fastest.
    """

    def __init__(self, comparison: Comparison):
        c = self._comparison = comparison
        axes = [list(cases) for cases in c.cases.values()] + [
            list(values) for values in c.axes.values()
        ]
        self._words = [
            distinct([file_word(str(value)) for value in values])
            for values in (*axes, *([list(c.tasks)] if c.tasks else []))
        ]
        self._bases = distinct([file_word(Path(name).stem) for name in c.base])
        self._sizes = [len(c.base), *map(len, axes), max(len(c.tasks), 1)]
        self.task_runs = tuple(task.numbers(c.limit) for task in c.tasks.values()) or (None,)
        """Numbers of the runs of the controllers of each task; controller i is of task i modulo
        their number.
        """
        self._made = functools.lru_cache(maxsize=MOST_KEPT)(self._make)

    def __len__(self) -> int:
        return min(math.prod(self._sizes), sys.maxsize)

    @overload
    def __getitem__(self, i: int) -> Variant: ...
    @overload
    def __getitem__(self, i: slice) -> list[Variant]: ...
    def __getitem__(self, i: int | slice) -> Variant | list[Variant]:
        places = range(len(self))[i]
        return (
            self._made(places)
            if isinstance(places, int)
            else [self._made(place) for place in places]
        )

    def _make(self, i: int) -> Variant:
        c = self._comparison
        base, *varied = self._places(i)
        of_cases, of_axes = varied[: len(c.cases)], varied[len(c.cases) : -1]
        task = list(c.tasks)[varied[-1]] if c.tasks else None
        cases = {
            name: list(those)[place]
            for (name, those), place in zip(c.cases.items(), of_cases, strict=True)
        }
        axes = {
            path: (those[place], marks_under(("axes", path, place), c.places))
            for (path, those), place in zip(c.axes.items(), of_axes, strict=True)
        }
        blocks = [_settings(c, c.set, ("set",))]
        blocks += [
            _settings(c, c.cases[name][case], ("cases", name, case)) for name, case in cases.items()
        ]
        values = (
            cases
            | {path: value for path, (value, _) in axes.items()}
            | ({TASK: task} if task else {})
        )
        # without tasks the last place has no word
        words = [words[place] for words, place in zip(self._words, varied, strict=False)]
        # paths of fields are words of files, but the name of a case may be anything
        variant = allowed(
            ",".join(
                f"{file_word(name, 150)}={word}" for name, word in zip(values, words, strict=True)
            )
            or AS_IT_IS
        )
        variants = math.prod(self._sizes[1:])
        place = f"runs/{self._bases[base]}/{among(i % variants, variants, variant)}"
        # a whole block would overwrite its fields
        outer_first = dict(sorted(axes.items(), key=lambda axis: axis[0].count(".")))
        return _controller(c, base, merged(*blocks, outer_first), values, place, task)

    def _places(self, i: int) -> list[int]:
        """The place of controller i on each axis."""
        places = []
        for size in reversed(self._sizes):
            i, place = divmod(i, size)
            places.append(place)
        return places[::-1]


def _settings(c: Comparison, block: Mapping[str, object], key: Key) -> dict[str, Positioned]:
    return {path: (value, marks_under((*key, path), c.places)) for path, value in block.items()}


def controllers(comparison: Comparison, force: bool = False) -> Variants:
    """All controllers, the first MOST_RUNS of them loaded and checked: bad input is found before
    anything runs.

    comparison: the plan. force: allow more than MOST_RUNS runs. Raises ScenarioError: a scenario is
    invalid, or becomes so with a value of an axis. ParameterError: too many runs, or more than one
    seed for a scenario in which a seed draws nothing.
    """
    must_be_few(comparison, force)
    for i, name in enumerate(comparison.base):
        try:
            find(name)
        except ScenarioError as error:
            where = comparison.places.get(("base", i))
            raise (
                error if where is None else ScenarioError([Mistake(where, f"base.{i}", str(error))])
            ) from None
    found = Variants(comparison)
    file_of: dict[str, str] = {}
    for variant in itertools.islice(found, MOST_RUNS):  # loads them
        name, file = variant.scenario.name, variant.folder.split("/")[1]
        if file_of.setdefault(name, file) != file:  # the table would have both as one controller
            words = (
                f"has two scenarios of the name {name}, {file_of[name]} and {file};"
                " give each its own `name`"
            )
            raise ParameterError("base", words, list(comparison.base))
    return found


def must_be_few(comparison: Comparison, force: bool = False) -> None:
    """Refuse more than MOST_RUNS runs, unless by force. Raises ParameterError: with the product of
    which the runs come.
    """
    c = comparison
    counts = [
        (len(c.base), "scenarios"),
        *((len(those), f"of {name}") for name, those in (c.cases | c.axes).items()),
    ]
    counts.append(
        (sum(len(task.numbers(c.limit)) for task in c.tasks.values()), "starts of the tasks")
        if c.tasks
        else (c.seeds or 1, "seeds")
    )
    total = math.prod(n for n, _ in counts)
    if total > MOST_RUNS and not force:
        product = " x ".join(f"{n:,} {what}" for n, what in counts if n > 1)
        raise ParameterError(
            "comparison",
            f"would make {total:,} runs ({product}); more than {MOST_RUNS:,} need --force",
        )


def _controller(
    c: Comparison,
    base: int,
    settings: Mapping[str, Positioned],
    values: Mapping[str, object],
    folder: str,
    task_name: str | None,
) -> Variant:
    name = c.base[base]
    if task_name is None:
        scenario = _load(c, name, settings)
        return Variant(scenario, values, folder, _seeds_draw(scenario, c.seeds or 1))
    task = c.tasks[task_name]
    settings = merged(settings, _settings(c, task.set, ("tasks", task_name, "set")))
    if task.seeds is not None:
        scenario = _load(c, name, settings)
        return Variant(
            scenario,
            values,
            folder,
            _seeds_draw(scenario, task.runs),
            None,
            task.labels(),
            task.runs,
        )
    scenario = _load(c, name, merged(settings, _setting(c, task_name, task, 0)))
    start = functools.lru_cache(maxsize=STARTS_KEPT)(
        functools.partial(_start, c, scenario, name, settings, task_name)
    )
    if task.file is None:  # written by hand: mistakes are told before anything runs
        for i in range(task.runs):
            start(i)
    return Variant(scenario, values, folder, scenario.draws, start, task.labels(), task.runs)


def _start(
    c: Comparison,
    first: Scenario,
    name: str,
    settings: Mapping[str, Positioned],
    task_name: str,
    i: int,
) -> tuple[Scenario, str]:
    """The scenario of run i of a task, and why the robot cannot stand where it begins; first: that
    of run 0.
    """
    task = c.tasks[task_name]
    scenario = (
        _load(c, name, merged(settings, _setting(c, task_name, task, i)))
        if i and task.lists.each
        else first
    )
    if not task.displacements:
        return scenario, ""
    try:
        return scenario.displaced(
            task.displacements[i], "camera" if task.lists.camera_from_goal else "target"
        ), ""
    except UnreachableError as error:
        return scenario, error.problem


def _setting(c: Comparison, name: str, task: StartTable, i: int) -> dict[str, Positioned]:
    each = task.lists.each.items()
    return {
        path: (values[i], marks_under(("tasks", name, "each", path, i), c.places))
        for path, values in each
    }


def _load(c: Comparison, name: str, settings: Mapping[str, Positioned]) -> Scenario:
    values = {path: value for path, (value, _) in settings.items()}
    return load(
        name,
        values,
        places={path: marks for path, (_, marks) in settings.items()},
        plugins=c.plugins,
    )


def _seeds_draw(scenario: Scenario, runs: int) -> bool:
    """Whether a seed draws anything, but an error where several runs would all be the same."""
    if runs > 1 and not scenario.draws:
        problem = (
            "is missing, and nothing else is random: every seed would give the same run;"
            " add it, or noise, or leave --seeds out"
        )
        raise ParameterError(f"{scenario.name}: robot.start.random", problem)
    return scenario.draws


class Jobs:
    """All runs, seed by seed, so that the controllers can be compared at any time; a task has those
    of its table, or some of them.

    Args:
        found: the controllers. seeds: how many of those without a task, from `first` on; None: the
            nominal start.
    """

    def __init__(self, found: Sequence[Variant], seeds: int | None, first: int = 0):
        self._found = found
        # the controllers of a comparison tell without being loaded
        numbers = (
            found.task_runs
            if isinstance(found, Variants)
            else tuple(None if c.runs is None else tuple(range(c.runs)) for c in found)
        )
        without_task = None if seeds is None else range(first, first + seeds)
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
            for i in every:
                numbers = self._numbers_of(i) or ()
                if turn < len(numbers):
                    yield Job(self._found[i], numbers[turn], self._found[i].runs or len(numbers))

    def __getitem__(self, i: int) -> Job:
        return next(itertools.islice(self, range(len(self))[i], None))

    def _numbers_of(self, i: int) -> Sequence[int] | None:
        return self._numbers[i % len(self._numbers)]
