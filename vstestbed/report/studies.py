"""Pages of studies: basins of attraction, convergence maps, gain limits over delay, searches for
good settings.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from vstestbed.core.files import make_folder
from vstestbed.core.geometry import Array
from vstestbed.core.outcome import Outcome
from vstestbed.report.canvas import new_figure, panels, publish, style
from vstestbed.report.marks import FAILED, GOAL, INK, LINE_COLORS, Look, number
from vstestbed.report.pages import NO_CELL, Cell, data_url, write_page
from vstestbed.tasks.metrics import Metric

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.patches import Patch

__all__ = [
    "Branches",
    "ConvergenceMap",
    "ParameterAxis",
    "Sweep",
    "TrialRow",
    "TuningPage",
    "write_basin",
    "write_delay",
    "write_sweep",
    "write_tuning",
]

# Basins of attraction as a figure: the colour shows the outcome of a start, the shade its time to
# converge.
BasinAxis = tuple[str, str, float, float]  # Name, unit, low, high
# half of an outcome, which a batch tells apart: the camera is behind its target
PLANE_CROSSED = "plane_crossed"
PLANE_COLOUR, OTHER_COLOUR = "#d55e00", "#000000"
LABELS = {"target_lost": "target out of sight", PLANE_CROSSED: "behind the target's plane"}
"""Words of a legend, where they are not those of the outcome."""


def failures() -> list[str]:
    """How the starts of a map may fail, by name, in the order of legends."""
    first, *others = [outcome.name for outcome in Outcome if not outcome.success]
    return [first, PLANE_CROSSED, *others]


def colour_of(ending: str) -> str:
    """The colour of a failure by its name; black for one that no outcome has."""
    if ending == PLANE_CROSSED:
        return PLANE_COLOUR
    known = Outcome.__members__.get(ending)
    return OTHER_COLOUR if known is None else known.colour


def label_of(ending: str) -> str:
    """A failure in the words of a legend."""
    return LABELS.get(ending, ending.replace("_", " "))


# Blues (r, g, b) of the earliest and the latest starts to converge
SOON, LATE = np.array([0.86, 0.94, 1.0]), np.array([0.02, 0.22, 0.42])
PANEL_IN, BASIN_COLUMNS = 2.0, 5

# Law, outcome of each start by name, time to converge [s] (NaN if it did not), both (n_y, n_x)
BasinMap = tuple[str, Array, Array]


def colours(one: BasinMap, soonest: float, latest: float) -> Array:
    """The map as an image (n_y, n_x, 3): blue from light to dark between two times to converge [s],
    else the colour of the outcome.
    """
    from matplotlib.colors import to_rgb

    _, endings, time_s = one
    share = np.clip((time_s - soonest) / max(latest - soonest, 1e-9), 0, 1)
    picture = np.where(
        np.isfinite(share)[..., None],
        SOON + np.nan_to_num(share)[..., None] * (LATE - SOON),
        to_rgb(OTHER_COLOUR),
    )
    for ending in failures():
        picture[endings == ending] = to_rgb(colour_of(ending))
    return picture


def draw_basin(maps: Sequence[BasinMap], x: BasinAxis, y: BasinAxis) -> Figure:
    """One panel per law, all with the same scale of shades, and a legend of the colours below."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import LinearSegmentedColormap, Normalize

    columns = min(BASIN_COLUMNS, len(maps))
    rows = math.ceil(len(maps) / columns)
    drawn = new_figure(PANEL_IN * rows + 0.75, max(PANEL_IN * columns + 0.4, 4.6))
    times = np.concatenate([time_s[np.isfinite(time_s)] for _, _, time_s in maps])
    # percentiles: a few extreme times must not compress the scale of all others
    soonest, latest = np.percentile(times, [1, 99]).tolist() if len(times) else (0.0, 1.0)
    grid = panels(drawn, len(maps), columns, sharex=True, sharey=True)
    for axes, (law, endings, _), one in zip(grid, maps, maps, strict=True):
        shown = colours(one, soonest, latest)
        extent = (x[2], x[3], y[2], y[3])
        axes.imshow(shown, origin="lower", extent=extent, aspect="auto", interpolation="nearest")
        axes.grid(False)
        flown = endings[endings != "interrupted"]
        share = f": {100 * float(np.mean(flown == 'converged')):.1f} %" if len(flown) else ""
        axes.set_title(law + share)
    for axes in grid[-columns:]:
        axes.set_xlabel(f"{x[0]} [{x[1]}]")
        axes.tick_params(labelbottom=True)
    for axes in grid[::columns]:
        axes.set_ylabel(f"{y[0]} [{y[1]}]")
    # a colour bar of the times to converge, and a legend of the outcomes that occur
    blues = LinearSegmentedColormap.from_list("converged", [tuple(SOON), tuple(LATE)])
    scale = ScalarMappable(Normalize(soonest, latest), blues)
    bar = drawn.colorbar(scale, ax=grid, location="right", shrink=0.9, aspect=30, pad=0.015)
    bar.set_label("converged: time [s]")
    patches = _outcome_patches(maps)
    if patches:
        drawn.legend(handles=patches, loc="outside lower center", ncols=min(5, len(patches)))
    return drawn


