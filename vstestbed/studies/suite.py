"""The suite: the same tasks for any law, and how laws score and rank on them.

A task is a comparison without laws; the suite's laws, and a law of one's own, are its cases. What a law cannot take part in is left blank,
with the sentence that refused it, and counts neither for nor against it. Runs, tables and statistics are those of `compare`.
"""

from __future__ import annotations

import hashlib
import json
import shlex
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
from numpy.typing import NDArray

from vstestbed.core.errors import ParameterError, VstestbedError
from vstestbed.core.files import make_folder, write_whole
from vstestbed.core.geometry import Array
from vstestbed.core.named_files import folder, is_there
from vstestbed.core.spec import spec
from vstestbed.laws import LAWS
from vstestbed.report.canvas import new_figure, panels, publish, style
from vstestbed.report.comparison.statistics import CONFIDENCE, IntervalEstimate, success_rate
from vstestbed.report.marks import LINE_COLORS
from vstestbed.report.pages import write_page
from vstestbed.scenario.plugins import load_plugins
from vstestbed.scenario.yaml_marks import build, plain_mapping, text_of
from vstestbed.studies.comparison import carry_out, prepared
from vstestbed.studies.comparison.plan import TASK, Comparison, Jobs, changed, controllers, read_comparison
from vstestbed.studies.comparison.runs import OnDone

NAME = "VS-1"
LAW = "law"  # the axis of the laws in each comparison
RESAMPLES = 2000  # of the starts, for intervals of means and ranks
QUICK_STARTS = 2  # of each of a plan's start tables with `--quick`
HIDDEN_FROM, HIDDEN_SEEDS = 1_000_000, 900_000_000  # the random starts that a word draws; those of the plans are the first


@spec
class SuiteTask:
    """One task of a suite.

    Args:
        plan: file of its comparison, beside the suite's; e.g. `arm.yaml`.
        asks: what it asks of a law, in words.
    """

    plan: str
    asks: str = ""


@spec
class TaskSuite:
    """A suite's file.

    Args:
        description: one line.
        laws: blocks `law` by name: the first rows of each table.
        tasks: by name.
    """

    description: str = ""
    laws: dict[str, dict[str, Any]]
    tasks: dict[str, SuiteTask]


def read_suite(name: str = NAME) -> tuple[TaskSuite, Path]:
    """A suite by its bundled name or its file, and that file. ScenarioError: its mistakes."""
    path = Path(name) if is_there(Path(name)) else folder("scenarios") / "suite" / f"{name}.yaml"
    plain, marks = plain_mapping(text_of(path), str(path), "a suite needs laws and tasks")
    return build(TaskSuite, plain, marks, str(path)), path


def fingerprint(suite: TaskSuite, path: Path) -> str:
    """What identifies the frozen tasks: SHA-256 of the suite's file and of its plans."""
    found = hashlib.sha256()
    for file in (path, *(path.parent / task.plan for task in suite.tasks.values())):
        found.update(file.read_bytes())
    return found.hexdigest()


def law_of_file(file: str) -> tuple[str, dict[str, Any], tuple[str, ...]]:
    """Name, block and plugins of a law of one's own: a YAML file with `law` (and `plugins`), or a plugin with one law, as it is by default.
    Raises ParameterError: it has none, or several. PluginError, ScenarioError: it cannot be read.
    """
    path = Path(file)
    if path.suffix in (".yaml", ".yml"):
        plain, _ = plain_mapping(text_of(path), file, "a law's file needs law")
        if not isinstance(law := plain.get("law"), dict):
            raise ParameterError("LAW_FILE", "must have a block law, as a scenario has it", file)
        return path.stem, law, tuple(str(path.parent / name) for name in plain.get("plugins", ()))
    before = set(LAWS.members)
    (plugin,) = load_plugins([file])
    own = [kind for kind in LAWS.members if kind not in before or LAWS.members[kind].__module__ == path.stem]
    if len(own) != 1:
        raise ParameterError("LAW_FILE", "must add one law; of several, name one in a YAML file with law and plugins", own or file)
    return path.stem, {"kind": own[0]}, (plugin,)


