"""Writes the page of a comparison, and its figures for a paper, from its table and the logs in its
folder.
"""

from __future__ import annotations

import contextlib
import re
import shlex
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path
from typing import TYPE_CHECKING, Any

from vstestbed.core.errors import VstestbedError
from vstestbed.core.files import make_folder, write_whole
from vstestbed.core.registry import to_mapping
from vstestbed.core.shares import Call, at_once, result_of
from vstestbed.report.canvas import publish, style
from vstestbed.report.comparison import baseline, figures, tables
from vstestbed.report.comparison import grid as effects
from vstestbed.report.comparison.figures import PANELS, Data, read_series
from vstestbed.report.comparison.pairs import Pair, pairs
from vstestbed.report.comparison.records import write_records
from vstestbed.report.comparison.results import ComparisonResults, interquartiles, value_text
from vstestbed.report.comparison.sentences import Findings, findings, short_title
from vstestbed.report.marks import counted
from vstestbed.report.pages import cell, data_url, film_of, page, text_of, write_page
from vstestbed.report.run.tracks import MeasuredError, Setting
from vstestbed.scenario.dump import load_run
from vstestbed.scenario.load import GIVEN, RESOLVED
from vstestbed.scenario.yaml_marks import plain_mapping

if TYPE_CHECKING:
    from matplotlib.figure import Figure

UNCOMPARED = ("name", "description", "seed", "draw_start", "plugins")
"""Fields that change nothing of an experiment, or differ between seeds."""


def differing(runs: Sequence[Path]) -> tuple[str, ...]:
    """Dotted names of the fields in which the scenarios of runs' folders differ, sorted; empty
    where one of them cannot be read.
    """
    try:
        return tuple(sorted(set[str]().union(*_from_first(runs))))
    except (OSError, UnicodeError, VstestbedError):
        return ()


def _from_first(runs: Iterable[Path]) -> Iterator[set[str]]:
    """The fields in which the scenario of each run's folder differs from the first."""
    first: dict[str, object] = {}
    for run in runs:
        record = run / RESOLVED
        # all values of its scenario; a run that could not begin has none written out
        if record.is_file():
            scenario = plain_mapping(record.read_text(encoding="utf-8"), str(record), "")[0]
        else:
            scenario = to_mapping(load_run(run))
        values = dict(_flat(scenario))
        fields = {name: values[name] for name in values if name.split(".")[0] not in UNCOMPARED}
        first = first or fields
        # `...`: a scenario does not have the field
        every = first.keys() | fields.keys()
        yield {name for name in every if fields.get(name, ...) != first.get(name, ...)}


def _flat(value: Any, name: str = "") -> Iterator[tuple[str, object]]:
    """Every scalar of nested mappings and lists with its dotted name."""
    if not isinstance(value, dict | list) or not value:
        yield name, value
        return
    for key, inner in value.items() if isinstance(value, dict) else enumerate(value):
        yield from _flat(inner, f"{name}.{key}".removeprefix("."))


# A film up to this size is embedded (base64 makes it 4/3 as large); the page then stays under 20 MB
FILM_BYTES = 8_000_000
NOTEBOOK_PX = 480  # Height of a comparison's result in a notebook [px]
# Width of a paper's figure over one and two columns (IEEE) [in]
COLUMN_IN = {1: 3.5, 2: 7.16}

# The figures of a comparison in their order: key (of files, identifiers, and of the caption in
# `comparison.html`), title, columns that it takes, function that draws it.
Plot = tuple[str, str, int, Callable[[Data, float], "Figure | None"]]
PLOTS: tuple[Plot, ...] = (
    ("error", "Error over time", 1, figures.medians),
    ("success", "Success over time", 1, figures.success),
    ("runs", "Error of single runs", 2, figures.each_run),
    ("distributions", "All runs in numbers", 2, figures.distributions),
    ("grid", "Effects and controllers", 2, effects.grid),
    ("profiles", "Performance profiles", 2, figures.profiles),
    ("matrix", "Who is better", 1, figures.matrix),
    ("differences", "Paired differences", 2, figures.differences),
)
# Controllers from which figures take longer than other processes take to import what draws them
MANY = 5
GRID = next((i for i, plot in enumerate(PLOTS) if plot[0] == "grid"), 0)


