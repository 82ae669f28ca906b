"""Marks for a student's file: a lab as YAML, starts that the student has not seen, and the reason
for each point that is not given.
"""

from __future__ import annotations

import statistics
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

import polars as pl
from annotated_types import Ge, Le, Len

from vstestbed.core.errors import Mistake, ParameterError, ScenarioError, VstestbedError
from vstestbed.core.files import write_json, write_whole
from vstestbed.core.named_files import bundled_scenarios, is_there
from vstestbed.core.quantity import PositiveTime
from vstestbed.core.registry import to_mapping
from vstestbed.core.spec import spec
from vstestbed.laws import LAWS
from vstestbed.loop.isolated import MODULE, Child, Isolated, offered, shown
from vstestbed.loop.session import run, uninterrupted
from vstestbed.report.comparison.pairs import pairs
from vstestbed.report.comparison.results import ComparisonResults
from vstestbed.report.marks import counted, number
from vstestbed.scenario.load import load
from vstestbed.scenario.plugins import absolute_files
from vstestbed.scenario.yaml_marks import build, plain_mapping, text_of
from vstestbed.tasks.metrics import comparable
from vstestbed.testing.laws import check_law
from vstestbed.testing.likeness import Likeness

Points = Annotated[float, Ge(0), Le(1000)]
Block = str | dict[str, Any]


@spec
class Needs:
    """Limits of a number.

    Args:
        at_most: upper limit, in the unit of `summary.json`; e.g. `1.2`.
        at_least: lower limit; e.g. `10`.
    """

    at_most: float | None = None
    at_least: float | None = None

    def missed(self, value: float) -> str:
        """By how much, in words; "" where the value is within the limits."""
        if self.at_most is not None and not value <= self.at_most:
            return f"is {number(value)}, at most {number(self.at_most)} is allowed"
        if self.at_least is not None and not value >= self.at_least:
            return f"is {number(value)}, at least {number(self.at_least)} is asked for"
        return ""


@spec
class Further:
    """Further runs of a task, from the same starts.

    Args:
        set: values by dotted path, put over those of the task; e.g. `{law.jacobian: mean}`.
        median: limits, as those of the task.
    """

    set: dict[str, Any]
    median: dict[str, Needs] = field(default_factory=dict)

    def __post_init__(self) -> None:
        _known_metrics(self.median, "median")


@spec
class LabTask:
    """What a student's kind has to do, for points that are given whole or not at all.

    Args:
        title: what is asked; e.g. `It reaches its goal.`.
        points: for it; e.g. `3`.
        scenario: a bundled one, or a file beside the lab's; e.g. `ibvs_book`.
        set: values by dotted path, put over it and over the student's kind.
        seeds: number of random starts; 0: the nominal one alone.
        limit_s: time for all answers of the student's code in it, of which each run has its share
            [s].
        reached: from how many of them the goal has to be reached; null: from all, or from any
            number with `better_than`.
        median: limits of medians over the runs that reached it, by the names in `summary.json`;
            e.g. `{path_ratio: {at_most: 1.2}}`.
        better_than: another kind, in place of the student's, than which it has to be better by the
            verdict of a comparison from these starts; e.g. `{kind: ibvs, gain: 0.5}`.
        by: the metric that decides this verdict where both reach the goal alike.
        also: further settings with which it has to be done, so that a field that changes nothing
            has no points.
        may_be: bundled kinds whose commands the student's law may give, those that are to be
            written; the commands of another one have no points. null: of any.
    """

    title: str
    points: Points
    scenario: str
    set: dict[str, Any] = field(default_factory=dict)
    seeds: Annotated[int, Ge(0), Le(1000)] = 10
    limit_s: PositiveTime = 300.0
    reached: Annotated[int, Ge(0)] | None = None
    median: dict[str, Needs] = field(default_factory=dict)
    better_than: Block | None = None
    by: str = "time_to_goal_s"
    also: tuple[Further, ...] = ()
    may_be: tuple[str, ...] | None = None

    def __post_init__(self) -> None:
        if self.reached is not None and self.reached > max(self.seeds, 1):
            raise ParameterError.bound(
                "reached", "at most", f"the {max(self.seeds, 1)} runs of `seeds`", self.reached
            )
        _known_metrics(self.median, "median")
        _known_metrics([self.by], "by")
        for kind in self.may_be or ():
            if kind not in LAWS.members:
                raise ParameterError.choice("may_be", LAWS.members, kind)

    @property
    def parts(self) -> list[LabTask]:
        """It, and its further settings as tasks of their own."""
        alone = replace(self, better_than=None)
        others = [replace(alone, set=self.set | each.set, median=each.median) for each in self.also]
        return [self, *others]

    def needed(self, runs: int) -> int:
        """From how many of these runs the goal has to be reached."""
        if self.reached is not None:
            return self.reached
        return runs if self.better_than is None else 0


