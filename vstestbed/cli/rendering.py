"""What `render` does: a recorded run filmed again."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import nullcontext
from pathlib import Path

import numpy as np

from vstestbed.cli.progress import show_notes
from vstestbed.core import files
from vstestbed.core.errors import NOTHING_RAN, ParameterError, RunFolderError
from vstestbed.loop.log_file import open_log
from vstestbed.report.video import film
from vstestbed.report.video.gif import gif_of
from vstestbed.scenario.dump import load_run
from vstestbed.sim.scene.follow import FixedView

__all__ = ["filmed", "must_end_in", "shot_of"]


def filmed(
    run_dir: Path, shot: film.FilmView, path: Path, fine: bool, plugins: Sequence[str], quiet: bool
) -> Path | str:
    """Film a run's folder into a file, an .mp4 or a .gif; the film in words."""
    scenario = load_run(run_dir, plugins)
    log = open_log(run_dir, scenario)
    show_notes(not quiet)
    files.make_parents(path)
    quality = film.quality_of(scenario, fine)
    verdict = film.ending_of(run_dir)

    def make(path: Path) -> Path | None:
        return film.film_log(scenario, log, shot, path, quality, verdict)

    # a film elsewhere changes nothing in the run's folder
    with files.only_writer(run_dir) if path.parent == run_dir else nullcontext():
        made = gif_of(make, path) if path.suffix.lower() == ".gif" else make(path)
    if made is None:
        words = "has a log without frames; there is nothing to film"
        raise RunFolderError(run_dir, words, NOTHING_RAN)
    return made


def shot_of(camera: str, view: str | None, size: str | None) -> film.FilmView:
    """What `--camera`, `--view` and `--size` ask for. Raises ParameterError."""
    size_px = _size_of(size)
    if view is not None and camera != "overview":
        raise ParameterError.fixed("--camera", "overview", camera, where="with --view")
    return film.FilmView(camera, view_of(view), size_px)


def must_end_in(ending: str, out: Path | None) -> None:
    """Refuse the file of `--out` where it is not of the kind that `--gif` says."""
    if out is None or out.suffix.lower() == ending:
        return
    other = ".mp4 without" if ending == ".gif" else ".gif with"
    raise ParameterError("--out", f"must end in {ending}, or in {other} --gif", str(out))


def _size_of(words: str | None) -> tuple[int, int] | None:
    """The size [px] of `--size`."""
    if words is None:
        return None
    width, _, height = words.lower().partition("x")
    if not (
        width.isdigit()
        and height.isdigit()
        and 16 <= int(width) <= 7680
        and 16 <= int(height) <= 4320
    ):
        raise ParameterError.form("--size", "WIDTHxHEIGHT in pixels, such as 1280x720", words)
    return int(width), int(height)


def view_of(words: str | None) -> FixedView | None:
    """The view of `--view`. Raises ParameterError:
    other than three or six numbers, or no distance.
    """
    if words is None:
        return None
    try:
        numbers = [float(part) for part in words.split(",")]
    except ValueError:
        numbers = []
    if (
        len(numbers) not in (3, 6)
        or not all(map(math.isfinite, numbers))
        or not 0 < numbers[2] <= 1e4
    ):
        form = (
            "AZIMUTH,ELEVATION,DISTANCE[,X,Y,Z] in degrees and metres,"
            " such as 120,-20,3 or 120,-20,3,0.5,0,0.8"
        )
        raise ParameterError.form("--view", form, words)
    return FixedView(*numbers[:3], at=np.array(numbers[3:]) if numbers[3:] else None)
