"""Charts of a run's page, written as SVG directly: panels over one horizontal axis, equal scale,
and views of space.

A run's page is read once, seconds after the run: these charts take a hundredth of the time of a
plotting library, most of which measures text that the browser sets again. Looks are those of
`marks`. Legends are HTML below the drawing, which the browser wraps.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from html import escape
from math import ceil, floor, log10
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from vstestbed.core.geometry import Array
from vstestbed.report.marks import INK, RULE, WIDTH_IN, paint

LARGEST = 1e100  # number up to which an axis reaches: the span of larger ones would overflow
RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def ticks(low: float, high: float, most: int) -> Array:
    """At most so many intervals of 1, 2, 2.5 or 5 times a power of ten: their ends from `low` to
    `high`.
    """
    raw = (high - low) / max(most, 1)
    power = 10.0 ** floor(log10(raw))
    step = next(f * power for f in (1, 2, 2.5, 5, 10) if f * power >= raw * (1 - 1e-9))
    return step * np.arange(ceil(low / step - 1e-9), floor(high / step + 1e-9) + 1, dtype=float)


def log_ticks(low: float, high: float, most: int) -> Array:
    """Powers of ten; of less than two of them also twice and five times, and of less than two of
    these as on a linear axis.
    """
    powers = range(floor(log10(low)), ceil(log10(high)) + 1)
    for factors in ((1.0,), (1.0, 2.0, 5.0)):
        at = np.array([f * 10.0**k for k in powers for f in factors])
        at = at[(at >= low * (1 - 1e-9)) & (at <= high * (1 + 1e-9))]
        if len(at) > 1:
            return at[:: -(-len(at) // (most + 1))]
    return ticks(low, high, most)


def numerals(at: Array, powers: bool = False) -> list[str]:
    """The numbers of ticks, with the same number of decimals, or with powers of ten where these are
    shorter (or asked for).
    """
    step = np.abs(at).sum() or 1.0
    if len(at) > 1:
        step = np.ptp(at) / (len(at) - 1)
    # decimals of the number that needs most of them, to a thousandth of the distance of two; powers
    # instead of more than four of them
    enough = [d for d in range(5) if (np.abs(at - np.round(at, d)) < 1e-3 * step).all()]
    if powers or not enough or np.abs(at).max(initial=0) >= 1e5:
        return [_power(v) for v in at.tolist()]
    return [f"{v + 0.0:.{enough[0]}f}".replace("-", "\N{MINUS SIGN}") for v in at]


def _power(value: float) -> str:
    """`2×10⁻³`, `10²`, `1.25×10⁶`."""
    if value == 0:
        return "0"
    digits, exponent = f"{value:.6e}".split("e")
    digits = digits.rstrip("0").rstrip(".").replace("-", "\N{MINUS SIGN}")
    ten = "10" + str(int(exponent)).translate(RAISED)
    return ten if digits == "1" else f"{digits}×{ten}"


Pair = tuple[float, float]
POINT = 10  # Steps of a coordinate per point (1/72 in): all coordinates of curves are whole numbers
# Margins around the panels and between two of them [pt]
LEFT, RIGHT, BOTTOM, TOP, GAP = 64.0, 13.0, 32.0, 10.0, 13.0
# Lengths of dashes and gaps, in widths of the line
DASHES = {"-": (), "none": (), ":": (1.0, 1.65), "--": (3.7, 1.6)}
ANCHORS = {"left": "start", "center": "middle", "right": "end"}  # of words, by matplotlib's names
MARKS = {
    "o": "m{0} 0a{1} {1} 0 1 0 {2} 0a{1} {1} 0 1 0 {3} 0",
    "x": "m{0} {0}l{2} {2}m0 {3}l{3} {2}",
    "D": "m0 {0}l{1} {1} {0} {1} {0} {0}z",
    ">": "m{1} 0l{3} {1} 0 {3}z",
}
"""Markers as paths from their centre; {1} is half of their size, {2} the size, {0} and {3} are
their negatives.
"""


@dataclass(frozen=True)
class Curve:
    """A line through points (x, y) [data units]; NaN is a gap, and an infinite coordinate is the
    panel's border.
    """

    x: Array
    y: Array
    color: str = INK
    linewidth: float = 1.4
    alpha: float = 1.0
    linestyle: Any = "-"  # of DASHES, or as (0, lengths) in widths of the line
    marker: str = ""  # of MARKS, at each point
    markersize: float = 6.0
    fill: str = "none"  # colour inside, of the closed line or of its markers
    label: str = ""  # entry in the legend; "" for none. A curve without points is an entry alone
    zorder: float = 2.0  # of several curves, the higher lies above

    @property
    def is_area(self) -> bool:
        """Whether its inside is filled, and not that of its markers."""
        return self.fill != "none" and not self.marker

    def drawn(self, x: Array, y: Array) -> str:
        """The SVG of the curve through points [pt]."""
        known = ~np.isnan(x + y)
        points = np.stack([x, y], axis=-1)[known].clip(-1e6, 1e6)
        whole = np.rint(points * POINT).astype(int)
        if self.marker or len(whole) == 1:  # a single value would be a line without length
            return self._marks(whole)
        if self.linestyle == "none" and not self.is_area:
            return ""
        pieces = np.split(whole, np.flatnonzero(np.diff(np.flatnonzero(known)) > 1) + 1)
        path = "".join(map(_path, pieces))
        if path and self.is_area:
            path += "z"
        dashes = DASHES[self.linestyle] if isinstance(self.linestyle, str) else self.linestyle[1]
        return self._element(path, dashes)

    def _marks(self, whole: Array) -> str:
        size = self.markersize if self.marker else max(3.0, self.linewidth)
        half = round(POINT / 2 * size)
        mark = MARKS[self.marker or "o"].format(-half, half, 2 * half, -2 * half)
        return self._element("".join(f"M{u} {v}{mark}" for u, v in whole.tolist()), ())

    def _element(self, path: str, dashes: tuple[float, ...]) -> str:
        if not path:
            return ""
        look = f'fill="{paint(self.fill)}"'
        if self.linewidth:
            look += f' stroke="{paint(self.color)}" stroke-width="{POINT * self.linewidth:.3g}"'
        if dashes:
            lengths = " ".join(f"{POINT * self.linewidth * length:.3g}" for length in dashes)
            look += f' stroke-dasharray="{lengths}" stroke-linecap="butt"'
        if self.alpha < 1:
            look += f' opacity="{self.alpha:g}"'
        return f'<path d="{path}" {look}/>'

    def sample(self) -> str:
        """The SVG of the curve's entry in a legend, 20 pt by 9."""
        points = [[2.0, 18.0], [4.5, 4.5]]
        if self.is_area:
            points = [[2.0, 18.0, 18.0, 2.0], [1.0, 1.0, 8.0, 8.0]]
        elif self.marker:
            points = [[10.0], [4.5]]
        return (
            f'<svg viewBox="0 0 {20 * POINT} {9 * POINT}" aria-hidden="true">'
            f'<g stroke-linecap="round">{self.drawn(*np.array(points))}</g></svg>'
        )