@dataclass(frozen=True)
class SuiteEntry:
    """A suite that is to be flown.

    laws: blocks by name. plugins: that they need. quick: few starts of each task. word: draws the random starts, None for the plans' own.
    file: of the law of one's own, None without one.
    """

    suite: TaskSuite
    path: Path
    laws: Mapping[str, Mapping[str, Any]]
    plugins: tuple[str, ...] = ()
    quick: bool = False
    word: str | None = None
    file: str | None = None
    blank: dict[tuple[str, str], str] = field(default_factory=dict)  # why a law takes no part in a task, by law and task

    def plan(self, task: str) -> Comparison | None:
        """The comparison of a task, of the laws that take part in it; None where none does. Those that do not are noted in `blank`."""
        own = read_comparison(self.path.parent / self.suite.tasks[task].plan, self.plugins)
        fields: dict[str, Any] = {"plugins": (*own.plugins, *self.plugins)}
        fields |= {"limit" if own.tasks else "seeds": QUICK_STARTS} if self.quick else {}
        own = changed(own, None, **fields, **({} if own.tasks else {"first_seed": self.first_seed}))
        cases: dict[str, dict[str, Any]] = {}
        for name, law in self.laws.items():
            try:
                controllers(changed(own, cases={LAW: {name: {"law": dict(law)}}} | own.cases))
            except VstestbedError as error:
                self.blank[name, task] = str(error).splitlines()[0]
            else:
                cases[name] = {"law": dict(law)}
        return changed(own, cases={LAW: cases} | own.cases) if cases else None

    @cached_property
    def plans(self) -> dict[str, Comparison]:
        """The comparisons of all tasks that a law takes part in; `blank` says of the others why not."""
        return {task: plan for task in self.suite.tasks if (plan := self.plan(task)) is not None}

    @property
    def total(self) -> int:
        """How many runs it has."""
        return sum(len(Jobs(controllers(plan), plan.seeds, plan.first_seed)) for plan in self.plans.values())

    @property
    def about(self) -> dict[str, Any]:
        """What is flown, in plain values: name, hash of the frozen files, laws, starts."""
        few, drawn = ("the first starts of each list", self.quick), (f"random starts from {self.first_seed} on", self.word is not None)
        starts = [words for words, said in (few, drawn) if said] or ["all starts"]
        laws = {name: dict(law) for name, law in self.laws.items()}
        said = {"suite": self.path.stem, "sha256": fingerprint(self.suite, self.path), "starts": ", ".join(starts), "laws": laws}
        return said | {"quick": self.quick, "word": self.word, "file": None if self.file is None else Path(self.file).name}

    @property
    def command(self) -> str:
        """The command that flies it."""
        name = self.path.stem if self.path.parent == folder("scenarios") / "suite" else str(self.path)
        words = [*([] if self.file is None else [self.file]), *([] if name == NAME else ["--suite", name]), *["--quick"] * self.quick]
        alone = ["--alone"] if self.file is not None and len(self.laws) == 1 else []
        return shlex.join(["vstestbed", "suite", *words, *alone, *([] if self.word is None else ["--word", self.word])])

    def mark(self, out: Path) -> None:
        """Write `suite.json` into the folder, or see that it is of the same suite. Raises ParameterError: it is of another."""
        place, about = out / "suite.json", self.about
        if place.is_file() and json.loads(place.read_text(encoding="utf-8")) != about:
            raise ParameterError("--out", "holds another suite, or the same with other laws or starts; give a new folder", str(out))
        write_whole(place, json.dumps(about, indent=1) + "\n")
        sources: list[str] = [*([] if self.file is None else [self.file]), *self.plugins]
        for source in dict.fromkeys(sources):
            write_whole(make_folder(out / "law") / Path(source).name, Path(source).read_bytes())

    @property
    def first_seed(self) -> int:
        """The first of the random starts: 0, or what the word draws."""
        if self.word is None:
            return 0
        return HIDDEN_FROM + int.from_bytes(hashlib.sha256(self.word.encode()).digest()[:8], "big") % HIDDEN_SEEDS

    def fly(
        self,
        out: Path,
        jobs: int | None = None,
        executor: str = "local",
        on_done: OnDone = lambda job, summary: None,
        say: Callable[[str], None] = lambda words: None,
    ) -> pl.DataFrame:
        """Fly all tasks, each into a folder of `out`, going on with what is there; one row a run. Errors as of `compare`."""
        tables = []
        for task, plan in self.plans.items():
            say(task)
            there = (out / task / "comparison.yaml").is_file()
            with prepared([], {}, out / task, there, {}, self.plugins if there else (), False, requested=plan) as (runner, comparison):
                table = carry_out(runner, comparison, jobs, executor, on_done, figures=False)
            tables.append(rows_of(table, comparison, task))
        if not tables:
            raise ParameterError("LAW_FILE", f"takes part in no task: {next(iter(self.blank.values()))}")
        return pl.concat(tables)


