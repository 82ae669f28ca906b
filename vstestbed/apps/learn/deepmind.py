"""The dm_env environment of a scenario."""

from __future__ import annotations

from typing import Any

import dm_env
import numpy as np
from dm_env import specs
from numpy.typing import NDArray

from vstestbed.apps.learn.rollout import MOST_SEED, Bounds, Rollout
from vstestbed.camera import Image


class DmServo(dm_env.Environment):
    """A scenario as a dm_env environment; observations and actions: see `Rollout`, rewards:
    `Reward`.

    Not dm_control's `rl.control.Environment`: that one holds a time loop of its own, a fixed number
    of physics steps for each action, with the observation taken at the end of them. Here pictures
    have an exposure, a latency and jitter, may be missing, and commands take effect later; the one
    time loop that does this, `Session`, gives a frame when a picture arrives.

    A success or failure ends an episode with discount 0, a time-out with discount 1.

    info: of the last step, see `Rollout`: truth, outcome, judged error. rollout: the episodes.
    seed: of the seeds that they get, one after the other; None: other ones each time.
    """

    def __init__(self, rollout: Rollout, seed: int | None = None):
        self.rollout = rollout
        self._rng = np.random.default_rng(seed)
        self.scenario = rollout.scenario
        self.info: dict[str, Any] = {}
        self._last = True

    def reset(self) -> dm_env.TimeStep:
        """Begin an episode with a seed drawn, `info["seed"]`."""
        return self.reset_to(int(self._rng.integers(MOST_SEED)))

    def reset_to(self, seed: int) -> dm_env.TimeStep:
        """Begin the episode of `vstestbed run --seed`."""
        step = self.rollout.reset(seed)
        self._last = False
        self.info = step.info
        return dm_env.restart(step.observation)

    def step(self, action: NDArray[Any]) -> dm_env.TimeStep:
        """One camera frame; after the end, or before the first episode, a new one, whatever the
        action. Errors: see `Rollout.step`.
        """
        if self._last:
            return self.reset()
        step = self.rollout.step(action)
        self._last = step.terminated or step.truncated
        self.info = step.info
        if step.terminated:
            return dm_env.termination(step.reward, step.observation)
        if step.truncated:
            return dm_env.truncation(step.reward, step.observation)
        return dm_env.transition(step.reward, step.observation)

    def observation_spec(self) -> dict[str, Any]:  # pyright: ignore[reportIncompatibleMethodOverride] - dm_env says Any nested
        """The entries of an observation."""

        def spec_of(name: str, b: Bounds | dict[str, Bounds]) -> Any:
            if isinstance(b, dict):
                return {inner: spec_of(inner, one) for inner, one in b.items()}
            return specs.BoundedArray(b.shape, b.dtype, b.low, b.high, name)

        return {name: spec_of(name, b) for name, b in self.rollout.bounds().items()}

    def action_spec(self) -> specs.BoundedArray:  # pyright: ignore[reportIncompatibleMethodOverride] - dm_env's own has no type
        """Shares of the largest velocities along the robot's motions, (n,) in [-1, 1]."""
        return specs.BoundedArray(self.rollout.action_unit.shape, np.float32, -1.0, 1.0, "action")

    def render(self) -> Image:
        """The scene from outside, (H, W, 3) uint8."""
        return self.rollout.render()

    def close(self) -> None:
        """Free the simulation."""
        self.rollout.close()
        self._last = True
