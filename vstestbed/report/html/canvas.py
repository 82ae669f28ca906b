"""Matplotlib figures in one style, as inline SVG that follows the page's light or dark colours, and as files.

No pyplot and no global state. Ink and rules are drawn in two colours that nothing else uses; in the SVG they are replaced by the
page's CSS variables `--ink` and `--rule`. Identifiers get a prefix, because one page holds many figures.
"""

from __future__ import annotations

import colorsys
import html
import io
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from vstestbed.core.files import write_whole

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from mpl_toolkits.mplot3d import Axes3D

INK = "#010203"
RULE = "#a1b2c3"
LOST = "#d03040"
GOAL = "#0a8f6a"
AXIS_COLORS = ("#d55e00", "#009e73", "#0080d0")  # x, y, z; distinct to colour-blind readers (Okabe & Ito 2008, blue lightened)
LINE_COLORS = ("#0080d0", "#d55e00", "#009e73", "#b5559a", "#a88700", "#3fa7c4", "#8a6fd1", "#7a7f86")
WIDTH_IN = 5.2
RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")

_STYLE: Any = {
    "font.family": "DejaVu Sans",  # comes with matplotlib; the names behind `sans-serif` would be looked up for every word
    "font.size": 9.5,
    "axes.labelsize": 9.5,
    "axes.edgecolor": RULE,
    "axes.labelcolor": INK,
    "axes.titlesize": 9.5,
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
    "lines.linewidth": 1.4,
    "lines.solid_capstyle": "round",
    "legend.frameon": False,
    "legend.fontsize": 9,
    "legend.handlelength": 1.4,
    "legend.columnspacing": 1.2,
    "figure.facecolor": "none",
    "axes.facecolor": "none",
    "savefig.facecolor": "none",
    "svg.fonttype": "none",  # text stays text: small, searchable, in the page's own font
    "svg.hashsalt": "vstestbed",  # the same run gives the same bytes
    "pdf.fonttype": 42,  # embedded TrueType: journals refuse Type 3 fonts, matplotlib's default
    "path.simplify_threshold": 0.2,
}
_PAPER: Any = {
    "font.size": 8,
    "axes.labelsize": 8,
    "axes.titlesize": 8,
    "legend.fontsize": 7.5,
    "xtick.labelsize": 7.5,
    "ytick.labelsize": 7.5,
    "lines.linewidth": 1.2,
}


def style(paper: bool = False) -> Any:
    """A context manager in which figures are drawn and saved in the project's style; `paper`: with the smaller text of a paper."""
    import matplotlib  # all matplotlib imports are inside functions: commands that draw nothing start faster

    return matplotlib.rc_context(_STYLE | (_PAPER if paper else {}))