@dataclass(frozen=True)
class Drawing:
    """How the figures of a comparison are drawn."""

    call: Call = at_once  # does it, in other processes perhaps
    paper: bool = False  # whether for a paper, too (`figures/`)

    def place(self, folder: Path) -> Path | None:
        """The folder of a comparison's figures for a paper."""
        return make_folder(folder / "figures") if self.paper else None


AT_ONCE = Drawing()


def write_comparison_report(
    folder: Path,
    comparison: ComparisonResults,
    command: str = "",
    film: Path | Future[Path | None] | None = None,
    plugins: Sequence[str] = (),
    drawing: Drawing = AT_ONCE,
) -> Path:
    """Write `report.html`, the records `controllers` and `pairs`, and `tables.md` and `tables.tex`;
    returns the page's path.

    Args:
        folder, comparison: its results. command: the command line that repeats it.
        film: in the folder, perhaps still in the making; embedded up to 8 MB, else linked.
        plugins: as in `scenario.load.load`. drawing: how the figures are drawn.
    """
    table = comparison.table
    all_pairs = pairs(comparison)
    means = interquartiles(comparison)
    words = findings(comparison, all_pairs)
    write_records(folder, comparison, means, all_pairs, words)
    sections = tables.sections(comparison, means, all_pairs)
    write_tables(folder, words, sections["sections"])
    drawn = _figures(folder, comparison, all_pairs, plugins, drawing)
    filmed = result_of(film) if isinstance(film, Future) else film
    embedded = None
    if filmed is not None and filmed.is_file():
        small = filmed.stat().st_size <= FILM_BYTES
        embedded = film_of("The same seed, side by side", filmed, small)
    scenarios = list(dict.fromkeys(map(str, table["scenario"].to_list())))
    heading = f"Comparison of {len(scenarios)} scenarios"
    if 0 < len(scenarios) <= 3:  # two or three names fit the heading
        heading = " against ".join(scenarios)
    heading += by_one_metric(comparison)
    controllers = counted(len(comparison.controllers), "controller")
    seeds = counted(table["seed"].n_unique(), "seed")
    return write_page(
        folder,
        "comparison.html",
        heading,
        title=f"{heading}: comparison",
        description=comparison.description,
        plan=(
            f"{controllers}, {seeds}, {counted(len(table), 'run')};"
            " the same seed gives each the same start and noise."
        ),
        found=words,
        **sections,
        baseline=baseline.section(folder),
        figures=drawn,
        film=embedded,
        failures=failures(folder, comparison),
        command=command,
        place=folder.name,
        **_made_of(comparison),
    )


def comparison_cell(folder: Path, comparison: ComparisonResults) -> str:
    """The result of a comparison as a notebook shows it: who is better, the controllers' numbers,
    their differences; no figures.
    """
    where = f"Figures and films: {folder / 'report.html'}"
    all_pairs = pairs(comparison)
    words = findings(comparison, all_pairs)
    sections = tables.sections(comparison, interquartiles(comparison), all_pairs)
    return cell(
        page(
            "comparison.html",
            "Comparison",
            description="",
            plan=where,
            baseline=None,
            found=words,
            **sections,
        ),
        NOTEBOOK_PX,
    )


def by_one_metric(comparison: ComparisonResults) -> str:
    """`, by path over straight line`, for a title where controllers are compared by one number; ""
    where by several, and by time.
    """
    only = comparison.shown[0] if len(comparison.shown) == 1 else None
    metric = comparison.primary_metric if comparison.primary else only
    return f", by {short_title(metric)}" if metric else ""


def write_tables(folder: Path, found: Findings, sections: Sequence[tables.Section]) -> None:
    """The page's tables for a paper: `tables.md`, and `tables.tex` in the form of the LaTeX package
    booktabs.
    """
    for name in ("tables.md", "tables.tex"):
        write_whole(folder / name, text_of(name, found=found, sections=sections))


def _drawn(data: Data, plot: int, place: Path | None) -> str:
    """A figure for the page and, into the folder `place`, for a paper;
    "" for one without content.
    """
    key, title, columns, draw = PLOTS[plot]
    with style():
        figure = draw(data, COLUMN_IN[columns])
        return "" if figure is None else publish(figure, key, title, place)


