"""A run with its folder of results, each file complete or not at all: the one writer of such
folders.
"""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from vstestbed.core import files
from vstestbed.core.errors import OutputError, RunFolderError
from vstestbed.core.files import flush_entries, make_folder, temporary, write_whole, writing
from vstestbed.core.outcome import Outcome
from vstestbed.loop.log_file import finish, open_log
from vstestbed.loop.recording import Recording, Watcher
from vstestbed.loop.session import run
from vstestbed.scenario.dump import documents, kept_files
from vstestbed.scenario.load import GIVEN, RESOLVED
from vstestbed.scenario.scenario import Scenario
from vstestbed.scenario.yaml_marks import plain_mapping
from vstestbed.sim.build import scene_files

if TYPE_CHECKING:
    from vstestbed.report.video.film import FilmThread

__all__ = ["ASSETS", "Files", "files_in", "files_of_failure", "new_folder", "run_into", "store"]

Films = Literal["camera", "overview", "both", "none"]
FILM_CAMERAS: dict[str, dict[str, str]] = {
    "both": {"camera": "eye", "overview": "overview"},
    "camera": {"camera": "eye"},
    "overview": {"overview": "overview"},
    "none": {},
}
SUMMARY = "summary.json"
OWN_FILES = (GIVEN, RESOLVED, "model.xml", "log.part")
ASSETS = "assets"  # folder of the files that model.xml refers to
REMEDY = "give a new folder; an older run is never written over"


def new_folder(scenario: Scenario, out: Path | None) -> Path:
    """Make the folder of a new run: `out`, or `runs/<scenario>/<number>` with the next
    free number.
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
    fly: Callable[..., Recording] = run,
) -> Recording:
    """Run a scenario and leave its folder: scenario, model, log, summary, films, report.

    Args:
        folder: an empty folder, which is made if it is not there. films: which films to make.
        watch: further watchers, such as a progress bar. stage: called with a description of what is
            being done after the run.
        report: whether to write the report, which can also be written later.
        tile_px: (width, height) of the film from outside; by default that of its quality.
        fine: films with shadows, smooth edges and a picture of every frame, in place of drafts.
        fly: what runs it, as `loop.run`; another one takes its commands from elsewhere.

    Raises EnvironmentLackError: no OpenGL, no codec, no space. OutputError: the folder cannot be
    written, holds a run already, or another process writes into it.
    """
    folder = make_folder(Path(folder))
    with files.only_writer(folder):
        # of a process that ended between the check of `new_folder` and this one
        if (folder / GIVEN).exists():
            raise OutputError(folder, "holds a run", REMEDY)
        recording = _run_into(folder, scenario, _Filmed(films, tile_px, fine), watch, fly)
        if report:
            # imported only if a report is written
            from vstestbed.report import Setting, write_report

            stage("writing the report")
            write_report(folder, log=recording.rows, setting=Setting.of(recording.scenario))
    return recording


@dataclass(frozen=True)
class _Filmed:
    """Which films of a run are made, and how: as of `run_into`."""

    films: Films
    tile_px: tuple[int, int] | None
    fine: bool


def _run_into(
    folder: Path,
    scenario: Scenario,
    filmed: _Filmed,
    watch: Iterable[Watcher],
    fly: Callable[..., Recording],
) -> Recording:
    with _all_or_nothing(folder):
        before = files_before(scenario)  # first: what its seed draws may be refused
        scenario = scenario.resolved
        with _filming(folder, scenario, filmed) as filming:
            put(folder, before)
            # A film shows rows and flicker where the run took the pictures; one drawn afterwards is
            # of an instant.
            pictures = "camera" in FILM_CAMERAS[filmed.films] and scenario.by_rows
            recording = fly(scenario, [*filming, *watch], folder, pictures=pictures)
            for film in filming:
                # a film of several runs shows it itself
                film.close(None if filmed.tile_px else (recording.outcome, recording.reason))
        recording.time_ms["video"] = 1e3 * sum(film.spent_s for film in filming)
    finish(folder, recording.rows)
    goals: Files = {}
    if images := recording.goal_images:
        from vstestbed.report.video.writer import png_of  # imported only if there is one

        goals = {
            "goal.png" if len(images) == 1 else f"goal_{i}.png": png_of(image)
            for i, image in enumerate(images)
        }
    put(folder, goals | {SUMMARY: _summary(recording.summary())})
    return recording


# What is in a run's folder, and how it is written: a single run, a worker of a study and a crash
# have their files from here.

# content of a run's folder by file name, in the order in which they are written
Files = dict[str, bytes]


def files_before(scenario: Scenario) -> Files:
    """What is there before the run: the scenario as given and as it runs, the files that
    `model.xml` refers to, and it.
    Raises ParameterError: what the seed draws is refused.
    """
    runs = scenario.resolved
    xml, assets = scene_files(runs.scene)
    texts = {name: text.encode() for name, text in documents(scenario).items()}
    kept = {name: path.read_bytes() for name, path in kept_files(runs).items()}
    return texts | kept | assets | {"model.xml": xml.encode()}


def files_of_failure(
    text: str,
    reason: str,
    trace: str = "",
    rest: Files | None = None,
    outcome: Outcome = Outcome.crashed,
) -> Files:
    """The files of a run that crashed, or that could not begin: `rest`, which it has left, the
    scenario as given, traceback, summary.
    """
    plain = plain_mapping(text, GIVEN, "")[0]
    ended = {"outcome": outcome.name, "success": False, "reason": reason}
    figures = {"scenario": plain.get("name", "")} | ended | {"seed": plain.get("seed", 0)}
    told = {"error.txt": trace.encode()} if trace else {}
    return {GIVEN: text.encode()} | (rest or {}) | told | {SUMMARY: _summary(figures)}


def _summary(figures: Mapping[str, object]) -> bytes:
    return (json.dumps(figures, indent=1) + "\n").encode()


def files_in(folder: Path) -> Files:
    """The files of a run's folder; none where there is no folder."""
    return (
        {p.relative_to(folder).as_posix(): p.read_bytes() for p in folder.rglob("*") if p.is_file()}
        if folder.is_dir()
        else {}
    )


