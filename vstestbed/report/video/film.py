"""The films of a run: the servo camera's view with markers drawn in, and the scene from outside."""

from __future__ import annotations

import functools
import logging
import math
import queue
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, closing, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from vstestbed.camera import Camera
from vstestbed.core.files import write_whole
from vstestbed.core.geometry import inverse
from vstestbed.core.outcome import Outcome, Verdict
from vstestbed.imaging.chain import scaled
from vstestbed.loop.log_file import Log
from vstestbed.loop.recording import read_summary
from vstestbed.report.video.outside import Outside, inset_share
from vstestbed.report.video.overlay import (
    ALARM,
    GOOD,
    HOLD_S,
    FilmFrame,
    Overlay,
    Residual,
    captioned,
    draw_ending,
    named,
    overlay_of,
    strip_height,
)
from vstestbed.report.video.writer import Image, VideoWriter, png_of
from vstestbed.scenario.cameras import OtherCamera
from vstestbed.scenario.scenario import Scenario
from vstestbed.sim.render.pictures import draws_rays
from vstestbed.sim.replay import Replay
from vstestbed.sim.scene.follow import FixedView
from vstestbed.tasks.frame import Frame
from vstestbed.tasks.judged import in_a_frame, in_words_unit

__all__ = [
    "FINE",
    "FilmThread",
    "Pace",
    "Pictures",
    "ending_of",
    "film_log",
    "open_films",
    "picture_of_the_end",
    "quality_of",
    "replay_of",
    "rows_of",
]

# How films are drawn: quick drafts beside a run, or fine films; how large, and which frames they
# show.


@dataclass(frozen=True, slots=True)
class Quality:
    """How films are drawn."""

    size: tuple[int, int]  # (width, height) of the film from outside [px]
    longest: int  # the servo camera's film is scaled down to this side [px]
    samples: int  # multisampling of the view from outside
    shadows: bool  # draw them there
    most_hz: float  # most pictures a second of simulated time [Hz]

    def every(self, rate_hz: float) -> int:
        """Every how many frames of a camera the film has a picture."""
        return max(1, math.ceil(rate_hz / self.most_hz - 1e-9))

    def share(self, width: int, height: int) -> float:
        """Size of the servo camera's film as a share of its image's [px]."""
        return min(1.0, self.longest / max(width, height))


DRAFT = Quality((640, 360), longest=1280, samples=0, shadows=False, most_hz=15.0)
FINE = Quality((1280, 720), longest=4320, samples=4, shadows=True, most_hz=math.inf)
# Without OpenGL a picture takes some twenty times as long
RAYS = Quality((320, 180), longest=320, samples=0, shadows=False, most_hz=5.0)


def quality_of(scenario: Scenario, fine: bool = False) -> Quality:
    """The quality of a scenario's films: a draft, or fine films; small ones where rays draw them,
    with a warning that says so.
    """
    if fine:
        return FINE
    if not draws_rays(scenario.camera):
        return DRAFT
    _warn_once()
    return RAYS


@functools.cache
def _warn_once() -> None:
    words = (
        "films by rays are small, %d x %d from outside with %g pictures a second;"
        " --fine makes large ones, which takes long"
    )
    logging.getLogger("vstestbed").warning(words, *RAYS.size, RAYS.most_hz)


class Pace:
    """Which of a camera's frames a film shows: each that is the first one since the last picture
    was due.
    """

    def __init__(self, rate_hz: float, every: int):
        self._rate_hz, self._every = rate_hz, every
        self._began: float | None = None
        self._last = -1

    def place(self, t: float) -> int:
        """Number of the film's picture that shows time t [s], counted from the first frame's."""
        self._began = t if self._began is None else self._began
        return round((t - self._began) * self._rate_hz) // self._every

    def due(self, t: float) -> bool:
        """Whether the frame at t [s] is to be shown; to be called once for each frame, in their
        order.
        """
        before, self._last = self._last, self.place(t)
        return self._last > before