def rows_of(table: pl.DataFrame, comparison: Comparison, task: str) -> pl.DataFrame:
    """Of a task's runs: task, law, start, whether it reached the goal, and the time to it, of a failure its limit."""
    parts = [name for name in (*comparison.cases, TASK) if name in table.columns and name != LAW]
    start = pl.concat_str([pl.col(name).cast(pl.String) for name in (*parts, "seed")], separator=" ")
    time = pl.col("time_to_goal_s").cast(pl.Float64, strict=False)
    named = pl.lit(task).alias("task"), pl.col(LAW).alias("law"), start.alias("start")
    return table.select(*named, pl.col("success").cast(pl.Boolean), time.alias("time_s"))


@dataclass(frozen=True)
class Score:
    """How a law did in a task.

    rate: of success, with its Wilson interval. time_s: restricted mean time to the goal, a failure at its limit, with its bootstrap
    interval over starts. rank: 1 is the best by that time, with the interval of the same bootstrap, in which all laws share the starts.
    """

    task: str
    law: str
    rate: IntervalEstimate
    time_s: IntervalEstimate
    rank: IntervalEstimate


def scores(runs: pl.DataFrame) -> list[Score]:
    """The scores of all laws in all tasks, in the order of the table."""
    return [score for task in runs["task"].unique(maintain_order=True) for score in _of_task(runs.filter(pl.col("task") == task), task)]


def _of_task(runs: pl.DataFrame, task: str) -> Iterator[Score]:
    laws = runs["law"].unique(maintain_order=True).to_list()
    times = runs.pivot("law", index="start", values="time_s", aggregate_function="first").select(laws).to_numpy().T.astype(float)
    reached = runs.pivot("law", index="start", values="success", aggregate_function="first").select(laws).to_numpy().T.astype(float)
    flown = np.isfinite(reached).all(axis=0)  # starts that every law has flown
    times = np.where(np.isnan(times), np.nanmax(times, initial=0.0), times)[:, flown]  # one that crashed counts as the longest
    mean, low, high = _resampled(times)
    rank, best, last = _ranks(times)
    for i, law in enumerate(laws):
        done = reached[i][np.isfinite(reached[i])]
        yield Score(
            task,
            law,
            success_rate(int(done.sum()), len(done)),
            IntervalEstimate(mean[i], low[i], high[i], times.shape[1]),
            IntervalEstimate(rank[i], best[i], last[i], times.shape[1]),
        )


def _starts(n: int) -> NDArray[np.intp]:
    """Resamples of n starts, the same for all laws (RESAMPLES, n)."""
    return np.random.default_rng(0).integers(0, n, (RESAMPLES, n))


def _ends(samples: Array) -> tuple[Array, Array]:
    tail = 50 * (1 - CONFIDENCE)
    low, high = np.percentile(samples, [tail, 100 - tail], axis=0)
    return low, high


def _resampled(times: Array) -> tuple[Array, Array, Array]:
    """Means of each law's times (laws, starts), with the ends of their intervals."""
    return times.mean(axis=1), *_ends(times[:, _starts(times.shape[1])].mean(axis=2).T)


def _ranks(times: Array) -> tuple[Array, Array, Array]:
    """Ranks of the laws by their mean time (laws, starts), ties sharing the mean of their places, with the ends of their intervals."""
    from scipy.stats import rankdata

    means = times[:, _starts(times.shape[1])].mean(axis=2).T
    return rankdata(times.mean(axis=1)), *_ends(rankdata(means, axis=1))


def overall(found: Sequence[Score]) -> list[tuple[str, float, int]]:
    """Law, mean of its ranks, and in how many tasks it took part; the best first. It stands beside its parts, never for them."""
    by_law: dict[str, list[float]] = {}
    for score in found:
        by_law.setdefault(score.law, []).append(score.rank.mean)
    return sorted(((law, float(np.mean(ranks)), len(ranks)) for law, ranks in by_law.items()), key=lambda row: row[1])


def write_scores(out: Path, entry: SuiteEntry, runs: pl.DataFrame) -> list[Score]:
    """Write `runs.csv`, `scores.csv`, `scores.tex` and `report.html` into a suite's folder; the scores."""
    found = scores(runs)
    table = pl.DataFrame(
        [
            {"task": s.task, "law": s.law, "reached": round(s.rate.mean * s.rate.n), "runs": s.rate.n}
            | {
                f"{name}_{end}": value
                for name in ("rate", "time_s", "rank")
                for end, value in zip(("mean", "low", "high"), getattr(s, name)[:3], strict=True)
            }
            for s in found
        ]
    )
    write_whole(out / "runs.csv", runs.write_csv())
    write_whole(out / "scores.csv", table.write_csv())
    write_whole(out / "scores.tex", latex(entry, found))
    _write_page(out, entry, found)
    return found


