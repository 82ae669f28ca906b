"""Charts of a run's page, written as SVG directly: panels over one horizontal axis, equal scale,
and views of space.

A run's page is read once, seconds after the run: these charts take a hundredth of the time of a
plotting library, most of which measures text that the browser sets again. Looks are those of
`marks`. Legends are HTML below the drawing, which the browser wraps.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from html import escape
from math import ceil, floor, log10
from typing import Any

import numpy as np

from vstestbed.core.geometry import Array
from vstestbed.report.marks import INK, RULE, WIDTH_IN, paint

LARGEST = 1e100  # number up to which an axis reaches: the span of larger ones would overflow
RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def ticks(low: float, high: float, most: int) -> Array:
    """At most so many intervals of 1, 2, 2.5 or 5 times a power of ten: their ends from `low` to
    `high`.
    """
    raw = (high - low) / max(most, 1)
    step = next(
        s
        for s in (f * 10.0 ** floor(log10(raw)) for f in (1, 2, 2.5, 5, 10))
        if s >= raw * (1 - 1e-9)
    )
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
    step = float(np.ptp(at)) / (len(at) - 1) if len(at) > 1 else float(np.abs(at).sum()) or 1.0
    # decimals of the number that needs most of them, to a thousandth of the distance of two; powers
    # instead of more than four of them
    enough = (d for d in range(5) if (np.abs(at - np.round(at, d)) < 1e-3 * step).all())
    decimals = None if powers or np.abs(at).max(initial=0) >= 1e5 else next(enough, None)
    if decimals is None:
        return [_power(float(v)) for v in at]
    return [f"{v + 0.0:.{decimals}f}".replace("-", "\N{MINUS SIGN}") for v in at]


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
DASHES = {"-": (), ":": (1.0, 1.65), "--": (3.7, 1.6)}
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
    linestyle: Any = "-"  # of DASHES, `none`, or as (0, lengths) in widths of the line
    marker: str = ""  # of MARKS, at each point
    markersize: float = 6.0
    fill: str = "none"  # colour inside, of the closed line or of its markers
    label: str = ""  # entry in the legend; "" for none. A curve without points is an entry alone
    zorder: float = 2.0  # of several curves, the higher lies above

    def drawn(self, x: Array, y: Array) -> str:
        """The SVG of the curve through points [pt]."""
        known = ~np.isnan(x + y)
        whole = np.rint(np.stack([x, y], axis=-1)[known].clip(-1e6, 1e6) * POINT).astype(int)
        if self.marker or len(whole) == 1:  # a single value would be a line without length
            half = round(POINT / 2 * (self.markersize if self.marker else max(3.0, self.linewidth)))
            mark = MARKS[self.marker or "o"].format(-half, half, 2 * half, -2 * half)
            return self._element("".join(f"M{u} {v}{mark}" for u, v in whole.tolist()), ())
        if self.linestyle == "none" and self.fill == "none":
            return ""
        pieces = np.split(whole, np.flatnonzero(np.diff(np.flatnonzero(known)) > 1) + 1)
        dashes = (
            DASHES.get(self.linestyle, ()) if isinstance(self.linestyle, str) else self.linestyle[1]
        )
        return self._element(
            "".join(map(_path, pieces)) + ("z" if self.fill != "none" else ""), dashes
        )

    def _element(self, d: str, dashes: tuple[float, ...]) -> str:
        lengths = " ".join(f"{POINT * self.linewidth * length:.3g}" for length in dashes)
        more = f' stroke-dasharray="{lengths}" stroke-linecap="butt"' if dashes else ""
        more += f' opacity="{self.alpha:g}"' if self.alpha < 1 else ""
        stroke = (
            f' stroke="{paint(self.color)}" stroke-width="{POINT * self.linewidth:.3g}"'
            if self.linewidth
            else ""
        )
        return f'<path d="{d}" fill="{paint(self.fill)}"{stroke}{more}/>' if d else ""

    def sample(self) -> str:
        """The SVG of the curve's entry in a legend, 20 pt by 9."""
        if self.fill != "none" and not self.marker:
            body = self.drawn(np.array([2.0, 18, 18, 2]), np.array([1.0, 1, 8, 8]))
        else:
            body = self.drawn(
                *(np.array([[10.0], [4.5]]) if self.marker else np.array([[2.0, 18.0], [4.5, 4.5]]))
            )
        return (
            f'<svg viewBox="0 0 {20 * POINT} {9 * POINT}" aria-hidden="true">'
            f'<g stroke-linecap="round">{body}</g></svg>'
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


@dataclass
class ChartPanel:
    """A pair of axes: curves, words, limits and labels; limits that are not given follow from the
    curves.
    """

    curves: list[Curve] = field(default_factory=list)
    # (x, y, text, anchor, colour) at points [data units]; at y = infinity below the upper border
    words: list[tuple[float, float, str, str, str]] = field(default_factory=list)
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
        self.plot(
            [-np.inf, np.inf], [y, y], **{"color": RULE, "linewidth": 0.8, "zorder": 1.5} | look
        )

    def area(self, x: Pair, y: Pair, color: str, alpha: float, label: str = "") -> None:
        """A filled rectangle below all lines."""
        self.plot(
            np.repeat(x, 2),
            [*y, *y[::-1]],
            fill=color,
            linewidth=0,
            alpha=alpha,
            label=label,
            zorder=1,
        )

    def limits(self) -> tuple[Pair, Pair]:
        """The limits (left, right) and (bottom, top)."""
        x = self.xlim or _around(
            [c.x for c in self.curves] + [np.array([x for x, *_ in self.words])], False
        )
        if self.ylim:
            return x, self.ylim
        y = _around(
            [c.y for c in self.curves] + [np.array([y for _, y, *_ in self.words])], self.log
        )
        if y[1] - y[0] < self.least:
            y = ((y[0] + y[1] - self.least) / 2, (y[0] + y[1] + self.least) / 2)
        if self.lowest is not None:
            y = (self.lowest, y[1] if y[1] > self.lowest else self.lowest + 1)
        return x, y

    def drawn(self, left: float, top: float, width: float, height: float, last: bool) -> str:
        """The SVG of the panel in a rectangle [pt]; numbers along x only in the last panel of a
        column.
        """
        xlim, ylim = self.limits()
        title = text(left, top - 8, self.title, "start") if self.title else ""
        if self.equal:
            scale = min(width / abs(xlim[1] - xlim[0]), height / abs(ylim[1] - ylim[0]))
            across, down = scale * abs(xlim[1] - xlim[0]), scale * abs(ylim[1] - ylim[0])
            left, top, width, height = (
                left + (width - across) / 2,
                top + (height - down) / 2,
                across,
                down,
            )

        def place(x: Array, y: Array) -> tuple[Array, Array]:
            x, y, low, high = bordered(x, xlim), bordered(y, ylim), *ylim
            if self.log:
                y, low, high = np.log10(np.where(y > 0, y, np.nan)), log10(low), log10(high)
            return (x - xlim[0]) / (xlim[1] - xlim[0]) * width, (high - y) / (high - low) * height

        parts = [] if self.bare else list(self._axes(place, (left, top, width, height), last))
        body = "".join(
            c.drawn(*place(c.x, c.y))
            for c in sorted(self.curves, key=lambda c: c.zorder)
            if len(c.x)
        )
        view = f'x="{left:.1f}" y="{top:.1f}" width="{width:.1f}" height="{height:.1f}"'
        view += f' viewBox="0 0 {POINT * width:.0f} {POINT * height:.0f}"' + (
            ' overflow="visible"' if self.bare else ""
        )
        parts.append(
            f'<svg {view} preserveAspectRatio="none" stroke-linecap="round"'
            f' stroke-linejoin="round">{body}</svg>'
        )
        for x, y, words, anchor, color in self.words:
            u, v = place(np.array([x]), np.array([y]))
            parts.append(
                text(left + u[0], top + v[0] + (6 if np.isinf(y) else 0), words, anchor, color)
            )
        return "".join((*parts, title))

    def _axes(
        self,
        place: Callable[[Array, Array], tuple[Array, Array]],
        box: tuple[float, ...],
        last: bool,
    ) -> Iterator[str]:
        """Grid, borders at the left and below, numbers and labels."""
        left, top, width, height = box
        (x0, x1), (y0, y1) = (sorted(limits) for limits in self.limits())
        at_x, at_y = (
            ticks(x0, x1, round(width / 46)),
            (log_ticks if self.log else ticks)(y0, y1, max(2, round(height / 21))),
        )
        u, v = left + place(at_x, 0 * at_x + y1)[0], top + place(0 * at_y + x0, at_y)[1]
        grid = "".join(f"M{x:.1f} {top:.1f}v{height:.1f}" for x in u) + "".join(
            f"M{left:.1f} {y:.1f}h{width:.1f}" for y in v
        )
        yield f'<path d="{grid}" stroke="{paint(RULE)}" stroke-width=".6" opacity=".45"/>'
        yield (
            f'<path d="M{left:.1f} {top:.1f}v{height:.1f}h{width:.1f}" fill="none"'
            f' stroke="{paint(RULE)}" stroke-width=".8"/>'
        )
        middle = top + height / 2
        yield text(
            left - 53,
            middle,
            self.labels[1],
            more=f' transform="rotate(-90 {left - 53:.1f} {middle:.1f})"',
        )
        yield from (
            text(left - 5, y, words, "end")
            for y, words in zip(v, self._numbers(1, at_y), strict=True)
        )
        if last:
            yield from (
                text(x, top + height + 9, words)
                for x, words in zip(u, self._numbers(0, at_x), strict=True)
            )
            yield text(left + width / 2, top + height + 23, self.labels[0])

    def _numbers(self, axis: int, at: Array) -> list[str]:
        in_words = self.in_words[axis]
        # a logarithmic axis of less than a factor of two has the numbers of a linear one
        powers = self.log and axis == 1 and len(at) > 1 and at[-1] >= 2 * at[0]
        return [in_words(n) for n in at] if in_words else numerals(at, powers)


def bordered(values: Array, limits: Pair) -> Array:
    """Coordinates with the limits of their axis in place of infinite ones."""
    return np.where(np.isinf(values), np.where(values > 0, max(limits), min(limits)), values)


def _around(values: list[Array], log: bool) -> Pair:
    """Limits around all finite values, with a twentieth of their span to each side."""
    v = np.concatenate([np.zeros(0), *(np.ravel(a) for a in values)])
    v = v[np.isfinite(v) & (v > 0)] if log else v[np.isfinite(v)]
    if len(v) == 0:
        return (1.0, 10.0) if log else (0.0, 1.0)
    low, high = np.clip([v.min(), v.max()], 1 / LARGEST if log else -LARGEST, LARGEST).tolist()
    if log:
        margin = max((high / low) ** 0.05, 1.05)
        return low / margin, high * margin
    margin = 0.05 * (
        (high - low) if high - low > 1e-12 * max(abs(low), abs(high)) else abs(high) or 1.0
    )
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
        return LEFT, RIGHT, BOTTOM, TOP + (8 if any(panel.title for panel in self.panels) else 0)

    def svg(self, label: str) -> str:
        """The chart as `<svg>` element with this name for screen readers, and the legend as a list
        below it.
        """
        width, (left, right, bottom, top) = 72 * WIDTH_IN, self._margins()
        shares = [panel.share for panel in self.panels]
        each = (self.height - bottom - top + GAP) / sum(shares)
        body = "".join(
            panel.drawn(
                left,
                top + sum(shares[:i]) * each,
                width - left - right,
                panel.share * each - GAP,
                panel is self.panels[-1],
            )
            for i, panel in enumerate(self.panels)
        )
        look = (
            f'role="img" aria-label="{escape(label)}" viewBox="0 0 {width:.1f} {self.height:.1f}"'
            ' font-size="9.5" fill="var(--ink)"'
        )
        entries = "".join(
            f"<li>{curve.sample()}{escape(name)}</li>" for name, curve in self.legend().items()
        )
        key = f'<ul class="key">{entries}</ul>' if entries else ""
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
        self.panel, self.elev, self.azim = panel, elev, azim
        (se, sa), (ce, ca) = np.sin(np.radians([elev, azim])), np.cos(np.radians([elev, azim]))
        self.across = np.array([[-sa, ca, 0.0], [-se * ca, -se * sa, ce]])
        """The directions right and up of the picture in space, shape (2, 3)."""

    def plot(self, x: Any, y: Any, z: Any, **look: Any) -> None:
        """Add a line (see `chart.Curve`)."""
        self.panel.plot(*(self.across @ np.stack([x, y, z])), **look)

    def text(
        self,
        x: float,
        y: float,
        z: float,
        s: str,
        color: str = INK,
        ha: str = "center",
        va: str = "center",
    ) -> None:
        """Add words, vertically centred (`va` is there for matplotlib's axes); `ha`: left, center
        or right.
        """
        assert va == "center"
        u, v = self.across @ (x, y, z)
        self.panel.words.append(
            (u, v, s, {"left": "start", "center": "middle", "right": "end"}[ha], color)
        )

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
                    ends[:, axis], ends[:, other] = value, (low[other], high[other])
                    self.plot(*ends.T, color=RULE, linewidth=0.6, alpha=0.45, zorder=0)
            for value, words in zip(at, numerals(at), strict=True):
                self._beside(corner, axis, value, 0.025 * size * out, words, side)
            edge = np.array([corner, corner])
            edge[:, axis] = low[axis], high[axis]
            self.plot(*edge.T, color=RULE, linewidth=0.8, zorder=0)
            self._beside(
                corner,
                axis,
                (low + high)[axis] / 2,
                (0.17 if axis < 2 else 0.15) * size * out,
                f"{'xyz'[axis]} [m]",
                side,
            )

    def _beside(
        self, corner: Array, axis: int, value: float, shift: Array, words: str, side: str
    ) -> None:
        """Words beside a point of an edge."""
        at = corner + shift
        at[axis] += value - corner[axis]
        x, y, z = at.tolist()
        self.text(x, y, z, words, ha=side)