def new_figure(height_in: float, width_in: float = WIDTH_IN) -> Figure:
    """An empty figure on the Agg canvas, never a window; sizes in inches."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width_in, height_in), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def arrange(figure: Figure) -> None:
    """Place one column of axes and the legend below them by fixed margins: `constrained` draws all text three times to measure it.

    Axes in space are left as `fill` has placed them.
    """
    if any(axes.name == "3d" for axes in figure.axes):
        return
    width, height = figure.get_size_inches()
    rows = sum(-(-len(legend.get_texts()) // legend._ncols) for legend in figure.legends)  # pyright: ignore[reportAttributeAccessIssue]
    titled = any(axes.get_title(loc="left") for axes in figure.axes)
    left, right, bottom, top, gap = 0.82, 0.14, 0.5 + 0.2 * rows, 0.32 if titled else 0.2, 0.2
    figure.set_layout_engine("none")
    each = (height - bottom - top + gap) / len(figure.axes)
    for i, axes in enumerate(reversed(figure.axes)):
        low = bottom + i * each
        axes.set_position((left / width, low / height, 1 - (left + right) / width, (each - gap) / height))


def log_scale(axes: Axes) -> None:
    """Make the vertical axis of drawn curves logarithmic, with few ticks.

    Its numbers are plain text, `2×10⁻³`: matplotlib's parser of formulas takes longer than the figure.
    """
    from matplotlib.ticker import LogFormatterSciNotation, NullLocator

    class Plain(LogFormatterSciNotation):
        def __call__(self, x: float, pos: int | None = None) -> str:
            text = super().__call__(x, pos).replace("\\times", "\N{MULTIPLICATION SIGN}")
            text = re.sub(r"\^\{([-\d]+)\}", lambda power: power[1].translate(RAISED), text)
            return re.sub(r"\\mathdefault|[${} ]", "", text)

    axes.set_yscale("log")
    axes.yaxis.set_major_formatter(Plain())
    axes.yaxis.set_minor_formatter(Plain(labelOnlyBase=False))
    low, high = axes.get_ylim()
    if high > 30 * low:  # of fewer decades, the lines between them have numbers
        axes.yaxis.set_minor_locator(NullLocator())


def new_space(figure: Figure, **options: Any) -> Axes3D:
    """3-D axes for a figure that holds nothing else but a legend at the bottom; `fill` places them."""
    figure.set_layout_engine("none")
    width, height = figure.get_size_inches()
    # a first place only, which `fill` changes
    side = 0.8 * min(width, height)
    return figure.add_axes((0.1, 0.1, side / width, side / height), projection="3d", **options)  # pyright: ignore[reportReturnType]


def fill(axes: Axes3D, box: bool, legend_in: float = 0.3) -> None:
    """Scale and shift 3-D axes so that the drawing with all its text fills the figure above the legend.

    Args:
        axes: from `new_space`, with everything drawn.
        box: whether the axes have their box and ticks.
        legend_in: height reserved for the legend [in].
    """
    figure: Any = axes.figure
    width, height = figure.get_size_inches()
    margin = 0.08  # [in]
    low, high = np.array([margin, legend_in + margin]), np.array([width - margin, height - margin])
    for artist in (*axes.lines, *axes.collections):
        artist.set_clip_on(False)  # otherwise clipped at the square of the axes, which is not visible
    for _ in range(3):  # iterated, since text keeps its size when the axes are scaled
        figure.draw_without_rendering()
        extent = _extent(axes, box) / figure.dpi
        scale = float(((high - low) / np.ptp(extent, axis=0)).min())
        place = axes.get_position().get_points() * (width, height)
        corner, opposite = (low + high) / 2 + scale * (place - extent.mean(axis=0))
        axes.set_position((*(corner / (width, height)), *((opposite - corner) / (width, height))))


def _extent(axes: Any, box: bool) -> NDArray[np.float64]:
    """Bounding box of the drawing in 3-D axes, lower left and upper right corner (2, 2) [px]: lines, text, optionally box and ticks."""
    from mpl_toolkits.mplot3d.proj3d import proj_transform

    shown: list[Any] = [line.get_data_3d() for line in axes.get_lines()]
    shown += [np.reshape(word.get_position_3d(), (3, 1)) for word in axes.texts]
    if box:
        shown.append(np.array(np.meshgrid(axes.get_xlim(), axes.get_ylim(), axes.get_zlim())).reshape(3, -1))
    # project all shown points to the figure's plane
    x, y, z = np.concatenate(shown, axis=1)
    flat = proj_transform(x, y, z, axes.get_proj())[:2]
    pixels = axes.transData.transform(np.stack(flat, axis=-1))
    if box:
        renderer = axes.figure.canvas.get_renderer()
        pixels = np.concatenate([pixels, *(axis.get_tightbbox(renderer).get_points() for axis in (axes.xaxis, axes.yaxis, axes.zaxis))])
    return np.stack([np.nanmin(pixels, axis=0), np.nanmax(pixels, axis=0)])


def to_svg(figure: Figure, key: str, label: str) -> str:
    """The figure as an `<svg>` element for HTML; `key`: prefix of its identifiers, `label`: text for screen readers."""
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    sink = io.StringIO()
    # not `savefig`, which draws everything once before, to find a renderer
    FigureCanvasSVG(figure).print_svg(sink, metadata={"Date": None, "Creator": None, "Format": None, "Type": None})
    text = sink.getvalue()
    text = re.sub(r"<metadata>.*?</metadata>", "", text[text.index("<svg") :], flags=re.DOTALL)
    # several figures share a page, and with one hash salt matplotlib would give their clip paths the same identifiers
    text = re.sub(r'\bid="', f'id="{key}-', text)
    text = re.sub(r'(href="|url\()#', rf"\1#{key}-", text)
    # the page's colours, which follow light and dark mode
    text = text.replace(INK, "var(--ink)").replace(RULE, "var(--rule)")
    return re.sub(r"<svg\b", f'<svg role="img" aria-label="{html.escape(label)}"', text, count=1).strip()


def save(figure: Figure, path: Path, dpi: int = 150) -> Path:
    """Write the figure on white in the format of the file's suffix, without a date: the same figure gives the same bytes.

    Raises:
        OutputError: the file cannot be written.
    """
    kind, sink = path.suffix.lower()[1:], io.BytesIO()
    undated: dict[str, Any] = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}.get(kind, {})
    figure.savefig(sink, format=kind, dpi=dpi, facecolor="white", metadata=undated)
    return write_whole(path, sink.getvalue())


def marker_colors(n: int) -> list[tuple[float, float, float]]:
    """One colour per marker, with the hue of its paint and a luminance that contrasts with white and with black."""
    return [_at_luminance(colorsys.hsv_to_rgb(i / n, 1.0, 1.0), 0.23) for i in range(n)]


def _at_luminance(rgb: tuple[float, float, float], target: float) -> tuple[float, float, float]:
    """The colour darkened, or mixed with white, to a relative luminance (its contrast with white is 1.05 / (target + 0.05))."""
    linear = [c**2.2 for c in rgb]  # gamma of sRGB, nearly; below: its luminance weights (ITU-R BT.709)
    luminance = 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]
    if luminance > target:
        linear = [c * target / luminance for c in linear]
    else:
        white = (target - luminance) / (1 - luminance)
        linear = [c + (1 - c) * white for c in linear]
    return (linear[0] ** (1 / 2.2), linear[1] ** (1 / 2.2), linear[2] ** (1 / 2.2))


def note(axes: Axes, text: str) -> None:
    """A sentence in the middle of axes that have nothing to show."""
    axes.text(0.5, 0.5, text, transform=axes.transAxes, ha="center", va="center", alpha=0.7)