class Pictures:
    """The pictures of a run from one camera (`eye`, `overview`, ...), with what explains them;
    asked for each frame in turn.

    Beside the servo camera's pictures stand those of the further cameras, or below them where the
    whole is higher than wide.

    size: (width, height) of a picture [px]. strip: height of the line of numbers below it [px];
    None: as its height asks for.
    """

    def __init__(
        self,
        scenario: Scenario,
        camera: str,
        replay: Replay,
        size: tuple[int, int],
        strip: int | None = None,
    ):
        self._scenario = scenario
        self._camera = camera
        self._replay = replay
        eyes = scenario.eyes if camera == "eye" else {}
        self._below = size[1] > size[0] and len(eyes) > 0
        self._size, *others = panels(
            size, [scenario.camera, *(eye.camera for eye in eyes.values())], self._below
        )
        self._others = [
            OtherPanel(eye, panel) for eye, panel in zip(eyes.values(), others, strict=True)
        ]
        self._alone = OtherPanel(scenario.eyes[camera], size) if camera in scenario.eyes else None
        size = self._size
        self.strip = strip_height(size[1]) if strip is None else strip
        self._title = " \u00b7 ".join(filter(None, (scenario.name, scenario.law.kind)))
        self._overlay = overlay_of(scenario, size)
        self._scale = np.array(size) / (scenario.camera.width, scenario.camera.height)
        self._residual = Residual(scenario, replay) if "image" in scenario.law.inputs else None
        self._outside = Outside(scenario, replay, camera, size) if camera == "overview" else None

    @classmethod
    def within(
        cls, scenario: Scenario, camera: str, replay: Replay, size: tuple[int, int]
    ) -> Pictures:
        """Pictures that have this size (width, height) with their line of numbers [px]."""
        strip = strip_height(size[1])
        return cls(scenario, camera, replay, (size[0], size[1] - strip), strip)

    def picture(self, frame: FilmFrame) -> Image:
        """The picture of one frame (H, W, 3) with its line of numbers."""
        values = dict(zip(self._scenario.own_columns, frame.own.tolist(), strict=True))
        values["error_px"] = frame.error_px
        image = self._drawn(frame, int(values.get("view", 0)))
        error = error_in_words(self._scenario, values)
        return captioned(image, self._title, self.strip, t=frame.t, error=error)

    def _drawn(self, frame: FilmFrame, goal: int) -> Image:
        if self._camera == "eye":
            return self._of_eye(frame, goal)
        if self._alone is not None:
            return self._alone.drawn(frame, self._replay)
        if self._outside is not None:
            return self._of_outside(self._outside, frame, goal)
        return self._rendered(self._camera, frame)

    def _of_eye(self, frame: FilmFrame, goal: int) -> Image:
        taken = self._taken(frame)
        seen = self._rendered("eye", frame) if taken is None else taken
        # a copy: the detector and other films use it
        image = np.array(scaled(seen, self._size))
        uv, goal_uv = ((uv + 0.5) * self._scale - 0.5 for uv in (frame.uv, frame.goal_uv))
        self._overlay.draw(image, uv, goal_uv, frame.lost)
        if self._residual is not None:
            self._residual.put(image, seen, frame, goal)
        parts = [image, *(other.drawn(frame, self._replay) for other in self._others)]
        return np.concatenate(parts, axis=0 if self._below else 1) if self._others else image

    def _of_outside(self, outside: Outside, frame: FilmFrame, goal: int) -> Image:
        T = self._scenario.goal_pose_at(frame.t, goal)
        T_world_goal = None if T is None else frame.T_world_target @ inverse(T)
        image = outside.picture(frame, T_world_goal)
        taken = self._taken(frame)
        outside.put_inset(image, frame, taken, lambda: self._rendered("eye", frame))
        return image

    def _taken(self, frame: FilmFrame) -> Image | None:
        """The servo camera's image, if it has been rendered for the run or for another film."""
        return self._replay.seen(frame.t) if frame.image is None else frame.image

    def _rendered(self, camera: str, m: FilmFrame) -> Image:
        return self._replay.picture(camera, self._size, m.state)


def panels(
    size: tuple[int, int], cameras: Sequence[Camera], below: bool = False
) -> list[tuple[int, int]]:
    """Sizes (width, height) of the pictures of several cameras beside, or below, one another that
    fill a size [px].
    """
    shares = np.array(
        [
            camera.height / camera.width if below else camera.width / camera.height
            for camera in cameras
        ]
    )
    along = size[1] if below else size[0]
    ends = np.rint(np.cumsum(shares) / shares.sum() * along).astype(int).tolist()
    lengths = [end - begin for begin, end in zip([0, *ends[:-1]], ends, strict=True)]
    return [(size[0], length) if below else (length, size[1]) for length in lengths]


class OtherPanel:
    """The part of a film that shows a further camera. size: (width, height) [px]."""

    def __init__(self, eye: OtherCamera, size: tuple[int, int]):
        self._eye, self._size = eye, size
        self._overlay = Overlay(
            *size, eye.target.colors[: len(eye.target.points)], eye.target.outlined
        )
        self._scale = np.array(size) / (eye.camera.width, eye.camera.height)

    def drawn(self, frame: FilmFrame, replay: Replay) -> Image:
        """Its picture at a frame, with its markers and its name; black before its first one."""
        shown = frame.cameras.get(self._eye.name)
        if shown is None:
            return np.zeros((self._size[1], self._size[0], 3), np.uint8)
        image = shown.image
        if image is None:
            image = replay.picture(self._eye.name, self._size, frame.state)
        image = np.array(scaled(image, self._size))
        uv, goal_uv = ((uv + 0.5) * self._scale - 0.5 for uv in (shown.uv, shown.goal_uv))
        self._overlay.draw(image, uv, goal_uv)
        named(image, self._eye.name)
        return image


