"""Writes `report.html` and `figures/` of a comparison from its table and the logs in its folder."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import polars as pl

from vstestbed.core.errors import VstestbedError
from vstestbed.core.files import make_folder, write_whole
from vstestbed.core.registry import to_mapping
from vstestbed.core.shares import Call, at_once, result_of
from vstestbed.report.comparison import baseline, summary_text, tables
from vstestbed.report.comparison import failures as comparison_failures
from vstestbed.report.comparison import figures as comparison_figures
from vstestbed.report.comparison import figures as profiles
from vstestbed.report.comparison import figures as strip_plots
from vstestbed.report.comparison import grid as effects
from vstestbed.report.comparison import tables as comparison_tables
from vstestbed.report.comparison.columns import DEFAULT_METRICS, ComparisonResults, shown_by_default, value_text
from vstestbed.report.comparison.figures import PANELS, Data, Series, read_series
from vstestbed.report.comparison.pairs import Pair, pairs, write_records
from vstestbed.report.comparison.statistics import Interquartile, interquartiles
from vstestbed.report.html.canvas import WIDTH_IN, save, style, to_svg
from vstestbed.report.html.template import PAGE, STYLE, cell, figure, film
from vstestbed.report.run import numbers
from vstestbed.report.run.tracks import MeasuredError, Setting
from vstestbed.scenario.dump import load_run
from vstestbed.scenario.load import GIVEN, RESOLVED
from vstestbed.scenario.yaml_marks import plain_mapping

if TYPE_CHECKING:
    from matplotlib.figure import Figure


# In which fields of their scenarios the controllers of a comparison differ.
UNCOMPARED = ("name", "description", "seed", "draw_start", "plugins")
"""Fields that change nothing of an experiment, or differ between seeds."""
MISSING = object()
"""Stands for a field that a scenario does not have."""


def differing(runs: Sequence[Path]) -> tuple[str, ...]:
    """Dotted names of the fields in which the scenarios of runs' folders differ, sorted; empty where one of them cannot be read."""
    try:
        return tuple(sorted(set[str]().union(*_from_first(runs))))
    except (OSError, UnicodeError, VstestbedError):
        return ()


def _from_first(runs: Iterable[Path]) -> Iterator[set[str]]:
    """The fields in which the scenario of each run's folder differs from the first."""
    first: dict[str, object] | None = None
    for run in runs:
        fields = {name: value for name, value in _flat(_scenario(run)) if name.split(".")[0] not in UNCOMPARED}
        first = fields if first is None else first
        yield {name for name in first.keys() | fields.keys() if fields.get(name, MISSING) != first.get(name, MISSING)}


def only_gains(fields: Iterable[str]) -> bool:
    """Whether all these fields are gains of the law: `law.gain`, `law.gain.at_zero`, `law.gain_z`, `law.k_rho`."""
    names = list(fields)
    return bool(names) and all(
        name.startswith("law.") and any("gain" in part or part.startswith("k_") for part in name.split(".")) for name in names
    )


def gains_alone(folder: Path, comparison: ComparisonResults) -> str:
    """The gains in which controllers differ that differ in nothing else, in words; "" for others, or where a scenario cannot be read.

    The first run of each controller stands for all of its seeds. Reading ends at the first difference that is no gain: to read a scenario
    takes 50 ms.

    Args:
        folder: the comparison's folder. comparison: its results.
    """
    found: set[str] = set()
    try:
        for fields in _from_first(folder / str(c.runs["folder"][0]) for c in comparison.controllers):
            if fields and not only_gains(fields):
                return ""
            found |= fields
    except (OSError, UnicodeError, VstestbedError):
        return ""
    return in_words(found)


def in_words(gains: Iterable[str]) -> str:
    """Names of gains in a sentence: `law.gain and law.k_rho`."""
    names = list(dict.fromkeys(name.removesuffix(".value") for name in sorted(gains)))  # a constant gain may be written as a number
    return " and ".join(names) if len(names) < 3 else f"{', '.join(names[:-1])} and {names[-1]}"


def _scenario(run: Path) -> Any:
    """All values of a run's scenario; one that could not begin has none written out."""
    record = run / RESOLVED
    if record.is_file():
        return plain_mapping(record.read_text(encoding="utf-8"), str(record), "")[0]
    return to_mapping(load_run(run))


