"""The Gymnasium environment of a scenario."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from vstestbed.apps.learn.rollout import MOST_SEED, Bounds, Rollout, Step
from vstestbed.camera import Image
from vstestbed.core.errors import ParameterError
from vstestbed.loop.recording import Recording
from vstestbed.scenario.scenario import Scenario


class SpecWithLength:
    """Gymnasium's `spec` of an environment, with `max_episode_steps`: the scenario's own clock ends
    an episode, and needs no wrapper.
    """

    def __get__(self, env: Any, owner: type | None = None) -> Any:
        return None if env is None else env.__dict__.get("_spec")

    def __set__(self, env: Any, spec: Any) -> None:
        if spec is not None:
            spec = replace(spec, max_episode_steps=env._max_episode_steps)
        env.__dict__["_spec"] = spec


class GymServo(gymnasium.Env[dict[str, Any], NDArray[Any]]):
    """A scenario as a Gymnasium environment; observations, actions and info: see `Rollout`,
    rewards: `Reward`.

    `reset(seed=k)` is the run of `vstestbed run --seed k`, byte for byte; without a seed,
    `np_random` draws one (`info["seed"]`), so that episodes differ, and a seeded first reset makes
    all that follow the same. `reset(options={"overrides": {"world.light.brightness": 0.5}})`
    changes values by dotted path for one episode. Keys are LeRobot's: `pixels`, `agent_pos`,
    `info["is_success"]`, `task_description`, `_max_episode_steps`; `spec.max_episode_steps` is that
    of the clock.

    Args:
        scenario: path of a YAML file, name of a bundled scenario, or a loaded one.
        render_mode: None, or `rgb_array`, the scene from outside.
        settings: observation, reward, discount, success_bonus, overrides, end_on_rest, end_on_loss,
            action_repeat, picture_px, as `Rollout` has them.
    Raises ScenarioError: the scenario has mistakes. ParameterError: a setting is none of the
    possible ones.
    """

    spec = SpecWithLength()  # pyright: ignore[reportAssignmentType] - the base class has a plain attribute
    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 25}  # noqa: RUF012 - the base class has it so

    def __init__(
        self, scenario: str | Path | Scenario, *, render_mode: str | None = None, **settings: Any
    ):
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise ParameterError.fixed("render_mode", "None or rgb_array", render_mode)
        self.render_mode = render_mode
        self._rollout = Rollout(scenario, **settings)
        self.scenario = self._rollout.scenario
        self.task = self.scenario.name
        self.task_description = self.scenario.description
        self._max_episode_steps = self._rollout.most_steps
        self.metadata = self.metadata | {"render_fps": self.scenario.camera.rate_hz}
        self.observation_space = _space(self._rollout.bounds())
        self.action_space = gymnasium.spaces.Box(
            -1.0, 1.0, self._rollout.action_unit.shape, np.float32
        )

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Begin an episode: its observation and info. options: `overrides`, see `Rollout.reset`;
        others have no effect.
        """
        super().reset(seed=seed)
        if seed is None:
            seed = int(self.np_random.integers(MOST_SEED))
        step = self._rollout.reset(seed, (options or {}).get("overrides"))
        return step.observation, step.info

    def step(self, action: NDArray[Any]) -> Step:
        """One camera frame: observation, reward, terminated, truncated, info. Errors: see
        `Rollout.step`.
        """
        return self._rollout.step(action)

    def expert(self) -> NDArray[Any]:
        """The action of the scenario's own law for the last frame: see `Rollout.expert`."""
        return self._rollout.expert().astype(np.float32)

    def recording(self) -> Recording:
        """The episode so far: see `Rollout.recording`."""
        return self._rollout.recording()

    def render(self) -> Image | None:  # pyright: ignore[reportIncompatibleMethodOverride] - the base class's type is a variable
        """The scene from outside, (H, W, 3) uint8; None without a render mode."""
        return None if self.render_mode is None else self._rollout.render()

    def close(self) -> None:
        """Free the simulation."""
        self._rollout.close()


def _space(bounds: Mapping[str, Bounds | dict[str, Bounds]]) -> gymnasium.spaces.Dict:
    """The space of an observation, or of the pictures of several cameras in it."""
    spaces: dict[str, gymnasium.Space[Any]] = {}
    for name, b in bounds.items():
        if isinstance(b, dict):
            spaces[name] = _space(b)
        else:
            spaces[name] = gymnasium.spaces.Box(b.low, b.high, b.shape, b.dtype)
    return gymnasium.spaces.Dict(spaces)
