"""What both writers of charts share (`chart`: SVG of a run's page; `canvas`: matplotlib): colours,
lines, markers, numbers as text.
"""

from __future__ import annotations

import colorsys
import math
from typing import Any

__all__ = [
    "AIM",
    "AXIS_COLORS",
    "BAND",
    "END",
    "FAILED",
    "GOAL",
    "INK",
    "LINE",
    "LINE_COLORS",
    "LOST",
    "MARKERS",
    "RULE",
    "START",
    "THRESHOLD",
    "TIME",
    "WIDTH_IN",
    "Look",
    "counted",
    "line_color",
    "listed",
    "look",
    "marker_colors",
    "number",
    "paint",
    "signed",
    "with_unit",
]

INK = "#010203"
RULE = "#a1b2c3"
"""Colours that nothing else uses: on a page they are replaced by its CSS variables, which follow
light and dark (`paint`).
"""
LOST = "#d03040"
GOAL = "#0a8f6a"
# x, y, z; distinct to colour-blind readers (Okabe & Ito 2008, blue lightened)
AXIS_COLORS = ("#d55e00", "#009e73", "#0080d0")
LINE_COLORS = (
    "#0080d0",
    "#d55e00",
    "#009e73",
    "#b5559a",
    "#a88700",
    "#3fa7c4",
    "#8a6fd1",
    "#7a7f86",
)
MARKERS = "os^DvX*P<h>pd"
WIDTH_IN = 5.2  # Width of a figure in one of the page's two columns [in]

# Looks have matplotlib's names, which `chart.Curve` has, too.
Look = dict[str, Any]
# true values: where the measured ones agree, their line lies in the band
BAND: Look = {"linewidth": 4.0, "alpha": 0.28}
LINE: Look = {"linewidth": 1.0}  # measured or commanded values
START: Look = {"marker": "o", "markersize": 5, "linestyle": "none"}
END: Look = {"marker": "x", "markersize": 6, "linewidth": 1.6, "linestyle": "none"}
AIM: Look = {"marker": "D", "markersize": 8, "linestyle": "none"}
THRESHOLD: Look = {"color": GOAL, "linestyle": "--", "linewidth": 1.2}
FAILED: Look = {
    "marker": "x",
    "color": LOST,
    "linestyle": "none",
    "markersize": 3.5,
    "markeredgewidth": 0.9,
}
DASHES: tuple[Any, ...] = ("-", (0, (5, 2)), (0, (1, 1.2)), (0, (5, 1.5, 1, 1.5)))
TIME = "time [s]"  # The label of every axis of time


def line_color(i: int) -> str:
    """The colour of the i-th of several lines."""
    return LINE_COLORS[i % len(LINE_COLORS)]


def look(i: int) -> Look:
    """The line of controller i: the eight colours with solid lines first, then the same colours
    dashed.
    """
    return {"color": line_color(i), "linestyle": DASHES[i // len(LINE_COLORS) % len(DASHES)]}


def paint(color: str) -> str:
    """A colour on a page: ink and rules in the page's own, which follow light and dark."""
    return {INK: "var(--ink)", RULE: "var(--rule)"}.get(color, color)


def marker_colors(n: int) -> list[str]:
    """One colour per marker, with the hue of its paint and a luminance that contrasts with white
    and with black.
    """
    colors = (_at_luminance(colorsys.hsv_to_rgb(i / n, 1.0, 1.0), 0.23) for i in range(n))
    return ["#" + "".join(f"{round(255 * part):02x}" for part in color) for color in colors]


def _at_luminance(rgb: tuple[float, float, float], target: float) -> list[float]:
    """The colour darkened, or mixed with white, to a relative luminance (its contrast with white is
    1.05 / (target + 0.05)).
    """
    # gamma of sRGB, nearly; below: its luminance weights (ITU-R BT.709)
    linear = [c**2.2 for c in rgb]
    luminance = 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]
    white = max(0.0, (target - luminance) / (1 - luminance))
    linear = [c + (1 - c) * white if white else c * target / luminance for c in linear]
    return [c ** (1 / 2.2) for c in linear]


def number(value: object) -> str:
    """A number with three significant figures: fixed point where that is short, else a power of
    ten; a dash if unknown.
    """
    if isinstance(value, bool) or not isinstance(value, int | float):
        return "–" if value is None else str(value)
    if isinstance(value, int):
        return str(value)
    if not math.isfinite(value):
        return "–"
    if value and not 1e-4 <= abs(value) < 1e6:
        mantissa, exponent = f"{value:.2e}".split("e")
        return f"{mantissa}·10^{int(exponent)}"
    return f"{value:.{max(0, 2 - math.floor(math.log10(abs(value))))}f}" if value else "0"


def signed(value: float) -> str:
    """A difference with its sign and three significant figures."""
    return ("+" if value > 0 else "\N{MINUS SIGN}" if value < 0 else "") + number(abs(value))


def with_unit(value: object, unit: str) -> tuple[str, str]:
    """Number and unit as they are read: lengths under 10 cm in millimetres, longer ones in metres;
    no unit beside a dash.
    """
    if isinstance(value, float) and unit in ("m", "mm"):
        metres = value if unit == "m" else 1e-3 * value
        value, unit = (1e3 * metres, "mm") if 0 < abs(metres) < 0.1 else (metres, "m")
    words = number(value)
    return words, "" if words == "–" else unit


def counted(n: int, what: str) -> str:
    """`1 run`, `20 runs`."""
    return f"{n} {what}{'s' * (n != 1)}"


def listed(words: list[str]) -> str:
    """Words in a sentence: `a, b and c`."""
    # a label with commas (several varied fields) is bracketed, or one could not see where it ends
    quoted = words if not any("," in w for w in words) else [f"({w})" for w in words]
    return (
        " and ".join(quoted) if len(quoted) < 3 else ", ".join(quoted[:-1]) + f" and {quoted[-1]}"
    )
