"""Matplotlib figures in one style, as inline SVG that follows the page's light or dark colours, and
as files; no global state.
"""

from __future__ import annotations

import html
import io
import re
import textwrap
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from vstestbed.core.files import write_whole
from vstestbed.core.geometry import Array
from vstestbed.report.chart import bordered
from vstestbed.report.marks import INK, RULE, WIDTH_IN, paint

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from vstestbed.report.chart import Chart, ChartPanel, Curve

__all__ = ["chart_figure", "new_figure", "panels", "plain", "publish", "save", "style", "wrapped"]

DPI = 200  # of pictures
_STYLE: Any = {
    # comes with matplotlib; the names behind `sans-serif` would be looked up for every word
    "font.family": "DejaVu Sans",
    "font.size": 8,
    "axes.labelsize": 8,
    "axes.edgecolor": RULE,
    "axes.labelcolor": INK,
    "axes.titlesize": 8,
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": RULE,
    "grid.alpha": 0.45,
    "grid.linewidth": 0.6,
    "text.color": INK,
    "xtick.color": RULE,
    "ytick.color": RULE,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "xtick.labelsize": 7.5,
    "ytick.labelsize": 7.5,
    "lines.linewidth": 1.2,
    "lines.solid_capstyle": "round",
    "legend.frameon": False,
    "legend.fontsize": 7.5,
    "legend.handlelength": 1.4,
    "legend.columnspacing": 1.2,
    "figure.facecolor": "none",
    "axes.facecolor": "none",
    "savefig.facecolor": "none",
    # hinted text is narrower in the layout than in the vector formats: labels at the edge would be
    # cut
    "text.hinting": "no_hinting",
    "svg.fonttype": "none",  # text stays text: small, searchable, in the page's own font
    "svg.hashsalt": "vstestbed",  # the same run gives the same bytes
    "pdf.fonttype": 42,  # embedded TrueType: journals refuse Type 3 fonts, matplotlib's default
    "path.simplify_threshold": 0.2,
}


def style() -> Any:
    """A context manager in which figures are drawn and saved in the project's style, that of a
    paper.
    """
    # all matplotlib imports are inside functions: commands that draw nothing start faster
    import matplotlib

    return matplotlib.rc_context(_STYLE)