def _known_metrics(names: Iterable[str], where: str) -> None:
    for name in names:
        if name not in comparable():
            raise ParameterError.choice(where, comparable(), name)


@spec
class Lab:
    """A lab: the kind that a student's file adds, and what it has to do.

    Args:
        title: of the sheet of marks.
        kind: the word of the student's kind; e.g. `my_law`.
        field: where it stands in a scenario: `law`, or within it, such as `law.feature`. Other
            kinds would be part of what judges them.
        check: points for passing `vstestbed.testing.check_law`, and at least one of the tasks: a
            file as `vstestbed new` writes it passes the former; 0: it is not asked for.
        tasks: what it has to do.
    """

    title: str
    kind: str
    field: str = "law"
    check: Points = 0.0
    tasks: Annotated[tuple[LabTask, ...], Len(1, 50)]

    def __post_init__(self) -> None:
        if self.field.partition(".")[0] != "law":
            why = "a robot, a detector or a goal would be part of what judges it"
            raise ParameterError.fixed(
                "field", "law, or within it, such as law.feature", self.field, why=why
            )


@dataclass(frozen=True)
class Result:
    """A task with the points for it, and why they were not given; no reason: they were."""

    title: str
    points: float
    reasons: tuple[str, ...]

    @property
    def given(self) -> float:
        """All of them, or none."""
        return 0.0 if self.reasons else self.points


@dataclass(frozen=True)
class Mark:
    """The marks of one file. missing: a result is, since the code could not be loaded, ended its
    process, or took too long.
    """

    lab: str
    file: str
    results: tuple[Result, ...]
    missing: bool = False

    @property
    def points(self) -> tuple[float, float]:
        """Those given, and all."""
        given = sum(result.given for result in self.results)
        return given, sum(result.points for result in self.results)

    def plain(self) -> dict[str, Any]:
        """For JSON."""
        given, all_of = self.points
        tasks = [asdict(result) | {"given": result.given} for result in self.results]
        return {"lab": self.lab, "file": self.file, "points": given, "of": all_of, "tasks": tasks}

    def markdown(self) -> str:
        """A table for people."""
        given, all_of = self.points
        lines = [
            f"# {self.lab}",
            "",
            f"**{given:g} of {all_of:g} points** ({self.file})",
            "",
            "| task | points | why |",
            "|---|---|---|",
        ]
        for r in self.results:
            # in one line: what a student's exception says begins no row of its own
            why = " ".join(" ".join(r.reasons).split()).replace("|", "/") or "passed"
            lines.append(f"| {r.title} | {r.given:g} of {r.points:g} | {why} |")
        return "\n".join([*lines, ""])

    def write(self, folder: Path) -> None:
        """`mark.json` and `mark.md`."""
        write_json(folder / "mark.json", self.plain())
        write_whole(folder / "mark.md", self.markdown().encode())


def read_lab(path: Path) -> Lab:
    """A lab's file. Raises ScenarioError: all mistakes in it at once; or in a task's scenario and
    settings, but for those of the student's kind.
    """
    plain, marks = plain_mapping(text_of(path), str(path), "a lab needs title, kind and tasks")
    lab = build(Lab, plain, marks, str(path))
    for i, whole in enumerate(lab.tasks):
        try:
            for task in whole.parts:
                _check_scenario(task, path)
        except ScenarioError as error:
            raise ScenarioError(
                [replace(each, where=f"{path}: tasks.{i}") for each in error.mistakes]
            ) from None
    return lab


