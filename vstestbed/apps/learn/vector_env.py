"""Many ideal cameras as one vector environment: all steps of all environments by the same few
operations on arrays.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium.spaces import Box, Dict
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from vstestbed.apps.learn.gym_env import SpecWithLength
from vstestbed.apps.learn.rollout import MOST_SEED, Rollout, marker_bounds
from vstestbed.core.errors import ParameterError, SessionError
from vstestbed.core.geometry import Array, exp
from vstestbed.core.outcome import Outcome
from vstestbed.endings import GOES_ON, OUTCOMES, IdealRuns, codes
from vstestbed.features.depth import PnP
from vstestbed.laws.policy import MOST_PX
from vstestbed.scenario.scenario import Scenario
from vstestbed.studies.batch import (
    FIRST_POSE,
    BatchSetup,
    ideal,
    left_out,
    seen_by,
    start_of,
)
from vstestbed.tasks.judged import in_a_frame, nearness
from vstestbed.tasks.monitor import REST

NAMES = np.array([*(outcome.name for outcome in OUTCOMES), ""], dtype=object)
"""Names of outcomes by their codes; the last one is of GOES_ON."""


class GymServos(VectorEnv[dict[str, Any], NDArray[Any], NDArray[Any]]):
    """A scenario of an ideal camera in many copies, each as `GymServo` is with the same seed and
    actions.

    `gymnasium.make_vec(id, num_envs, vectorization_mode="vector_entry_point")`. Observations
    `markers` (n, N, 2), `seen` (n, N) and `goal` (n, N, 2) are those of `Rollout` in float32, with
    the picture's borders as bounds; actions (n, 6), rewards as there. Infos are arrays:
    `is_success`, `outcome` ("" while an episode goes on), `error` [px], `t` [s], `seed`, and
    `truth` with `T_camera_target`, which a learner may look at and a policy may not. An environment
    that has ended begins its next episode with the next step (`AutoresetMode.NEXT_STEP`);
    `reset(seed=k)` gives environment i the seed k + i, and later episodes the seeds that `GymServo`
    draws.

    A target counts as lost where fewer markers are in sight than the scenario's law needs: the law
    itself is not asked.

    Args:
        scenario: path of a YAML file, name of a bundled scenario, or a loaded one.
        num_envs: how many.
        ideal: of a scenario of an arm, or with latency, noise, pictures: fly the ideal camera of
            it, as `vstestbed basin` does.
        settings: as of `Rollout`, in mode `markers`.
    Raises ScenarioError: the scenario has mistakes. ParameterError: a setting is none of the
    possible ones, or the scenario is not ideal.
    """

    spec = SpecWithLength()  # pyright: ignore[reportAssignmentType] - the base class has a plain attribute
    metadata: dict[str, Any] = {"render_modes": [], "autoreset_mode": AutoresetMode.NEXT_STEP}  # noqa: RUF012 - the base class has it so

    def __init__(
        self,
        scenario: str | Path | Scenario,
        num_envs: int = 1,
        *,
        ideal: bool = False,
        render_mode: None = None,
        **settings: Any,
    ):
        if render_mode is not None:
            raise ParameterError.fixed(
                "render_mode", "None", render_mode, why="a batch draws no pictures"
            )
        rollout = Rollout(scenario, **settings)
        if "pixels" in rollout.bounds():
            raise ParameterError.fixed(
                "observation", "markers", settings["observation"], why="a batch draws no pictures"
            )
        if rollout.action_repeat != 1:
            raise ParameterError.fixed(
                "action_repeat", "1", rollout.action_repeat, where="in a batch"
            )
        self._given = rollout.scenario
        self._unit = rollout.action_unit
        self._reward = rollout.reward
        self._max_episode_steps = rollout.most_steps
        self.scenario = _ideal(rollout.scenario, ideal)
        self._setup = setup = BatchSetup(self.scenario)
        stop = self.scenario.stop
        law = self.scenario.law
        self._limit = in_a_frame(self.scenario.goal.judged, stop, {"error_px": 1.0}).limit
        posed = isinstance(law.depth, PnP) and law.inputs != ("relative",)
        self._first = max(setup.needed, FIRST_POSE) if posed else setup.needed
        self.num_envs = num_envs
        self.single_observation_space = self._space()
        self.single_action_space = Box(-1.0, 1.0, self._unit.shape, np.float32)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        goal = np.nan_to_num(self.scenario.goal_view.uv)
        self._goal = goal.clip(-MOST_PX, MOST_PX).astype(np.float32)
        self._rngs: list[np.random.Generator] = []
        self._runs: _Episodes | None = None

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Begin an episode in each environment. options: `reset_mask` (n,), in these alone."""
        n = self.num_envs
        mask = np.asarray((options or {}).get("reset_mask", np.ones(n)), dtype=bool)
        seeds: Sequence[int | None] = (None,) * n
        if isinstance(seed, int):
            seeds = range(seed, seed + n)
        elif seed is not None:
            seeds = seed
        if len(seeds) != n or mask.shape != (n,):
            words = "values, one for each environment"
            found = len(seeds), mask.shape
            raise ParameterError.count("seed and options.reset_mask", n, words, found)
        if self._runs is None:
            if not mask.all():
                raise SessionError("no episode has begun", "call reset() without a mask first")
            self._runs = _Episodes(n)
            self._rngs = [seeding.np_random(None)[0] for _ in seeds]
        for i in np.flatnonzero(mask).tolist():
            self._begin(self._runs, i, seeds[i])
        return self._look(self._runs, np.full((n, 6), np.inf), mask)

    def _begin(self, runs: _Episodes, i: int, seed: int | None = None) -> None:
        """Begin an episode in environment i, with a seed or the next one that it draws."""
        if seed is None:
            seed = int(self._rngs[i].integers(MOST_SEED))
        else:
            self._rngs[i] = seeding.np_random(seed)[0]
        runs.begin(i, self._given, int(seed))

    def step(
        self, actions: NDArray[Any]
    ) -> tuple[dict[str, Any], NDArray[Any], NDArray[Any], NDArray[Any], dict[str, Any]]:
        """One frame of each environment; one that has ended begins anew, with the reward 0. Errors:
        as of `Rollout.step`.
        """
        runs = self._runs
        action = np.asarray(actions, dtype=float)
        if runs is None:
            raise SessionError("no episode has begun", "call reset() first")
        shape = self.num_envs, len(self._unit)
        if action.shape != shape:
            raise ParameterError("actions", f"must have the shape {shape}", action.shape)
        if not np.isfinite(action).all():
            raise ParameterError.infinite("actions", "NaN or inf")
        anew = runs.told.copy()
        # one may have ended with its first frame: its first step tells
        goes = ~anew & (runs.code == GOES_ON)
        twist = np.where(~goes[:, None], 0.0, self._unit * np.clip(action, -1.0, 1.0))
        runs.T = exp(-self.scenario.camera.period * twist) @ runs.T
        runs.frame += goes
        for i in np.flatnonzero(anew).tolist():
            self._begin(runs, i)
        before = runs.phi.copy()
        seen, info = self._look(runs, np.where(goes[:, None], twist, np.inf), goes | anew)
        truncated = runs.code == OUTCOMES.index(Outcome.timed_out)
        terminated = (runs.code != GOES_ON) & ~truncated
        runs.told = (runs.code != GOES_ON) & ~anew
        left = np.maximum(0, self._max_episode_steps - runs.frame)
        reward = self._reward.of_step(before, runs.phi, terminated, info["is_success"], left)
        return seen, np.where(anew, 0.0, reward), terminated & ~anew, truncated & ~anew, info

    def _look(
        self, runs: _Episodes, twist: Array, now: NDArray[np.bool_]
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Observation and info of all environments, whose counters and outcomes it brings up to
        date.
        twist: commanded since the frame before (n, 6), inf where none was. now: which are in a new
        frame (n,).
        """
        s = self.scenario
        uv, seen, error, all_seen = seen_by(s, s.target.points_at(runs.T))
        blind = seen.sum(axis=1) < np.where(runs.frame == 0, self._first, self._setup.needed)
        error[blind] = np.nan
        near = ~blind & all_seen & (error < self._setup.error_px)
        least = REST * np.repeat((s.goal_view.reach_m, 1.0), 3)
        still = ~blind & ~near & (np.abs(twist) < least).all(axis=1)
        goes_on = blind & (runs.blind > 0) & np.isfinite(twist[:, 0])
        way = np.where(goes_on, np.linalg.norm(twist[:, :3], axis=1) * s.camera.period, 0.0)
        runs.blind_m = np.where(blind, runs.blind_m + way, 0.0)
        for name, holds in (("near", near), ("rest", still), ("blind", blind)):
            count = getattr(runs, name)
            count[now] = np.where(holds, count + 1, 0)[now]
        ideal_runs = IdealRuns(
            frame=runs.frame,
            near=runs.near,
            rest=runs.rest,
            blind=runs.blind,
            blind_m=runs.blind_m,
            T_camera_target=runs.T,
            failed=np.zeros(self.num_envs, dtype=bool),
        )
        runs.code = np.where(now, codes(ideal_runs, self._setup.limits), runs.code)
        runs.phi = nearness(error, self._limit)
        markers = np.where(seen[..., None], uv, 0.0).clip(-MOST_PX, MOST_PX).astype(np.float32)
        goal = np.broadcast_to(self._goal, markers.shape).copy()
        observation = {"goal": goal, "markers": markers, "seen": seen.astype(np.float32)}
        return observation, self._info(runs, error)

    def _info(self, runs: _Episodes, error: Array) -> dict[str, Any]:
        told = {
            "is_success": runs.code == OUTCOMES.index(Outcome.converged),
            "outcome": NAMES[runs.code],
            "error": error,
            "t": runs.frame * self.scenario.camera.period,
            "seed": runs.seed.copy(),
            "truth": {"T_camera_target": runs.T.copy()},
        }
        return told | {f"_{name}": np.ones(self.num_envs, dtype=bool) for name in told}

    def _space(self) -> Dict:
        """Of one environment: pixels within the picture, where the field of view is limited."""
        s = self.scenario
        n = len(s.target.points)
        _, _, low, high = marker_bounds(s, s.camera, s.detector)
        goal = Box(-MOST_PX, MOST_PX, (n, 2), np.float32)
        seen = Box(0.0, 1.0, (n,), np.float32)
        return Dict({"goal": goal, "markers": Box(low, high, dtype=np.float32), "seen": seen})


class _Episodes:
    """The n episodes: poses T_camera_target, numbers of the frames, of those near the goal, at rest
    and without sight until now, the way without sight [m], potentials, codes of the outcomes,
    seeds, and which have told their end.
    """

    def __init__(self, n: int):
        self.T = np.tile(np.eye(4), (n, 1, 1))
        self.frame, self.near, self.rest, self.blind, self.seed = np.zeros((5, n), int)
        self.code = np.full(n, GOES_ON)
        self.blind_m, self.phi = np.zeros((2, n))
        self.told = np.zeros(n, dtype=bool)

    def begin(self, i: int, scenario: Scenario, seed: int) -> None:
        """Episode i at the start that a seed draws."""
        self.T[i] = start_of(scenario, seed)
        self.seed[i] = seed
        self.code[i] = GOES_ON
        for counter in self.frame, self.near, self.rest, self.blind, self.blind_m, self.told:
            counter[i] = 0


def _ideal(scenario: Scenario, wanted: bool) -> Scenario:
    """The ideal scenario of a batch; itself where nothing is left out."""
    omitted = list(left_out(scenario))
    detector = scenario.detector
    if detector.needs_image and detector.rows is None:
        omitted.append(f"the pictures of detector {detector.kind} (oracle needs none)")
    if omitted and not wanted:
        words = (
            "must be True for this scenario:"
            f" a batch is of ideal cameras, and leaves out {', '.join(omitted)}"
        )
        raise ParameterError("ideal", words)
    return ideal(scenario)
