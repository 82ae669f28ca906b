"""Writes `report.html` of one run from the files in the run's folder: outcome, numbers, figures,
films, where they come from.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeGuard

import numpy as np
import polars as pl
from numpy.typing import NDArray

from vstestbed.core.errors import NOTHING_RAN, ParameterError, RunFolderError
from vstestbed.core.files import write_whole
from vstestbed.core.geometry import rotation_angle
from vstestbed.loop.columns import WORDS
from vstestbed.loop.log_file import Log, open_log
from vstestbed.loop.recording import read_summary
from vstestbed.loop.stability import reversal
from vstestbed.report.chart import Chart
from vstestbed.report.marks import counted, line_color, listed, number, with_unit
from vstestbed.report.pages import Film, cell, data_url, film_of, page
from vstestbed.report.run import figures, space
from vstestbed.report.run.tracks import LogArrays, Setting
from vstestbed.robots.base import STANDS_RADPS
from vstestbed.tasks.judged import MEASURED_BY, in_words_unit
from vstestbed.tasks.metrics import EVERY_RUN, KNOWN, OF_A_RUN, SOME_RUNS, Metric, own_metrics

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from vstestbed.loop.recording import Recording
    from vstestbed.scenario.scenario import Scenario

Summary = Mapping[str, Any]
Item = tuple[str, str, str]  # Title, number, unit
# Positions beyond [m] are no run's, which ends (`diverged`) 200 m away from its target
FARTHEST_M = 1e6
EMBED_BYTES = 30_000_000
"""Films up to this size together are embedded in the page; larger ones are linked, so that a
browser can still open it.
"""
NOTEBOOK_PX = 720  # Height of the report in a notebook [px]
FILMS = {"camera": "What the camera sees", "overview": "From outside"}
TITLES = {"scenario.yaml": "Scenario as given", "resolved.yaml": "Scenario as it ran"}
ROW_METRICS = tuple(
    metric
    for metric in (*OF_A_RUN, *EVERY_RUN, *SOME_RUNS)
    if not metric.tile and metric.name != "judged_error"
)
UNLIMITED = 0.999  # a command scaled under this is limited
# what moves by more than a robot that stands does in it, STANDS_RADPS, still moves at the end
LAST_S = 1.0
STUCK, LEAST_TOLD, STUCK_FRAMES = 0.02, 1e-4, 4
"""A joint is held by friction that moves by less than this share of its command, which is at least
so large [rad/s, m/s], for so many frames.
"""
LEAST_STOOD_S = 0.2  # in all, of a joint that is told of
CONTINUING = ("worst_task_error_m", "path_length_m", "real_time_factor")
"""The large numbers of a continuing task, which has no goal pose to measure an error from."""

# The figures of a run's page in their order, each with its title; `run.html` has the captions, by
# the names of these functions.
FIGURES: dict[Callable[[LogArrays], Chart | None], str] = {
    space.features: "Features in the image",
    space.other_cameras: "Features in the pictures of further cameras",
    space.polar: "Features in polar coordinates",
    space.spherical: "Features in spherical coordinates",
    space.on_sphere: "Features on the sphere",
    figures.error: "Error in the image",
    space.camera_path: "Camera path",
    space.plane: "Path on the floor",
    figures.task_error: "Error of the task",
    figures.twist: "Camera twist",
    figures.velocity: "Velocity of the craft",
    figures.tilt: "Tilt",
    figures.rates: "Body rates",
    figures.rotors: "Rotors and wind",
    figures.pose_error: "Distance from the goal",
    figures.depth: "Depth of the markers",
    figures.localisation_error: "Localisation error",
    figures.wheels: "Wheels and steering",
    figures.slip: "Slip",
    figures.joints: "Joints and actuators",
    figures.own_columns: "Columns of the law and of effects",
}


def write_report(
    run_dir: Path,
    log: Log | pl.DataFrame | None = None,
    setting: Setting | None = None,
    plugins: Sequence[str] = (),
) -> Path:
    """Write `report.html` into a run's folder; returns its path.

    Args:
        run_dir: the folder with both scenarios, `summary.json`, `log.parquet` (or `log.part`) and
            films, if there are any.
        log, setting: log and scenario data of the figures, if the caller has them already; else
            those of the folder.
        plugins: files or modules, besides those that `scenario.yaml` names.

    RunFolderError: the folder holds no run, a damaged one, or one without a frame. ScenarioError,
    PluginError: its scenario cannot be loaded. OutputError: the page cannot be written.
    """
    from vstestbed.scenario.dump import load_run  # here: the figures themselves need no scenario
    from vstestbed.scenario.load import GIVEN, RESOLVED
    from vstestbed.scenario.yaml_marks import text_of

    texts = {GIVEN: text_of(run_dir / GIVEN)}
    if (run_dir / RESOLVED).is_file():
        texts[RESOLVED] = text_of(run_dir / RESOLVED)
    summary = _summary(run_dir)
    videos = {name: run_dir / f"{name}.mp4" for name in FILMS}
    videos = {name: path for name, path in videos.items() if path.is_file()}
    if log is None or setting is None:
        scenario = load_run(run_dir, plugins)
        setting = setting or Setting.of(scenario)
        if log is None:
            log = _log_of(run_dir, scenario)
    goals = sorted(run_dir.glob("goal*.png"), key=lambda path: (len(path.name), path.name))
    pictures = [path.read_bytes() for path in goals]
    return write_whole(
        run_dir / "report.html", render_page(log, summary, texts, videos, setting, pictures)
    )


def _log_of(run_dir: Path, scenario: Scenario) -> Log:
    """The log of a run's folder, which has a frame, and positions that a figure has a scale for."""
    log = open_log(run_dir, scenario)
    if not len(log):
        words = "has a log without frames; there is nothing to report"
        raise RunFolderError(run_dir, words, NOTHING_RAN)
    for name in [f"{who}_{axis}" for who in ("cam", "tgt") for axis in "xyz"]:
        if not (abs(log[name]) < FARTHEST_M).all():
            where = f"a position over {FARTHEST_M:g} m in the column {name}"
            raise RunFolderError(run_dir, f"its log is damaged ({where})")
    return log


