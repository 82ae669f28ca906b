"""Maps of starts and of settings as figures: basins of attraction, convergence maps."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from vstestbed.core.files import write_whole
from vstestbed.core.geometry import Array
from vstestbed.report.comparison.tables import STYLE as TABLES
from vstestbed.report.html.canvas import INK, new_figure, save, style
from vstestbed.report.html.template import PAGE, STYLE, data_url, figure
from vstestbed.report.run.numbers import number

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


# Basins of attraction as a figure: the colour shows the outcome of a start, the shade its time to converge.
BasinAxis = tuple[str, str, float, float]
"""Name, unit, low, high."""
ENDINGS: Final = {
    "target_lost": ("#f3c04b", "target out of sight"),
    "plane_crossed": ("#d55e00", "behind the target's plane"),
    "local_minimum": ("#a0287a", "local minimum"),
    "diverged": ("#33150a", "diverged"),
    "unstable": ("#4f7a1e", "unstable"),
    "timed_out": ("#9c9c9c", "timed out"),
}
"""Colour and name of each failure. The colours differ in lightness as well as in hue (after Okabe & Ito 2008), so that colour-blind
readers can distinguish them, also in a grey print; blues are reserved for the converged."""
OTHER: Final = "#000000"
"""Colour of any other outcome."""
SOON, LATE = np.array([0.86, 0.94, 1.0]), np.array([0.02, 0.22, 0.42])
"""Blues (r, g, b) of the earliest and the latest starts to converge."""
PANEL_IN, BASIN_COLUMNS, BASIN_DPI = 2.0, 5, 200


@dataclass(frozen=True)
class BasinMap:
    """Outcome of each start of a grid by name, and time to converge [s] (NaN if it did not), both (n_y, n_x)."""

    label: str
    endings: Array
    time_s: Array


def colours(one: BasinMap, soonest: float, latest: float) -> Array:
    """The map as an image (n_y, n_x, 3): blue from light to dark between two times to converge [s], else the colour of the outcome."""
    from matplotlib.colors import to_rgb

    share = np.clip((one.time_s - soonest) / max(latest - soonest, 1e-9), 0, 1)
    picture = np.where(np.isfinite(share)[..., None], SOON + np.nan_to_num(share)[..., None] * (LATE - SOON), to_rgb(OTHER))
    for ending, (colour, _) in ENDINGS.items():
        picture[one.endings == ending] = to_rgb(colour)
    return picture


def draw_basin(maps: Sequence[BasinMap], x: BasinAxis, y: BasinAxis) -> Figure:
    """One panel per law, all with the same scale of shades, and a legend of the colours below."""
    columns = min(BASIN_COLUMNS, len(maps))
    rows = math.ceil(len(maps) / columns)
    drawn = new_figure(PANEL_IN * rows + 0.75, max(PANEL_IN * columns + 0.4, 4.6))
    times = np.concatenate([m.time_s[np.isfinite(m.time_s)] for m in maps]) if maps else np.zeros(0)
    # percentiles: a few extreme times must not compress the scale of all others
    soonest, latest = np.percentile(times, [1, 99]).tolist() if len(times) else (0.0, 1.0)
    grid = drawn.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    for axes in grid.ravel()[len(maps) :]:
        axes.set_visible(False)
    for i, one in enumerate(maps):
        axes = grid.ravel()[i]
        axes.imshow(colours(one, soonest, latest), origin="lower", extent=(x[2], x[3], y[2], y[3]), aspect="auto", interpolation="nearest")
        axes.grid(False)
        axes.set_title(f"{one.label}: {100 * float(np.mean(one.endings == 'converged')):.1f} %")
        if i + columns >= len(maps):
            axes.set_xlabel(f"{x[0]} [{x[1]}]")
            axes.tick_params(labelbottom=True)
        if i % columns == 0:
            axes.set_ylabel(f"{y[0]} [{y[1]}]")
    _draw_legend(drawn, grid, maps, soonest, latest)
    return drawn


def _draw_legend(drawn: Figure, grid: Any, maps: Sequence[BasinMap], soonest: float, latest: float) -> None:
    """A colour bar of the times to converge, and a legend of the outcomes that occur."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import LinearSegmentedColormap, Normalize
    from matplotlib.patches import Patch

    blues = LinearSegmentedColormap.from_list("converged", [tuple(SOON), tuple(LATE)])
    bar = drawn.colorbar(ScalarMappable(Normalize(soonest, latest), blues), ax=grid, location="right", shrink=0.9, aspect=30, pad=0.015)
    bar.set_label("converged: time [s]")
    present = {str(e) for m in maps for e in np.unique(m.endings.astype(str))} - {"converged"}
    patches = [Patch(color=colour, label=name) for ending, (colour, name) in ENDINGS.items() if ending in present]
    patches += [Patch(color=OTHER, label=ending.replace("_", " ")) for ending in sorted(present - set(ENDINGS))]
    if patches:
        drawn.legend(handles=patches, loc="outside lower center", ncols=min(5, len(patches)))


