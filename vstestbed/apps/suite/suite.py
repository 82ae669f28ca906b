"""The suite: the same tasks for any law, and how laws score and rank on them.

A task is a comparison without laws; the suite's laws, and a law of one's own, are its cases. What a
law cannot take part in is left blank, with the sentence that refused it, and counts neither for nor
against it. Runs, tables and statistics are those of `compare`.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import re
import shlex
from collections.abc import Callable, Container, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any

import polars as pl
from annotated_types import Ge

from vstestbed.apps.suite.scores import Score, TaskOfSuite, write_scores
from vstestbed.core.errors import ParameterError, VstestbedError, nearest, short
from vstestbed.core.files import make_folder, read_json, write_whole
from vstestbed.core.named_files import folder, is_there
from vstestbed.core.quantity import PositiveTime
from vstestbed.core.spec import spec
from vstestbed.laws import LAWS
from vstestbed.loop.isolated import MODULE, Isolated, honest
from vstestbed.scenario.load import find
from vstestbed.scenario.plugins import absolute_files, load_plugins
from vstestbed.scenario.yaml_marks import build, plain_mapping, text_of
from vstestbed.studies.comparison import PLAN, begun, merge, resumed
from vstestbed.studies.comparison.folder import ComparisonTable
from vstestbed.studies.comparison.plan import (
    TASK,
    Comparison,
    Job,
    Jobs,
    Variants,
    changed,
    controllers,
    read_comparison,
)
from vstestbed.studies.comparison.record import files_in, is_bundled, needed_files
from vstestbed.studies.comparison.runs import OnDone
from vstestbed.studies.comparison.shards import Shard
from vstestbed.studies.pools import workers
from vstestbed.tasks.metrics import Metric

NAME = "VS-1"
TO_GOAL = "time_to_goal_s"  # the metric of which each failed run has a number
PLAIN_NAME = re.compile(r"[A-Za-z0-9_.-]+")  # of a law in tables, so that no two look alike
LAW = "law"  # the axis of the laws in each comparison
HOW = (
    "Successes with Wilson intervals; the mean of each task's number,"
    " in which a failure counts the task's limit, with Student's interval, as flown;"
    " ranks by it, from 1 + the laws that beat a law to as many as it does not beat,"
    " by paired t-tests of all pairs of the task's laws after Holm's correction."
    " The mean of the ranks stands beside its parts, with bootstrap intervals:"
    " on these tasks, from other starts, and on tasks like these."
)
# the random starts that a word draws; those of the plans are the first
HIDDEN_FROM, HIDDEN_SEEDS = 1_000_000, 900_000_000


@spec
class SuiteTask:
    """One task of a suite.

    Args:
        plan: file of its comparison, beside the suite's; e.g. `arm.yaml`.
        asks: what it asks of a law, in words.
        metric: by which laws are ranked: a number of a run's summary, of which less is better.
        worst: the number of a run that ended early, and the largest that counts, in the summary's
            unit; null: what the summary says; e.g. `0.2`.
        quick: starts of each of the plan's lists with `--quick` [1].
        run_s: processor time of a run, as it was measured [s]; null: not known; e.g. `0.5`.
    """

    plan: str
    asks: str = ""
    metric: str = TO_GOAL
    worst: float | None = None
    quick: Annotated[int, Ge(1)] = 2
    run_s: PositiveTime | None = None


@spec
class SuiteLaw:
    """A law as it flies the tasks.

    Args:
        law: its block, as a scenario has it.
        tasks: by task, what differs there: values of the block by name, or, for a task that it does
            not fly, why, in words; e.g. `{craft: {gain: 0.3}}`.
    """

    law: dict[str, Any]
    tasks: Mapping[str, dict[str, Any] | str] = field(
        default_factory=dict[str, dict[str, Any] | str]
    )


@spec
class TaskSuite:
    """A suite's file.

    Args:
        description: one line.
        laws: by name: the first rows of each table.
        tasks: by name.
    """

    description: str = ""
    laws: dict[str, SuiteLaw]
    tasks: dict[str, SuiteTask]


def read_suite(name: str = NAME) -> tuple[TaskSuite, Path]:
    """A suite by its bundled name, which no file in the current folder takes, or its file; and that
    file. ScenarioError: its mistakes.
    """
    bundled = folder("scenarios") / "suite" / f"{name}.yaml"
    path = Path(name) if is_there(Path(name)) and not is_there(bundled) else bundled
    plain, marks = plain_mapping(text_of(path), str(path), "a suite needs laws and tasks")
    return build(TaskSuite, plain, marks, str(path)), path


def fingerprint(suite: TaskSuite, path: Path) -> str:
    """What identifies the frozen tasks: SHA-256 of the suite's file and plans, and of the scenarios
    and lists of starts that they name.
    """
    found = hashlib.sha256(path.read_bytes())
    for plan in dict.fromkeys(path.parent / task.plan for task in suite.tasks.values()):
        comparison = read_comparison(plan)
        starts = [Path(task.file) for task in comparison.tasks.values() if task.file is not None]
        for file in (plan, *map(find, comparison.base), *starts):
            found.update(file.read_bytes())
    return found.hexdigest()


def kept_runs(suite: TaskSuite, path: Path) -> pl.DataFrame | None:
    """The runs of the suite's own laws that are kept beside its file; None where none are, or where
    they are of other tasks.
    """
    place = path.with_suffix(".csv")
    if (
        not is_there(place)
        or place.read_text(encoding="utf-8").splitlines()[0] != f"# {fingerprint(suite, path)}"
    ):
        return None
    return pl.read_csv(
        place, comment_prefix="#", schema_overrides={"start": pl.String, "value": pl.Float64}
    )


def law_of_file(file: str, apart: bool = False) -> tuple[str, SuiteLaw, tuple[str, ...]]:
    """Name, law and plugins of a law of one's own: a YAML file with `law` (and `tasks`, `plugins`),
    or a plugin with one law, as it is by default. apart: a plugin is not loaded here, and which law
    it has is left open.
    Raises ParameterError: it has none, or several. PluginError, ScenarioError: it cannot be read.
    """
    path = Path(file)
    if path.suffix in (".yaml", ".yml"):
        return _law_of_yaml(path, file)
    if apart:
        return path.stem, SuiteLaw(law={}), (str(path.absolute()),)
    before = set(LAWS.members)
    (plugin,) = load_plugins([file])
    own = [
        kind
        for kind, cls in LAWS.members.items()
        if kind not in before or cls.__module__ == path.stem
    ]
    if len(own) != 1:
        raise ParameterError(
            "LAW_FILE",
            "must add one law; of several, name one in a YAML file with law and plugins",
            own or file,
        )
    return path.stem, SuiteLaw(law={"kind": own[0]}), (plugin,)


def _law_of_yaml(path: Path, file: str) -> tuple[str, SuiteLaw, tuple[str, ...]]:
    plain, marks = plain_mapping(text_of(path), file, "a law's file needs law")
    plugins = plain.pop("plugins", None) or []
    if not isinstance(plugins, list) or not all(isinstance(name, str) for name in plugins):
        raise ParameterError(
            "plugins", "must be a list of the law's files, such as [mine.py]", plugins
        )
    beside = tuple(str(path.parent / name) for name in plugins)
    return path.stem, build(SuiteLaw, plain, marks, file), beside


def _inside(path: Path, main: Path) -> Path:
    """A file as it lies in the folder of a law's file, or below it, also when links are followed.
    ParameterError: it does not.
    """
    place, plain = main.parent, Path(os.path.normpath(path.absolute()))
    if plain.is_relative_to(place) and path.resolve().is_relative_to(place.resolve()):
        return plain.relative_to(place)
    raise ParameterError(
        "LAW_FILE",
        f"needs {path}, which must be in the folder of {main.name}, or below it",
        str(main),
    )


@dataclass(frozen=True)
class SuiteEntry:
    """A suite that is to be flown.

    laws: by name. plugins: that they need. quick: few starts of each task. word: draws the random
    starts, None for the plans' own.
    file: of the law of one's own, None without one. apart: files of laws that fly in a process of
    their own (`loop.isolated`); None: they fly in this one.
    """

    suite: TaskSuite
    path: Path
    laws: Mapping[str, SuiteLaw]
    plugins: tuple[str, ...] = ()
    quick: bool = False
    word: str | None = None
    file: str | None = None
    apart: tuple[str, ...] | None = None
    # why a law takes no part in a task, by law and task
    blank: dict[tuple[str, str], str] = field(default_factory=dict)

    def block(self, name: str, task: str) -> dict[str, Any] | str:
        """The block of a law in a task, with its files by their whole names, or why it does not fly
        it.
        """
        law = self.laws[name]
        if isinstance(other := law.tasks.get(task, {}), str):
            return other
        place = self.path if name in self.suite.laws else Path(self.file or "")
        beside = place.absolute().parent
        block = absolute_files({**({} if "kind" in other else law.law), **other}, beside)
        if self.apart is None:
            return block
        return {"kind": "isolated", "files": [*self.apart], "reads": str(beside), "block": block}

    def plan(self, task: str) -> Comparison | None:
        """The comparison of a task, of the laws that take part in it; None where none does. Those
        that do not are noted in `blank`.
        """
        asked = self.suite.tasks[task]
        own = read_comparison(self.path.parent / asked.plan, self.plugins)
        fields: dict[str, Any] = {"plugins": (*own.plugins, *self.plugins)}
        fields |= {"limit" if own.tasks else "seeds": asked.quick} if self.quick else {}
        own = changed(own, None, **fields, **({} if own.tasks else {"first_seed": self.first_seed}))
        cases: dict[str, dict[str, Any]] = {}
        for name in self.laws:
            if isinstance(block := self.block(name, task), str):
                self.blank[name, task] = block
                continue
            try:
                flown = controllers(
                    changed(
                        own,
                        cases={LAW: {name: {"law": block}}} | own.cases,
                        tasks={},
                        limit=None,
                        seeds=None,
                    )
                )
                if name not in self.suite.laws:
                    for each in flown:
                        honest(each.scenario.law.depth)
            except VstestbedError as error:
                self.blank[name, task] = (
                    str(error).splitlines()[0].replace(f"{self.path.parent}/", "")
                )
            else:
                cases[name] = {"law": block}
        return changed(own, cases={LAW: cases} | own.cases) if cases else None

    @cached_property
    def plans(self) -> dict[str, Comparison]:
        """The comparisons of all tasks that a law takes part in; `blank` says of the others why
        not.
        """
        return {task: plan for task in self.suite.tasks if (plan := self.plan(task)) is not None}

    def jobs(self, task: str) -> dict[str, Job]:
        """The runs of a task by their starts, as `rows_of` names them; of one law."""
        plan, found = self.plans[task], dict[str, Job]()
        for job in Jobs(controllers(plan), plan.seeds, plan.first_seed):
            parts = [
                str(job.controller.values[name])
                for name in (*plan.cases, TASK)
                if name in job.controller.values and name != LAW
            ]
            seed = job.controller.scenario.seed if job.seed is None else job.seed
            found[" ".join([*parts, str(seed)])] = job
        return found

    @property
    def total(self) -> int:
        """How many runs it has."""
        return sum(map(self._runs, self.plans))

    def effort(self, shards: int = 1, jobs: int | None = None) -> str:
        """How many runs one of so many shards has, and about how long they take here, in words."""
        hours = (
            sum(
                self._runs(task) * (self.suite.tasks[task].run_s or math.nan) for task in self.plans
            )
            / shards
            / 3600
        )
        runs = self.total // shards
        if math.isnan(hours):
            return f"{runs:,} runs"
        cores = workers(jobs, runs)
        return (
            f"{runs:,} runs, about {hours:.1f} processor hours;"
            f" here, {cores} at a time, about {hours / cores:.1f} h"
        )

    def _runs(self, task: str) -> int:
        plan = self.plans[task]
        return len(Jobs(Variants(plan), plan.seeds, plan.first_seed))

    @property
    def about(self) -> dict[str, Any]:
        """What is flown, in plain values: name, hash of the frozen files, laws, starts."""
        few, drawn = (
            ("the first starts of each list", self.quick),
            (f"random starts from {self.first_seed} on", self.word is not None),
        )
        starts = [words for words, said in (few, drawn) if said] or ["all starts"]
        laws = {
            name: {"law": dict(own.law), "tasks": dict(own.tasks)}
            for name, own in self.laws.items()
        }
        said = {
            "suite": self.path.stem,
            "sha256": fingerprint(self.suite, self.path),
            "starts": ", ".join(starts),
            "laws": laws,
        }
        return said | {
            "quick": self.quick,
            "word": self.word,
            "file": None if self.file is None else Path(self.file).name,
        }

    @property
    def command(self) -> str:
        """The command that flies it."""
        name = (
            self.path.stem if self.path.parent == folder("scenarios") / "suite" else str(self.path)
        )
        words = [
            *([] if self.file is None else [self.file]),
            *([] if name == NAME else ["--suite", name]),
            *["--quick"] * self.quick,
        ]
        alone = ["--alone"] if self.file is not None and len(self.laws) == 1 else []
        return shlex.join(
            [
                "vstestbed",
                "suite",
                *words,
                *alone,
                *([] if self.word is None else ["--word", self.word]),
            ]
        )

    def mark(self, out: Path) -> None:
        """Write `suite.json` into the folder, and the law's files with those that they need into
        `law/`, or see that it is of the same suite.
        Raises ParameterError: it is of another; or a file of the law is not beside the law's file,
        or below it.
        """
        named = [] if self.file is None else self.must_stay()
        place, about = out / "suite.json", self.about
        if place.is_file() and read_json(place) != about:
            raise ParameterError(
                "--out",
                "holds another suite, or the same with other laws or starts; give a new folder",
                str(out),
            )
        write_whole(place, json.dumps(about, indent=1) + "\n")
        if self.file is None:
            return
        main = Path(self.file).absolute()
        needed, elsewhere = needed_files(named)
        for path in (*needed, *elsewhere):
            copy = out / "law" / _inside(path, main)
            write_whole(make_folder(copy.parent) / copy.name, path.read_bytes())

    def must_stay(self) -> list[Path]:
        """The law's file, its plugins and the files that its blocks name. Raises ParameterError:
        one is not in its folder, or below it.
        """
        main = Path(self.file or "").absolute()
        blocks = [self.block(main.stem, task) for task in self.suite.tasks]
        found = [
            main,
            *map(Path, self.plugins if self.apart is None else self.apart),
            *files_in(blocks),
        ]
        found = [path for path in found if not is_bundled(path)]
        for path in found:
            _inside(path, main)
        return found

    @property
    def first_seed(self) -> int:
        """The first of the random starts: 0, or what the word draws."""
        if self.word is None:
            return 0
        return (
            HIDDEN_FROM
            + int.from_bytes(hashlib.sha256(self.word.encode()).digest()[:8], "big") % HIDDEN_SEEDS
        )

    def fly(
        self,
        out: Path,
        jobs: int | None = None,
        executor: str = "local",
        on_done: OnDone = lambda job, summary: None,
        say: Callable[[str], None] = lambda words: None,
        shard: Shard | None = None,
    ) -> pl.DataFrame:
        """Fly all tasks, each into a folder of `out`, going on with what is there; one row a run.
        shard: only this share of each task. Errors as of `compare`.
        """
        tables = []
        for task, plan in self.plans.items():
            say(task)
            folder = out / task
            if (folder / PLAN).is_file():
                ready = resumed(folder, plan, self.plugins, film=False, shard=shard)
            else:
                ready = begun(plan, folder, film=False, shard=shard)
            with ready as campaign:
                table = campaign.carry_out(jobs, executor, on_done, figures=False)
            tables.append(self.rows_of(table, campaign.comparison, task))
        return self._joined(tables)

    def merged(
        self, places: Sequence[Path], out: Path, say: Callable[[str], None] = lambda words: None
    ) -> pl.DataFrame:
        """The runs of shards, each task's put together in a folder of `out`; one row a run. Errors
        as of `compare --merge`.
        """
        tables = []
        for task, plan in self.plans.items():
            say(task)
            tables.append(
                self.rows_of(
                    merge([place / task for place in places], out / task, figures=False), plan, task
                )
            )
        return self._joined(tables)

    def _joined(self, tables: Sequence[pl.DataFrame]) -> pl.DataFrame:
        if not tables:
            raise ParameterError(
                "LAW_FILE", f"takes part in no task: {next(iter(self.blank.values()))}"
            )
        return pl.concat(tables)

    def rows_of(
        self, table: pl.DataFrame | ComparisonTable, comparison: Comparison, task: str
    ) -> pl.DataFrame:
        """Of a task's runs: task, law, start, whether it reached the goal, and the task's number in
        its unit of display; of a failure the worst.
        """
        one, parts = (
            self.suite.tasks[task],
            [name for name in (*comparison.cases, TASK) if name in table.columns and name != LAW],
        )
        start = pl.concat_str(
            [pl.col(name).cast(pl.String) for name in (*parts, "seed")], separator=" "
        )
        number = (pl.col(one.metric) if one.metric in table.columns else pl.lit(None)).cast(
            pl.Float64, strict=False
        )
        success = pl.col("success").cast(pl.Boolean)
        if one.worst is not None:  # a run that ended early is no better than the worst that lasted
            lasted = success.fill_null(False) | (pl.col("outcome") == "timed_out")
            number = pl.when(lasted).then(pl.min_horizontal(number, one.worst)).otherwise(one.worst)
        elif one.metric == TO_GOAL and bool(table.select(number.is_null().any()).item()):
            # of a run that crashed: the task's limit
            number = number.fill_null(
                max(each.scenario.stop.duration_s for each in Variants(comparison))
            )
        named = pl.lit(task).alias("task"), pl.col(LAW).alias("law"), start.alias("start")
        return table.select(
            *named, success, (number * Metric.named(one.metric).scale).alias("value")
        )

    def write(self, out: Path, runs: pl.DataFrame) -> list[Score]:
        """Write scores and page into the suite's folder; the scores. Beside a law that was flown
        alone stand the suite's own, with the kept runs from the same starts.
        """
        kept = (
            None if self.laws.keys() & self.suite.laws.keys() else kept_runs(self.suite, self.path)
        )
        shown = (
            runs
            if kept is None
            else pl.concat([runs, kept.join(runs, on=["task", "start"], how="semi")])
        )
        about = (
            f"{self.suite.description}. {self.about['starts'].capitalize()};"
            f" files {self.about['sha256'][:12]}. {HOW}"
        )
        write_whole(out / "runs.csv", runs.write_csv())
        heading = f"Suite {self.path.stem}"
        return write_scores(out, shown, self.shown_tasks(self.laws), heading, about, self.command)

    def shown_tasks(self, laws: Container[str]) -> dict[str, TaskOfSuite]:
        """The tasks as their scores show them, by name, with the laws that take no part."""
        found: dict[str, TaskOfSuite] = {}
        for name, task in self.suite.tasks.items():
            blank = {law: why for (law, of), why in self.blank.items() if of == name}
            without = {law: why for law, why in blank.items() if law in laws}
            found[name] = TaskOfSuite(Metric.named(task.metric), task.asks, without)
        return found


def _must_name_tasks(laws: Mapping[str, SuiteLaw], suite: TaskSuite) -> None:
    """Refuse a law's block for a task that the suite has not."""
    for name, law in laws.items():
        for task in law.tasks:
            if task not in suite.tasks:
                words = f"must be tasks of the suite; {nearest(task, suite.tasks)}"
                raise ParameterError(f"{name}: tasks", words, task)


def opened(
    file: str | None,
    name: str = NAME,
    quick: bool = False,
    word: str | None = None,
    alone: bool = False,
    apart: bool = False,
) -> SuiteEntry:
    """A suite with its own laws, and with that of a file beside them, or `alone`; then `apart`, if
    wished: no code of its files is loaded here. Errors as of `read_suite` and `law_of_file`.
    """
    suite, path = read_suite(name)
    laws, plugins = dict(suite.laws), tuple[str, ...]()
    if file is not None:
        own, law, plugins = law_of_file(file, apart)
        if not PLAIN_NAME.fullmatch(own):
            raise ParameterError(
                "LAW_FILE", "must have a name of the letters A to Z, digits, _, . and -", short(own)
            )
        if own.lower() in map(str.lower, laws):
            raise ParameterError.twice("LAW_FILE", "a law of the suite", own)
        laws = {own: law} if alone else laws | {own: law}
    elif alone:
        raise ParameterError.needs("--alone", "a law of your own", why="LAW_FILE")
    _must_name_tasks(laws, suite)
    if not apart:
        return SuiteEntry(suite, path, laws, plugins, quick, word, file)
    LAWS.add(Isolated)
    return SuiteEntry(suite, path, laws, (MODULE,), quick, word, file, plugins)
