"""The films of a run: the servo camera's view with markers drawn in, and the scene from outside."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from vstestbed.core.files import write_whole
from vstestbed.core.geometry import Array, pose_from
from vstestbed.loop.columns import POSE
from vstestbed.loop.recording import Rows
from vstestbed.report.video.overlay import Overlay, draw_caption
from vstestbed.report.video.writer import Image, VideoWriter
from vstestbed.scenario.scenario import Scenario
from vstestbed.sim.replay import Replay
from vstestbed.tasks.frame import Frame

OVERVIEW_SIZE = (960, 540)


@dataclass(frozen=True, slots=True)
class FilmFrame:
    """State of one frame as a film shows it; `image`: the servo camera's image, if it was rendered already."""

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
    def of_frame(cls, frame: Frame) -> FilmFrame:
        """A frame of a running loop."""
        truth, error = frame.truth, frame.error
        scene = (truth.T_world_target, truth.T_world_camera, truth.q)
        return cls(frame.t, *scene, frame.observation.uv, error.rms_px, error.lost, frame.goal.uv, frame.image)

    @classmethod
    def of_row(cls, row: dict[str, float], joints: tuple[str, ...], markers: int) -> FilmFrame:
        """The frame of one row of a log."""
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
    """A film of a run from one camera, one film frame per camera frame.

    Args:
        scenario: the experiment.
        camera: `eye`, `overview`, or another camera of the scene.
        path: the file (`.mp4`).
        replay: renders the images that the run itself did not.
        size: (width, height) [px]; by default 960 x 540, for the servo camera its image size.
    """

    def __init__(self, scenario: Scenario, camera: str, path: Path, replay: Replay, size: tuple[int, int] | None = None):
        self._camera, self._replay, self._size = camera, replay, size
        self._title = scenario.name or scenario.law.kind
        self._overlay = Overlay(scenario.camera.width, scenario.camera.height, scenario.target.colors, title=self._title)
        self._writer = VideoWriter(path, scenario.camera.rate_hz)
        self.spent_s = 0.0

    def frame(self, frame: Frame) -> None:
        """Film a frame of a running loop (a Watcher)."""
        self.show(FilmFrame.of_frame(frame))

    def show(self, frame: FilmFrame) -> None:
        """Film one frame."""
        began = time.perf_counter()
        width, height = self._size or OVERVIEW_SIZE
        if self._camera == "eye":
            # a copy: the overlay draws into it, and the detector's image must stay as it is
            image = np.array(frame.image) if frame.image is not None else self._picture(frame, width, height)
            self._overlay.draw(image, frame.uv, frame.goal_uv, t=frame.t, error_px=frame.error_px, lost=frame.lost)
            if self._size is not None:
                image = np.asarray(
                    cv2.resize(image, self._size, interpolation=cv2.INTER_AREA), np.uint8
                )  # drawn at the full size first: the overlay is in its pixels
        else:
            image = self._picture(frame, width, height)
            draw_caption(image, self._title, t=frame.t, error_px=frame.error_px)
        self._writer.write(image)
        self.spent_s += time.perf_counter() - began

    def _picture(self, m: FilmFrame, width: int, height: int) -> Image:
        return self._replay.picture(self._camera, width, height, m.t, m.T_world_target, m.q, m.T_world_camera)

    def close(self) -> Path | None:
        """Finish the film; None if it has no frame."""
        return self._writer.close()

    def abort(self) -> None:
        """Discard the film."""
        self._writer.abort()


def replay_of(scenario: Scenario, shadows: bool = True) -> Replay:
    """A replay of the scene of a scenario."""
    return Replay(scenario.robot, scenario.camera, scenario.target, scenario.world, shadows, scenario.sights)


def rows_of(log: Rows) -> Iterator[dict[str, float]]:
    """The rows of a log one by one."""
    for block in log.blocks():
        for values in zip(*block.values(), strict=True):
            yield dict(zip(block, map(float, values), strict=True))


def film_log(scenario: Scenario, log: Rows, camera: str, path: Path, size: tuple[int, int] | None = None) -> Path | None:
    """Film a recorded run from any camera, without simulating.

    Raises:
        ParameterError: no such camera. EnvironmentLackError: no OpenGL, no codec, no space.
    """
    replay = replay_of(scenario)
    film = Film(scenario, camera, path, replay, size)
    try:
        for row in rows_of(log):
            film.show(FilmFrame.of_row(row, scenario.robot.joints, len(scenario.target.points)))
        return film.close()
    except BaseException:
        film.abort()
        raise
    finally:
        replay.close()


def picture_of_the_end(scenario: Scenario, log: Rows, path: Path, size: tuple[int, int] = (480, 270)) -> None:
    """Write a PNG of the last frame of a recorded run, from outside.

    Raises:
        EnvironmentLackError: no OpenGL, no space. OutputError: the picture cannot be written.
    """
    (last,) = deque(rows_of(log), maxlen=1)
    m = FilmFrame.of_row(last, scenario.robot.joints, len(scenario.target.points))
    replay = replay_of(scenario)
    try:
        image = replay.picture("overview", *size, m.t, m.T_world_target, m.q, m.T_world_camera)
    finally:
        replay.close()
    draw_caption(image, scenario.name or scenario.law.kind, t=m.t, error_px=m.error_px)
    write_whole(path, cv2.imencode(".png", cv2.cvtColor(image, cv2.COLOR_RGB2BGR))[1].tobytes())