def write_maps(
    folder: Path, maps: Sequence[BasinMap], x: BasinAxis, y: BasinAxis, summaries: Sequence[Mapping[str, Any]], command: str
) -> Path:
    """Write `basin.png`, `basin.pdf` and `report.html`; returns the page's path.

    Raises:
        OutputError: a file cannot be written.
    """
    with style(paper=True):
        drawn = draw_basin(maps, x, y)
        save(drawn, folder / "basin.pdf", BASIN_DPI)
        png = save(drawn, folder / "basin.png", BASIN_DPI)
    picture = f'<img src="{data_url("image/png", png.read_bytes())}" alt="Basins of attraction" style="width: 100%; height: auto">'
    caption = (
        f"Start of the camera, {x[0]} and {y[0]} in the frame of its goal{_fixed_coordinates(summaries)}. Ideal cameras, without latency "
        f"or noise{_field_of_view(summaries)}. Blue converges, darker later; the number is its share."
    )
    body = figure("How each start ended", picture, caption) + _basin_table(summaries) + _checks(summaries)
    if command:
        body += f"<section><h2>How it was made</h2><p>Made again by<br><code>{escape(command)}</code></p></section>"
    page = PAGE.format(title="Basins of attraction", style=STYLE + TABLES, heading="Basins of attraction", description="", body=body)
    return write_whole(folder / "report.html", page)


def _fixed_text(summary: Mapping[str, Any]) -> str:
    # + 0.0 turns the -0.0 of rounding into 0
    return ", ".join(f"{name} {round(one['value'], 6) + 0.0:g} {one['unit']}" for name, one in summary["fixed"].items())


def _fixed_coordinates(summaries: Sequence[Mapping[str, Any]]) -> str:
    """The coordinates that are not on the map; for each law if they differ."""
    values = [_fixed_text(s) for s in summaries]
    if len(set(values)) > 1:
        return "; " + "; ".join(f"{s['label']}: {at}" for s, at in zip(summaries, values, strict=True))
    return f"; {values[0]}" if values else ""


FIELDS_OF_VIEW: Final = {"limited": "; limited field of view", "unlimited": "; unlimited field of view"}


def _field_of_view(summaries: Sequence[Mapping[str, Any]]) -> str:
    """The field of view; nothing if the laws differ in it."""
    found = {s["field_of_view"] for s in summaries}
    return FIELDS_OF_VIEW.get(found.pop(), "") if len(found) == 1 else ""


def _basin_table(summaries: Sequence[Mapping[str, Any]]) -> str:
    """Shares of the outcomes that occur, one row per law."""
    endings = ["converged", *ENDINGS]
    endings += sorted({e for s in summaries for e in s["shares"]} - set(endings))
    endings = [e for e in endings if any(s["shares"].get(e) for s in summaries)]
    head = "".join(f"<th>{escape(e.replace('_', ' '))} [%]</th>" for e in endings)
    rows = []
    for s in summaries:
        cells = "".join(f"<td>{100 * s['shares'].get(e, 0.0):.2f}</td>" for e in endings)
        check = f"{s['agreeing']} of {s['checked']}" if s["checked"] else "-"
        cells += f"<td>{s['starts']}</td><td>{s['processor_s']:.1f}</td><td>{check}</td>"
        rows.append(f'<tr><th scope="row">{escape(s["label"])}</th>{cells}</tr>')
    tail = "<th>starts</th><th>time of one core [s]</th><th>time loop agrees</th>"
    table = f"<table><thead><tr><th></th>{head}{tail}</tr></thead><tbody>{''.join(rows)}</tbody></table>"
    return f'<h2>In numbers</h2><div class="wide">{table}</div>'


def _checks(summaries: Sequence[Mapping[str, Any]]) -> str:
    """The checked starts whose single run ended otherwise than in the batch."""
    found = [(s["label"], d["words"]) for s in summaries for d in s["disagreements"]]
    if not found:
        return ""
    lines = "".join(f"<li>{escape(label)} at {escape(words)}</li>" for label, words in found)
    return f'<h2>Where the time loop ends otherwise</h2><ul class="runs">{lines}</ul>'


# Convergence maps as a figure: the share of seeds that converged in each cell, and how most of the others ended.
LETTERS: Final = {
    "target_lost": "L",
    "local_minimum": "M",
    "diverged": "D",
    "timed_out": "T",
    "unstable": "U",
    "unreachable": "R",
    "crashed": "C",
}
"""Letter of the most frequent outcome of a cell's failures."""
NONE, ALL = np.array([0.96, 0.93, 0.88]), np.array([0.05, 0.36, 0.62])
"""Colours (r, g, b) of cells in which no seed and in which every seed converged; those between are mixed linearly."""
SWEEP_COLUMNS, SWEEP_DPI = 2, 200
SweepAxis = tuple[str, list[str]]


