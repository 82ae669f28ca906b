"""A recorded run as exports read it: scenario, log, summary, and the servo camera's pictures, taken
again one by one.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, NamedTuple, cast

import polars as pl

from vstestbed.camera import Image
from vstestbed.core.errors import NOTHING_RAN, RunFolderError
from vstestbed.core.files import make_folder, whole_folder
from vstestbed.core.geometry import Array
from vstestbed.loop.columns import text_of
from vstestbed.loop.log_file import Log, open_log
from vstestbed.loop.recording import read_summary
from vstestbed.report.video.film import rows_of
from vstestbed.report.video.overlay import FilmFrame
from vstestbed.scenario.distributions import IMAGE_STREAM, IMAGING_STREAM
from vstestbed.scenario.dump import load_run
from vstestbed.scenario.scenario import Scenario
from vstestbed.sim.replay import Rerendering

__all__ = [
    "Bodies",
    "ExportFormat",
    "ExportRequest",
    "Meaning",
    "RecordedRun",
    "Taken",
    "meaning",
    "name_with_unit",
    "opened",
    "unit_of_joint",
]

# The scene's bodies: their names, places (B, 3) [m] and quaternions (B, 4), wxyz, in the world
Bodies = tuple[list[str], Array, Array]


class Taken(NamedTuple):
    """One frame of a recorded run."""

    row: dict[str, float]  # of the log
    state: FilmFrame  # the same as a film has it
    picture: Image  # (H, W, 3) uint8 RGB
    bodies: Bodies  # valid until the next frame


@dataclass(frozen=True)
class RecordedRun:
    """A run's folder."""

    folder: Path  # of the run
    scenario: Scenario  # with its start and its noise
    log: Log
    summary: dict[str, Any] | None  # as written; None of a run that was cut off

    @classmethod
    def of(cls, folder: Path, plugins: Sequence[str] = ()) -> RecordedRun:
        """Read a run's folder; plugins: as of `load`.

        RunFolderError: it has no run, a damaged one, or one without a frame. ScenarioError: its
            scenario cannot be read.
        """
        if not (folder / "scenario.yaml").is_file():
            raise RunFolderError(folder, "no run here" if folder.is_dir() else "no such folder")
        scenario = load_run(folder, plugins)
        log = open_log(folder, scenario)
        summary = (
            read_summary(folder, "run the scenario again")
            if (folder / "summary.json").is_file()
            else None
        )
        if not len(log):
            raise RunFolderError(
                folder, "has a log without frames; there is nothing to export", NOTHING_RAN
            )
        return cls(folder, scenario, log, summary)

    def place(self, within: Path | None) -> str:
        """The folder's name, or its path within another folder."""
        return self.folder.name if within is None else self.folder.relative_to(within).as_posix()

    @property
    def success(self) -> bool:
        """Whether it reached its goal; a run that was cut off has not."""
        return bool(self.summary and self.summary["success"])

    @property
    def outcome(self) -> str:
        """How it ended, in a word."""
        return self.summary["outcome"] if self.summary else "cut off"

    @property
    def noisy(self) -> bool:
        """Whether its pictures have noise."""
        return self.scenario.noise.image_sigma > 0 or self.scenario.camera.sensor is not None

    @property
    def how_taken(self) -> str:
        """What its exported pictures are, in words."""
        noise, timing, camera = self.scenario.noise, self.scenario.timing, self.scenario.camera
        words = ["redrawn from the log at the camera's rate and size"]
        if noise.image_sigma:
            words.append(f"with the run's noise of {noise.image_sigma:g} grey levels")
        if noise.drift.brightness or noise.drift.color:
            words.append("with the drift of its gains")
        if camera.imaged:
            changed = [
                name
                for name in ("optics", "exposure", "sensor", "stream")
                if getattr(camera, name) is not None
            ]
            words.append(f"through the camera's {' and '.join(changed)}")
        light = self.scenario.world.light
        left_out = {
            f"the motion blur of its {timing.first_s(camera):g} s exposure": timing.first_s(camera)
            > 0,
            f"the skew of its rolling shutter of {camera.readout_s:g} s": camera.readout_s > 0,
            "the flicker of its light": light is not None and light.flicker.depth > 0,
        }
        words += [f"without {what}" for what, there in left_out.items() if there]
        return ", ".join(words)

    def frames(self) -> Iterator[Taken]:
        """The frames in their order, each with its picture drawn anew. EnvironmentLackError: it
        cannot be drawn here.
        """
        s, noise = self.scenario, self.scenario.noise
        with closing(
            Rerendering(
                s.scene, noise.image_sigma, s.rng(IMAGE_STREAM), noise.drift, s.rng(IMAGING_STREAM)
            )
        ) as rerendered:
            names = rerendered.body_names
            for row in rows_of(self.log):
                state = FilmFrame.of_row(row, s)
                picture = rerendered.picture(
                    state.t, state.T_world_target, state.q, state.T_world_camera
                )
                yield Taken(row, state, picture, (names, *rerendered.body_poses))


