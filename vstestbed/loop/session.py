"""Session: a scenario that is simulated frame by frame, by the scenario's law or by hand."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from vstestbed.core.errors import ParameterError, SessionError
from vstestbed.core.geometry import Array
from vstestbed.core.outcome import Outcome
from vstestbed.core.spatial import pose_matrix, twist_numbers
from vstestbed.laws import Law
from vstestbed.loop.ego_motion import start_basis
from vstestbed.loop.episode import Episode
from vstestbed.loop.inputs import numbers_of
from vstestbed.loop.recording import Recording, Watcher
from vstestbed.scenario.load import seeded
from vstestbed.scenario.scenario import Scenario, check_scenario
from vstestbed.tasks.frame import Frame

if TYPE_CHECKING:
    from spatialmath import SE3, Twist3

__all__ = ["Session", "run", "uninterrupted"]


class Session:
    """A scenario that is simulated frame by frame; `run` is a session turned to its end.

        with vs.Session(vs.load("arm_ibvs")) as session:
            frame = session.reset(seed=3)
            while frame.outcome is None:
                frame = session.step()
        session.recording()

    Sessions are independent of each other and of the thread that steps them, one at a time each.
    All methods but `reset` and `close` raise SessionError where there is nothing to step.

    Args:
        scenario: the experiment; ParameterError where it is none.
        pictures: take whole pictures (`Frame.image`), also where the detector needs none. The log
            has the same bytes.
        watch: receive every frame, with the command that was sent.
        plate_m: edge of a square plate in reserve, for `hold_plate` [m]; 0 for none.
    """

    def __init__(
        self,
        scenario: Scenario,
        *,
        pictures: bool = False,
        watch: Iterable[Watcher] = (),
        plate_m: float = 0.0,
    ):
        check_scenario(scenario)
        self._plate_m = plate_m
        self._given = scenario
        self._pictures = pictures
        self._watchers = tuple(watch)
        self.episode: Episode | None = None
        self._motions = start_basis(scenario).shape[1]

    def __reduce__(self) -> Any:
        raise SessionError(
            "a session holds a running simulation and cannot be pickled or copied",
            "take its scenario, or its recording()",
        )

    def reset(self, seed: int | None = None) -> Frame:
        """Begin an episode and simulate until its first picture has arrived. An episode that is
        under way ends unfinished. seed: of the start and of all noise, as `run --seed`; None for
        the scenario's own start and seed.
        Raises ParameterError: a seed for a scenario in which nothing is random.
        EnvironmentLackError: a picture is needed that only OpenGL can draw, and it does not work
        here. SessionError: no picture arrived before the end.
        """
        self.close()
        scenario = self._given if seed is None else seeded(self._given, seed)
        self.episode = Episode(scenario, self._pictures, self._watchers, None, self._plate_m)
        frame = self.episode.advance()
        if frame is None:
            raise SessionError(
                f"the run ended before a picture arrived: {self.episode.reason}",
                "change the camera's timing",
            )
        return frame.protected()

    def step(self, command: ArrayLike | Twist3 | None = None) -> Frame:
        """Send the command for the last frame, and simulate until the next picture has arrived.

        Args:
            command: in place of the law's command: a camera twist (6,) [m/s, rad/s], or velocities
                along the robot's motions (n,) (omni: vx, vy, wz; car: v, w; quadrotor: vx, vy, vz,
                wz). Of spatialmath's Twist3 it is S = (v, w), read as the velocity of the camera in
                the camera's frame. It has the scenario's latency and the robot's limits. The law
                still computes its own command for every frame, `Frame.command`.

        Returns the next frame, or where the run ended without another picture the last one, with
        the outcome.

        Raises ParameterError: a command of another shape, or one that is not finite. SessionError:
        before `reset`, or after the end.
        """
        episode = self._running()
        numbers = None if command is None else self._numbers(twist_numbers(command))
        return (episode.advance(numbers) or episode.ended()).protected()

    def _numbers(self, command: ArrayLike) -> Array:
        """A command as an array; ParameterError where it is none."""
        n = self._motions
        numbers = numbers_of(command)
        if numbers.shape not in ((6,), (n,)):
            words = "must be a camera twist (6,)"
            if n != 6:
                words += f", or {n} velocities along the robot's motions"
            raise ParameterError("command", words, command)
        if not np.isfinite(numbers).all():
            raise ParameterError.infinite("command", command)
        return numbers

    def take_pictures(self, on: bool) -> None:
        """Whether the exposures from now on are whole pictures, where `pictures` was asked for:
        fewer take less time.
        """
        self._running().take_pictures(on and self._pictures)

    def retune(self, law: Law[Any]) -> None:
        """Go on with other parameters of the law, such as its gain, from the next picture on. Like
        all that is changed by hand, the recording's description tells it, and no scenario repeats
        it. Raises ParameterError: as `Controller.retune`.
        """
        self._running().retune(law)

    def push(self, force: Array, duration_s: float = 0.2) -> None:
        """Push the robot at its flange with a force (3,) along world axes [N], from now on, for a
        while.
        Raises ParameterError: an ideal camera, which has no mass; a force or a duration that is
        none.
        """
        episode = self._running()
        episode.plant.push(force, duration_s)
        episode.changed_by_hand("robot pushed")

    @property
    def weight_n(self) -> float:
        """Weight of the robot [N], to choose a push by;
        0 for an ideal camera, and before `reset`.
        """
        return self.episode.plant.weight_n if self.episode is not None else 0.0

    def move_target(self, T_world_target: Array | SE3) -> None:
        """Put the target at a pose, SE3 or (4, 4), now; one that moves goes on from there.
        ParameterError for a target that is carried.
        """
        episode = self._running()
        episode.plant.move_target(pose_matrix(T_world_target, "T_world_target"))
        episode.changed_by_hand("target moved")

    def hold_plate(self, T_world_plate: Array | SE3 | None) -> None:
        """Hold an opaque plate at a pose of its middle, SE3 or (4, 4), across its z axis, or take
        it away (None). It touches nothing.
        Raises ParameterError: no pose, or the session has no plate (`plate_m`).
        """
        episode = self._running()
        if T_world_plate is not None:
            T_world_plate = pose_matrix(T_world_plate, "T_world_plate")
        episode.plant.hold_plate(T_world_plate)
        episode.changed_by_hand("plate held")

    def recording(self) -> Recording:
        """The episode so far: outcome, log, metrics; `interrupted` where it has not ended. The same
        bytes as `run` where the law drove.
        Raises SessionError: before `reset`.
        """
        if self.episode is None:
            raise SessionError("nothing has run", "call reset() first")
        return self.episode.recording()

    def close(self) -> None:
        """End the episode and free the simulation; the recording stays."""
        if self.episode is not None:
            self.episode.close()

    def __enter__(self) -> Session:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _running(self) -> Episode:
        episode = self.episode
        if episode is None:
            raise SessionError("nothing to step", "call reset() first")
        if episode.outcome is not None:
            raise SessionError(
                f"the run has ended: {episode.reason}", "call reset() for another one"
            )
        if episode.closed:
            raise SessionError("the session is closed", "call reset() for another run")
        if episode.steps:
            raise SessionError(
                "another thread steps this session, which serves one at a time",
                "step it from one thread, or hold a lock",
            )
        return episode


def run(
    scenario: Scenario,
    watch: Iterable[Watcher] = (),
    folder: Path | None = None,
    *,
    pictures: bool = False,
) -> Recording:
    """Simulate a scenario from its nominal start until an outcome (`Scenario.randomised` draws
    another start).

    watch: receive every frame; a KeyboardInterrupt ends the run with the outcome `interrupted`.
    folder: where `log.part` grows with the run; in memory alone by default. pictures: take whole
    pictures for those who watch, see `Session`, whose errors it raises.
    """
    check_scenario(scenario)
    episode = Episode(scenario, pictures, tuple(watch), folder)
    with contextlib.closing(episode), contextlib.suppress(KeyboardInterrupt):
        while episode.outcome is None:
            episode.advance()
    return episode.recording()


def uninterrupted(recording: Recording) -> Recording:
    """The recording of a run in a study; KeyboardInterrupt for one that was interrupted, else the
    study would go on with its next run.
    """
    if recording.outcome is Outcome.interrupted:
        raise KeyboardInterrupt
    return recording