def render_page(
    log: Log | pl.DataFrame,
    summary: Summary,
    texts: Mapping[str, str],
    videos: Mapping[str, Path],
    setting: Setting | None = None,
    goal_pictures: Sequence[bytes] = (),
) -> str:
    """The report as HTML that refers to nothing outside itself (films of more than 30 MB together
    excepted).

    Args:
        log: one row per frame, the columns of `log.parquet`; may be empty. summary: that of
            `summary.json`; missing numbers show as dashes.
        texts: the scenario as given and as it ran, by the names of the files, shown verbatim.
            videos: films by name (`camera`, `overview`).
        setting: data for the figures.
        goal_pictures: PNG files of the pictures taken at the goal views.
    """
    setting = setting or Setting()
    tracks = LogArrays.of(log, setting)
    name = str(summary.get("scenario") or "Run")
    outcome = outcome_text(summary)
    drawn = []
    for draw, title in FIGURES.items():
        chart = draw(tracks)
        if chart is not None:
            drawn.append((draw.__name__, title, chart.svg(title)))
    versions: Summary = summary.get("versions") or {}
    return page(
        "run.html",
        name,
        f"{name}: {outcome}",
        description=setting.description,
        changed=setting.changed,
        good=bool(summary.get("success")),
        outcome=outcome,
        sentences=" ".join([sentences(summary), *events(tracks)]),
        tiles=tiles(summary),
        rows=rows(summary),
        figures=drawn,
        films=_films(videos),
        goals=[data_url("image/png", png) for png in goal_pictures],
        timing=_timing(summary),
        documents=[(f"{TITLES.get(name, name)} ({name})", text) for name, text in texts.items()],
        versions=[(package, str(version), "") for package, version in versions.items()],
        everything=json.dumps(dict(summary), indent=2, default=str),
    )


def _timing(summary: Summary) -> list[tuple[str, float, str]]:
    """Where the time of a frame went [ms], each part with its colour; empty where it took none."""
    known: Summary = summary.get("time_ms") or {}
    parts = {part: ms for part, ms in known.items() if _is_number(ms) and ms >= 0}
    if not any(parts.values()):
        return []
    return [(part, ms, line_color(i)) for i, (part, ms) in enumerate(parts.items())]


def recording_cell(recording: Recording) -> str:
    """The report of a recording as a notebook shows it, without films."""
    from vstestbed.scenario.dump import documents

    scenario = recording.scenario
    return cell(
        render_page(
            recording.rows, recording.summary(), documents(scenario), {}, Setting.of(scenario)
        ),
        NOTEBOOK_PX,
    )