def _flat(value: Any, name: str = "") -> Iterator[tuple[str, object]]:
    """Every scalar of nested mappings and lists with its dotted name."""
    if isinstance(value, dict | list) and value:
        for key, inner in value.items() if isinstance(value, dict) else enumerate(value):
            yield from _flat(inner, f"{name}.{key}" if name else str(key))
    else:
        yield name, value


FILM_BYTES: Final = 8_000_000
"""A film up to this size is embedded (base64 makes it 4/3 as large); the page then stays under 20 MB."""
BROAD_IN: Final = 2 * WIDTH_IN
"""Width of a figure over both columns of the page [in]."""
NOTEBOOK_PX: Final = 480
"""Height of a comparison's result in a notebook [px]."""
COLUMN_IN: Final = {1: 3.5, 2: 7.16}
"""Width of a paper's figure over one and two columns (IEEE) [in]."""
DPI: Final = 300

# Of each figure: key (file name, SVG identifiers), title, caption, columns that it takes, function that draws it.
Plot = tuple[str, str, str, int, Callable[[Data, float], "Figure | None"]]
PLOTS: Final[tuple[Plot, ...]] = (
    (
        "error",
        "Error over time",
        "Median over the runs, with the band from the first to the third quartile for up to four controllers. A run that has ended holds "
        "its last value; one without target in sight, or without a log, counts as farther away than all others. Dotted: the threshold.",
        1,
        comparison_figures.medians,
    ),
    (
        "success",
        "Success over time",
        "Share of all runs that had come under the threshold for good by a time, with its pointwise 95 % band (Wilson) for up to four "
        "controllers: the performance profile of the time to converge.",
        1,
        profiles.success,
    ),
    (
        "runs",
        "Error of single runs",
        "Thin: the first runs of each controller, those in red did not reach the goal, a cross where they were last seen. "
        "Thick: median and quartiles of all its runs. Grey: the other controllers' medians in the same unit. Dotted: the threshold.",
        2,
        comparison_figures.each_run,
    ),
    (
        "distributions",
        "All runs in numbers",
        "A point a run; bar and stroke: quartiles and median, as in the table. Red crosses: runs that did not reach the goal, an arrow "
        "at the edge where they lie beyond it; a red number right of the frame counts the runs that have no such number. Of very many "
        "runs the first are drawn; the bars are of all.",
        2,
        strip_plots.distributions,
    ),
    (
        "grid",
        "Effects and controllers",
        "A row for each value of the first axis, a column for each of the second. Of the time to converge the first row has the median, "
        "and the others the mean change against it over the starts from which both reached the goal. Last: the mean over the columns. "
        "In bold: p is at most 0.05 after Holm's correction over all cells, or over all rows of the last column.",
        2,
        effects.grid,
    ),
    (
        "profiles",
        "Performance profiles",
        "Share of all runs that are as good as the value on the axis, or better; the good end is on the left. "
        f"{tables.FAILED}: a curve ends at the share of those that did. Bands as above.",
        2,
        profiles.profiles,
    ),
    (
        "differences",
        "Paired differences",
        "Mean over the seeds on which both reached the goal, with its 95 % interval. Filled: the difference is real "
        "after Holm's correction for all tests of the page. In colour, but not filled: only who is better more often is (sign test).",
        2,
        comparison_figures.differences,
    ),
)

GRID: Final = next((i for i, plot in enumerate(PLOTS) if plot[0] == "grid"), 0)