def _outcome_patches(maps: Sequence[BasinMap]) -> list[Patch]:
    """Entries of the legend for the failures that occur."""
    from matplotlib.patches import Patch

    present = {str(ending) for _, endings, _ in maps for ending in np.unique(endings.astype(str))}
    present -= {outcome.name for outcome in Outcome if outcome.success}
    known = [ending for ending in failures() if ending in present]
    endings = known + sorted(present.difference(known))
    return [Patch(color=colour_of(ending), label=label_of(ending)) for ending in endings]


def write_basin(
    folder: Path,
    maps: Sequence[BasinMap],
    x: BasinAxis,
    y: BasinAxis,
    summaries: Sequence[Mapping[str, Any]],
    command: str,
) -> Path:
    """Write `basin.png`, `basin.pdf` and `report.html`; returns the page's path."""
    views = {s["field_of_view"] for s in summaries}
    view = (
        f"; {views.pop()} field of view"
        if len(views) == 1 and views <= {"limited", "unlimited"}
        else ""
    )
    caption = (
        f"Start of the camera, {x[0]} and {y[0]} in the frame of its"
        f" goal{_fixed_coordinates(summaries)}. Ideal cameras, without latency or noise{view}."
        " Blue converges, darker later; the number is its share."
    )
    image = _plate(folder, "basin", lambda: draw_basin(maps, x, y))
    heads, lines = _basin_table(summaries)
    # the checked starts whose single run ended otherwise than in the batch
    checks = [f"{s['label']} at {d['words']}" for s in summaries for d in s["disagreements"]]
    content = {
        "plate": ("How each start ended", image, caption),
        "tables": [("In numbers", heads, lines)],
        "checks": checks,
    }
    return write_page(folder, "study.html", "Basins of attraction", **content, command=command)


def _plate(folder: Path, name: str, draw: Callable[[], Figure]) -> str:
    """The figure of a study as PDF and PNG in its folder; returns the picture for its page."""
    with style():
        publish(draw(), name, name, folder)
    return data_url("image/png", (folder / f"{name}.png").read_bytes())


def _fixed_coordinates(summaries: Sequence[Mapping[str, Any]]) -> str:
    """The coordinates that are not on the map, for each law if they differ."""
    values = []
    for s in summaries:
        # + 0.0 turns the -0.0 of rounding into 0
        fixed = [
            f"{name} {round(one['value'], 6) + 0.0:g} {one['unit']}"
            for name, one in s["fixed"].items()
        ]
        values.append(", ".join(fixed))
    if len(set(values)) > 1:
        values = [f"{s['label']}: {at}" for s, at in zip(summaries, values, strict=True)]
        return "; " + "; ".join(values)
    return f"; {values[0]}" if values else ""


