"""Matplotlib as this project uses it: Figure objects, one style, inline SVG that follows the page's light or dark colours.

No pyplot and no global state. Ink and rules are drawn in two colours nobody else uses, and become the page's CSS
variables `--ink` and `--rule` in the SVG; identifiers get a prefix, because one page holds many figures.
"""

from __future__ import annotations

import colorsys
import html
import io
import re
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

INK = "#010203"
RULE = "#a1b2c3"
LOST = "#d03040"
GOAL = "#0a8f6a"
AXIS_COLORS = ("#d55e00", "#009e73", "#0080d0")  # x, y, z; told apart by colour-blind eyes (Okabe & Ito 2008, blue lightened)
LINE_COLORS = ("#0080d0", "#d55e00", "#009e73", "#b5559a", "#a88700", "#3fa7c4", "#8a6fd1", "#7a7f86")
WIDTH_IN = 5.2

_STYLE: Any = {
    "font.family": "sans-serif",
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
    "svg.fonttype": "none",  # letters stay letters: small, searchable, in the page's own font
    "svg.hashsalt": "vstestbed",  # the same run gives the same bytes
    "path.simplify_threshold": 0.2,
}


def style() -> Any:
    """A context manager under which figures are made and saved in the house's style."""
    import matplotlib

    return matplotlib.rc_context(_STYLE)


def new_figure(height_in: float, width_in: float = WIDTH_IN) -> Figure:
    """An empty figure on the Agg canvas, never a window; sizes in inches."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width_in, height_in), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def to_svg(figure: Figure, key: str, label: str) -> str:
    """The figure as an `<svg>` element to stand in HTML; its identifiers start with `key`, `label` is read aloud."""
    sink = io.StringIO()
    figure.savefig(sink, format="svg", metadata={"Date": None, "Creator": None, "Format": None, "Type": None})
    text = sink.getvalue()
    text = re.sub(r"<metadata>.*?</metadata>", "", text[text.index("<svg") :], flags=re.DOTALL)
    text = re.sub(r'\bid="', f'id="{key}-', text)
    text = re.sub(r'(href="|url\()#', rf"\1#{key}-", text)
    text = text.replace(INK, "var(--ink)").replace(RULE, "var(--rule)")
    return re.sub(r"<svg\b", f'<svg role="img" aria-label="{html.escape(label)}"', text, count=1).strip()


def marker_colors(n: int) -> list[tuple[float, float, float]]:
    """One colour a marker, the hues of its paint, at a lightness that shows on white and on black alike."""
    return [_at_luminance(colorsys.hsv_to_rgb(i / n, 1.0, 1.0), 0.23) for i in range(n)]


def _at_luminance(rgb: tuple[float, float, float], wanted: float) -> tuple[float, float, float]:
    """The colour darkened, or mixed with white, to a relative luminance (contrast on white is 1.05 / (wanted + 0.05))."""
    linear = [c**2.2 for c in rgb]
    luminance = 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]
    if luminance > wanted:
        linear = [c * wanted / luminance for c in linear]
    else:
        white = (wanted - luminance) / (1 - luminance)
        linear = [c + (1 - c) * white for c in linear]
    return (linear[0] ** (1 / 2.2), linear[1] ** (1 / 2.2), linear[2] ** (1 / 2.2))


def note(axes: Axes, words: str) -> None:
    """A sentence in the middle of axes that have nothing to show."""
    axes.text(0.5, 0.5, words, transform=axes.transAxes, ha="center", va="center", alpha=0.7)