def opened(folders: Iterable[Path], plugins: Sequence[str] = ()) -> Iterator[RecordedRun]:
    """The runs of folders, one at a time."""
    for folder in folders:
        yield RecordedRun.of(folder, plugins)


def write_each(
    runs: Iterable[RecordedRun],
    out: Path,
    within: Path,
    suffix: str,
    write: Callable[[RecordedRun, Path], object],
) -> Path:
    """Write each run at its place within a folder into a new folder `out`, which appears whole or
    not at all.
    """
    with whole_folder(out) as folder:
        for run in runs:
            path = folder / f"{run.place(within)}{suffix}"
            make_folder(path.parent)
            write(run, path)
    return out


@dataclass(frozen=True)
class ExportRequest:
    """What an export is to write: runs, one at a time, into a new file or folder `out`.

    within: the comparison's folder, and table: of its runs; None of one run. task: what all
    episodes are to do, in words; None: each its scenario's description. start_s: what t = 0 is
    [s since 1970]. tick: called after each frame.
    """

    runs: Iterator[RecordedRun]
    out: Path
    within: Path | None
    table: pl.DataFrame | None
    task: str | None
    start_s: float
    tick: Callable[[], None]

    def each(self, write: Callable[[RecordedRun, Path], object], suffix: str = "") -> None:
        """Write one run to `out`, or each of a comparison's at its place within `out`."""
        if self.within is None:
            write(next(self.runs), self.out)
        else:
            write_each(self.runs, self.out, self.within, suffix, write)


@dataclass(frozen=True)
class ExportFormat:
    """A format of `vstestbed export --to`, which apps add by `App.exports`.

    write: writes all that is asked for. suffix: of the file that a run becomes; "" of a folder.
    heeds: the options that say something to it, of `--start` and `--task`.
    """

    write: Callable[[ExportRequest], object]
    suffix: str = ""
    heeds: tuple[str, ...] = ()


# What the columns of a log are: their units, and who knows them.
Whose = Literal["clock", "measured", "command", "truth", "own"]
"""`clock`: times and counters; `measured`: what camera and robot know; `command`: what they
command; `truth`: the simulator's alone; `own`: of the robot's kind or the task.
"""

# Of a column: its unit ("" for numbers without one), who knows it, and in words
Meaning = tuple[str, Whose, str]

_SUFFIXES = {
    "px": "px",
    "m": "m",
    "mm": "mm",
    "rad": "rad",
    "deg": "deg",
    "s": "s",
    "mps": "m/s",
    "radps": "rad/s",
    "n": "N",
    "nm": "Nm",
}
"""Unit by the last part of a name, for columns of plugins."""
IN_NAMES = {"m/s": "mps", "rad/s": "radps", "grey levels": "grey"}  # Units as parts of names


def meaning(column: str, scenario: Scenario) -> Meaning:
    """What a column of a scenario's log is."""
    kind, _, joint = column.partition("_")
    if kind in ("q", "qd") and joint in scenario.robot.joints:
        unit = unit_of_joint(joint, scenario) + ("/s" if kind == "qd" else "")
        return unit, "truth", "velocity of a joint" if kind == "qd" else "position of a joint"
    if (text := text_of(column)) is not None:
        return text.unit, cast(Whose, text.whose), text.words
    return (
        _SUFFIXES.get(column.rpartition("_")[2], ""),
        "own",
        "of the robot's kind, or of the task",
    )


def unit_of_joint(joint: str, scenario: Scenario) -> str:
    """rad, or m for a joint that slides."""
    chain = getattr(scenario.robot, "chain", None)  # of an arm read from a file
    slides = (
        ()
        if chain is None
        else [name for name, slide in zip(chain.names, chain.slides, strict=True) if slide]
    )
    return "m" if joint in (*slides, "root_x", "root_y") else "rad"


def name_with_unit(name: str, unit: str) -> str:
    """A name that ends with its unit, of letters, digits and underscores alone, and no digit first:
    `vx_mps`.
    """
    word = IN_NAMES.get(unit, unit)
    plain = re.sub(r"^(?=\d)|\W", "_", name)
    return plain if not word or plain.endswith(f"_{word}") else f"{plain}_{word}"