def _basin_table(summaries: Sequence[Mapping[str, Any]]) -> tuple[list[str], list[list[str]]]:
    endings = ["converged", *failures()]
    endings += sorted({e for s in summaries for e in s["shares"]} - set(endings))
    endings = [e for e in endings if any(s["shares"].get(e) for s in summaries)]
    lines = []
    for s in summaries:
        check = f"{s['agreeing']} of {s['checked']}" if s["checked"] else "-"
        shares = (f"{100 * s['shares'].get(e, 0.0):.2f}" for e in endings)
        lines.append([s["label"], *shares, str(s["starts"]), f"{s['processor_s']:.1f}", check])
    return [
        "",
        *(f"{e.replace('_', ' ')} [%]" for e in endings),
        "starts",
        "time of one core [s]",
        "time loop agrees",
    ], lines


# Convergence maps as a figure: the share of seeds that converged in each cell, and how most of the
# others ended.
NONE, ALL = np.array([0.96, 0.93, 0.88]), np.array([0.05, 0.36, 0.62])
"""Colours (r, g, b) of cells in which no seed and in which every seed converged; those between are
mixed linearly.
"""
SWEEP_COLUMNS = 2
SweepAxis = tuple[str, list[str]]


ConvergenceMap = tuple[str, Array, NDArray[np.object_], Array]
"""Law; share of the seeds that converged (NaN where no run is done); most frequent outcome of the
others ("" if all converged); median distance from the true goal of those that converged [m] (NaN if
none did); arrays of shape (n_y, n_x).
"""