def _path(p: Array) -> str:
    """A line through whole points (n, 2), without those on the straight way between their
    neighbours.
    """
    if len(p) == 0:
        return ""
    p = p[np.concatenate([[True], np.diff(p, axis=0).any(axis=1)])]
    step = np.diff(p, axis=0)
    before, after = step[:-1], step[1:]
    straight = (before[:, 0] * after[:, 1] == before[:, 1] * after[:, 0]) & (
        (before * after).sum(axis=1) > 0
    )
    p = p[np.concatenate([[True], ~straight, [True]])[: len(p)]]
    steps = " ".join(map(str, np.diff(p, axis=0).ravel().tolist()))
    return f"M{p[0, 0]} {p[0, 1]}" + (f"l{steps}" if steps else "h0")


def text(
    x: float, y: float, words: str, anchor: str = "middle", color: str = INK, more: str = ""
) -> str:
    """Words in the SVG, vertically centred at y [pt]."""
    shade = "" if color == INK else f' fill="{paint(color)}"'
    return (
        f'<text x="{x:.1f}" y="{y:.1f}" dy=".35em" text-anchor="{anchor}"{shade}{more}>'
        f"{escape(words)}</text>"
    )


class Words(NamedTuple):
    """Words at a point of a panel [data units]; at y = infinity below its upper border."""

    x: float
    y: float
    text: str
    ha: str = "left"  # left, center or right
    color: str = INK


class PlotArea(NamedTuple):
    """A rectangle of the drawing [pt]."""

    left: float
    top: float
    width: float
    height: float

    def shaped(self, across: float, down: float) -> PlotArea:
        """The largest rectangle in its middle with sides as these."""
        scale = min(self.width / across, self.height / down)
        width = scale * across
        height = scale * down
        left = self.left + (self.width - width) / 2
        return PlotArea(left, self.top + (self.height - height) / 2, width, height)


