"""The two films of a run: what the camera sees with markers drawn in, and the scene from outside."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np

from vstestbed.core.geometry import Array, pose_from
from vstestbed.loop.columns import POSE
from vstestbed.report.video.overlay import Overlay, draw_caption
from vstestbed.report.video.writer import Image, VideoWriter
from vstestbed.scenario.scenario import Scenario
from vstestbed.sim.replay import Replay
from vstestbed.tasks.frame import Frame

if TYPE_CHECKING:
    import polars

OVERVIEW_SIZE = (960, 540)


@dataclass(frozen=True, slots=True)
class Moment:
    """What a film shows of one frame; `image` is the servo camera's picture where there is one already."""

    t: float
    T_world_target: Array
    T_world_camera: Array
    q: Array
    uv: Array
    error_px: float
    lost: bool
    goal_uv: Array
    image: Image | None = None

    @classmethod
    def of_frame(cls, frame: Frame) -> Moment:
        """The moment of a frame."""
        truth, seen, error = frame.truth, frame.observation, frame.error
        return cls(
            seen.t, truth.T_world_target, truth.T_world_camera, truth.q, seen.uv, error.rms_px, error.lost, frame.goal.uv, frame.image
        )

    @classmethod
    def of_row(cls, row: dict[str, float], joints: tuple[str, ...], markers: int) -> Moment:
        """The moment that one row of a log tells of."""
        camera, target = (np.array([row[f"{who}_{name}"] for name in POSE]) for who in ("cam", "tgt"))
        return cls(
            t=row["t"],
            T_world_target=pose_from(target[:3], target[3:]),
            T_world_camera=pose_from(camera[:3], camera[3:]),
            q=np.array([row[f"q_{name}"] for name in joints]),
            uv=np.array([[row[f"u_{i}"], row[f"v_{i}"]] for i in range(markers)]),
            error_px=row["error_px"],
            lost=bool(row["lost"]),
            goal_uv=np.array([[row[f"u_goal_{i}"], row[f"v_goal_{i}"]] for i in range(markers)]),
        )


class Film:
    """A film from one camera of a run, one frame a moment.

    Args:
        scenario: the experiment.
        camera: `eye`, `overview`, or another camera of the scene.
        path: where the film goes (`.mp4`).
        replay: takes the pictures that the run itself did not.
        size: (width, height) [px]; default 960 x 540, for the servo camera its own.
    """

    def __init__(self, scenario: Scenario, camera: str, path: Path, replay: Replay, size: tuple[int, int] | None = None):
        self._camera, self._replay, self._size = camera, replay, size
        self._title = scenario.name or scenario.law.kind
        self._overlay = Overlay(scenario.camera.width, scenario.camera.height, scenario.target.colors, title=self._title)
        self._writer = VideoWriter(path, scenario.camera.rate_hz)
        self.spent_s = 0.0

    def frame(self, frame: Frame) -> None:
        """Film a frame while the run goes."""
        self.show(Moment.of_frame(frame))

    def show(self, moment: Moment) -> None:
        """Film one moment."""
        began = time.perf_counter()
        width, height = self._size or OVERVIEW_SIZE
        if self._camera == "eye":
            image = np.array(moment.image) if moment.image is not None else self._picture(moment, width, height)
            self._overlay.draw(image, moment.uv, moment.goal_uv, t=moment.t, error_px=moment.error_px, lost=moment.lost)
            if self._size is not None:
                image = np.asarray(cv2.resize(image, self._size, interpolation=cv2.INTER_AREA), np.uint8)
        else:
            image = self._picture(moment, width, height)
            draw_caption(image, self._title, t=moment.t, error_px=moment.error_px)
        self._writer.write(image)
        self.spent_s += time.perf_counter() - began

    def _picture(self, m: Moment, width: int, height: int) -> Image:
        return self._replay.picture(self._camera, width, height, m.t, m.T_world_target, m.q, m.T_world_camera)

    def close(self) -> Path | None:
        """Finish the film; None where it has no frame."""
        return self._writer.close()

    def abort(self) -> None:
        """Leave no film."""
        self._writer.abort()


def replay_of(scenario: Scenario, shadows: bool = True) -> Replay:
    """A replay of a scenario's scene."""
    return Replay(scenario.robot, scenario.camera, scenario.target, scenario.world, shadows, scenario.sights)


def film_log(scenario: Scenario, log: polars.DataFrame, camera: str, path: Path, size: tuple[int, int] | None = None) -> Path | None:
    """A film of a recorded run from any camera, without simulating.

    Raises:
        ParameterError: no such camera. EnvironmentLackError: no OpenGL, no codec, no space.
    """
    replay = replay_of(scenario)
    film = Film(scenario, camera, path, replay, size)
    try:
        for row in log.iter_rows(named=True):
            film.show(Moment.of_row(row, scenario.robot.joints, len(scenario.target.points)))
        return film.close()
    except BaseException:
        film.abort()
        raise
    finally:
        replay.close()


def picture_of_the_end(scenario: Scenario, log: polars.DataFrame, path: Path, size: tuple[int, int] = (480, 270)) -> None:
    """A PNG of the last frame of a recorded run, from outside.

    Raises:
        EnvironmentLackError: no OpenGL.
    """
    m = Moment.of_row(log.row(-1, named=True), scenario.robot.joints, len(scenario.target.points))
    replay = replay_of(scenario)
    try:
        image = replay.picture("overview", *size, m.t, m.T_world_target, m.q, m.T_world_camera)
    finally:
        replay.close()
    draw_caption(image, scenario.name or scenario.law.kind, t=m.t, error_px=m.error_px)
    path.write_bytes(cv2.imencode(".png", cv2.cvtColor(image, cv2.COLOR_RGB2BGR))[1].tobytes())