class Film:
    """A film (`.mp4`) of a run from one camera, in real time; the quality gives its rate.

    size: (width, height) of the film with its line of numbers [px]; by default the quality's, or of
    the servo camera's film the camera's with the line below.
    """

    def __init__(
        self,
        scenario: Scenario,
        camera: str,
        path: Path,
        replay: Replay,
        quality: Quality,
        size: tuple[int, int] | None = None,
    ):
        eye = scenario.camera
        share = quality.share(eye.width, eye.height)
        if size is not None or camera not in ("eye", *scenario.eyes):
            self._pictures = Pictures.within(scenario, camera, replay, size or quality.size)
        else:
            own = eye if camera == "eye" else scenario.eyes[camera].camera
            width = round(share * own.width)
            height = round(share * own.height)
            if camera == "eye":  # the pictures of the further cameras stand beside
                for other in scenario.eyes.values():
                    width += round(height * other.camera.width / other.camera.height)
            self._pictures = Pictures(scenario, camera, replay, (width, height))
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
        self._image = self._pictures.picture(frame)
        self._writer.write(self._image)
        self.spent_s += time.perf_counter() - began

    @property
    def frames(self) -> int:
        """Number of its pictures so far."""
        return self._writer.frames

    def _hold(self, pictures: int) -> None:
        """Let the last picture stand for so many more."""
        if self._image is not None:
            for _ in range(pictures):
                self._writer.write(self._image)

    def end(self, outcome: Outcome, reason: str) -> None:
        """Let the last picture stand for a second: how the run ended, and why."""
        if self._image is not None:
            words = outcome.value.capitalize()
            color = GOOD if outcome.success else ALARM
            draw_ending(self._image, self._pictures.strip, words, reason, color)
        self._hold(round(HOLD_S * self._rate_hz))

    def close(self) -> Path | None:
        """Finish the film; None if it has no frame."""
        return self._writer.close()

    def abort(self) -> None:
        """Discard the film, unless it is finished."""
        self._writer.abort()


def error_in_words(scenario: Scenario, values: dict[str, float]) -> str:
    """The error of one frame by which the task is judged, in its own unit."""
    judged = in_a_frame(scenario.goal.judged, scenario.stop, values)
    value, unit = in_words_unit(judged.value, judged.unit)
    if not math.isfinite(value):
        return "error \u2013"
    digits = 3 if unit.startswith("m") else 2
    return f"error {value:.{digits}f} {unit}"


def ending_of(folder: Path) -> Verdict | None:
    """How the run of a folder ended; None where it has no summary. RunFolderError: the summary is
    damaged.
    """
    if not (folder / "summary.json").is_file():
        return None
    summary = read_summary(folder, "run the scenario again")
    return Outcome[summary["outcome"]], summary.get("reason", "")


def replay_of(
    scenario: Scenario,
    quality: Quality,
    inset_in: tuple[int, int] | None = None,
    view: FixedView | None = None,
) -> Replay:
    """A replay of the scene; inset_in: size of a picture in whose inset alone the servo camera's
    drafts are shown, drawn as small. view: of the camera outside; None: it follows the robot.
    """
    share = quality.share(scenario.camera.width, scenario.camera.height)
    if inset_in is not None and quality.longest < FINE.longest:
        share = min(share, inset_share(scenario.camera, inset_in))
    return Replay(scenario.scene, quality.shadows, quality.samples, share, view)


@contextmanager
def open_films(
    scenario: Scenario,
    paths: dict[str, Path],
    quality: Quality,
    size: tuple[int, int] | None = None,
    view: FixedView | None = None,
) -> Iterator[list[Film]]:
    """Films of a run by the names of their cameras; they are finished at the end, and discarded on
    an exception.
    """
    # without a film of its own the servo camera is in an inset alone
    own = not {"eye", *scenario.eyes}.isdisjoint(paths)
    replay = replay_of(scenario, quality, None if own else size or quality.size, view)
    films = [Film(scenario, camera, path, replay, quality, size) for camera, path in paths.items()]
    try:
        yield films
        for film in films:
            film.close()
    finally:
        for film in films:
            film.abort()
        replay.close()