class Scale(NamedTuple):
    """Where values lie in a panel."""

    box: PlotArea
    xlim: Pair
    ylim: Pair
    log: bool  # whether y is logarithmic

    def across(self, x: Array) -> Array:
        """Distances from the left border [pt]."""
        left, right = self.xlim
        return (bordered(x, self.xlim) - left) / (right - left) * self.box.width

    def down(self, y: Array) -> Array:
        """Distances from the upper border [pt]."""
        y = bordered(y, self.ylim)
        low, high = self.ylim
        if self.log:
            y = np.log10(np.where(y > 0, y, np.nan))
            low, high = log10(low), log10(high)
        return (high - y) / (high - low) * self.box.height


@dataclass
class ChartPanel:
    """A pair of axes: curves, words, limits and labels; limits that are not given follow from the
    curves.
    """

    curves: list[Curve] = field(default_factory=list)
    words: list[Words] = field(default_factory=list)
    labels: tuple[str, str] = ("", "")
    title: str = ""
    xlim: Pair | None = None  # xlim, ylim: limits, in the order left, right and bottom, top
    ylim: Pair | None = None
    lowest: float | None = None  # lower limit of y
    least: float = 0.0  # least span of y
    equal: bool = False  # whether a unit is as long in x as in y
    bare: bool = False  # without axes
    log: bool = False  # whether y is logarithmic
    share: float = 1.0  # of the chart's height, as a multiple of another panel's
    # number of a tick as text, of x and of y; None for `numerals`
    in_words: tuple[Callable[[float], str] | None, Callable[[float], str] | None] = (None, None)

    def plot(self, x: Any, y: Any, **look: Any) -> None:
        """Add a line (see `Curve`)."""
        self.curves.append(Curve(np.asarray(x, dtype=float), np.asarray(y, dtype=float), **look))

    def rule(self, y: float, **look: Any) -> None:
        """A line across the panel below the curves, grey unless another look is given."""
        grey = {"color": RULE, "linewidth": 0.8, "zorder": 1.5}
        self.plot([-np.inf, np.inf], [y, y], **grey | look)

    def area(self, x: Pair, y: Pair, color: str, alpha: float, label: str = "") -> None:
        """A filled rectangle below all lines."""
        look = {"fill": color, "linewidth": 0, "alpha": alpha, "label": label, "zorder": 1}
        self.plot(np.repeat(x, 2), [*y, *y[::-1]], **look)

    def limits(self) -> tuple[Pair, Pair]:
        """The limits (left, right) and (bottom, top)."""
        x = self.xlim or _around([*(c.x for c in self.curves), [w.x for w in self.words]], False)
        if self.ylim:
            return x, self.ylim
        low, high = _around([*(c.y for c in self.curves), [w.y for w in self.words]], self.log)
        if high - low < self.least:
            middle = low + high
            low = (middle - self.least) / 2
            high = (middle + self.least) / 2
        if self.lowest is not None:
            low = self.lowest
            high = high if high > low else low + 1
        return x, (low, high)

    def drawn(self, box: PlotArea, last: bool) -> str:
        """The SVG of the panel in a rectangle; numbers along x only in the last panel of a
        column.
        """
        xlim, ylim = self.limits()
        parts = []
        title = text(box.left, box.top - 8, self.title, "start") if self.title else ""
        if self.equal:
            box = box.shaped(abs(xlim[1] - xlim[0]), abs(ylim[1] - ylim[0]))
        scale = Scale(box, xlim, ylim, self.log)
        if not self.bare:
            parts += self._axes(scale, last)
        curves = sorted(self.curves, key=lambda c: c.zorder)
        body = "".join(c.drawn(scale.across(c.x), scale.down(c.y)) for c in curves)
        left, top, width, height = box
        view = f'x="{left:.1f}" y="{top:.1f}" width="{width:.1f}" height="{height:.1f}"'
        view += f' viewBox="0 0 {POINT * width:.0f} {POINT * height:.0f}"'
        if self.bare:
            view += ' overflow="visible"'
        parts.append(
            f'<svg {view} preserveAspectRatio="none" stroke-linecap="round"'
            f' stroke-linejoin="round">{body}</svg>'
        )
        for x, y, words, ha, color in self.words:
            u = left + float(scale.across(np.array(x)))
            v = top + float(scale.down(np.array(y)))
            if np.isinf(y):
                v += 6
            parts.append(text(u, v, words, ANCHORS[ha], color))
        return "".join((*parts, title))

    def _axes(self, scale: Scale, last: bool) -> Iterator[str]:
        """Grid, borders at the left and below, numbers and labels."""
        left, top, width, height = scale.box
        at_x = ticks(min(scale.xlim), max(scale.xlim), round(width / 46))
        ticked = log_ticks if self.log else ticks
        at_y = ticked(min(scale.ylim), max(scale.ylim), max(2, round(height / 21)))
        u = left + scale.across(at_x)
        v = top + scale.down(at_y)
        grid = "".join(f"M{x:.1f} {top:.1f}v{height:.1f}" for x in u)
        grid += "".join(f"M{left:.1f} {y:.1f}h{width:.1f}" for y in v)
        yield f'<path d="{grid}" stroke="{paint(RULE)}" stroke-width=".6" opacity=".45"/>'
        yield (
            f'<path d="M{left:.1f} {top:.1f}v{height:.1f}h{width:.1f}" fill="none"'
            f' stroke="{paint(RULE)}" stroke-width=".8"/>'
        )
        at = left - 53
        middle = top + height / 2
        turned = f' transform="rotate(-90 {at:.1f} {middle:.1f})"'
        yield text(at, middle, self.labels[1], more=turned)
        for y, words in zip(v, self._numbers(1, at_y), strict=True):
            yield text(left - 5, y, words, "end")
        if last:
            for x, words in zip(u, self._numbers(0, at_x), strict=True):
                yield text(x, top + height + 9, words)
            yield text(left + width / 2, top + height + 23, self.labels[0])

    def _numbers(self, axis: int, at: Array) -> list[str]:
        in_words = self.in_words[axis]
        if in_words is not None:
            return [in_words(n) for n in at]
        # a logarithmic axis of less than a factor of two has the numbers of a linear one
        powers = self.log and axis == 1 and len(at) > 1 and at[-1] >= 2 * at[0]
        return numerals(at, powers)