def draw_sweep(maps: Sequence[ConvergenceMap], x: SweepAxis, y: SweepAxis) -> Figure:
    """The maps side by side."""
    rows = -(-len(maps) // SWEEP_COLUMNS)
    n_y, n_x = maps[0][1].shape
    wide, high = 0.55 + 0.37 * n_x, 0.75 + 0.27 * n_y
    drawn = new_figure(high * rows + 0.35, max(2, SWEEP_COLUMNS) * max(wide, 3.0))
    grid = panels(drawn, len(maps), SWEEP_COLUMNS, sharex=True, sharey=True)
    for axes, (label, shares, others, _) in zip(grid, maps, strict=True):
        colors = np.where(np.isnan(shares)[..., None], 1.0, NONE + shares[..., None] * (ALL - NONE))
        axes.imshow(colors, origin="lower", aspect="auto")
        for (i, j), share in np.ndenumerate(shares):
            most = Outcome.__members__.get(str(others[i, j]))
            letter = most.letter if most is not None and share < 1 else ""
            words = "-" if np.isnan(share) else f"{100 * share:.0f}{letter}"
            axes.text(
                j,
                i,
                words,
                ha="center",
                va="center",
                fontsize=6.5,
                color="white" if share > 0.55 else INK,
            )
        axes.set_xticks(range(len(x[1])), x[1], rotation=45 if max(map(len, x[1])) > 5 else 0)
        axes.set_yticks(range(len(y[1])), y[1])
        axes.grid(visible=False)
        axes.set_title(label)
    drawn.supxlabel(x[0], fontsize=8)
    drawn.supylabel(y[0], fontsize=8)
    return drawn


def _letters(maps: Sequence[ConvergenceMap]) -> str:
    """The letters that occur, in words."""
    present = {str(outcome) for _, _, others, _ in maps for outcome in others.flat}
    known = [outcome for outcome in Outcome if outcome.name in present and outcome.letter]
    words = [f"{outcome.letter}: {outcome.name.replace('_', ' ')}" for outcome in known]
    return ", ".join(words) or "none"


@dataclass(frozen=True)
class Sweep:
    """What the page of a sweep shows."""

    maps: Sequence[ConvergenceMap]
    x: SweepAxis
    y: SweepAxis
    seeds: int  # of each cell
    description: str
    caution: str = ""  # stands on top


def write_sweep(folder: Path, sweep: Sweep, command: str) -> Path:
    """Write `convergence.png`, `convergence.pdf` and `report.html`; returns the page's path."""
    maps, x, y = sweep.maps, sweep.x, sweep.y
    caption = (
        f"Share of {sweep.seeds} seeds that reached the goal [%];"
        f" the letter: how most of the others ended ({_letters(maps)})."
    )
    image = _plate(folder, "convergence", lambda: draw_sweep(maps, x, y))
    what = "median distance from the true goal, of those that converged [mm]"
    found = []
    for label, _, _, away_m in maps:
        lines = []
        for value, row in zip(y[1], away_m.tolist(), strict=True):
            lines.append([value, *(number(1e3 * m) if math.isfinite(m) else "-" for m in row)])
        lines.reverse()  # from top to bottom, as in the figure
        found.append((f"{label}: {what}", ["", *x[1]], lines))
    return write_page(
        folder,
        "study.html",
        "Convergence",
        plate=("Where it converges", image, caption),
        tables=found,
        about=sweep.description,
        caution=sweep.caution,
        command=command,
    )


# Measured and theoretical gain limits over delay as a figure, beside the root locus of the loop.

Rows = Sequence[Mapping[str, Any]]
DELAY_COLUMNS = (
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

Branches = tuple[float, NDArray[np.complexfloating], NDArray[np.complexfloating]]
"""Root locus of one delay [frames]: poles (m, n) over m gains from 0 on, and the poles at the
measured limit (n,).
"""


def draw_delay(rows: Rows, loci: Sequence[Branches]) -> Figure:
    """Gain limits over the delay, and the root loci in the upper half of the z plane."""
    drawn = new_figure(3.7, 7.2)
    left, right = drawn.subplots(1, 2, width_ratios=(1, 1.15))
    rows = sorted(rows, key=lambda row: row["delay_frames"])
    d = [row["delay_frames"] for row in rows]
    left.plot(d, [row["g_theory"] for row in rows], color=INK, label="theory for the delay alone")
    for key, line, color, label in (
        ("g_with_lag", "--", LINE_COLORS[1], "theory, servos' measured lag"),
        ("g_linear", ":", LINE_COLORS[2], "linear model of the arm"),
    ):
        values = [row.get(key) for row in rows]
        if any(values):
            left.plot(d, values, line, color=color, label=label)
    measured = [row["g_measured"] for row in rows]
    left.plot(d, measured, "o", color=LINE_COLORS[0], markersize=5, label="measured")
    left.set_xlabel("delay d [frames]")
    left.set_ylabel("largest stable gain x period")
    left.set_ylim(bottom=0)
    left.set_xticks(d)
    left.legend(loc="upper center", bbox_to_anchor=(0.5, -0.2), ncols=2, fontsize=7)
    _draw_locus(right, loci)
    return drawn


def _draw_locus(axes: Axes, loci: Sequence[Branches]) -> None:
    angle = np.linspace(0, np.pi, 181)
    axes.plot(np.cos(angle), np.sin(angle), color=INK, linewidth=0.8)
    from matplotlib import colormaps

    for i, (delay, poles, at_limit) in enumerate(loci):
        color = colormaps["plasma"](0.9 * i / max(len(loci) - 1, 1))  # delays have an order
        upper = poles.imag >= -1e-9  # the lower half mirrors it; the tolerance keeps real poles
        axes.plot(
            np.where(upper, poles.real, np.nan),
            np.where(upper, poles.imag, np.nan),
            color=color,
            linewidth=1.0,
        )
        crossing = at_limit[at_limit.imag >= -1e-9]
        axes.plot(crossing.real, crossing.imag, "o", color=color, markersize=3)
        # an empty line for the legend: `upper` is a matrix with a line for each pole
        axes.plot([], [], color=color, label=f"d = {delay:g}")
    axes.set_aspect("equal")
    axes.set_xlim(-1.35, 1.35)
    axes.set_ylim(-0.06, 1.6)
    axes.set_xlabel("Re z")
    axes.set_ylabel("Im z")
    axes.set_title("root locus; dots: the measured limit", pad=4)
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.2), ncols=3, fontsize=7)