def figure_of(recording: Recording, name: str) -> Figure:
    """A figure of the report of a recording by the name of its function. Raises ParameterError: it
    has none of this name.
    """
    from vstestbed.report.canvas import chart_figure

    tracks = LogArrays.of(recording.rows, Setting.of(recording.scenario))
    drawers = {draw.__name__: draw for draw in FIGURES}
    chart = drawers[name](tracks) if name in drawers else None
    if chart is None:
        there = [known for known, draw in drawers.items() if draw(tracks) is not None]
        raise ParameterError.choice("plot", there, name)
    return chart_figure(chart)


def outcome_text(summary: Summary) -> str:
    """The outcome as text: `Target lost` for `target_lost`."""
    return str(summary.get("outcome") or "no outcome").replace("_", " ").capitalize()


def sentences(summary: Summary) -> str:
    """The reason of the outcome, whether the command swung on the way,
    and the error that decided.
    """
    reason = str(summary.get("reason") or "")
    found = [reason[:1].upper() + reason[1:].rstrip(".") + "."] if reason else []
    swung_s = summary.get("swung_s")
    frames = summary.get("swing_frames")
    # the outcome `unstable` says so itself
    if _is_number(swung_s) and _is_number(frames) and summary.get("outcome") != "unstable":
        found.append(
            f"On the way its command {reversal(frames)}, for {number(swung_s)} s"
            " without a break: it is badly damped."
        )
    if (by := summary.get("judged_by")) is not None:  # older summaries have none
        value = _judged(summary, "judged_error")
        limit = _judged(summary, "judged_limit")
        found.append(f"Task error by {MEASURED_BY[by]}: {value}, limit {limit}.")
    return " ".join(found)


def _judged(summary: Summary, name: str) -> str:
    """The error by which the task is judged, or its limit, in words."""
    if not _is_number(summary[name]):
        return "unknown"
    value, unit = in_words_unit(summary[name], str(summary["judged_unit"]))
    return f"{number(value)} {unit}"


def events(tracks: LogArrays) -> list[str]:
    """What happened on the way that a figure shows and a reader may miss: commands that limits
    shortened, joints that friction held.
    """
    found = [*_limits(tracks), *_friction(tracks)]
    if moving := still_moving(tracks):
        words = "In its last second it still moved"
        if tracks.setting.band_m is not None:
            words = "Its task has no end, and in its last second it moved on"
        found.append(
            f"{words}, by more than the {STANDS_RADPS:g} rad or m of a robot"
            f" that stands: {listed(moving)}."
        )
    return found


def _limits(tracks: LogArrays) -> Iterator[str]:
    """How many commands were shortened or turned, and by what."""
    t = tracks.t
    limit = tracks.column("limit")
    limited = np.flatnonzero((tracks.column("scale") < UNLIMITED) | (limit > 0))
    if len(limited):
        yield (
            f"Limits of law or robot shortened or turned {len(limited)} of its {len(t)} commands,"
            f" the last at {t[limited[-1]]:.3g} s."
        )
    frames = {word: int((limit == i).sum()) for i, word in enumerate(WORDS) if word}
    by = [f"{word.replace('_', ' ')} {counted(n, 'frame')}" for word, n in frames.items() if n]
    if by:
        turned = np.degrees(np.nanmax(tracks.column("turned_rad")))
        way = f"; its motion was turned by up to {turned:.2g} degrees" if turned else ""
        yield f"The robot's limits were: {listed(by)}{way}."


def _friction(tracks: LogArrays) -> Iterator[str]:
    """Which joints friction held, for how long."""
    if not tracks.setting.told_speeds or tracks.setting.planar:
        return
    spans = {name: _held(tracks, name) for name in tracks.named("qd")}
    held = {name: span for name, span in spans.items() if span is not None}
    if held:
        longest = max(for_s for for_s, _ in held.values())
        first = min(from_s for _, from_s in held.values())
        who = "it was" if len(held) == 1 else "they were"
        yield (
            f"Friction held {listed(list(held))} for up to {longest:.2g} s although {who} told to"
            f" move, first at {first:.3g} s (stick-slip)."
        )