@dataclass(frozen=True)
class ConvergenceMap:
    """The map of one law, arrays of shape (n_y, n_x).

    Attributes:
        label: name of the law.
        share: share of the seeds that converged; NaN where no run is done.
        others: most frequent outcome of the others; empty if all converged.
        away_m: median distance from the true goal of those that converged [m]; NaN if none did.
    """

    label: str
    share: Array
    others: NDArray[np.object_]
    away_m: Array


def draw_sweep(maps: Sequence[ConvergenceMap], x: SweepAxis, y: SweepAxis) -> Figure:
    """The maps side by side."""
    rows = -(-len(maps) // SWEEP_COLUMNS)
    n_y, n_x = maps[0].share.shape
    wide, high = 0.55 + 0.37 * n_x, 0.75 + 0.27 * n_y
    drawn = new_figure(high * rows + 0.35, max(2, SWEEP_COLUMNS) * max(wide, 3.0))
    grid = np.ravel(drawn.subplots(rows, SWEEP_COLUMNS, squeeze=False, sharex=True, sharey=True))
    for axes, one in zip(grid, maps, strict=False):
        _draw(axes, one, x, y)
    for axes in grid[len(maps) :]:
        axes.set_visible(False)
    drawn.supxlabel(x[0], fontsize=8)
    drawn.supylabel(y[0], fontsize=8)
    return drawn


def _draw(axes: Axes, one: ConvergenceMap, x: SweepAxis, y: SweepAxis) -> None:
    axes.imshow(np.where(np.isnan(one.share)[..., None], 1.0, NONE + one.share[..., None] * (ALL - NONE)), origin="lower", aspect="auto")
    for (i, j), share in np.ndenumerate(one.share):
        letter = LETTERS.get(str(one.others[i, j]), "") if share < 1 else ""
        words = "-" if np.isnan(share) else f"{100 * share:.0f}{letter}"
        axes.text(j, i, words, ha="center", va="center", fontsize=6.5, color="white" if share > 0.55 else INK)
    axes.set_xticks(range(len(x[1])), x[1], rotation=45 if max(map(len, x[1])) > 5 else 0)
    axes.set_yticks(range(len(y[1])), y[1])
    axes.grid(visible=False)
    axes.set_title(one.label)


def write_page(
    folder: Path,
    maps: Sequence[ConvergenceMap],
    x: SweepAxis,
    y: SweepAxis,
    seeds: int,
    description: str,
    command: str,
    caution: str = "",
) -> Path:
    """Write `convergence.png`, `convergence.pdf` and `report.html`, with a caution on top; returns the page's path.

    Raises:
        OutputError: a file cannot be written.
    """
    with style(paper=True):
        drawn = draw_sweep(maps, x, y)
        save(drawn, folder / "convergence.pdf", SWEEP_DPI)
        png = save(drawn, folder / "convergence.png", SWEEP_DPI)
    picture = f'<img src="{data_url("image/png", png.read_bytes())}" alt="Convergence maps" style="width: 100%; height: auto">'
    letters = ", ".join(f"{letter}: {word.replace('_', ' ')}" for word, letter in LETTERS.items())
    caption = f"Share of {seeds} seeds that reached the goal [%]; the letter: how most of the others ended ({letters})."
    body = f"<p><strong>{escape(caution)}</strong></p>" if caution else ""
    body += figure("Where it converges", picture, caption) + "".join(_sweep_table(one, x, y) for one in maps)
    if command:
        body += f"<section><h2>How it was made</h2><p>Made again by<br><code>{escape(command)}</code></p></section>"
    page = PAGE.format(title="Convergence", style=STYLE + TABLES, heading="Convergence", description=escape(description), body=body)
    return write_whole(folder / "report.html", page)


def _sweep_table(one: ConvergenceMap, x: SweepAxis, y: SweepAxis) -> str:
    """Distances from the true goal as a table, its rows from top to bottom as in the figure."""
    head = "".join(f"<th>{escape(value)}</th>" for value in x[1])
    rows = []
    for i in reversed(range(len(y[1]))):
        cells = "".join("<td>-</td>" if np.isnan(a) else f"<td>{number(1e3 * float(a))}</td>" for a in one.away_m[i])
        rows.append(f'<tr><th scope="row">{escape(y[1][i])}</th>{cells}</tr>')
    title = f"{escape(one.label)}: median distance from the true goal, of those that converged [mm]"
    return f'<h2>{title}</h2><div class="wide"><table><thead><tr><th></th>{head}</tr></thead><tbody>{"".join(rows)}</tbody></table></div>'