def _check_scenario(task: LabTask, lab: Path) -> None:
    """Refuse a task whose scenario has mistakes, but for those of the student's law, or whose end
    its law would tell; ScenarioError.
    """
    named = absolute_files(task.set, lab.absolute().parent)
    others = {key: value for key, value in named.items() if not _of_law(key)}
    scenario = load(_place(task.scenario, lab.parent), others)
    if scenario.stop.converged.error_grey is not None:
        words = "is told by the law itself, and gives no marks; works: null, with another condition"
        raise ScenarioError([Mistake("", "stop.converged.error_grey", words)])


def _of_law(path: str) -> bool:
    """Whether a dotted path is of the law."""
    return path.partition(".")[0] == "law"


def grade(
    lab: Lab,
    student: Path,
    first_seed: int = 0,
    beside: Path | None = None,
    on_task: Callable[[str], None] = lambda title: None,
) -> Mark:
    """Mark a student's file. Its code is run in processes of their own (`loop.isolated`), which get
    observations alone.

    first_seed: of the random starts; one that students do not know keeps them from fitting to these
    starts. beside: folder of the lab's file, in which scenarios are searched first; None: they are
    bundled ones. on_task: is told the title of each task as it begins.
    """
    place = student.absolute()
    results: list[Result] = []
    lost = Child.lost
    with offered():
        refused = _refused(lab, place)
        unchecked = refused
        if lab.check:
            on_task("check")
            unchecked = refused or tuple(_unchecked(lab, place))
        for task in lab.tasks:
            on_task(task.title)
            reasons = refused or _all_reasons(lab, task, place, first_seed, beside)
            results.append(Result(task.title, task.points, reasons))
        missing = bool(refused) or Child.lost > lost
    if lab.check:
        if not any(result.given for result in results):
            unchecked = unchecked or ("It does none of the tasks.",)
        results.insert(0, Result("It passes the suite of its room.", lab.check, unchecked))
    return Mark(lab.title, shown(student.name), tuple(results), missing)


def _apart(lab: Lab, student: Path, block: Any, run_s: float | None = None) -> dict[str, Any]:
    """The block of a law in a process of its own, which loads the student's file.

    run_s: for loading it and for all answers in a run [s]; None: what the lab gives for a whole
    task, where no run of a task says less.
    """
    place = {"files": [str(student)], "adds": lab.kind, "reads": str(student.parent)}
    most = max(task.limit_s for task in lab.tasks)
    return {"kind": "isolated", "block": block, **place, "run_s": most if run_s is None else run_s}


def _refused(lab: Lab, student: Path) -> tuple[str, ...]:
    """Why the file is not marked at all; nothing where it can be loaded, and adds the lab's
    kind.
    """
    try:
        Isolated(**_apart(lab, student, {"kind": lab.kind if lab.field == "law" else "ibvs"}))
    except ParameterError as error:
        if error.field == "files":
            return (f"The file {error.problem}",)
    return ()


def _unchecked(lab: Lab, student: Path) -> Iterator[str]:
    """Why a law does not pass its suite; nothing where it does."""
    try:
        check_law(Isolated(**_apart(lab, student, {"kind": lab.kind})))
    except Exception as error:
        # an assertion's; and whatever the numbers of a law bring about in the loop
        Child.lost += not isinstance(error, AssertionError | VstestbedError)
        yield str(error).replace("isolated", lab.kind)


def _all_reasons(
    lab: Lab, task: LabTask, student: Path, first_seed: int, beside: Path | None
) -> tuple[str, ...]:
    """Why the points of a task, with its further settings, are not given; each reason once."""
    found: dict[str, None] = {}
    for part in task.parts:
        found |= dict.fromkeys(_reasons(lab, part, student, first_seed, beside))
    return tuple(found)