def bordered(values: Array, limits: Pair) -> Array:
    """Coordinates with the limits of their axis in place of infinite ones."""
    return np.where(np.isinf(values), np.where(values > 0, max(limits), min(limits)), values)


def _around(values: Sequence[ArrayLike], log: bool) -> Pair:
    """Limits around all finite values, with a twentieth of their span to each side."""
    v = np.concatenate(values)
    v = v[np.isfinite(v)]
    if log:
        v = v[v > 0]
    if not len(v):
        return (1.0, 10.0) if log else (0.0, 1.0)
    least = 1 / LARGEST if log else -LARGEST
    low, high = np.clip([v.min(), v.max()], least, LARGEST).tolist()
    if log:
        margin = max((high / low) ** 0.05, 1.05)
        return low / margin, high * margin
    span = high - low
    if span <= 1e-12 * max(abs(low), abs(high)):  # one value, which is its own scale
        span = abs(high) or 1.0
    margin = 0.05 * span
    return low - margin, high + margin


class Chart:
    """One or several panels, one above the other, over the same horizontal axis."""

    def __init__(self, height_in: float = 4.0, panels: int = 1):
        """`height_in`: height of the drawing without its legend [in]."""
        self.height = 72 * height_in
        self.panels = [ChartPanel() for _ in range(panels)]

    def fit(self, least_in: float, most_in: float) -> None:
        """Make a single panel of equal scale as high as it is when it fills the width, within
        limits [in].
        """
        left, right, bottom, top = self._margins()
        (x0, x1), (y0, y1) = self.panels[0].limits()
        high = (72 * WIDTH_IN - left - right) * abs((y1 - y0) / (x1 - x0))
        self.height = min(max(high, 72 * least_in), 72 * most_in) + bottom + top

    def _margins(self) -> tuple[float, float, float, float]:
        if any(panel.bare for panel in self.panels):
            return 36.0, 36.0, 20.0, 24.0
        titles = 8 if any(panel.title for panel in self.panels) else 0
        return LEFT, RIGHT, BOTTOM, TOP + titles

    def svg(self, label: str) -> str:
        """The chart as `<svg>` element with this name for screen readers, and the legend as a list
        below it.
        """
        width = 72 * WIDTH_IN
        left, right, bottom, top = self._margins()
        shares = sum(panel.share for panel in self.panels)
        each = (self.height - bottom - top + GAP) / shares
        body = ""
        for panel in self.panels:
            box = PlotArea(left, top, width - left - right, panel.share * each - GAP)
            body += panel.drawn(box, panel is self.panels[-1])
            top += panel.share * each
        look = (
            f'role="img" aria-label="{escape(label)}" viewBox="0 0 {width:.1f} {self.height:.1f}"'
            ' font-size="9.5" fill="var(--ink)"'
        )
        key = "".join(f"<li>{c.sample()}{escape(name)}</li>" for name, c in self.legend().items())
        if key:
            key = f'<ul class="key">{key}</ul>'
        return f"<svg {look}>{body}</svg>{key}"

    def legend(self) -> dict[str, Curve]:
        """The entries of the legend in their order, areas last: the first curve with each label."""
        found: dict[str, Curve] = {}
        curves = [curve for panel in self.panels for curve in panel.curves if curve.label]
        for curve in sorted(curves, key=lambda curve: curve.zorder <= 1):
            found.setdefault(curve.label, curve)
        return found