def write_comparison_report(
    folder: Path,
    table: pl.DataFrame,
    axes: tuple[str, ...],
    metrics: tuple[str, ...] = DEFAULT_METRICS,
    description: str = "",
    command: str = "",
    film: Path | Future[Path | None] | None = None,
    plugins: Sequence[str] = (),
    call: Call = at_once,
) -> Path:
    """Write `report.html`, `figures/` and the tables `controllers` and `pairs` into a comparison's folder; returns the page's path.

    Args:
        folder: the comparison's folder, with the runs' folders that the table names.
        table: one row per run, as in `comparison.parquet`.
        axes: paths of the varied fields, each a column of the table.
        metrics: keys of `summary.json` to show; one that no run has shows as dashes.
        description: what is compared, in a few words. command: the command line that repeats the comparison.
        film: the side-by-side film in the folder, which may still be in the making; embedded up to 8 MB, else linked.
        plugins: of the comparison, as in `scenario.load.load`. call: draws the figures.

    Raises:
        OutputError: a file cannot be written.
    """
    comparison = ComparisonResults(table, axes, metrics, description)
    all_pairs, means = pairs(comparison), interquartiles(comparison)
    write_records(folder, comparison, means, all_pairs)
    figures = _all_figures(folder, comparison, all_pairs, plugins, call)
    body = [
        summary_text.headline(comparison, all_pairs, gains_alone(folder, comparison)),
        baseline.section(folder),
        *_tables(comparison, means, all_pairs),
        f"<section><h2>Figures</h2>{figures}</section>",
        _film(result_of(film) if isinstance(film, Future) else film),
        comparison_failures.section(folder, comparison),
        _provenance(comparison, command),
        comparison_tables.SCRIPT,
    ]
    scenarios = list(dict.fromkeys(map(str, table["scenario"].to_list())))
    # two or three names fit the heading
    heading = " against ".join(scenarios) if 0 < len(scenarios) <= 3 else f"Comparison of {len(scenarios)} scenarios"
    subtitle = f'<p class="soft">{escape(_plan_sentence(comparison))}</p>'
    subtitle = (f"<p>{escape(description)}</p>" if description else "") + subtitle
    page = PAGE.format(
        title=escape(f"{heading}: comparison"),
        style=STYLE + comparison_tables.STYLE,
        heading=escape(heading),
        description=subtitle,
        body="\n".join(filter(None, body)),
    )
    return write_whole(folder / "report.html", page)


def comparison_cell(folder: Path, table: pl.DataFrame, axes: tuple[str, ...], metrics: tuple[str, ...]) -> str:
    """The result of a comparison as a notebook shows it: who is better, the controllers' numbers, their differences; no figures."""
    comparison = ComparisonResults(table, axes, metrics or shown_by_default(table))
    paired = pairs(comparison)
    body = [
        summary_text.headline(comparison, paired, gains_alone(folder, comparison)),
        *_tables(comparison, interquartiles(comparison), paired),
        comparison_tables.SCRIPT,
    ]
    look, where = STYLE + comparison_tables.STYLE, f'<p class="soft">Figures and films: {escape(str(folder / "report.html"))}</p>'
    return cell(PAGE.format(title="Comparison", style=look, heading="Comparison", description=where, body="\n".join(body)), NOTEBOOK_PX)


def _tables(comparison: ComparisonResults, means: Sequence[Mapping[str, Interquartile]], all_pairs: list[Pair]) -> tuple[str, ...]:
    """The controllers' numbers and how they differ."""
    return (
        comparison_tables.controllers(comparison),
        tables.interquartile_means(comparison, means),
        comparison_tables.differences(comparison, all_pairs),
        tables.improvements(comparison, all_pairs),
    )


def _paper(data: Data, plot: int, place: Path) -> None:
    """A figure in the size and style of a paper, as PDF with embedded fonts and as PNG."""
    key, _, _, columns, draw = PLOTS[plot]
    with style(paper=True):
        drawn = draw(data, COLUMN_IN[columns])
        if drawn is not None:
            save(drawn, place / f"{key}.pdf")
            drawn.set_layout_engine("none")  # keep the layout of the PDF: to compute it again would take as long
            save(drawn, place / f"{key}.png", DPI)


def _on_page(data: Data, plot: int) -> str:
    """A figure as inline SVG with its title and caption; empty where it has nothing to show."""
    key, title, caption, columns, draw = PLOTS[plot]
    with style():
        drawn = draw(data, {1: WIDTH_IN, 2: BROAD_IN}[columns])
        return "" if drawn is None else figure(title, to_svg(drawn, key, title), caption)


def _all_figures(folder: Path, comparison: ComparisonResults, all_pairs: list[Pair], plugins: Sequence[str], call: Call) -> str:
    """The figures: all of them for up to PANELS controllers; of more the grid, or without a grid all figures of the first PANELS."""
    n, place = len(comparison.controllers), make_folder(folder / "figures")
    if n > PANELS and effects.Grid.of(comparison) is not None:
        words = f"The grid stands for the figures with a line or a row for each controller, since there are {n} of them."
        return _soft(words) + _figures(Data(comparison, Series(np.zeros(1), ()), all_pairs), (GRID,), place, call)
    shown = comparison if n <= PANELS else comparison.first(PANELS)
    chosen = [pair for pair in all_pairs if max(pair.a, pair.b) < PANELS]
    data = Data(shown, read_series(folder, shown, _measured(folder, shown, plugins)), chosen)
    words = _soft(f"The figures show the first {PANELS} of {n} controllers.") if n > PANELS else ""
    return words + _figures(data, range(len(PLOTS)), place, call)