def still_moving(tracks: LogArrays) -> list[str]:
    """What truly moved in the last second of a run: driven joints, from end to end, and the camera,
    along its path.
    """
    t = tracks.t
    if not len(t):
        return []
    last = t > t[-1] - LAST_S
    return [*_joints_moving(tracks, last), *_camera_moving(tracks, last)]


def _joints_moving(tracks: LogArrays, last: NDArray[np.bool_]) -> Iterator[str]:
    driven = tracks.named("ctrl")
    # a car's wheels are not: they roll on with it
    for name in tracks.named("q"):
        span = float(np.ptp(tracks.column(f"q_{name}")[last]))
        unit = "m" if name in tracks.setting.slides else "rad"
        if name in driven and span > STANDS_RADPS:
            yield f"{name} by {' '.join(with_unit(span, unit))} from end to end"


def _camera_moving(tracks: LogArrays, last: NDArray[np.bool_]) -> Iterator[str]:
    T = tracks.poses("cam")[last]
    R = T[:, :3, :3]
    way = np.linalg.norm(np.diff(T[:, :3, 3], axis=0), axis=1)
    turned = rotation_angle(R[:-1].mT @ R[1:])
    for what, unit, steps in (("camera", "m", way), ("camera's direction", "rad", turned)):
        size = float(steps.sum())
        if size > STANDS_RADPS:  # not of a log without poses, whose are NaN
            yield f"the {what} by {' '.join(with_unit(size, unit))} along its path"


def _held(tracks: LogArrays, joint: str) -> tuple[float, float] | None:
    """For how long in all a joint stood although it was told to move, and from when on [s]; None
    where it did not.
    """
    t = tracks.t
    speed = np.abs(tracks.column(f"qd_{joint}"))
    told = np.abs(tracks.column(f"ctrl_{joint}"))
    stands = (speed < STUCK * told) & (told > LEAST_TOLD)
    edges = np.flatnonzero(np.diff(stands, prepend=False, append=False))
    stood = [(a, b) for a, b in edges.reshape(-1, 2).tolist() if b - a >= STUCK_FRAMES]
    held = sum(float(t[b - 1] - t[a]) for a, b in stood)
    return (held, float(t[stood[0][0]])) if held >= LEAST_STOOD_S else None


def tiles(summary: Summary) -> list[Item]:
    """The most important numbers; of a law that works on grey levels and measures no markers the
    error in grey levels.
    """
    if "worst_task_error_m" in summary:
        return _items([KNOWN[name] for name in CONTINUING], summary)
    grey = "final_error_grey" in summary and summary.get("final_error_px") is None
    other = "final_error_px" if grey else "final_error_grey"
    large = [m for m in _had([*KNOWN.values()], summary) if m.tile and m.name != other]
    return _items(large, summary)


def rows(summary: Summary) -> list[Item]:
    """The other numbers, one per line; those of the scenario's own metrics come last."""
    own = [metric for name, metric in own_metrics().items() if name in summary]
    return _items([*_had(ROW_METRICS, summary), *own], summary)


def _had(metrics: Sequence[Metric], summary: Summary) -> list[Metric]:
    """Those of every run, and those of some runs that this one has."""
    return [m for m in metrics if not m.where or summary.get(m.name) is not None]


def _items(metrics: Iterable[Metric], summary: Summary) -> list[Item]:
    found = []
    for metric in metrics:
        value = summary.get(metric.name)
        if isinstance(value, float):
            value *= metric.scale
        found.append((metric.title, *with_unit(value, metric.unit)))
    return found


def _is_number(value: object) -> TypeGuard[float]:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _films(videos: Mapping[str, Path]) -> list[Film]:
    """The films: embedded in the page as long as they fit, else linked to the files beside it."""
    left = EMBED_BYTES
    films = []
    for name, path in videos.items():  # in their order: the camera's film is embedded first
        size = path.stat().st_size
        embedded = size <= left
        films.append(film_of(FILMS.get(name, name), path, embedded))
        if embedded:
            left -= size
    return films


def _summary(run_dir: Path) -> dict[str, Any]:
    """The summary; for a run that was killed, and has none, one that says so."""
    if not (run_dir / "summary.json").exists():
        return {
            "scenario": run_dir.resolve().parent.name,
            "outcome": "interrupted",
            "reason": "the run was cut off before it wrote a summary",
        }
    return read_summary(run_dir, "without this file `report` shows what the log has")