def write_delay(
    folder: Path, name: str, rows: Rows, loci: Sequence[Branches], command: str
) -> Path:
    """Write `delay.png`, `delay.pdf` and `report.html`; returns the page's path."""
    caption = (
        "Left: the gain, times the camera's period, at which the loop becomes unstable."
        " Right: its poles as the gain rises."
    )
    image = _plate(folder, "delay", lambda: draw_delay(rows, loci))
    plate = ("Gain limit over delay", image, caption)
    # columns without any value are left out: a robot without joints has no lag
    shown = [
        column for column in DELAY_COLUMNS if any(row.get(column[0]) is not None for row in rows)
    ]
    lines = [
        ["-" if row.get(key) is None else format(row[key], form) for key, _, form in shown]
        for row in rows
    ]
    found = [("In numbers", [head for _, head, _ in shown], lines)]
    return write_page(
        folder, "study.html", f"Delay: {name}", plate=plate, tables=found, command=command
    )


# A search for good settings, and its figures: trials over each parameter, the best so far.

TUNING_COLUMNS = 3  # Panels side by side
WIDE = 20.0  # Ratio of the largest to the smallest number from which an axis is logarithmic


@dataclass(frozen=True)
class TrialRow:
    """A trial as the page shows it."""

    number: int  # of the trial
    values: tuple[float | str, ...]  # of each parameter, a number or a word
    reached: int  # reached, runs: how many runs reached the goal, of how many
    runs: int
    mean: float  # of the metric over those runs, NaN where none has it
    note: str = ""  # how the others ended

    @property
    def whole(self) -> bool:
        """Whether all runs reached the goal, and the metric is known."""
        return self.reached == self.runs > 0 and math.isfinite(self.mean)


# Path of a parameter, its words, and whether equal factors are equally far apart
ParameterAxis = tuple[str, tuple[str, ...], bool]


@dataclass(frozen=True)
class TuningPage:
    """What the page of a search shows."""

    title: str  # the scenario
    headline: str  # headline, sentences: the result in words
    sentences: Sequence[str]
    command: str  # that takes it
    metric: Metric  # by which trials are compared
    higher: bool  # whether more is better
    sure: bool  # whether nothing speaks against the result
    axes: Sequence[ParameterAxis]  # the parameters
    trials: Sequence[TrialRow]  # in their order
    best: int | None  # number of the best one; None without any
    made_by: str = ""  # the command that repeats the search


