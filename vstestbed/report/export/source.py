"""A recorded run as exports read it: scenario, log, summary, and the servo camera's pictures, taken again one by one."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from vstestbed.camera import Image
from vstestbed.core.errors import NOTHING_RAN, RunFolderError
from vstestbed.core.geometry import Array
from vstestbed.loop.log_file import FolderLog, open_log
from vstestbed.loop.summary_file import read_summary
from vstestbed.report.video.film import rows_of
from vstestbed.report.video.film_frame import FilmFrame
from vstestbed.scenario.load import load
from vstestbed.scenario.scenario import Scenario
from vstestbed.scenario.streams import IMAGE_STREAM, IMAGING_STREAM
from vstestbed.sim.retake import Retake


class Bodies(NamedTuple):
    """The scene's bodies: their names, places (B, 3) [m] and quaternions (B, 4), wxyz, in the world."""

    names: list[str]
    places: Array
    quaternions: Array


class Taken(NamedTuple):
    """One frame of a recorded run.

    Attributes:
        row: of the log. state: the same as a film has it. picture: (H, W, 3) uint8 RGB. bodies: valid until the next frame.
    """

    row: dict[str, float]
    state: FilmFrame
    picture: Image
    bodies: Bodies


@dataclass(frozen=True)
class RecordedRun:
    """A run's folder.

    Attributes:
        folder: of the run. scenario: with its start and its noise. log: on disk. summary: as written; None of a run that was cut off.
    """

    folder: Path
    scenario: Scenario
    log: FolderLog
    summary: dict[str, Any] | None

    @classmethod
    def of(cls, folder: Path, plugins: Sequence[str] = ()) -> RecordedRun:
        """Read a run's folder; plugins: as of `load`.

        Raises:
            RunFolderError: it has no run, a damaged one, or one without a frame. ScenarioError: its scenario cannot be read.
        """
        if not (folder / "scenario.yaml").is_file():
            raise RunFolderError(folder, "no run here" if folder.is_dir() else "no such folder")
        scenario = load(folder / "scenario.yaml", plugins=plugins)
        log = open_log(folder, scenario)
        summary = read_summary(folder, "run the scenario again") if (folder / "summary.json").is_file() else None
        if not len(log):
            raise RunFolderError(folder, "has a log without frames; there is nothing to export", NOTHING_RAN)
        return cls(folder, scenario, log, summary)

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
            changed = [name for name in ("optics", "exposure", "sensor", "stream") if getattr(camera, name) is not None]
            words.append(f"through the camera's {' and '.join(changed)}")
        light = self.scenario.world.light
        left_out = {
            f"the motion blur of its {timing.first_s(camera):g} s exposure": timing.first_s(camera) > 0,
            f"the skew of its rolling shutter of {camera.readout_s:g} s": camera.readout_s > 0,
            "the flicker of its light": light is not None and light.flicker.depth > 0,
        }
        words += [f"without {what}" for what, there in left_out.items() if there]
        return ", ".join(words)

    def frames(self) -> Iterator[Taken]:
        """The frames in their order, each with its picture drawn anew.

        Raises:
            EnvironmentLackError: it cannot be drawn here.
        """
        s = self.scenario
        noise = s.noise
        scene = (s.robot, s.camera, s.target_in_run, s.world)
        with closing(Retake(*scene, noise.image_sigma, s.rng(IMAGE_STREAM), noise.drift, s.rng(IMAGING_STREAM))) as retake:
            names = retake.body_names
            for row in rows_of(self.log):
                state = FilmFrame.of_row(row, s)
                picture = retake.picture(state.t, state.T_world_target, state.q, state.T_world_camera)
                yield Taken(row, state, picture, Bodies(names, *retake.body_poses))


def opened(folders: Iterable[Path], plugins: Sequence[str] = ()) -> Iterator[RecordedRun]:
    """The runs of folders, one at a time."""
    for folder in folders:
        yield RecordedRun.of(folder, plugins)