def _soft(words: str) -> str:
    return f'<p class="soft">{words}</p>'


def _figures(data: Data, numbers: Sequence[int], place: Path, call: Call) -> str:
    """Figures for the page, the narrow ones side by side, the broad ones below; and for papers in the folder `place`."""
    on_page, papers = [call(_on_page, data, i) for i in numbers], [call(_paper, data, i, place) for i in numbers]
    drawn = [(PLOTS[i][3], result_of(made)) for i, made in zip(numbers, on_page, strict=True)]
    narrow, broad = ([f for columns, f in drawn if columns == wanted and f] for wanted in (1, 2))
    for paper in papers:
        result_of(paper)
    above = _sampled(data.series.sampled)
    return f'{above}<div class="plots">{"".join(narrow)}</div>' + "".join(f'<div class="broad">{f}</div>' for f in broad)


def _sampled(most: int | None) -> str:
    """Which runs the curves are of, where it is not all."""
    return _soft(f"Errors over time are of the first {most:,} runs of each controller, all else of all runs.") if most else ""


def _measured(folder: Path, comparison: ComparisonResults, plugins: Sequence[str]) -> list[MeasuredError]:
    """The error in the image that decides, of each controller; without a threshold where those with the same unit differ in it."""
    # one run per controller suffices: seeds do not change the stop block
    firsts = [folder / str(c.runs["folder"][0]) for c in comparison.controllers]
    found = [Setting.of(load_run(run, plugins)).image_errors[0] if (run / GIVEN).is_file() else None for run in firsts]
    limits: dict[str, set[float | None]] = {}
    for error in filter(None, found):
        limits.setdefault(error.unit, set()).add(error.threshold)
    agreed = {unit: known.pop() if len(known) == 1 else None for unit, known in limits.items()}
    return [error._replace(threshold=agreed.get(error.unit)) for error in (one or MeasuredError() for one in found)]


def _film(path: Path | None) -> str:
    if path is None or not path.is_file():
        return ""
    content = film("The same seed, side by side", path, path.stat().st_size <= FILM_BYTES)
    return f'<section class="films"><h2>Film</h2>{content}</section>'


def _plan_sentence(comparison: ComparisonResults) -> str:
    n, seeds = len(comparison.controllers), comparison.table["seed"].n_unique()
    total = summary_text.runs(len(comparison.table))
    return f"{n} controller{'s' * (n != 1)}, {seeds} seed{'s' * (seeds != 1)}, {total}; the same seed gives each the same start and noise."


def _provenance(comparison: ComparisonResults, command: str) -> str:
    """The plan of the comparison, the command that repeats it, and the versions of the software."""
    table = comparison.table
    repeat = f"<p>Made again by<br><code>{escape(command)}</code></p>" if command else ""
    plan = {"scenario": _values(table["scenario"].to_list())}
    plan |= {axis: _values(table[axis].to_list()) for axis in comparison.axes}
    plan |= {"seeds": _seeds(table["seed"].to_list()), "runs": str(len(table)), "numbers": ", ".join(comparison.metrics)}
    lines = "".join(f"<dt>{escape(k)}</dt><dd>{escape(v)}</dd>" for k, v in plan.items())
    names = [c for c in table.columns if c.startswith("versions.")]
    # more than one version of a package if the comparison was resumed after an update
    versions = {name.removeprefix("versions."): _values([v for v in table[name].to_list() if v is not None]) for name in names}
    software = numbers.provenance({"versions": versions})
    return f'<section><h2>How it was made</h2>{repeat}<dl class="plan">{lines}</dl>{software}</section>'


def _values(values: Sequence[object]) -> str:
    """The distinct values, in order of first appearance."""
    return ", ".join(dict.fromkeys(map(value_text, values)))


def _seeds(seeds: Sequence[int]) -> str:
    """`0 to 19` for consecutive seeds, otherwise all of them."""
    distinct = sorted(set(seeds))
    consecutive = len(distinct) > 2 and distinct == list(range(distinct[0], distinct[-1] + 1))
    return f"{distinct[0]} to {distinct[-1]}" if consecutive else ", ".join(map(str, distinct))
