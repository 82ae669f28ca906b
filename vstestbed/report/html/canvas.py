"""Matplotlib figures in one style, as inline SVG that follows the page's light or dark colours, and as files.

No pyplot and no global state. Ink and rules are drawn in two colours that nothing else uses; in the SVG they are replaced by the
page's CSS variables `--ink` and `--rule`. Identifiers get a prefix, because one page holds many figures.
"""

from __future__ import annotations

import colorsys
import html
import io
import re
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from vstestbed.core.files import write_whole

if TYPE_CHECKING:
    from matplotlib.figure import Figure

INK = "#010203"
RULE = "#a1b2c3"
LOST = "#d03040"
GOAL = "#0a8f6a"
AXIS_COLORS = ("#d55e00", "#009e73", "#0080d0")  # x, y, z; distinct to colour-blind readers (Okabe & Ito 2008, blue lightened)
LINE_COLORS = ("#0080d0", "#d55e00", "#009e73", "#b5559a", "#a88700", "#3fa7c4", "#8a6fd1", "#7a7f86")
WIDTH_IN = 5.2

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


def panels(figure: Figure, n: int, columns: int, **shared: Any) -> list[Any]:
    """The first n axes of a grid in the figure, row by row; the others of the last row are hidden."""
    found = figure.subplots(-(-n // columns), columns, squeeze=False, **shared).ravel().tolist()
    for axes in found[n:]:
        axes.set_visible(False)
    return found[:n]


def to_svg(figure: Figure, key: str, label: str) -> str:
    """The figure as an `<svg>` element for HTML; `key`: prefix of its identifiers, `label`: text for screen readers."""
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    sink = io.StringIO()
    # not `savefig`, which draws everything once before, to find a renderer
    with _without_warnings():
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
    """Write the figure on white in the format of the file's suffix, without a date: the same figure gives the same bytes."""
    kind, sink = path.suffix.lower()[1:], io.BytesIO()
    undated: dict[str, Any] = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}.get(kind, {})
    with _without_warnings():
        figure.savefig(sink, format=kind, dpi=dpi, facecolor="white", metadata=undated)
    return write_whole(path, sink.getvalue())


@contextmanager
def _without_warnings() -> Iterator[None]:
    """Matplotlib's warnings are for who writes the figure: of a name in a script that its font lacks, a reader can mend nothing."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        yield


def printable(name: str) -> str:
    """A name with its control characters, which no font has and XML does not allow, written as Python escapes them."""
    return "".join(c if c.isprintable() or c == "\n" else repr(c)[1:-1] for c in name)


def marker_colors(n: int) -> list[str]:
    """One colour per marker, with the hue of its paint and a luminance that contrasts with white and with black."""
    colors = (_at_luminance(colorsys.hsv_to_rgb(i / n, 1.0, 1.0), 0.23) for i in range(n))
    return ["#" + "".join(f"{round(255 * part):02x}" for part in color) for color in colors]


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