def slices(found: TuningPage, width_in: float) -> Figure:
    """The metric of each trial over each parameter; red crosses at the top: trials some of whose
    runs failed.
    """
    rows = -(-len(found.axes) // TUNING_COLUMNS)
    drawn = new_figure(2.5 * rows, width_in)
    grid = panels(drawn, len(found.axes), min(TUNING_COLUMNS, len(found.axes)), sharey=True)
    for i, (axes, (path, words, log)) in enumerate(zip(grid, found.axes, strict=True)):
        values = (trial.values[i] for trial in found.trials)
        # words at 0, 1, 2, ...
        _points(
            axes, found, [words.index(str(value)) if words else float(value) for value in values]
        )
        axes.set_xlabel(path)
        if words:
            axes.set_xticks(
                range(len(words)),
                [word[:24] for word in words],
                rotation=20 if max(map(len, words)) > 8 else 0,
            )
            axes.set_xlim(-0.5, len(words) - 0.5)
        elif log:
            axes.set_xscale("log")
    grid[0].set_ylabel(found.metric.label)
    return drawn


def history(found: TuningPage, width_in: float) -> Figure:
    """The metric of each trial in their order, with the best so far."""
    drawn = new_figure(2.5, width_in)
    axes = drawn.add_subplot()
    _points(axes, found, [trial.number for trial in found.trials])
    good = [(trial.number, trial.mean) for trial in found.trials if trial.whole]
    if good:
        numbers, means = (np.array(column, dtype=float) for column in zip(*good, strict=True))
        so_far = (np.maximum if found.higher else np.minimum).accumulate(means)
        axes.step(
            [*numbers, found.trials[-1].number],
            [*so_far, so_far[-1]],
            where="post",
            color=LINE_COLORS[0],
        )
    axes.set_xlabel("trial")
    axes.set_ylabel(found.metric.label)
    return drawn


def _points(axes: Axes, found: TuningPage, places: Sequence[float]) -> None:
    """A point for each trial: later ones darker, the best one ringed, those with failed runs as
    crosses at the top.
    """
    top = axes.get_xaxis_transform()
    for trial, x in zip(found.trials, places, strict=True):
        if not trial.whole:
            axes.plot(x, 0.97, transform=top, clip_on=False, **FAILED)
            continue
        shade = 0.25 + 0.65 * (trial.number + 1) / len(found.trials)
        dot: Look = {"color": LINE_COLORS[0], "alpha": shade, "markeredgewidth": 0}
        axes.plot(x, trial.mean, "o", markersize=4.5, **dot)
        if trial.number == found.best:
            ring: Look = {"markeredgecolor": GOAL, "markeredgewidth": 1.8}
            axes.plot(x, trial.mean, "o", markersize=10, markerfacecolor="none", **ring)
    means = [trial.mean for trial in found.trials if trial.whole]
    if means and min(means) > 0 and max(means) / min(means) > WIDE:
        axes.set_yscale("log")
    axes.margins(y=0.12)


PLOTS = (
    (
        "slices",
        "Trials over each parameter",
        slices,
        (
            "A point for each trial whose runs all reached the goal: the mean of the metric,"
            " later trials darker, the best one ringed. Red crosses at the top:"
            " trials of which a run failed, which count as worse than all of the others."
        ),
    ),
    ("history", "Trials in their order", history, "The line is the best trial so far."),
)


def write_tuning(folder: Path, found: TuningPage) -> Path:
    """Write `report.html`, and the figures as PDF and PNG into `figures/`;
    returns the page's path.
    """
    place, plots = make_folder(folder / "figures"), []
    for key, title, draw, caption in PLOTS:
        with style():
            plots.append((title, publish(draw(found, 7.16), key, title, place), caption))
    return write_page(
        folder,
        "study.html",
        f"{found.title}: tuning",
        about=f"{len(found.trials)} trials by {found.metric.title.lower()}",
        outcome=(
            found.headline,
            "" if found.best is None else "good" if found.sure else "open",
            found.sentences,
        ),
        take=found.command,
        plots=plots,
        trials=(
            [
                "Trial",
                *(path for path, _, _ in found.axes),
                "Reached the goal",
                found.metric.label,
                "The others ended",
            ],
            _trials(found),
        ),
        command=found.made_by,
    )


def _trials(found: TuningPage) -> list[list[Cell]]:
    """A line for each trial, the best ones first."""
    sign = -1 if found.higher else 1

    def goodness(trial: TrialRow) -> tuple[int, float]:
        mean = sign * trial.mean if math.isfinite(trial.mean) else math.inf
        return trial.runs - trial.reached or not trial.runs, mean

    lines = []
    for trial in sorted(found.trials, key=goodness):
        name = f"{trial.number} (the best)" if trial.number == found.best else str(trial.number)
        values = [Cell(v, v if isinstance(v, str) else f"{v:g}") for v in trial.values]
        reached = Cell(trial.reached, f"{trial.reached} of {trial.runs}")
        mean = Cell(trial.mean, number(trial.mean)) if math.isfinite(trial.mean) else NO_CELL
        note = Cell.named(trial.note)
        lines.append([Cell(trial.number, name), *values, reached, mean, note])
    return lines