# Views of space for charts: points (x, y, z) in parallel projection, and a box with the axes'
# numbers.
class Space:
    """A panel that shows space from a direction, z up and equal scale. Its methods have the names
    of matplotlib's 3-D axes.
    """

    def __init__(self, panel: ChartPanel, elev: float, azim: float):
        """`elev`, `azim`: elevation and azimuth of the viewer from the origin [deg]."""
        panel.equal = panel.bare = True
        self.panel = panel
        self.elev = elev
        self.azim = azim
        se, sa = np.sin(np.radians([elev, azim]))
        ce, ca = np.cos(np.radians([elev, azim]))
        self.across = np.array([[-sa, ca, 0.0], [-se * ca, -se * sa, ce]])
        """The directions right and up of the picture in space, shape (2, 3)."""

    def plot(self, x: Any, y: Any, z: Any, **look: Any) -> None:
        """Add a line (see `chart.Curve`)."""
        self.panel.plot(*(self.across @ np.stack([x, y, z])), **look)

    def text(self, x: float, y: float, z: float, s: str, color: str = INK, **align: str) -> None:
        """Add words, vertically centred (`va` is there for matplotlib's axes); `ha`: left, center
        or right.
        """
        u, v = self.across @ (x, y, z)
        self.panel.words.append(Words(u, v, s, align.get("ha", "center"), color))

    def box(self, low: Array, high: Array, most: int = 5) -> None:
        """The three far sides of a box from `low` to `high` (3,) [m] with a grid, and its numbers;
        for a viewer at +x, -y and +z.
        """
        far = np.array([low[0], high[1], low[2]])  # the corner farthest from the viewer
        # per axis the corner of its numbered edge, the direction out of the box there, and the
        # numbers' alignment
        right = np.array([*self.across[0, :2], 0.0])
        edges = (
            (low, np.array([0, -1.0, 0]), "right"),
            (np.array([high[0], low[1], low[2]]), np.array([1.0, 0, 0]), "left"),
            (low, -right, "right"),
        )
        size = float((high - low).max())
        for axis, (corner, out, side) in enumerate(edges):
            at = ticks(low[axis], high[axis], max(2, round(most * (high - low)[axis] / size)))
            for value in (low[axis], *at, high[axis]):
                for other in {0, 1, 2} - {axis}:
                    ends = np.array([far, far])
                    ends[:, axis] = value
                    ends[:, other] = low[other], high[other]
                    self.plot(*ends.T, color=RULE, linewidth=0.6, alpha=0.45, zorder=0)
            for value, words in zip(at, numerals(at), strict=True):
                self._beside(corner, axis, value, 0.025 * size * out, words, side)
            edge = np.array([corner, corner])
            edge[:, axis] = low[axis], high[axis]
            self.plot(*edge.T, color=RULE, linewidth=0.8, zorder=0)
            beyond = (0.17, 0.17, 0.15)[axis] * size * out
            self._beside(corner, axis, (low + high)[axis] / 2, beyond, f"{'xyz'[axis]} [m]", side)

    def _beside(
        self, corner: Array, axis: int, value: float, shift: Array, words: str, side: str
    ) -> None:
        """Words beside a point of an edge."""
        at = corner + shift
        at[axis] += value - corner[axis]
        x, y, z = at.tolist()
        self.text(x, y, z, words, ha=side)