def _write_page(out: Path, entry: SuiteEntry, found: Sequence[Score]) -> None:
    by, ranked, suite = {(s.law, s.task): s for s in found}, overall(found), entry.suite
    heads = ["law", "mean rank", *suite.tasks]
    lines = [[law, f"{rank:.2f} of {tasks} tasks", *(_cell(by.get((law, task))) for task in suite.tasks)] for law, rank, tasks in ranked]
    asked = [[task, one.asks, str(len({s.law for s in found if s.task == task}))] for task, one in suite.tasks.items()]
    blanks = [[law, task, why] for (law, task), why in entry.blank.items()]
    tables = [("Scores", heads, lines), ("Tasks", ["task", "what it asks of a law", "laws"], asked)]
    tables += [("Without part", ["law", "task", "why"], blanks)] if blanks else []
    plots = [
        (
            "Ranks",
            _drawn_ranks(found),
            "Rank by the restricted mean time in each task, 1 is the best, with 95 % bootstrap intervals over starts.",
        )
    ]
    about = (
        f"{suite.description}. {entry.about['starts'].capitalize()}; files {entry.about['sha256'][:12]}. Successes with Wilson "
        "intervals, mean time to the goal in which a failure counts its limit, and ranks by it with bootstrap intervals over starts, which "
        "all laws share; the mean of the ranks stands beside its parts."
    )
    write_page(out, "study.html", f"Suite {entry.path.stem}", about=about, plots=plots, tables=tables, command=entry.command)


def _drawn_ranks(found: Sequence[Score]) -> str:
    tasks, order = list(dict.fromkeys(s.task for s in found)), [law for law, _, _ in overall(found)]
    with style():
        drawn = new_figure(0.22 * len(order) + 0.7, 1.4 * len(tasks) + 1.2)
        for axes, task in zip(panels(drawn, len(tasks), len(tasks), sharey=True), tasks, strict=True):
            for s in (s for s in found if s.task == task):
                y = order.index(s.law)
                axes.plot([s.rank.low, s.rank.high], [y, y], color=LINE_COLORS[0], lw=1.2)
                axes.plot(s.rank.mean, y, "o", color=LINE_COLORS[0], ms=4)
            axes.set_title(task)
            axes.set_xlabel("rank")
            axes.set_xlim(0.5, len(order) + 0.5)
            axes.set_xticks(range(1, len(order) + 1, 2))
            axes.set_yticks(range(len(order)), order)
            axes.set_ylim(len(order) - 0.5, -0.5)
        return publish(drawn, "ranks", "Ranks of the laws in each task")


def _cell(score: Score | None) -> list[str]:
    """A score in words: successes, time, rank, each with its interval; blank for a law that took no part."""
    if score is None:
        return ["-"]
    rate, time_s, rank = score.rate, score.time_s, score.rank
    return [
        f"{round(rate.mean * rate.n)} of {rate.n} ({100 * rate.low:.0f} to {100 * rate.high:.0f} %)",
        f"{time_s.mean:.1f} s ({time_s.low:.1f} to {time_s.high:.1f})",
        f"rank {rank.mean:.3g} ({rank.low:.3g} to {rank.high:.3g})",
    ]


def latex(entry: SuiteEntry, found: Sequence[Score]) -> str:
    """The table of a paper: laws by tasks, successes and restricted mean time."""
    by = {(s.law, s.task): s for s in found}
    tasks = list(entry.suite.tasks)
    lines = [r"\begin{tabular}{l" + "r" * len(tasks) + "}", " & ".join(["law", *tasks]) + r" \\ \hline"]
    for law, _, _ in overall(found):
        words = [f"{round(s.rate.mean * s.rate.n)}/{s.rate.n}, {s.time_s.mean:.1f} s" if (s := by.get((law, t))) else "--" for t in tasks]
        lines.append(" & ".join([law.replace("_", r"\_"), *words]) + r" \\")
    return "\n".join([*lines, r"\end{tabular}", ""])


def opened(file: str | None, name: str = NAME, quick: bool = False, word: str | None = None, alone: bool = False) -> SuiteEntry:
    """A suite with its own laws, and with that of a file beside them, or `alone`. Errors as of `read_suite` and `law_of_file`."""
    suite, path = read_suite(name)
    laws, plugins = dict(suite.laws), tuple[str, ...]()
    if file is not None:
        own, block, plugins = law_of_file(file)
        if own in laws:
            raise ParameterError.twice("LAW_FILE", "a law of the suite", own)
        laws = {own: block} if alone else laws | {own: block}
    elif alone:
        raise ParameterError.needs("--alone", "a law of your own", why="LAW_FILE")
    return SuiteEntry(suite, path, laws, plugins, quick, word, file)
