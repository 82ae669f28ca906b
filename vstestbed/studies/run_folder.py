"""A run with its folder of results: scenario, model, log, summary, films, report, each complete or not at all."""

from __future__ import annotations

import contextlib
import json
import shutil
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from vstestbed.core import files
from vstestbed.core.errors import OutputError, RunFolderError
from vstestbed.core.files import make_folder, write_whole
from vstestbed.loop.columns import Layout
from vstestbed.loop.log_file import FolderLog, open_log
from vstestbed.loop.recording import Recording, Watcher
from vstestbed.loop.session import run
from vstestbed.scenario.dump import dump_for_folder, kept_files
from vstestbed.scenario.scenario import Scenario
from vstestbed.sim.build import scene_files

if TYPE_CHECKING:
    from vstestbed.report.video.film import FilmThread

Films = Literal["camera", "overview", "both", "none"]
FILM_CAMERAS: dict[str, dict[str, str]] = {
    "both": {"camera": "eye", "overview": "overview"},
    "camera": {"camera": "eye"},
    "overview": {"overview": "overview"},
    "none": {},
}
OWN_FILES = ("scenario.yaml", "model.xml", "log.part")
ASSETS = "assets"
"""Folder of the files that model.xml refers to."""
REMEDY = "give a new folder; an older run is never written over"


def new_folder(scenario: Scenario, out: Path | None) -> Path:
    """Make the folder of a new run: `out`, or `runs/<scenario>/<number>` with the next free number.

    Raises:
        OutputError: `out` holds something already, or cannot be made.
    """
    return files.new_folder(Path("runs") / files.file_word(scenario.name), out, REMEDY)


def run_into(
    folder: str | Path,
    scenario: Scenario,
    films: Films = "both",
    watch: Iterable[Watcher] = (),
    stage: Callable[[str], None] = lambda _: None,
    report: bool = True,
    tile_px: tuple[int, int] | None = None,
    fine: bool = False,
) -> Recording:
    """Run a scenario and leave its folder: scenario, model, log, summary, films, report.

    Args:
        folder: an empty folder, which is made if it is not there.
        films: which films to make.
        watch: further watchers, such as a progress bar.
        stage: called with a description of what is being done after the run.
        report: whether to write the report, which can also be written later.
        tile_px: (width, height) of the film from outside; by default that of its quality.
        fine: films with shadows, smooth edges and a picture of every frame, in place of drafts.

    Raises:
        EnvironmentLackError: no OpenGL, no codec, no space.
        OutputError: the folder cannot be written, holds a run already, or another process writes into it.
    """
    folder = make_folder(Path(folder))
    with files.only_writer(folder):
        if (folder / "scenario.yaml").exists():  # of a process that ended between the check of `new_folder` and this one
            raise OutputError(folder, "holds a run", REMEDY)
        recording = _run_into(folder, scenario, films, watch, tile_px, fine)
        if report:
            from vstestbed.report import Setting, write_report  # imported only if a report is written

            stage("writing the report")
            write_report(folder, log=recording.rows, setting=Setting.of(recording.scenario))
    return recording


def _run_into(
    folder: Path, scenario: Scenario, films: Films, watch: Iterable[Watcher], tile_px: tuple[int, int] | None, fine: bool
) -> Recording:
    """`run_into` without the report."""
    with _all_or_nothing(folder):
        with _filming(folder, scenario, films, tile_px, fine) as filming:
            for name, content in _experiment(scenario):
                make_folder((folder / name).parent)
                write_whole(folder / name, content)
            log = FolderLog.create(folder, Layout(scenario).columns)
            try:
                # A film shows rows and flicker where the run took the pictures; one drawn afterwards is of an instant.
                pictures = "camera" in FILM_CAMERAS[films] and scenario.by_rows
                recording = run(scenario, [*filming, *watch], log, pictures=pictures)
            finally:
                log.close()
            for film in filming:
                film.close(None if tile_px else (recording.outcome, recording.reason))  # a film of several runs shows it itself
        recording.time_ms["video"] = 1e3 * sum(film.spent_s for film in filming)
    summary = _summary(recording.summary())  # before `log.finish`: log.part is read without decompressing it
    log.finish()
    for name, content in _goal_pictures(recording):
        write_whole(folder / name, content)
    write_whole(folder / "summary.json", summary)  # after it: a summary says that the run is finished
    return recording


def _experiment(scenario: Scenario) -> Iterator[tuple[str, bytes]]:
    """The files of a run's folder that are there before the run, by name: the scenario, the files that `model.xml` refers to, and it."""
    yield "scenario.yaml", dump_for_folder(scenario).encode()
    for name, path in kept_files(scenario).items():
        yield name, path.read_bytes()
    scene = scene_files(scenario.robot, scenario.camera, scenario.target_in_run, scenario.world, scenario.physics, scenario.sights)
    yield from scene.assets.items()
    yield "model.xml", scene.xml.encode()


def _goal_pictures(recording: Recording) -> Iterator[tuple[str, bytes]]:
    """The pictures taken at the goal views as PNG files: `goal.png`, or `goal_0.png`, ... of several."""
    images = recording.goal_images
    if not images:
        return
    from vstestbed.report.video.writer import png_of  # imported only if there is one

    for i, image in enumerate(images):
        yield "goal.png" if len(images) == 1 else f"goal_{i}.png", png_of(image)


def _summary(figures: dict[str, object]) -> str:
    return json.dumps(figures, indent=1) + "\n"


@contextmanager
def _all_or_nothing(folder: Path) -> Iterator[None]:
    """Remove the folder again if the run failed before its first frame (no OpenGL, no codec, no space)."""
    try:
        yield
    except BaseException:
        if _has_frames(folder):  # a run that fails later keeps its log
            raise
        for name in OWN_FILES:  # by name: a folder that the user gave may hold other files by now
            (folder / name).unlink(missing_ok=True)
        shutil.rmtree(folder / ASSETS, ignore_errors=True)
        files.remove_empty(folder)
        raise


def _has_frames(folder: Path) -> bool:
    with contextlib.suppress(RunFolderError):
        return len(open_log(folder)) > 0
    return False


@contextmanager
def _filming(folder: Path, scenario: Scenario, films: Films, tile_px: tuple[int, int] | None, fine: bool) -> Iterator[list[FilmThread]]:
    """The films of a run, to be closed when it ends or is interrupted; discarded when it fails."""
    paths = {camera: folder / f"{name}.mp4" for name, camera in FILM_CAMERAS[films].items()}
    if not paths:
        yield []
        return
    from vstestbed.report.video.film import FilmThread, open_films
    from vstestbed.report.video.quality import Pace, quality_of

    quality = quality_of(scenario, fine)
    quality = replace(quality, size=tile_px or quality.size)
    rate_hz = scenario.camera.rate_hz
    filming = FilmThread(lambda: open_films(scenario, paths, quality), Pace(rate_hz, quality.every(rate_hz)))
    try:
        yield [filming]
    finally:
        filming.abort()
