"""Environments for LeRobot's evaluation, as its hub asks for them: a repository's `env.py` need
only import `make_env` from here.

Source: https://huggingface.co/docs/lerobot/envhub
"""

from __future__ import annotations

from typing import Any

import gymnasium

from vstestbed.apps.learn.environments import ANY

# of a configuration, handed on to the environment
SETTINGS = "observation", "reward", "action_repeat", "picture_px", "overrides"


def make_env(
    n_envs: int = 1, use_async_envs: bool = False, cfg: Any = None
) -> dict[str, dict[int, gymnasium.vector.VectorEnv]]:
    """The scenario's environments as `{scenario: {0: VectorEnv}}`, with the observations `pixels`
    and `agent_pos` that policies expect.

    n_envs: how many. use_async_envs: each in a process of its own, started by `spawn`: OpenGL does
    not live through a fork.
    cfg: the scenario's name or path, or a configuration whose `task` is it (a mapping, or an object
    with attributes) and which may have SETTINGS; None: `arm_ibvs`. Errors: as of `GymServo`.
    """
    values = {"task": cfg} if isinstance(cfg, str) else cfg
    if not isinstance(values, dict):
        values = {name: getattr(values, name, None) for name in ("task", *SETTINGS)}
    settings: dict[str, Any] = {"scenario": values.get("task") or "arm_ibvs"}
    settings["observation"] = "pixels"
    for name in SETTINGS:
        if values.get(name) is not None:
            settings[name] = values[name]
    envs = gymnasium.make_vec(
        ANY,
        num_envs=n_envs,
        vectorization_mode="async" if use_async_envs else "sync",
        vector_kwargs={"context": "spawn"} if use_async_envs else {},
        **settings,
    )
    return {str(settings["scenario"]): {0: envs}}
