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
    first: dict[str, object] | None = None
    for run in runs:
        record = run / RESOLVED
        # all values of its scenario; a run that could not begin has none written out
        scenario = (
            plain_mapping(record.read_text(encoding="utf-8"), str(record), "")[0]
            if record.is_file()
            else to_mapping(load_run(run))
        )
        fields = {
            name: value for name, value in _flat(scenario) if name.split(".")[0] not in UNCOMPARED
        }
        first = fields if first is None else first
        # `...`: a scenario does not have the field
        yield {
            name
            for name in first.keys() | fields.keys()
            if fields.get(name, ...) != first.get(name, ...)
        }


def _flat(value: Any, name: str = "") -> Iterator[tuple[str, object]]:
    """Every scalar of nested mappings and lists with its dotted name."""
    if isinstance(value, dict | list) and value:
        for key, inner in value.items() if isinstance(value, dict) else enumerate(value):
            yield from _flat(inner, f"{name}.{key}" if name else str(key))
    else:
        yield name, value


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


def write_comparison_report(
    folder: Path,
    comparison: ComparisonResults,
    command: str = "",
    film: Path | Future[Path | None] | None = None,
    plugins: Sequence[str] = (),
    call: Call = at_once,
    paper: bool = False,
) -> Path:
    """Write `report.html`, the records `controllers` and `pairs`, and `tables.md` and `tables.tex`;
    returns the page's path.

    Args:
        folder, comparison: its results. command: the command line that repeats it.
        film: in the folder, perhaps still in the making; embedded up to 8 MB, else linked.
        plugins: as in `scenario.load.load`. call: draws the figures. paper: whether to draw them
            for a paper, too (`figures/`).
    """
    table, all_pairs, means = comparison.table, pairs(comparison), interquartiles(comparison)
    words = findings(comparison, all_pairs)
    write_records(folder, comparison, means, all_pairs, words)
    sections = tables.sections(comparison, means, all_pairs)
    write_tables(folder, words, sections["sections"])
    place = make_folder(folder / "figures") if paper else None
    drawn = _figures(folder, comparison, all_pairs, plugins, call, place)
    filmed, embedded = result_of(film) if isinstance(film, Future) else film, None
    if filmed is not None and filmed.is_file():
        embedded = film_of(
            "The same seed, side by side", filmed, filmed.stat().st_size <= FILM_BYTES
        )
    scenarios = list(dict.fromkeys(map(str, table["scenario"].to_list())))
    # two or three names fit the heading
    heading = (
        " against ".join(scenarios)
        if 0 < len(scenarios) <= 3
        else f"Comparison of {len(scenarios)} scenarios"
    )
    heading += by_one_metric(comparison)
    counts = (
        (len(comparison.controllers), "controller"),
        (table["seed"].n_unique(), "seed"),
        (len(table), "run"),
    )
    return write_page(
        folder,
        "comparison.html",
        heading,
        title=f"{heading}: comparison",
        description=comparison.description,
        plan=(
            f"{', '.join(counted(*each) for each in counts)};"
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
    if comparison.primary:
        return f", by {short_title(comparison.primary_metric)}"
    return f", by {short_title(comparison.shown[0])}" if len(comparison.shown) == 1 else ""


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
    call: Call,
    place: Path | None,
) -> dict[str, Any]:
    """All figures for up to PANELS controllers; of more the grid, or without one those of the first
    PANELS; for papers into `place`.
    """
    n = len(comparison.controllers)
    if n > PANELS and effects.Grid.of(comparison) is not None:
        data, numbers = Data(comparison, all_pairs), [GRID]
        notes = [
            "The grid stands for the figures with a line or a row for each controller,"
            f" since there are {n} of them."
        ]
    else:
        shown = comparison if n <= PANELS else comparison.first(PANELS)
        chosen = [pair for pair in all_pairs if max(pair.a, pair.b) < PANELS]
        data, numbers = (
            read_series(folder, shown, chosen, _measured(folder, shown, plugins)),
            list(range(len(PLOTS))),
        )
        notes = [f"The figures show the first {PANELS} of {n} controllers."] if n > PANELS else []
        if data.sampled:
            notes.append(
                f"Errors over time are of the first {data.sampled:,} runs of each controller,"
                " all else of all runs."
            )
    if n < MANY:
        call = at_once
    made = [call(_drawn, data, i, place) for i in numbers]
    drawn = [
        (PLOTS[i][2], (*PLOTS[i][:2], result_of(one))) for i, one in zip(numbers, made, strict=True)
    ]
    narrow, broad = ([f for columns, f in drawn if columns == wanted and f[2]] for wanted in (1, 2))
    return {"notes": notes, "narrow": narrow, "broad": broad}


def _measured(
    folder: Path, comparison: ComparisonResults, plugins: Sequence[str]
) -> list[MeasuredError]:
    """The error in the image that decides, of each controller; without a threshold where those with
    the same unit differ in it.
    """
    # one run per controller suffices: seeds do not change the stop block
    firsts = [folder / str(c.runs["folder"][0]) for c in comparison.controllers]
    found = [
        Setting.of(load_run(run, plugins)).image_errors[0] if (run / GIVEN).is_file() else None
        for run in firsts
    ]
    limits: dict[str, set[float | None]] = {}
    for error in filter(None, found):
        limits.setdefault(error.unit, set()).add(error.threshold)
    agreed = {unit: known.pop() if len(known) == 1 else None for unit, known in limits.items()}
    return [
        error._replace(threshold=agreed.get(error.unit))
        for error in (one or MeasuredError() for one in found)
    ]


def _made_of(comparison: ComparisonResults) -> dict[str, Any]:
    """What was compared, and the versions of the software that did it."""
    table = comparison.table
    plan = {"scenario": _values(table["scenario"].to_list())} | {
        axis: _values(table[axis].to_list()) for axis in comparison.axes
    }
    seeds = sorted(set(table["seed"].to_list()))
    consecutive = len(seeds) > 2 and seeds == list(range(seeds[0], seeds[-1] + 1))
    plan |= {
        "seeds": f"{seeds[0]} to {seeds[-1]}" if consecutive else ", ".join(map(str, seeds)),
        "runs": str(len(table)),
        "numbers": ", ".join(comparison.metrics),
    }
    names = [c for c in table.columns if c.startswith("versions.")]
    # more than one version of a package if the comparison was resumed after an update
    versions = [
        (
            name.removeprefix("versions."),
            _values([v for v in table[name].to_list() if v is not None]),
            "",
        )
        for name in names
    ]
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
    kinds: dict[tuple[str, str], list[Failure]] = defaultdict(list)
    for controller in comparison.controllers:
        for row in controller.runs.filter(~controller.success).iter_rows(named=True):
            outcome, reason = str(row.get("outcome") or "no outcome"), str(row.get("reason") or "")
            failure = {
                "controller": controller.label,
                "seed": int(row["seed"]),
                "outcome": outcome,
                "reason": reason,
            }
            # reasons that differ in numbers (times, pixels) only are one kind of failure
            kinds[outcome, re.sub(r"\d[\d.e+-]*", "#", reason)].append(
                failure | {"place": folder / str(row["folder"])}
            )
    groups = sorted(kinds.values(), key=len, reverse=True)
    # tracebacks of every kind of crash in turn, since there is room for only a few
    for failure in _in_turn([g for g in groups if g[0]["outcome"] == "crashed"], ERRORS):
        with contextlib.suppress(OSError):
            text = (failure["place"] / "error.txt").read_text(encoding="utf-8", errors="replace")
            failure["error"] = text[-ERROR_CHARACTERS:].strip()
    for failure in _in_turn(groups, LISTED):
        failure["command"] = rerun_command(failure["place"])
    pictured, pictures = _gallery(groups)
    return {
        "failed": sum(map(len, groups)),
        "runs": len(comparison.table),
        "listed": LISTED,
        "kinds": [_kind(group) for group in groups],
        "pictured": pictured,
        "pictures": pictures,
        "repeated": [
            f"{c.label}, seed {row['seed']} ({str(row['outcome']).replace('_', ' ')})"
            for c in comparison.controllers
            for row in c.runs.iter_rows(named=True)
            if (row.get("attempts") or 1) > 1
        ],
    }


def rerun_command(place: Path) -> str:
    """The command that repeats a run, from the directory in which the comparison was started."""
    return f"vstestbed run {shlex.quote((place / 'scenario.yaml').as_posix())}"


def _kind(group: list[Failure]) -> dict[str, Any]:
    """One kind of failure: number of runs, seeds of each controller, and those runs whose command
    is shown.
    """
    first = group[0]["reason"]
    same = all(failure["reason"] == first for failure in group)
    seeds: dict[str, list[str]] = defaultdict(list)
    for failure in group:
        seeds[failure["controller"]].append(str(failure["seed"]))
    more = {
        name: f" and {len(s) - SEEDS:,} more" if len(s) > SEEDS else "" for name, s in seeds.items()
    }
    who = "; ".join(
        f"{name}: seed{'s' * (len(s) > 1)} {', '.join(s[:SEEDS])}{more[name]}"
        for name, s in seeds.items()
    )
    shown = [{"error": "", **failure} for failure in group if "command" in failure]
    reason = first if same else f"{first}, and the like"
    return {
        "outcome": group[0]["outcome"],
        "runs": len(group),
        "reason": reason,
        "who": who,
        "same": same,
        "shown": shown,
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
    room, pictures = PICTURE_BYTES, []
    for failure in _in_turn(with_picture, PICTURES):
        path = failure["place"] / "end.png"
        if (size := path.stat().st_size) > room:
            continue  # a smaller one may still fit
        room -= size
        words = (
            f"{failure['controller']}, seed {failure['seed']}:"
            f" {failure['outcome'].replace('_', ' ')}"
        )
        pictures.append((data_url("image/png", path.read_bytes()), words))
    return sum(map(len, with_picture)), pictures
