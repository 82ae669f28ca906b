"""A run that goes on while it is looked at: a session, its settings, its pace. Nothing here knows of pages."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

import numpy as np

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array, inverse, transform
from vstestbed.live.settings import Settings
from vstestbed.live.transport import Sample, Transport
from vstestbed.loop.session import Session
from vstestbed.report.video.film_frame import FilmFrame
from vstestbed.scenario.scenario import Scenario
from vstestbed.tasks.frame import Frame
from vstestbed.tasks.judged import in_a_frame, in_words_unit

PLATE_RADII, LEAST_PLATE_M = 5.0, 0.06
"""Edge of the plate in reserve: so many radii of a marker, but at least so much [m]."""
PICTURE_S, REST = 1 / 15, 2.5
"""Least time on the wall between two whole pictures [s], and over the time that a frame with one took."""
NEAR_MARKER = 0.75
"""Where the plate is held, as a share of the way from the camera to the marker."""


class LiveRun:
    """A run that can be stopped, stepped, tuned and disturbed.

    Args:
        settings: the scenario, and what is changed of it.

    Attributes:
        transport: play, pause, step, speed. last: the last frame, as pages show it. frames: how many there were.
        restarts: counts the episodes. session: of the present one.
    """

    def __init__(self, settings: Settings):
        self.settings, self.transport = settings, Transport()
        self.restarts = self.frames = 0
        self._next_picture = 0.0
        self.session: Session
        self.last: Sample
        self.frame: Frame
        self.restart()

    @property
    def scenario(self) -> Scenario:
        """In force now."""
        return self.settings.scenario

    @property
    def ended(self) -> bool:
        """Whether the run has an outcome."""
        return self.frame.outcome is not None

    @property
    def by_hand(self) -> tuple[str, ...]:
        """What was changed by hand in this run, which its scenario does not repeat."""
        episode = self.session.episode
        return tuple(episode.by_hand) if episode else ()

    def restart(self) -> None:
        """Begin again, with the settings in force. A run that cannot begin leaves the one before as it is."""
        edge = max(LEAST_PLATE_M, PLATE_RADII * self.scenario.target.marker.radius)
        session = Session(self.scenario, pictures=True, plate_m=edge)
        frame = session.reset()
        if self.restarts:
            self.session.close()
        self.session, self.plate_m = session, edge
        self.restarts += 1
        self.frames = 0
        self.transport.begin()
        self._show(frame)

    def wait_s(self) -> float | None:
        """How long the next frame is not due [s]; None where none is to come: paused, or at the end."""
        return None if self.ended else self.transport.wait_s(self.frame.t)

    def turn(self) -> None:
        """One frame more; with a whole picture not more often than a page shows it, nor than the machine can."""
        began = time.monotonic()
        wanted = not self.transport.playing or began >= self._next_picture
        self.session.take_pictures(wanted)
        frame = self.session.step()
        if wanted:
            now = time.monotonic()
            self._next_picture = now + max(PICTURE_S, REST * (now - began))
        self._show(frame)

    def change(self, path: str, value: object) -> bool:
        """Change a setting, at once where the law alone changes and can, else with a new start; whether there was one.

        Raises:
            VstestbedError: the setting is refused; everything stays as it was.
        """
        before = self.settings.copy()
        now = self.settings.change(path, value)
        try:
            return self._put_in_force(before.scenario, now)
        except BaseException:
            self.settings = before
            raise

    def _put_in_force(self, before: Scenario, now: Scenario) -> bool:
        if now == before:
            return False
        if not self.ended and replace(now, law=before.law) == before and self._retuned(now.law):
            return False
        self.restart()
        return True

    def _retuned(self, law: Any) -> bool:
        try:
            self.session.retune(law)
        except ParameterError:  # of another kind or feature: its memory begins anew
            return False
        return True

    def push(self, force: Array, duration_s: float) -> None:
        """Push the robot; ParameterError where it has no mass."""
        self._goes_on()
        self.session.push(force, duration_s)

    def move_target(self, T_world_target: Array) -> None:
        """Put the target at a pose (4, 4); ParameterError where it is carried."""
        self._goes_on()
        self.session.move_target(T_world_target)

    def check_target_free(self) -> None:
        """ParameterError where the target is carried, so that nobody else can move it."""
        target = self.scenario.target
        if target.on_gripper or target.carrier is not None:
            raise ParameterError("target", "is carried, and goes where its carrier goes")

    def hold_plate(self, T_world_plate: Array | None) -> None:
        """Hold the plate at a pose (4, 4), or take it away."""
        self._goes_on()
        self.session.hold_plate(T_world_plate)

    def before_marker(self, i: int) -> Array:
        """The pose (4, 4) of a plate that hides marker i (without markers, the target's middle) from the camera where it is now."""
        truth, target = self.frame.truth, self.scenario.target
        places = target.places if len(target.places) else np.zeros((1, 3))
        marker = transform(truth.T_world_target, places)[min(i, len(places) - 1)]
        T = truth.T_world_camera.copy()
        T[:3, 3] += NEAR_MARKER * (marker - T[:3, 3])
        return T

    def _goes_on(self) -> None:
        if self.ended:
            raise ParameterError("run", "has ended; reset it first")

    def _show(self, frame: Frame) -> None:
        self.frame, self.last = frame, sample_of(self.scenario, frame)
        self.frames += 1
        self.transport.passed(frame.t)

    def close(self) -> None:
        """Free the simulation."""
        self.session.close()


def sample_of(scenario: Scenario, frame: Frame) -> Sample:
    """A frame of a session as pages show it."""
    film = FilmFrame.of_frame(frame)
    values = dict(zip(scenario.own_columns, frame.row.tolist(), strict=True)) | {"error_px": frame.error.rms_px}
    return sample(scenario, film, values, frame.timing.number, frame.twist, frame.goal.view, frame.verdict)


def sample(scenario: Scenario, film: FilmFrame, values: dict[str, float], number: int, twist: Array, view: int, verdict: Any) -> Sample:
    """A frame as pages show it, from a session or a log; values: its `error_px` and own columns."""
    judged = in_a_frame(scenario.goal.judged, scenario.stop, values)
    value, unit = in_words_unit(judged.value, judged.unit)
    T = scenario.goal_pose_at(film.t, view)
    return Sample(number, film, twist, value, unit, None if T is None else film.T_world_target @ inverse(T), verdict)