def _reasons(
    lab: Lab, task: LabTask, student: Path, first_seed: int, beside: Path | None
) -> Iterator[str]:
    """Why the points of one of a task's parts are not given."""
    like = Likeness({path.removeprefix("law."): value for path, value in task.set.items()})
    watch = Child.watch = None if task.may_be is None else like
    try:
        own = _runs(lab, task, student, first_seed, beside, watch)
    except Exception as error:
        # a refusal's; and whatever the numbers of a law bring about in the loop
        Child.lost += not isinstance(error, VstestbedError)
        yield f"It cannot be run: {error}"
        return
    finally:
        Child.watch = None
    if same := like.found(task.may_be or ()):
        yield f"Its commands are those of {same}, which is there already."
    yield from _missed(task, own)
    if task.better_than is not None:
        yield from _not_better(own, _runs(lab, task, None, first_seed, beside), task.by)


def _missed(task: LabTask, own: list[dict[str, Any]]) -> Iterator[str]:
    """What runs of a task are short of, by their summaries."""
    good = [row for row in own if row["success"]]
    needed = task.needed(len(own))
    if len(good) < needed:
        yield from _too_few(own, needed)
    for name, bounds in task.median.items():
        values = [float(row[name]) for row in good if row.get(name) is not None]
        missed = "is unknown, since no run reached the goal"
        if values:
            missed = bounds.missed(statistics.median(values))
        if missed:
            yield f"The median of {name} {missed}."


def _too_few(own: list[dict[str, Any]], needed: int) -> Iterator[str]:
    """That too few runs reached the goal, how the others ended, and why the law failed in one."""
    failures = [row for row in own if not row["success"]]
    ends = Counter(str(row["outcome"]) for row in failures)
    listed = ", ".join(f"{n} {end}" for end, n in ends.most_common())
    good = len(own) - len(failures)
    reached = f"{good} of {counted(len(own), 'run')} reached the goal"
    yield f"{reached}, {needed} are needed ({listed})."
    for row in failures:
        if row["outcome"] == "law_failed" and row["reason"]:
            yield f"The law failed: {row['reason']}."
            return


def _runs(
    lab: Lab,
    task: LabTask,
    student: Path | None,
    first_seed: int,
    beside: Path | None,
    like: Likeness | None = None,
) -> list[dict[str, Any]]:
    """Summaries of a task's runs, of the student's kind or (None) of the one that it has to be
    better than. like: flies bundled laws beside it.
    """
    place = _place(task.scenario, beside)
    seeds = range(first_seed, first_seed + task.seeds) if task.seeds else (None,)
    settings = absolute_files(task.set, beside or Path())
    if student is None:
        changes = {lab.field: task.better_than} | settings
    else:  # what is said of the law goes to the one inside
        law = to_mapping(load(place).law)
        changes = {"law": _apart(lab, student, law, task.limit_s / len(seeds))}
        for path, value in ({lab.field: {"kind": lab.kind}} | settings).items():
            changes[f"law.block{path[3:]}" if _of_law(path) else path] = value
    found = []
    for seed in seeds:
        scenario = load(place, changes, seed=seed, plugins=[MODULE])
        watch = []
        if like is not None:
            scenario = like.beside(scenario)
            watch.append(like)
        found.append(uninterrupted(run(scenario, watch)).summary())
    return found


def _not_better(own: list[dict[str, Any]], others: list[dict[str, Any]], by: str) -> Iterator[str]:
    """Why there is no verdict for the student's kind, from the same starts."""
    names = ("seed", "success", by)
    rows = []
    for who, runs in (("other", others), ("own", own)):
        rows += [{"scenario": who} | {name: row[name] for name in names} for row in runs]
    table = pl.DataFrame(rows, infer_schema_length=None)
    (pair,) = pairs(ComparisonResults(table, (), (), primary=by))
    if pair.better != 1:
        count = sum(bool(row["success"]) for row in own)
        other = sum(bool(row["success"]) for row in others)
        reached = f"it reached the goal from {count} of {len(own)} starts, the other from {other}"
        verdict = "the other is better" if pair.better == 0 else "these starts show neither better"
        yield f"It is not better: {verdict} ({reached})."


def _place(name: str, beside: Path | None) -> str:
    """A task's scenario: beside the lab's file, else a bundled one; never of the current folder,
    which may be the student's.
    """
    if beside is None or (name in bundled_scenarios() and not is_there(beside / name)):
        return name
    return str((beside / name).absolute())
