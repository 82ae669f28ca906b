"""Writes `report.html` of one run from the files in the run's folder."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import polars as pl

from vstestbed.core.errors import NOTHING_RAN, RunFolderError
from vstestbed.core.files import write_whole
from vstestbed.loop.log_file import Log, open_log
from vstestbed.loop.recording import read_summary
from vstestbed.report.html.chart import Chart
from vstestbed.report.html.template import STYLE, cell, figure, film, folded, page, picture
from vstestbed.report.run import figures, numbers, robots, space
from vstestbed.report.run.tracks import Setting, Tracks

if TYPE_CHECKING:
    from vstestbed.loop.recording import Recording

FARTHEST_M: Final = 1e6  # Positions beyond [m] are no run's, which ends (`diverged`) 200 m away from its target
EMBED_BYTES: Final = 30_000_000
"""Films up to this size together are embedded in the page; larger ones are linked, so that a browser can still open it."""

NOTEBOOK_PX: Final = 720  # Height of the report in a notebook [px]

FILMS: Final = {"camera": "What the camera sees", "overview": "From outside"}

# Title and caption of each figure, by the function that draws it or gives None.
PLOTS: Final[dict[Callable[[Tracks], Chart | None], tuple[str, str]]] = {
    figures.features: (
        "Features in the image",
        "The path of each marker, or of a region's middle, through the image; the frame is the image border.",
    ),
    space.polar: (
        "Features in polar coordinates",
        "As the law sees them: the angle about the optical axis, drawn on beyond a half turn, and the distance from it.",
    ),
    space.spherical: (
        "Features in spherical coordinates",
        "As the law sees them: the angle about the optical axis, drawn on beyond a half turn, and the angle from it.",
    ),
    space.on_sphere: (
        "Features on the sphere",
        "The unit sphere around the camera, seen from outside and ahead; z is the optical axis. What is paler lies on the far side.",
    ),
    figures.error: (
        "Error in the image",
        "Root mean square of goal minus measured: over the markers' coordinates [px], or over the picture's pixels, with the law's weights "
        "[grey levels].",
    ),
    space.camera_path: ("Camera path", "In the world, equal scale on all axes; pyramids look where the camera looks."),
    robots.plane: (
        "Path on the floor",
        "From above, equal scale. Shaded: the region in the image, at the landmarks' height, at the start and at the end.",
    ),
    robots.task_error: (
        "Error of the task",
        "True error: distance of the camera from its goal or path, gap minus the desired gap, or lateral offset to the left of the line.",
    ),
    figures.twist: ("Camera twist", "In the camera's frame: commanded (thin line) and true (pale band)."),
    robots.velocity: (
        "Velocity of the craft",
        "In its level frame: commanded (thin line) and its own estimate of the velocity flown (pale band).",
    ),
    robots.tilt: ("Tilt", "True (pale band), estimated from the IMU (thin line), and the reference of the velocity loop (dotted)."),
    robots.rates: ("Body rates", "Reference of the attitude loop (thin line) and measured by the gyro (pale band)."),
    robots.rotors: ("Rotors and wind", "Speeds of the rotors, their limit dotted; the wind along the world's axes."),
    figures.pose_error: ("Distance from the goal", "True pose against the goal pose."),
    figures.depth: ("Depth of the markers", "As the law used it (thin line) and true (pale band)."),
    robots.localisation_error: ("Localisation error", "Estimated minus true position (distance) and heading (counter-clockwise)."),
    robots.wheels: ("Wheels and steering", "Commanded (thin line) and measured (pale band)."),
    robots.slip: ("Slip", "True motion minus the motion by the encoders (sliding, a wrong wheel radius): mean between two frames."),
    figures.joints: ("Joints and actuators", "Positions [rad or m], velocities, and actuator inputs in the actuators' own units."),
}


TITLES = {"scenario.yaml": "Scenario as given", "resolved.yaml": "Scenario as it ran"}


def write_report(run_dir: Path, log: Log | pl.DataFrame | None = None, setting: Setting | None = None, plugins: Sequence[str] = ()) -> Path:
    """Write `report.html` into a run's folder; returns its path.

    Args:
        run_dir: the folder with both scenarios, `summary.json`, `log.parquet` (or `log.part`) and films, if there are any.
        log, setting: log and scenario data of the figures, if the caller has them already; else those of the folder.
        plugins: files or modules, besides those that `scenario.yaml` names.

    Raises:
        RunFolderError: the folder holds no run, a damaged one, or one without a frame.
        ScenarioError, PluginError: its scenario cannot be loaded. OutputError: the page cannot be written.
    """
    from vstestbed.scenario.dump import load_run  # here: the figures themselves need no scenario
    from vstestbed.scenario.load import GIVEN, RESOLVED, text_of

    texts = {name: text_of(run_dir / name) for name in (GIVEN, RESOLVED) if name == GIVEN or (run_dir / name).is_file()}
    summary = _summary(run_dir)
    videos = {path.stem: path for path in (run_dir / f"{name}.mp4" for name in FILMS) if path.is_file()}
    if log is None or setting is None:
        scenario = load_run(run_dir, plugins)
        setting = setting or Setting.of(scenario)
        if log is None:
            log = _in_reach(run_dir, open_log(run_dir, scenario))
            if not len(log):
                raise RunFolderError(run_dir, "has a log without frames; there is nothing to report", NOTHING_RAN)
    goals = [path.read_bytes() for path in sorted(run_dir.glob("goal*.png"), key=lambda path: (len(path.name), path.name))]
    return write_whole(run_dir / "report.html", render_page(log, summary, texts, videos, setting, goals))


def render_page(
    log: Log | pl.DataFrame,
    summary: Mapping[str, Any],
    texts: Mapping[str, str],
    videos: Mapping[str, Path],
    setting: Setting | None = None,
    goal_pictures: Sequence[bytes] = (),
) -> str:
    """The report as HTML that refers to nothing outside itself (films of more than 30 MB together excepted).

    Args:
        log: one row per frame, the columns of `log.parquet`; may be empty. summary: that of `summary.json`; missing numbers show as dashes.
        texts: the scenario as given and as it ran, by the names of the files, shown verbatim. videos: films by name (`camera`, `overview`).
        setting: data for the figures.
        goal_pictures: PNG files of the pictures taken at the goal views.
    """
    setting = setting or Setting()
    name = str(summary.get("scenario") or "Run")
    body = [
        numbers.headline(summary),
        numbers.tiles(summary),
        numbers.table(summary),
        f'<section><h2>Figures</h2><div class="plots">{_figures(Tracks.of(log, setting))}</div></section>',
        _films(videos),
        _goal_pictures(goal_pictures),
        numbers.timing(summary),
        *(folded(f"{TITLES.get(name, name)} ({name})", text) for name, text in texts.items()),
        numbers.provenance(summary),
        folded("All numbers (summary.json)", json.dumps(dict(summary), indent=2, default=str)),
    ]
    subtitle = f'<p class="soft">{escape(setting.description)}</p>' if setting.description else ""
    if setting.changed:
        subtitle += f'<p class="soft">Changed in this run: {", ".join(f"<code>{escape(one)}</code>" for one in setting.changed)}</p>'
    return page(name, body, subtitle, f"{name}: {numbers.outcome_text(summary)}", STYLE)


def recording_cell(recording: Recording) -> str:
    """The report of a recording as a notebook shows it, without films."""
    from vstestbed.scenario.dump import documents

    scenario = recording.scenario
    return cell(render_page(recording.rows, recording.summary(), documents(scenario), {}, Setting.of(scenario)), NOTEBOOK_PX)


def _figures(tracks: Tracks) -> str:
    charts = ((title, draw(tracks), caption) for draw, (title, caption) in PLOTS.items())
    return "".join(figure(title, chart.svg(title), caption) for title, chart, caption in charts if chart is not None)


def _films(videos: Mapping[str, Path]) -> str:
    """The films: embedded in the page as long as they fit, else linked to the files beside it."""
    left, films = EMBED_BYTES, []
    for name, path in videos.items():
        # in their order: the camera's film is embedded first
        size = path.stat().st_size
        embedded = size <= left
        left -= size if embedded else 0
        films.append(film(FILMS.get(name, name), path, embedded))
    return f'<section class="films"><h2>Films</h2><div class="grid">{"".join(films)}</div></section>' if films else ""


def _goal_pictures(pictures: Sequence[bytes]) -> str:
    cards = "".join(picture("Goal" if len(pictures) == 1 else f"View {i + 1}", png) for i, png in enumerate(pictures))
    return f'<section class="films"><h2>Picture of the goal</h2><div class="grid">{cards}</div></section>' if cards else ""


def _in_reach(run_dir: Path, log: Log) -> Log:
    """The log, unless a position is so far away that only a damaged file can have it: figures have no scale for it."""
    for name in (f"{who}_{axis}" for who in ("cam", "tgt") for axis in "xyz"):
        if not (abs(log[name]) < FARTHEST_M).all():
            raise RunFolderError(run_dir, f"its log is damaged (a position over {FARTHEST_M:g} m in the column {name})")
    return log


def _summary(run_dir: Path) -> dict[str, Any]:
    """The summary; for a run that was killed, and has none, one that says so."""
    if not (run_dir / "summary.json").exists():
        return {
            "scenario": run_dir.resolve().parent.name,
            "outcome": "interrupted",
            "reason": "the run was cut off before it wrote a summary",
        }
    return read_summary(run_dir, "without this file `report` shows what the log has")
