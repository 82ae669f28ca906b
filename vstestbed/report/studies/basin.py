"""Basins of attraction as a picture: colour says how a start ended, shade when it converged."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from vstestbed.core.files import write_whole
from vstestbed.core.geometry import Array
from vstestbed.report.comparison.tables import STYLE as TABLES
from vstestbed.report.html.canvas import new_figure, save, style
from vstestbed.report.html.parts import data_url, figure
from vstestbed.report.html.template import PAGE, STYLE

if TYPE_CHECKING:
    from matplotlib.figure import Figure

AxisLabels = tuple[str, str, float, float]
"""Name, unit, low, high."""
ENDINGS: Final = {
    "target_lost": ("#f3c04b", "target out of sight"),
    "plane_crossed": ("#d55e00", "target's plane crossed"),
    "local_minimum": ("#a0287a", "local minimum"),
    "diverged": ("#33150a", "diverged"),
    "timed_out": ("#9c9c9c", "timed out"),
}
"""Colour and words of each ending that is no success. They differ in lightness as well as in hue (after Okabe & Ito 2008), so
that neither colour-blind eyes nor a grey print confuse them; blues are the converged."""
OTHER: Final = "#000000"
SOON, LATE = np.array([0.86, 0.94, 1.0]), np.array([0.02, 0.22, 0.42])
"""The blues (r, g, b) of starts that converge first and last."""
PANEL_IN, COLUMNS, DPI = 2.0, 5, 200


@dataclass(frozen=True)
class BasinMap:
    """How each start of a grid ended, (n_y, n_x), by the word of its ending, and when it converged [s]."""

    label: str
    endings: Array
    time_s: Array


def colours(made: BasinMap, soonest: float, latest: float) -> Array:
    """The map as a picture (n_y, n_x, 3): blue from light to dark between two times to converge [s], else its ending's colour."""
    from matplotlib.colors import to_rgb

    share = np.clip((made.time_s - soonest) / max(latest - soonest, 1e-9), 0, 1)
    picture = np.where(np.isfinite(share)[..., None], SOON + np.nan_to_num(share)[..., None] * (LATE - SOON), to_rgb(OTHER))
    for ending, (colour, _) in ENDINGS.items():
        picture[made.endings == ending] = to_rgb(colour)
    return picture


def draw(maps: Sequence[BasinMap], x: AxisLabels, y: AxisLabels) -> Figure:
    """One panel a law, all with the same shades; below them what the colours mean."""
    columns = min(COLUMNS, len(maps))
    rows = math.ceil(len(maps) / columns)
    drawn = new_figure(PANEL_IN * rows + 0.75, max(PANEL_IN * columns + 0.4, 4.6))
    times = np.concatenate([m.time_s[np.isfinite(m.time_s)] for m in maps]) if maps else np.zeros(0)
    soonest, latest = np.percentile(times, [1, 99]).tolist() if len(times) else (0.0, 1.0)
    grid = drawn.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    for axes in grid.ravel()[len(maps) :]:
        axes.set_visible(False)
    for i, made in enumerate(maps):
        axes = grid.ravel()[i]
        axes.imshow(colours(made, soonest, latest), origin="lower", extent=(x[2], x[3], y[2], y[3]), aspect="auto", interpolation="nearest")
        axes.grid(False)
        axes.set_title(f"{made.label}: {100 * float(np.mean(made.endings == 'converged')):.1f} %")
        if i + columns >= len(maps):
            axes.set_xlabel(f"{x[0]} [{x[1]}]")
            axes.tick_params(labelbottom=True)
        if i % columns == 0:
            axes.set_ylabel(f"{y[0]} [{y[1]}]")
    _key(drawn, grid, maps, soonest, latest)
    return drawn


def _key(drawn: Figure, grid: Any, maps: Sequence[BasinMap], soonest: float, latest: float) -> None:
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import LinearSegmentedColormap, Normalize
    from matplotlib.patches import Patch

    blues = LinearSegmentedColormap.from_list("converged", [tuple(SOON), tuple(LATE)])
    bar = drawn.colorbar(ScalarMappable(Normalize(soonest, latest), blues), ax=grid, location="right", shrink=0.9, aspect=30, pad=0.015)
    bar.set_label("converged: time [s]")
    present = {str(e) for m in maps for e in np.unique(m.endings.astype(str))} - {"converged"}
    patches = [Patch(color=colour, label=words) for ending, (colour, words) in ENDINGS.items() if ending in present]
    patches += [Patch(color=OTHER, label=ending.replace("_", " ")) for ending in sorted(present - set(ENDINGS))]
    if patches:
        drawn.legend(handles=patches, loc="outside lower center", ncols=min(5, len(patches)))


def write_maps(
    folder: Path, maps: Sequence[BasinMap], x: AxisLabels, y: AxisLabels, summaries: Sequence[Mapping[str, Any]], command: str
) -> Path:
    """`basin.png`, `basin.pdf` and `report.html`; gives the page.

    Raises:
        OutputError: a file cannot be written.
    """
    with style(paper=True):
        drawn = draw(maps, x, y)
        save(drawn, folder / "basin.pdf", DPI)
        png = save(drawn, folder / "basin.png", DPI)
    picture = f'<img src="{data_url("image/png", png.read_bytes())}" alt="Basins of attraction" style="width: 100%; height: auto">'
    caption = (
        f"Start of the camera, {x[0]} and {y[0]} in the frame of its goal{_elsewhere(summaries)}. Ideal cameras, without latency or "
        f"noise{_border(summaries)}. Blue converges, darker later; the number is its share."
    )
    body = figure("How each start ended", picture, caption) + _table(summaries) + _checks(summaries)
    if command:
        body += f"<section><h2>How it was made</h2><p>Made again by<br><code>{escape(command)}</code></p></section>"
    page = PAGE.format(title="Basins of attraction", style=STYLE + TABLES, heading="Basins of attraction", description="", body=body)
    return write_whole(folder / "report.html", page)


def _placed(summary: Mapping[str, Any]) -> str:
    return ", ".join(f"{name} {round(one['value'], 6) + 0.0:g} {one['unit']}" for name, one in summary["fixed"].items())


def _elsewhere(summaries: Sequence[Mapping[str, Any]]) -> str:
    """The coordinates that are not on the map; of each law where they differ."""
    words = [_placed(s) for s in summaries]
    if len(set(words)) > 1:
        return "; " + "; ".join(f"{s['label']}: {at}" for s, at in zip(summaries, words, strict=True))
    return f"; {words[0]}" if words else ""


def _border(summaries: Sequence[Mapping[str, Any]]) -> str:
    views = {s["field_of_view"] for s in summaries}
    return (
        {"limited": "; the picture has its border", "unlimited": "; picture without border"}.get(views.pop(), "") if len(views) == 1 else ""
    )


def _table(summaries: Sequence[Mapping[str, Any]]) -> str:
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
    found = [(s["label"], d) for s in summaries for d in s["disagreements"]]
    if not found:
        return ""
    lines = "".join(f"<li>{escape(label)} at ({d['x']:g}, {d['y']:g}): {d['batch']} here, {d['full']} there</li>" for label, d in found)
    return f'<h2>Where the time loop ends otherwise</h2><ul class="runs">{lines}</ul>'