def rows_of(log: Log) -> Iterator[dict[str, float]]:
    """The rows of a log one by one."""
    for row in log.table:
        yield dict(zip(log.columns, row.tolist(), strict=True))


@dataclass(frozen=True, slots=True)
class FilmView:
    """What a film of a recorded run shows."""

    camera: str  # by its name
    view: FixedView | None = None  # of the camera `overview`; None: it follows the robot
    size: tuple[int, int] | None = None  # see `Film`


def film_log(
    scenario: Scenario,
    log: Log,
    shot: FilmView,
    path: Path,
    quality: Quality,
    ending: Verdict | None = None,
) -> Path | None:
    """Film a recorded run from any camera, without simulating; ending: its outcome, shown at the
    end.

    ParameterError: no such camera. EnvironmentLackError: no OpenGL, no codec, no space.
    """
    pace = Pace(scenario.camera.rate_hz, quality.every(scenario.camera.rate_hz))
    with open_films(scenario, {shot.camera: path}, quality, shot.size, shot.view) as (film,):
        last = len(log)
        for number, row in enumerate(rows_of(log), start=1):
            if pace.due(row["t"]) or number == last:
                film.show(FilmFrame.of_row(row, scenario))
        if ending is not None:
            film.end(*ending)
    return path if film.frames else None


def picture_of_the_end(scenario: Scenario, log: Log, path: Path, quality: Quality) -> None:
    """Write a PNG of the last frame of a recorded run, from outside. EnvironmentLackError: no
    OpenGL, no space.
    """
    last = FilmFrame.of_row(dict(zip(log.columns, log.table[-1].tolist(), strict=True)), scenario)
    with closing(replay_of(scenario, quality, quality.size)) as replay:
        pictures = Pictures.within(scenario, "overview", replay, quality.size)
        write_whole(path, png_of(pictures.picture(last)))


# Films a run while it goes on: what the loop hands over is drawn and encoded by a thread of its
# own.

# Most frames that wait to be drawn: two seconds of simulated time, 30 MB of pictures of 640 x 480
WAITING = 32


class FilmThread:
    """Films a run beside it (a Watcher); `opened` opens the films and finishes or discards them,
    `pace` says which frames are shown.

    The state of each frame that the films show goes into a bounded queue, from which a thread takes
    it. The run waits while the queue is full, and computes the same numbers as without films. As
    all pictures by OpenGL are drawn in turn by the process's one rendering thread, the run's own
    pictures wait for at most one of a film. An error of the films is raised by `frame` or `close`.
    """

    def __init__(self, opened: Callable[[], AbstractContextManager[Sequence[Film]]], pace: Pace):
        self._opened, self._pace = opened, pace
        self._queue: queue.Queue[FilmFrame | None] = queue.Queue(WAITING)
        self._unshown: Frame | None = None
        self._error: BaseException | None = None
        self._aborted = False
        self._ending: Verdict | None = None
        self.spent_s = 0.0
        self._thread = threading.Thread(target=self._work, name="vstestbed films", daemon=True)
        self._thread.start()

    def frame(self, frame: Frame) -> None:
        """Hand over a frame of a running loop, if the films show it."""
        if self._error is not None:
            raise self._error
        if self._pace.due(frame.t):
            self._hand_over(frame)
        else:
            self._unshown = frame

    def close(self, ending: Verdict | None) -> None:
        """Finish the films, which end with the run's last frame; `ending`: its outcome, which they
        show.
        """
        if self._unshown is not None:
            self._hand_over(self._unshown)
        self._ending = ending
        self._queue.put(None)
        self._thread.join()
        if self._error is not None:
            raise self._error

    def abort(self) -> None:
        """Discard the films. Harmless after `close`."""
        self._aborted = True
        if self._thread.is_alive():
            self._queue.put(None)
            self._thread.join()

    def _hand_over(self, frame: Frame) -> None:
        self._unshown = None
        state = FilmFrame.of_frame(frame)
        if state.image is not None:
            # a copy: the next frame's image may overwrite it, and the overlay is drawn into it
            state = replace(state, image=np.array(state.image))
        self._queue.put(state)

    def _work(self) -> None:
        frames = iter(self._queue.get, None)
        try:
            with self._opened() as films:
                for frame in frames:
                    for film in films if not self._aborted else ():
                        film.show(frame)
                for film in films:
                    if self._aborted:
                        film.abort()
                    elif self._ending is not None:
                        film.end(*self._ending)
            self.spent_s = sum(film.spent_s for film in films)
        except BaseException as error:  # belongs to the thread of the loop
            self._error = error
            for _ in frames:  # to the end, or the loop would wait for room in the queue
                pass