def put(folder: Path, files: Files) -> None:
    """Write files into a run's folder, each whole. Raises EnvironmentLackError, OutputError: see
    `core.files.writing`.
    """
    for name, content in files.items():
        make_folder((folder / name).parent)
        write_whole(folder / name, content)


def store(place: Path, files: Files, shared: Path, attempts: int) -> dict[str, Any]:
    """Write a run's folder under a temporary name, flush it to the disk, and only then rename it.
    Returns the summary.

    place: the folder. files: its content. shared: where the only copy of each mesh or texture of a
    study's runs stands. attempts: at the run, for its summary. Raises EnvironmentLackError: no
    space left. OutputError: cannot be written.
    """
    summary = json.loads(files[SUMMARY]) | {"attempts": attempts}
    with writing(place):
        for left in place.parent.glob(f"{place.name}.*.part"):  # over from a study that was killed
            shutil.rmtree(left, ignore_errors=True)
        part = temporary(place)
        part.mkdir(parents=True)
        files = files | {SUMMARY: _summary(summary)}
        put(
            part,
            {
                name: content
                for name, content in files.items()
                if not _linked(part / name, name, content, shared)
            },
        )
        flush_entries(part)
        if place.exists():  # left incomplete: a complete one is never stored again
            shutil.rmtree(place)
        part.rename(place)
        flush_entries(place.parent)
    return summary


def _linked(path: Path, name: str, content: bytes, shared: Path) -> bool:
    """Whether a mesh or texture could be stored as a link to the study's only copy of it: those of
    one arm are some 10 MB a run.
    """
    if not name.startswith(f"{ASSETS}/"):
        return False
    kept = shared / f"{zlib.crc32(content):08x}_{path.name}"
    try:
        if not kept.exists():
            kept.parent.mkdir(exist_ok=True)
            write_whole(kept, content)
        path.parent.mkdir(parents=True, exist_ok=True)
        os.link(kept, path)
    except OSError:  # a file system without hard links
        return False
    return True


@contextmanager
def _all_or_nothing(folder: Path) -> Iterator[None]:
    """Remove the folder again if the run failed before its first frame (no OpenGL, no codec, no
    space).
    """
    try:
        yield
    except BaseException:
        frames = 0
        with contextlib.suppress(RunFolderError):
            frames = len(open_log(folder))
        if frames:  # a run that fails later keeps its log
            raise
        for name in OWN_FILES:  # by name: a folder that the user gave may hold other files by now
            (folder / name).unlink(missing_ok=True)
        shutil.rmtree(folder / ASSETS, ignore_errors=True)
        files.remove_empty(folder)
        raise


@contextmanager
def _filming(folder: Path, scenario: Scenario, filmed: _Filmed) -> Iterator[list[FilmThread]]:
    """The films of a run, to be closed when it ends or is interrupted; discarded when it fails."""
    cameras = FILM_CAMERAS[filmed.films]
    paths = {camera: folder / f"{name}.mp4" for name, camera in cameras.items()}
    if not paths:
        yield []
        return
    from vstestbed.report.video.film import FilmThread, Pace, open_films, quality_of

    quality = quality_of(scenario, filmed.fine)
    quality = replace(quality, size=filmed.tile_px or quality.size)
    rate_hz = scenario.camera.rate_hz
    filming = FilmThread(
        lambda: open_films(scenario, paths, quality), Pace(rate_hz, quality.every(rate_hz))
    )
    try:
        yield [filming]
    finally:
        filming.abort()