def _figures(
    folder: Path,
    comparison: ComparisonResults,
    all_pairs: list[Pair],
    plugins: Sequence[str],
    drawing: Drawing,
) -> dict[str, Any]:
    """All figures for up to PANELS controllers; of more the grid, or without one those of the first
    PANELS.
    """
    place = drawing.place(folder)
    n = len(comparison.controllers)
    if n > PANELS and effects.Grid.of(comparison) is not None:
        note = (
            "The grid stands for the figures with a line or a row for each controller,"
            f" since there are {n} of them."
        )
        return {"notes": [note]} | _plots(Data(comparison, all_pairs), [GRID], drawing.call, place)
    notes = []
    if n > PANELS:
        comparison = comparison.first(PANELS)
        all_pairs = [pair for pair in all_pairs if max(pair.a, pair.b) < PANELS]
        notes.append(f"The figures show the first {PANELS} of {n} controllers.")
    measured = _measured(folder, comparison, plugins)
    data = read_series(folder, comparison, all_pairs, measured)
    if data.sampled:
        notes.append(
            f"Errors over time are of the first {data.sampled:,} runs of each controller,"
            " all else of all runs."
        )
    call = drawing.call if n >= MANY else at_once
    return {"notes": notes} | _plots(data, range(len(PLOTS)), call, place)


def _plots(
    data: Data, numbers: Sequence[int], call: Call, place: Path | None
) -> dict[str, list[tuple[str, str, str]]]:
    """Those of PLOTS that have content, by the columns that they take on the page."""
    made = [call(_drawn, data, number, place) for number in numbers]
    found: dict[int, list[tuple[str, str, str]]] = {1: [], 2: []}
    for number, future in zip(numbers, made, strict=True):
        key, title, columns, _ = PLOTS[number]
        if svg := result_of(future):
            found[columns].append((key, title, svg))
    return {"narrow": found[1], "broad": found[2]}


def _measured(
    folder: Path, comparison: ComparisonResults, plugins: Sequence[str]
) -> list[MeasuredError]:
    """The error in the image that decides, of each controller; without a threshold where those with
    the same unit differ in it.
    """
    found = []
    limits: dict[str, set[float | None]] = defaultdict(set)
    for controller in comparison.controllers:
        # one run per controller suffices: seeds do not change the stop block
        run = folder / str(controller.runs["folder"][0])
        error = MeasuredError()
        if (run / GIVEN).is_file():
            error = Setting.of(load_run(run, plugins)).image_errors[0]
            limits[error.unit].add(error.threshold)
        found.append(error)
    agreed = {unit: known.pop() for unit, known in limits.items() if len(known) == 1}
    return [error._replace(threshold=agreed.get(error.unit)) for error in found]


def _made_of(comparison: ComparisonResults) -> dict[str, Any]:
    """What was compared, and the versions of the software that did it."""
    table = comparison.table
    plan = {name: _values(table[name].to_list()) for name in ("scenario", *comparison.axes)}
    seeds = sorted(set(table["seed"].to_list()))
    plan["seeds"] = ", ".join(map(str, seeds))
    if len(seeds) > 2 and seeds == list(range(seeds[0], seeds[-1] + 1)):
        plan["seeds"] = f"{seeds[0]} to {seeds[-1]}"
    plan["runs"] = str(len(table))
    plan["numbers"] = ", ".join(comparison.metrics)
    versions = []
    for name in table.columns:
        package = name.removeprefix("versions.")
        if package != name:
            # more than one version of a package if the comparison was resumed after an update
            versions.append((package, _values(table[name].drop_nulls().to_list()), ""))
    return {"made_of": plan, "versions": versions}


def _values(values: Sequence[object]) -> str:
    return ", ".join(dict.fromkeys(map(value_text, values)))


# Failed runs, grouped by outcome and reason, with commands that repeat them and pictures of their
# ends.

PICTURES = 24
# Most pictures in the gallery, and most bytes of all of them: they are embedded in the page
PICTURE_BYTES = 4_000_000
LISTED = 300  # Most failed runs whose commands are listed
SEEDS = 20  # Most seeds of a controller that are named with one kind of failure
ERRORS = 24
# Most crashed runs whose `error.txt` is shown, and the length of its end that is shown
ERROR_CHARACTERS = 4000

# controller, seed, outcome, reason, and `place`, the folder of a run that did not reach the goal
Failure = dict[str, Any]


