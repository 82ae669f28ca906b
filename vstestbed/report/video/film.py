"""The films of a run: the servo camera's view with markers drawn in, and the scene from outside."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from vstestbed.core.files import write_whole
from vstestbed.core.geometry import Array, pose_from
from vstestbed.core.outcome import Outcome, Verdict
from vstestbed.loop.columns import POSE
from vstestbed.loop.recording import Rows
from vstestbed.report.video.overlay import Overlay, draw_caption
from vstestbed.report.video.quality import Pace, Quality
from vstestbed.report.video.writer import Image, VideoWriter
from vstestbed.scenario.scenario import Scenario
from vstestbed.sim.replay import Replay
from vstestbed.tasks.frame import Frame

HOLD_S = 1.0
"""The last picture stays so long [s]."""


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
    """A film of a run from one camera, in real time.

    Args:
        scenario: the experiment.
        camera: `eye`, `overview`, or another camera of the scene.
        path: the file (`.mp4`).
        replay: renders the images that the run itself did not.
        quality: the film's rate, and its size by default.
        size: (width, height) [px].
    """

    def __init__(self, scenario: Scenario, camera: str, path: Path, replay: Replay, quality: Quality, size: tuple[int, int] | None = None):
        self._camera, self._replay = camera, replay
        eye = scenario.camera
        self._size = size or (quality.eye_size(eye.width, eye.height) if camera == "eye" else quality.size)
        self._title = scenario.name or scenario.law.kind
        self._overlay = Overlay(eye.width, eye.height, scenario.target.colors, title=self._title)
        every = quality.every(eye.rate_hz)
        self._pace = Pace(eye.rate_hz, every)
        self._rate_hz = eye.rate_hz / every
        self._writer = VideoWriter(path, self._rate_hz)
        self._image: Image | None = None
        self.spent_s = 0.0

    def show(self, frame: FilmFrame) -> None:
        """Film one frame. While the camera gave no pictures, the last one stands."""
        began = time.perf_counter()
        self._hold(self._pace.place(frame.t) - self.frames)
        self._image = self._drawn(frame)
        self._writer.write(self._image)
        self.spent_s += time.perf_counter() - began

    @property
    def frames(self) -> int:
        """Number of its pictures so far."""
        return self._writer.frames

    def _drawn(self, frame: FilmFrame) -> Image:
        """The picture of a frame."""
        width, height = self._size
        if self._camera != "eye":
            image = self._picture(frame, width, height)
            draw_caption(image, self._title, t=frame.t, error_px=frame.error_px)
            return image
        image = frame.image if frame.image is not None else _scaled(self._picture(frame, width, height), self._overlay.size)
        self._overlay.draw(image, frame.uv, frame.goal_uv, t=frame.t, error_px=frame.error_px, lost=frame.lost)
        return _scaled(image, self._size)  # only now: the overlay is in the camera's pixels

    def _picture(self, m: FilmFrame, width: int, height: int) -> Image:
        return self._replay.picture(self._camera, width, height, m.t, m.T_world_target, m.q, m.T_world_camera)

    def _hold(self, pictures: int) -> None:
        """Let the last picture stand for so many more."""
        if self._image is not None:
            for _ in range(pictures):
                self._writer.write(self._image)

    def end(self, outcome: Outcome, reason: str) -> None:
        """Let the last picture stand for a second: how the run ended, and why."""
        self._hold(round(HOLD_S * self._rate_hz))

    def close(self) -> Path | None:
        """Finish the film; None if it has no frame."""
        return self._writer.close()

    def abort(self) -> None:
        """Discard the film, unless it is finished."""
        self._writer.abort()


def _scaled(image: Image, size: tuple[int, int]) -> Image:
    """The image at a size (width, height); itself if it has that size."""
    if image.shape[1::-1] == size:
        return image
    # the mean of pixels where they become fewer, as INTER_AREA has it; it would show blocks where they become more
    way = cv2.INTER_AREA if image.shape[1] > size[0] else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(image, size, interpolation=way), np.uint8)


def replay_of(scenario: Scenario, quality: Quality) -> Replay:
    """A replay of the scene of a scenario."""
    parts = scenario.robot, scenario.camera, scenario.target, scenario.world
    return Replay(*parts, quality.shadows, scenario.sights, quality.samples, quality.thin)


@contextmanager
def open_films(scenario: Scenario, paths: dict[str, Path], quality: Quality, size: tuple[int, int] | None = None) -> Iterator[list[Film]]:
    """Films of a run from cameras of its scene; they are finished at the end, and discarded on an exception.

    Args:
        scenario: the experiment.
        paths: the films by the names of their cameras.
        quality, size: see `Film`.
    """
    replay = replay_of(scenario, quality)
    films = [Film(scenario, camera, path, replay, quality, size) for camera, path in paths.items()]
    try:
        yield films
        for film in films:
            film.close()
    finally:
        for film in films:
            film.abort()
        replay.close()


def rows_of(log: Rows) -> Iterator[dict[str, float]]:
    """The rows of a log one by one."""
    for block in log.blocks():
        for values in zip(*block.values(), strict=True):
            yield dict(zip(block, map(float, values), strict=True))


def film_log(
    scenario: Scenario,
    log: Rows,
    camera: str,
    path: Path,
    quality: Quality,
    size: tuple[int, int] | None = None,
    ending: Verdict | None = None,
) -> Path | None:
    """Film a recorded run from any camera, without simulating; ending: its outcome, shown at the end.

    Raises:
        ParameterError: no such camera. EnvironmentLackError: no OpenGL, no codec, no space.
    """
    pace = Pace(scenario.camera.rate_hz, quality.every(scenario.camera.rate_hz))
    with open_films(scenario, {camera: path}, quality, size) as (film,):
        last = len(log)
        for number, row in enumerate(rows_of(log), start=1):
            if pace.due(row["t"]) or number == last:
                film.show(FilmFrame.of_row(row, scenario.robot.joints, len(scenario.target.points)))
        if ending is not None:
            film.end(*ending)
    return path if film.frames else None


def picture_of_the_end(scenario: Scenario, log: Rows, path: Path, quality: Quality) -> None:
    """Write a PNG of the last frame of a recorded run, from outside.

    Raises:
        EnvironmentLackError: no OpenGL, no space. OutputError: the picture cannot be written.
    """
    (last,) = deque(rows_of(log), maxlen=1)
    m = FilmFrame.of_row(last, scenario.robot.joints, len(scenario.target.points))
    replay = replay_of(scenario, quality)
    try:
        image = replay.picture("overview", *quality.size, m.t, m.T_world_target, m.q, m.T_world_camera)
    finally:
        replay.close()
    draw_caption(image, scenario.name or scenario.law.kind, t=m.t, error_px=m.error_px)
    write_whole(path, cv2.imencode(".png", cv2.cvtColor(image, cv2.COLOR_RGB2BGR))[1].tobytes())
