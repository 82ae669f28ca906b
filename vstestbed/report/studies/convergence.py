"""Convergence maps as a figure: the share of seeds that converged in each cell, and how most of the others ended."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from vstestbed.core.files import write_whole
from vstestbed.core.geometry import Array
from vstestbed.report.comparison.tables import STYLE as TABLES
from vstestbed.report.html.canvas import INK, new_figure, save, style
from vstestbed.report.html.parts import data_url, figure
from vstestbed.report.html.template import PAGE, STYLE
from vstestbed.report.run.numbers import number

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

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
COLUMNS, DPI = 2, 200
AxisLabels = tuple[str, list[str]]


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


def draw(maps: Sequence[ConvergenceMap], x: AxisLabels, y: AxisLabels) -> Figure:
    """The maps side by side."""
    rows = -(-len(maps) // COLUMNS)
    n_y, n_x = maps[0].share.shape
    wide, high = 0.55 + 0.37 * n_x, 0.75 + 0.27 * n_y
    drawn = new_figure(high * rows + 0.35, max(2, COLUMNS) * max(wide, 3.0))
    grid = np.ravel(drawn.subplots(rows, COLUMNS, squeeze=False, sharex=True, sharey=True))
    for axes, one in zip(grid, maps, strict=False):
        _draw(axes, one, x, y)
    for axes in grid[len(maps) :]:
        axes.set_visible(False)
    drawn.supxlabel(x[0], fontsize=8)
    drawn.supylabel(y[0], fontsize=8)
    return drawn


def _draw(axes: Axes, one: ConvergenceMap, x: AxisLabels, y: AxisLabels) -> None:
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
    x: AxisLabels,
    y: AxisLabels,
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
        drawn = draw(maps, x, y)
        save(drawn, folder / "convergence.pdf", DPI)
        png = save(drawn, folder / "convergence.png", DPI)
    picture = f'<img src="{data_url("image/png", png.read_bytes())}" alt="Convergence maps" style="width: 100%; height: auto">'
    letters = ", ".join(f"{letter}: {word.replace('_', ' ')}" for word, letter in LETTERS.items())
    caption = f"Share of {seeds} seeds that reached the goal [%]; the letter: how most of the others ended ({letters})."
    body = f"<p><strong>{escape(caution)}</strong></p>" if caution else ""
    body += figure("Where it converges", picture, caption) + "".join(_table(one, x, y) for one in maps)
    if command:
        body += f"<section><h2>How it was made</h2><p>Made again by<br><code>{escape(command)}</code></p></section>"
    page = PAGE.format(title="Convergence", style=STYLE + TABLES, heading="Convergence", description=escape(description), body=body)
    return write_whole(folder / "report.html", page)


def _table(one: ConvergenceMap, x: AxisLabels, y: AxisLabels) -> str:
    """Distances from the true goal as a table, its rows from top to bottom as in the figure."""
    head = "".join(f"<th>{escape(value)}</th>" for value in x[1])
    rows = []
    for i in reversed(range(len(y[1]))):
        cells = "".join("<td>-</td>" if np.isnan(a) else f"<td>{number(1e3 * float(a))}</td>" for a in one.away_m[i])
        rows.append(f'<tr><th scope="row">{escape(y[1][i])}</th>{cells}</tr>')
    title = f"{escape(one.label)}: median distance from the true goal, of those that converged [mm]"
    return f'<h2>{title}</h2><div class="wide"><table><thead><tr><th></th>{head}</tr></thead><tbody>{"".join(rows)}</tbody></table></div>'