def new_figure(height_in: float, width_in: float = WIDTH_IN) -> Figure:
    """An empty figure on the Agg canvas, never a window; sizes in inches."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width_in, height_in), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def panels(figure: Figure, n: int, columns: int, **shared: Any) -> list[Any]:
    """The first n axes of a grid in the figure, row by row;
    the others of the last row are hidden.
    """
    found = figure.subplots(-(-n // columns), columns, squeeze=False, **shared).ravel().tolist()
    for axes in found[n:]:
        axes.set_visible(False)
    return found[:n]


def chart_figure(chart: Chart) -> Figure:
    """A run's chart (`chart`) as a matplotlib figure."""
    with style():
        entries = chart.legend()
        # as many columns as the longest entry leaves room for
        longest = max(map(len, entries), default=1)
        columns = max(1, min(len(entries), 90 // (longest + 7)))
        figure = new_figure(chart.height / 72 + 0.2 * -(-len(entries) // columns))
        shares = [panel.share for panel in chart.panels]
        grid = figure.subplots(len(shares), squeeze=False, sharex=True, height_ratios=shares)[:, 0]
        for axes, panel in zip(grid, chart.panels, strict=True):
            _draw_panel(axes, panel)
        grid[-1].set_xlabel(chart.panels[-1].labels[0])
        if entries:
            nothing = np.zeros(0)
            handles = [_artist(curve, nothing, nothing) for curve in entries.values()]
            names = [plain(name) for name in entries]
            figure.legend(handles, names, loc="outside lower center", ncols=columns)
        picture = io.BytesIO()
        save_to(figure, picture, "png", 110)
    # Jupyter shows it without `%matplotlib inline`, too
    figure._repr_png_ = picture.getvalue  # pyright: ignore[reportAttributeAccessIssue]
    return figure


def _draw_panel(axes: Axes, panel: ChartPanel) -> None:
    """A panel's curves and words between its limits."""
    xlim, ylim = panel.limits()
    axes.set(xlim=xlim, ylim=ylim, ylabel=panel.labels[1], title=panel.title)
    if panel.log:
        axes.set_yscale("log")
    if panel.equal:
        axes.set_aspect("equal")
    if panel.bare:
        axes.set_axis_off()
    for axis, words in zip((axes.xaxis, axes.yaxis), panel.in_words, strict=True):
        if words is not None:
            axis.set_major_formatter(lambda value, _, words=words: words(value))
    for curve in panel.curves:
        axes.add_artist(_artist(curve, bordered(curve.x, xlim), bordered(curve.y, ylim)))
    for x, y, words, ha, color in panel.words:
        at = float(bordered(np.array(x), xlim)), float(bordered(np.array(y), ylim))
        va = "top" if np.isinf(y) else "center"
        axes.text(*at, plain(words), color=color, ha=ha, va=va, fontsize=7.5)


def _artist(curve: Curve, x: Array, y: Array) -> Artist:
    """A curve through these points, or its entry in a legend."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Polygon

    look: Any = {"linewidth": curve.linewidth, "alpha": curve.alpha, "zorder": curve.zorder}
    if curve.is_area:
        corners = np.column_stack([x, y])
        return Polygon(corners, facecolor=curve.fill, edgecolor=curve.color, **look)
    return Line2D(
        x,
        y,
        color=curve.color,
        linestyle="none" if curve.marker else curve.linestyle,
        marker=curve.marker or ("o" if len(x) == 1 else ""),
        markersize=curve.markersize,
        markerfacecolor=curve.fill,
        markeredgewidth=curve.linewidth,
        **look,
    )


def publish(figure: Figure, key: str, label: str, place: Path | None = None) -> str:
    """The figure as an `<svg>` element for HTML and, in the folder `place`, as KEY.pdf with
    embedded fonts, KEY.svg and KEY.png, all alike. key: also the prefix of the element's
    identifiers. label: text for screen readers.
    """
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    sink = io.StringIO()
    figure.set_facecolor("white")
    # without matplotlib's warnings, which are for who writes the figure: of a script that its font
    # lacks, a reader can mend nothing
    with warnings.catch_warnings(action="ignore", category=UserWarning):
        figure.draw_without_rendering()
        figure.set_layout_engine(None)  # keep this layout: to compute it again would take as long
        FigureCanvasSVG(figure).print_svg(
            sink, metadata={"Date": None, "Creator": None, "Format": None, "Type": None}
        )
    text = sink.getvalue()
    if place is not None:
        write_whole(place / f"{key}.svg", text.encode())
        save(figure, place / f"{key}.pdf")
        save(figure, place / f"{key}.png", DPI)
    text = re.sub(r"<metadata>.*?</metadata>", "", text[text.index("<svg") :], flags=re.DOTALL)
    # several figures share a page, and with one hash salt matplotlib would give their clip paths
    # the same identifiers
    text = re.sub(r'\bid="', f'id="{key}-', text)
    text = re.sub(r'(href="|url\()#', rf"\1#{key}-", text)
    # the page's colours, which follow light and dark mode
    text = (
        text.replace("fill: #ffffff", "fill: none", 1)
        .replace(INK, paint(INK))
        .replace(RULE, paint(RULE))
    )
    return re.sub(
        r"<svg\b", f'<svg role="img" aria-label="{html.escape(label)}"', text, count=1
    ).strip()


def save(figure: Figure, path: Path, dpi: int = 150) -> Path:
    """Write the figure on white in the format of the file's suffix, without a date: the same figure
    gives the same bytes.
    """
    sink = io.BytesIO()
    save_to(figure, sink, path.suffix.lower()[1:], dpi)
    return write_whole(path, sink.getvalue())


def save_to(figure: Figure, sink: io.BytesIO, kind: str, dpi: int) -> None:
    """`save` into memory."""
    undated: dict[str, Any] = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}.get(kind, {})
    with warnings.catch_warnings(action="ignore", category=UserWarning):
        figure.savefig(sink, format=kind, dpi=dpi, facecolor="white", metadata=undated)


def plain(name: str) -> str:
    """A name for matplotlib: no mathtext, no leading underscore, which a legend would hide; control
    characters as Python escapes them.
    """
    # no font has them, XML does not allow them
    printable = "".join(c if c.isprintable() or c == "\n" else repr(c)[1:-1] for c in name)
    return printable.replace("$", r"\$").lstrip("_") or "(unnamed)"


def wrapped(label: str, width: int = 20) -> str:
    """A long label broken into several lines."""
    return textwrap.fill(label, width)
