"""Measured and theoretical gain limits over delay as a figure, beside the root locus of the loop."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from vstestbed.core.files import write_whole
from vstestbed.report.comparison.tables import STYLE as TABLES
from vstestbed.report.html.canvas import INK, LINE_COLORS, new_figure, save, style
from vstestbed.report.html.template import PAGE, STYLE, data_url, figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Rows = Sequence[Mapping[str, Any]]
DPI = 200
COLUMNS: tuple[tuple[str, str, str], ...] = (
    ("delay_frames", "delay [frames]", "g"),
    ("latency_s", "delay [s]", ".3g"),
    ("gain_limit", "gain limit [1/s]", ".4g"),
    ("g_measured", "g measured", ".4f"),
    ("g_theory", "g in theory", ".4f"),
    ("measured_to_theory", "measured / theory", ".3f"),
    ("g_with_lag", "g with lag", ".4f"),
    ("measured_to_lag", "measured / with lag", ".3f"),
    ("joint", "unstable first", "s"),
    ("joint_lag_s", "its lag [s]", ".4f"),
    ("g_linear", "g of the linear arm", ".4f"),
    ("measured_to_linear", "measured / linear arm", ".3f"),
)
"""Columns of the table: name in the data, head, format."""


@dataclass(frozen=True)
class Branches:
    """Root locus of one delay: poles (m, n) over m gains from 0 on, and the poles at the measured limit (n,)."""

    delay_frames: float
    poles: NDArray[np.complexfloating]
    at_limit: NDArray[np.complexfloating]


def draw(rows: Rows, loci: Sequence[Branches]) -> Figure:
    """Gain limits over the delay, and the root loci in the upper half of the z plane."""
    drawn = new_figure(3.3, 7.2)
    left, right = drawn.subplots(1, 2, width_ratios=(1, 1.15))
    _draw_limits(left, rows)
    _draw_locus(right, loci)
    return drawn


def _draw_limits(axes: Axes, rows: Rows) -> None:
    rows = sorted(rows, key=lambda row: row["delay_frames"])
    d = [row["delay_frames"] for row in rows]
    axes.plot(d, [row["g_theory"] for row in rows], color=INK, label="theory for the delay alone")
    if any(row["g_with_lag"] for row in rows):
        axes.plot(d, [row["g_with_lag"] for row in rows], "--", color=LINE_COLORS[1], label="theory, servos' measured lag")
    if any(row.get("g_linear") for row in rows):
        axes.plot(d, [row["g_linear"] for row in rows], ":", color=LINE_COLORS[2], label="linear model of the arm")
    axes.plot(d, [row["g_measured"] for row in rows], "o", color=LINE_COLORS[0], markersize=5, label="measured")
    axes.set_xlabel("delay d [frames]")
    axes.set_ylabel("largest stable gain x period")
    axes.set_ylim(bottom=0)
    axes.set_xticks(d)
    axes.legend(loc="best")


def _draw_locus(axes: Axes, loci: Sequence[Branches]) -> None:
    angle = np.linspace(0, np.pi, 181)
    axes.plot(np.cos(angle), np.sin(angle), color=INK, linewidth=0.8)
    for i, one in enumerate(loci):
        color = LINE_COLORS[i % len(LINE_COLORS)]
        upper = one.poles.imag >= -1e-9  # the lower half mirrors it; the tolerance keeps real poles
        axes.plot(np.where(upper, one.poles.real, np.nan), np.where(upper, one.poles.imag, np.nan), color=color, linewidth=1.0)
        crossing = one.at_limit[one.at_limit.imag >= -1e-9]
        axes.plot(crossing.real, crossing.imag, "o", color=color, markersize=3)
        # an empty line for the legend: `upper` is a matrix with a line for each pole
        axes.plot([], [], color=color, label=f"d = {one.delay_frames:g}")
    axes.set_aspect("equal")
    axes.set_xlim(-1.35, 1.35)
    axes.set_ylim(-0.06, 1.6)
    axes.set_xlabel("Re z")
    axes.set_ylabel("Im z")
    axes.set_title("root locus; dots: the measured limit", pad=4)
    axes.legend(loc="upper center", ncols=3, fontsize=7)


def write_page(folder: Path, name: str, rows: Rows, loci: Sequence[Branches], command: str) -> Path:
    """Write `delay.png`, `delay.pdf` and `report.html`; returns the page's path.

    Raises:
        OutputError: a file cannot be written.
    """
    with style(paper=True):
        drawn = draw(rows, loci)
        save(drawn, folder / "delay.pdf", DPI)
        png = save(drawn, folder / "delay.png", DPI)
    picture = f'<img src="{data_url("image/png", png.read_bytes())}" alt="Gain limit over delay" style="width: 100%; height: auto">'
    caption = "Left: the gain, times the camera's period, at which the loop becomes unstable. Right: its poles as the gain rises."
    body = figure("Gain limit over delay", picture, caption) + _table(rows)
    if command:
        body += f"<section><h2>How it was made</h2><p>Made again by<br><code>{escape(command)}</code></p></section>"
    title = f"Delay: {escape(name)}"
    page = PAGE.format(title=title, style=STYLE + TABLES, heading=title, description="", body=body)
    return write_whole(folder / "report.html", page)


def _table(rows: Rows) -> str:
    """The limits as a table; columns without any value are left out (a robot without joints has no lag)."""
    shown = [column for column in COLUMNS if any(row.get(column[0]) is not None for row in rows)]
    heads = "".join(f"<th>{escape(head)}</th>" for _, head, _ in shown)
    cells = ["".join(f"<td>{_cell(row.get(key), form)}</td>" for key, _, form in shown) for row in rows]
    body = "".join(f"<tr>{row}</tr>" for row in cells)
    return f'<h2>In numbers</h2><div class="wide"><table><thead><tr>{heads}</tr></thead><tbody>{body}</tbody></table></div>'


def _cell(value: Any, form: str) -> str:
    return "-" if value is None else escape(format(value, form))
