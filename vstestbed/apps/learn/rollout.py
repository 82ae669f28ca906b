"""Rollout: a session as learners want it, with observations, actions in [-1, 1],
rewards and info.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, NamedTuple, get_args

import numpy as np

from vstestbed.camera import Camera, Image
from vstestbed.core.errors import ParameterError, SessionError
from vstestbed.core.geometry import Array
from vstestbed.imaging.chain import scaled
from vstestbed.laws.policy import MOST_PX, action_unit, observed
from vstestbed.loop.ego_motion import start_basis
from vstestbed.loop.inputs import numbers_of
from vstestbed.loop.recording import Recording
from vstestbed.loop.session import Session
from vstestbed.report.video.film import Pictures, quality_of, replay_of
from vstestbed.report.video.overlay import FilmFrame
from vstestbed.scenario.cameras import OWN
from vstestbed.scenario.distributions import values_of
from vstestbed.scenario.load import load
from vstestbed.scenario.scenario import Scenario
from vstestbed.sim.replay import Replay
from vstestbed.tasks.frame import Frame
from vstestbed.tasks.judged import JudgedError, Reward, RewardKind, in_a_frame, potential
from vstestbed.vision import Detector, Oracle

ObservationMode = Literal["markers", "pixels", "both"]
MOST = 1e6  # bound of `agent_pos`: far beyond any reading in metres, radians or their rates
MOST_SEED = 2**31 - 1  # largest seed that an episode without a given one draws


class Bounds(NamedTuple):
    """One entry of an observation: its shape, type and bounds, numbers or arrays of the shape."""

    shape: tuple[int, ...]
    dtype: type
    low: Any
    high: Any


class Step(NamedTuple):
    """What a step gives: observation, reward, whether the episode has ended, whether by the clock,
    and info.
    """

    observation: dict[str, Any]
    reward: float
    terminated: bool
    truncated: bool
    info: dict[str, Any]


def marker_bounds(scenario: Scenario, camera: Camera, detector: Detector[Any]) -> Bounds:
    """Of the markers (N, 2) [px] that a camera's detector finds: the picture's borders, wide ones
    where its field of view is unlimited.
    """
    low = np.full((scenario.rows, 2), -0.5, np.float32)
    high = (low + [camera.width, camera.height]).astype(np.float32)
    if isinstance(detector, Oracle) and detector.field_of_view != "limited":
        low[:] = -MOST_PX
        high[:] = MOST_PX
    return Bounds(low.shape, np.float32, low, high)


def _check_size(picture_px: tuple[int, int] | None) -> None:
    if picture_px is None:
        return
    if len(picture_px) != 2 or not all(isinstance(n, int) and n > 0 for n in picture_px):
        raise ParameterError.count(
            "picture_px", "two", "whole numbers over 0, width and height", picture_px
        )


class Rollout:
    """A session as learners want it; the Gymnasium and the dm_env environment are this in their
    words.

    Observation: `markers` (N, 2) [px], 0 for one not seen, and `seen` (N,); `goal` (N, 2), where
    the markers are to be now [px] (it changes with via points, descents and paths); `agent_pos`
    (k,), what the robot's own sensors tell (`Robot.proprioception`), where it has any; `pixels` (H,
    W, 3) uint8. Of further cameras, those of their last pictures, all 0 before the first:
    `markers_NAME`, `seen_NAME`; and `pixels` is then a picture of each by its name, the law's own
    under `camera`. It is what a law of the scenario gets, and no truth. Mode `markers` has no
    pixels, `pixels` no markers, `both` has all. Numbers are float32; markers lie within the
    picture's borders, or where noise has put them beyond, on them.

    Action (n,) in [-1, 1]: velocities along the robot's motions as shares of the law's limits, or
    of 1 m/s and 1 rad/s where it has none (`laws.policy.action_unit`); clipped. It has the
    scenario's latency and the robot's limits.

    An episode ends with the run's outcome: truncated by a time-out, terminated by any other. Two of
    the ends can be switched off for learners, who rest and lose the target often: `local_minimum`
    (and `stuck` of the monitor `settles`), and `target_lost`.

    Info at every step: `is_success`, `outcome` and `reason` ("" while it runs), `error`,
    `error_unit`, `error_limit`, `error_by` (the judged error in this frame, NaN where unknown, and
    who measures it), `t` [s], `seed`, `randomised` (what the seed drew for the block `randomise`,
    by paths), and `truth`: `T_world_camera`, `T_world_target` (4, 4), `twist` (6,) of the camera,
    `q`. The reward and the end of tasks that the truth decides (`error_by`) are the referee's,
    computed with it; observations never are.

    Args:
        scenario: path of a YAML file, name of a bundled scenario, or a loaded one. Of a file its
            plugins are run.
        observation: the mode. reward, discount, success_bonus: of a step, see `Reward`.
        overrides: values by dotted path, as `vstestbed.load`.
        picture_px: (width, height) of `pixels` [px], to which pictures are scaled, by the mean of
            pixels where they become fewer; None: their own. The detector works on the camera's own
            picture.
        end_on_rest: whether a rest away from the goal ends an episode; if not, `stop.rest_after_s`
            of `scenario` is None.
        end_on_loss: whether a target out of sight ends an episode; if not, `stop.lost_after_s` and
            `stop.lost_after_m` are None.
        action_repeat: for how many frames an action holds; the reward is that of the step from its
            first to its last.
    Raises ScenarioError: the scenario has mistakes. ParameterError: another mode; overrides of a
    loaded scenario; those of `Reward`.
    """

    def __init__(
        self,
        scenario: str | Path | Scenario,
        observation: ObservationMode = "markers",
        *,
        reward: RewardKind = "potential",
        discount: float = 0.99,
        success_bonus: float = 10.0,
        overrides: Mapping[str, object] | None = None,
        end_on_rest: bool = True,
        end_on_loss: bool = True,
        action_repeat: int = 1,
        picture_px: tuple[int, int] | None = None,
    ):
        if observation not in get_args(ObservationMode):
            raise ParameterError.choice("observation", get_args(ObservationMode), observation)
        if isinstance(scenario, Scenario) and overrides:
            raise ParameterError.only_for(
                "overrides", "a scenario given by name or path; load it with them"
            )
        if not isinstance(action_repeat, int) or action_repeat < 1:
            raise ParameterError.bound(
                "action_repeat", "a whole number of at least", 1, action_repeat
            )
        _check_size(picture_px)
        self.action_repeat = action_repeat
        self._picture_px = picture_px
        self._stop: dict[str, None] = {}
        if not end_on_rest:
            self._stop["rest_after_s"] = None
        if not end_on_loss:
            self._stop |= {"lost_after_s": None, "lost_after_m": None}
        self._name: str | Path | None = None
        self._overrides = dict(overrides or {})
        if not isinstance(scenario, Scenario):
            self._name = scenario
            scenario = load(scenario, overrides)
        self.scenario = self._stopped(scenario)
        self._mode = observation
        self.reward = Reward(reward, discount, success_bonus)
        self.action_unit = action_unit(self.scenario.law.limits, start_basis(self.scenario))
        self._session: Session | None = None
        self._frame: Frame | None = None
        self._replay: Replay | None = None
        self._overview: Pictures | None = None
        self._phi = 0.0
        self._told = False
        self._steps = 0
        self._randomised: dict[str, Any] = {}
        self._bounds = self.bounds()

    @property
    def most_steps(self) -> int:
        """Steps of an episode that ends by the clock, where no picture is missing."""
        frames = math.ceil(self.scenario.stop.duration_s * self.scenario.camera.rate_hz - 1e-9)
        return math.ceil(frames / self.action_repeat)

    def _stopped(self, given: Scenario) -> Scenario:
        """A scenario with the ends that were asked for."""
        return replace(given, stop=replace(given.stop, **self._stop))

    def bounds(self) -> dict[str, Bounds | dict[str, Bounds]]:
        """The entries of an observation."""
        s = self.scenario
        n = s.rows
        found: dict[str, Bounds | dict[str, Bounds]] = {
            "goal": Bounds((n, 2), np.float32, -MOST_PX, MOST_PX)
        }
        eyes = {OWN: s, **s.eyes}
        if self._mode != "pixels":
            for name, eye in eyes.items():
                end = "" if name == OWN else f"_{name}"
                found[f"markers{end}"] = marker_bounds(s, eye.camera, eye.detector)
                found[f"seen{end}"] = Bounds((n,), np.float32, 0.0, 1.0)
        if self._mode != "markers":
            each = {name: self._picture_bounds(eye.camera) for name, eye in eyes.items()}
            found["pixels"] = each if s.eyes else each[OWN]
        if k := len(s.robot.proprioception_names):
            found["agent_pos"] = Bounds((k,), np.float32, -MOST, MOST)
        return found

    def _picture_bounds(self, camera: Camera) -> Bounds:
        width, height = self._picture_px or (camera.width, camera.height)
        return Bounds((height, width, 3), np.uint8, 0, 255)

    def reset(self, seed: int, overrides: Mapping[str, object] | None = None) -> Step:
        """Begin the episode of a seed: the start and the noise of `run --seed`; of a scenario
        without random starts the noise alone.

        overrides: values by dotted path, of this episode alone. Raises ParameterError: they would
        change what an observation holds, or the scenario was given loaded; ScenarioError: they have
        mistakes.
        """
        given = self._of_episode(overrides)
        seed = int(seed)  # of numpy, in a vector of environments
        random = given.robot.start.random is not None
        scenario = given.randomised(seed) if random else given.with_seed(seed)
        self.close()
        self._randomised = values_of(scenario.given)
        self._session = Session(scenario, pictures=self._mode != "markers")
        frame = self._frame = self._session.reset()
        error, self._phi = self._judged(frame)
        self._told = False
        self._steps = 0
        return Step(self._observation(frame), 0.0, False, False, self._info(frame, error))

    def _of_episode(self, overrides: Mapping[str, object] | None) -> Scenario:
        if not overrides:
            return self.scenario
        if self._name is None:
            raise ParameterError.only_for("options.overrides", "a scenario given by name or path")
        made = self._stopped(load(self._name, self._overrides | dict(overrides)))
        now, then = (
            (s.rows, s.robot.kind, s.camera.width, s.camera.height, tuple(s.cameras))
            for s in (self.scenario, made)
        )
        unit = action_unit(made.law.limits, start_basis(made))
        if now != then or not np.array_equal(unit, self.action_unit):
            words = "must leave markers, robot, limits and size of pictures as they are"
            raise ParameterError("options.overrides", words, dict(overrides))
        return made

    def step(self, action: Array) -> Step:
        """Send the robot the velocities of an action (n,), and simulate until the next picture has
        arrived.
        Raises ParameterError: an action of another shape, or one that is not finite. SessionError:
        before `reset`, or after the end.
        """
        u = self.action_unit * np.clip(self._checked(action), -1.0, 1.0)
        session, frame = self._running()
        if frame.outcome is None:
            self._steps += 1
        for _ in range(self.action_repeat):
            if frame.outcome is None:
                frame = self._frame = session.step(u)
        outcome = frame.outcome
        # an episode may have ended with its first frame: the first step tells
        self._told = outcome is not None
        before = self._phi
        error, self._phi = self._judged(frame)
        truncated = outcome is not None and outcome.out_of_time
        terminated = outcome is not None and not truncated
        info = self._info(frame, error)
        left = max(0, self.most_steps - self._steps)
        reward = self.reward.of_step(before, self._phi, terminated, info["is_success"], left)
        return Step(self._observation(frame), float(reward), terminated, truncated, info)

    def expert(self) -> Array:
        """The action (n,) of the scenario's own law for the last frame, clipped to [-1, 1]: a
        demonstration. SessionError without one.
        """
        return np.clip(self._running()[1].command.u / self.action_unit, -1.0, 1.0)

    def recording(self) -> Recording:
        """The episode so far, as `Session.recording`. Raises SessionError: before `reset`, or after
        `close`.
        """
        if self._session is None:
            raise SessionError("no episode has begun", "call reset() first")
        return self._session.recording()

    def render(self) -> Image:
        """The scene from outside at the last frame, as in a film's draft. SessionError before
        `reset`.
        """
        if self._frame is None or self._session is None:
            raise SessionError("nothing to draw", "call reset() first")
        if self._overview is None:
            scenario = self._episode.scenario
            quality = quality_of(scenario)
            self._replay = replay_of(scenario, quality)
            self._overview = Pictures.within(scenario, "overview", self._replay, quality.size)
        return self._overview.picture(FilmFrame.of_frame(self._frame))

    def close(self) -> None:
        """Free the simulation; `reset` begins another one."""
        self._overview = self._frame = None
        replay, self._replay = self._replay, None
        if replay is not None:
            replay.close()
        session, self._session = self._session, None
        if session is not None:
            session.close()

    @property
    def _episode(self) -> Any:
        assert self._session is not None and self._session.episode is not None
        return self._session.episode

    def _running(self) -> tuple[Session, Frame]:
        if self._session is None or self._frame is None:
            raise SessionError("no episode has begun", "call reset() first")
        if self._told:
            raise SessionError(
                f"the episode has ended: {self._episode.reason}", "call reset() for another one"
            )
        return self._session, self._frame

    def _checked(self, action: Array) -> Array:
        numbers = numbers_of(action)
        if numbers.shape != self.action_unit.shape:
            raise ParameterError.count(
                "action", len(self.action_unit), "numbers in [-1, 1]", action
            )
        if not np.isfinite(numbers).all():  # not their sum: it may overflow
            raise ParameterError.infinite("action", action)
        return numbers

    def _observation(self, frame: Frame) -> dict[str, Any]:
        seen = frame.observation
        reading = self._episode.controller.before.reading
        own = self.scenario.robot.proprioception(reading, seen.odometry)
        seen = replace(seen, proprioception=own if len(own) else None)
        told = observed(seen, frame.goal, tuple(self.scenario.cameras))
        found: dict[str, Any] = {}
        for name, value in told.items():
            within = self._bounds.get(name)
            if isinstance(within, Bounds):
                found[name] = np.clip(value, within.low, within.high)
                if name.startswith("markers"):
                    found[name][told[f"seen{name.removeprefix('markers')}"] == 0] = 0.0
        if self._mode != "markers":
            pictures = self._pictures(frame)
            found["pixels"] = pictures if self.scenario.cameras else pictures[OWN]
        return found

    def _picture(self, image: Image | None) -> Image:
        assert image is not None  # the session takes whole pictures
        return np.array(image if self._picture_px is None else scaled(image, self._picture_px))

    def _pictures(self, frame: Frame) -> dict[str, Image]:
        """The last picture of each camera by name, black before its first."""
        found = {OWN: self._picture(frame.image)}
        for name, eye in self.scenario.eyes.items():
            image = frame.cameras[name].image if name in frame.cameras else None
            if image is None:
                image = np.zeros((eye.camera.height, eye.camera.width, 3), np.uint8)
            found[name] = self._picture(image)
        return found

    def _judged(self, frame: Frame) -> tuple[JudgedError, float]:
        scenario = self.scenario
        values = dict(zip(scenario.own_columns, frame.row.tolist(), strict=True))
        values["error_px"] = frame.error.rms_px
        error = in_a_frame(scenario.goal.judged, scenario.stop, values)
        return error, potential(error, frame.goal.view, len(scenario.goal_views))

    def _info(self, frame: Frame, error: JudgedError) -> dict[str, Any]:
        """What a learner may look at and a policy may not."""
        outcome = frame.outcome
        truth = frame.truth
        true = {
            "T_world_camera": truth.T_world_camera,
            "T_world_target": truth.T_world_target,
            "twist": truth.twist,
            "q": truth.q,
        }
        return {
            "is_success": outcome is not None and outcome.success,
            "outcome": "" if outcome is None else outcome.name,
            "reason": frame.verdict[1] if frame.verdict else "",
            "error": error.value,
            "error_unit": error.unit,
            "error_limit": error.limit,
            "error_by": error.by,
            "t": frame.t,
            "seed": self._episode.scenario.seed,
            "randomised": dict(self._randomised),
            "truth": {name: np.array(value) for name, value in true.items()},
        }