def failures(folder: Path, comparison: ComparisonResults) -> dict[str, Any]:
    """Failed runs by kind, and runs that were repeated because their worker process died, for
    `failures.html`.
    """
    failed = []
    repeated = []
    for controller in comparison.controllers:
        rows = controller.runs.iter_rows(named=True)
        for row, reached in zip(rows, controller.success, strict=True):
            failure = _failure(folder, controller.label, row)
            if row.get("attempts") not in (None, 1):
                ended = str(row["outcome"]).replace("_", " ")
                repeated.append(f"{controller.label}, seed {row['seed']} ({ended})")
            if not reached:
                failed.append(failure)
    groups = _kinds(failed)
    crashed = [group for group in groups if group[0]["outcome"] == "crashed"]
    for failure in _in_turn(crashed, ERRORS):  # of every kind, since there is room for only a few
        failure["error"] = _end_of_error(failure["place"])
    for failure in _in_turn(groups, LISTED):
        failure["command"] = rerun_command(failure["place"])
    pictured, pictures = _gallery(groups)
    return {
        "failed": len(failed),
        "runs": len(comparison.table),
        "listed": LISTED,
        "kinds": [_kind(group) for group in groups],
        "pictured": pictured,
        "pictures": pictures,
        "repeated": repeated,
    }


def _kinds(failed: list[Failure]) -> list[list[Failure]]:
    """The failures by outcome and reason, the most frequent kind first; reasons that differ in
    numbers (times, pixels) only are one kind.
    """
    kinds: dict[tuple[str, str], list[Failure]] = defaultdict(list)
    for failure in failed:
        reason = re.sub(r"\d[\d.e+-]*", "#", failure["reason"])
        kinds[failure["outcome"], reason].append(failure)
    return sorted(kinds.values(), key=len, reverse=True)


def _failure(folder: Path, controller: str, row: dict[str, Any]) -> Failure:
    return {
        "controller": controller,
        "seed": row["seed"],
        "outcome": str(row.get("outcome") or "no outcome"),
        "reason": str(row.get("reason") or ""),
        "place": folder / str(row["folder"]),
    }


def _end_of_error(place: Path) -> str:
    """The end of a crashed run's traceback; "" where it cannot be read."""
    with contextlib.suppress(OSError):
        text = (place / "error.txt").read_text(encoding="utf-8", errors="replace")
        return text[-ERROR_CHARACTERS:].strip()
    return ""


def rerun_command(place: Path) -> str:
    """The command that repeats a run, from the directory in which the comparison was started."""
    return f"vstestbed run {shlex.quote((place / 'scenario.yaml').as_posix())}"


def _kind(group: list[Failure]) -> dict[str, Any]:
    """One kind of failure: number of runs, seeds of each controller, and those runs whose command
    is shown.
    """
    reason = group[0]["reason"]
    same = all(failure["reason"] == reason for failure in group)
    seeds: dict[str, list[str]] = defaultdict(list)
    for failure in group:
        seeds[failure["controller"]].append(str(failure["seed"]))
    who = []
    for name, those in seeds.items():
        more = f" and {len(those) - SEEDS:,} more" if len(those) > SEEDS else ""
        who.append(f"{name}: seed{'s' * (len(those) > 1)} {', '.join(those[:SEEDS])}{more}")
    return {
        "outcome": group[0]["outcome"],
        "runs": len(group),
        "reason": reason if same else f"{reason}, and the like",
        "who": "; ".join(who),
        "same": same,
        "shown": [{"error": "", **failure} for failure in group if "command" in failure],
    }


def _in_turn(groups: list[list[Failure]], most: int) -> list[Failure]:
    """Up to `most` failures, one of each group in turn, so that a frequent kind does not hide a
    rare one.
    """
    return [f for row in zip_longest(*groups) for f in row if f is not None][:most]


def _gallery(groups: list[list[Failure]]) -> tuple[int, list[tuple[str, str]]]:
    """How many failed runs have a picture of their end (`end.png`), and the first of these with
    words, every kind of failure in turn.
    """
    with_picture = [[f for f in group if (f["place"] / "end.png").is_file()] for group in groups]
    room = PICTURE_BYTES
    pictures = []
    for failure in _in_turn(with_picture, PICTURES):
        png = (failure["place"] / "end.png").read_bytes()
        if len(png) <= room:  # a smaller one may still fit
            room -= len(png)
            ended = failure["outcome"].replace("_", " ")
            words = f"{failure['controller']}, seed {failure['seed']}: {ended}"
            pictures.append((data_url("image/png", png), words))
    return sum(map(len, with_picture)), pictures
