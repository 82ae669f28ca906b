"""Many environments by arrays: the same episodes as of one environment each, seed by seed and
action by action.
"""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest
import vstestbed.env

import vstestbed as vs
from vstestbed.apps.learn.vector_env import GymServos
from vstestbed.core.errors import ParameterError, SessionError

IDEAL = {"detector": "oracle"}
N = 6


def made(mode: str, n: int = N, name: str = "ibvs_book", **settings: Any) -> Any:
    overrides = IDEAL | settings.pop("overrides", {})
    return gymnasium.make_vec(
        f"vstestbed/{name}-v0", num_envs=n, vectorization_mode=mode, overrides=overrides, **settings
    )


def towards(env: GymServos) -> np.ndarray:
    """Actions of the scenario's law, so that episodes also end at the goal."""
    runs, s = env._runs, env.scenario
    assert runs is not None
    twists = []
    for T in runs.T:
        goal = s.goal_view
        uv = s.camera.project(s.target.points_at(T))
        seen = vs.Observation(0.0, uv, s.camera.normalise(uv), s.target.points_at(T)[:, 2], T)
        twists.append(s.law.step(s.law.init(goal), seen, goal, np.eye(6))[1].twist)
    return np.clip(np.array(twists) / env._unit, -1, 1)


@pytest.mark.parametrize(
    ("settings", "share"),
    [
        ({"reward": "potential"}, 0.0),
        ({"reward": "negative_error", "overrides": {"stop.duration_s": 3.0}}, 1.0),
        ({"reward": "sparse", "end_on_loss": False, "overrides": {"stop.duration_s": 4.0}}, 0.0),
        ({"overrides": {"stop.rest_after_s": 0.3}}, 0.0),
    ],
    ids=["lost", "time", "no loss", "rest"],
)
def test_episodes_are_those_of_single_environments(settings: dict[str, Any], share: float) -> None:
    arrays, single = made("vector_entry_point", **settings), made("sync", **settings)
    a, b, ends = arrays.reset(seed=3), single.reset(seed=3), set()
    rng = np.random.default_rng(0)
    for k in range(160):
        for key, values in a[0].items():
            assert values.dtype == np.float32
            assert values == pytest.approx(b[0][key], rel=1e-6, abs=1e-3)
        assert arrays.observation_space.contains(a[0])
        for name in ("outcome", "is_success", "seed"):
            assert (a[-1][name] == b[-1][name]).all(), (k, name)
        assert a[-1]["t"] == pytest.approx(b[-1]["t"], abs=1e-9)
        assert a[-1]["error"] == pytest.approx(b[-1]["error"], nan_ok=True, rel=1e-6)
        wild = rng.uniform(-1, 1, (N, 6)) * (
            0.6 if "stop.rest_after_s" not in settings.get("overrides", {}) else (k % 40 < 20)
        )
        action = (share * towards(arrays.unwrapped) + (1 - share) * wild).astype(np.float32)
        a, b = arrays.step(action), single.step(action)
        assert (
            a[1] == pytest.approx(b[1], abs=1e-6) and (a[2] == b[2]).all() and (a[3] == b[3]).all()
        )
        ends |= set(a[-1]["outcome"])
    assert len(ends) > 1 or settings.get("end_on_loss") is False
    arrays.close(), single.close()


def test_an_episode_that_ends_with_its_first_frame_tells_it_in_its_first_step() -> None:
    at_goal = {"overrides": {"stop.converged": {"error_px": 5000, "hold_s": 0.0}}}
    arrays, single = made("vector_entry_point", 3, **at_goal), made("sync", 3, **at_goal)
    arrays.reset(seed=1), single.reset(seed=1)
    for _ in range(5):
        a, b = arrays.step(np.full((3, 6), 0.1)), single.step(np.full((3, 6), 0.1))
        assert (
            a[1] == pytest.approx(b[1], abs=1e-6)
            and (a[2] == b[2]).all()
            and (a[-1]["seed"] == b[-1]["seed"]).all()
        )
    single.close()


def test_the_law_reaches_the_goal_and_success_is_told() -> None:
    env = made("vector_entry_point", 4)
    _, info = env.reset(seed=0)
    reached = np.zeros(4, dtype=bool)
    for _ in range(400):
        _, reward, terminated, _, info = env.step(towards(env.unwrapped))
        assert (info["is_success"] <= terminated).all() and (reward[info["is_success"]] > 5).all()
        reached |= info["is_success"]
    assert reached.all() and (info["t"] < 400 * 0.1).all()


def test_a_mask_begins_some_of_them() -> None:
    env = made("vector_entry_point", 3)
    with pytest.raises(SessionError):
        env.step(np.zeros((3, 6)))
    env.reset(seed=[5, 6, 7])
    for _ in range(3):
        before, *_ = env.step(np.full((3, 6), 0.01))
    after, info = env.reset(
        seed=[9, None, None], options={"reset_mask": np.array([True, False, False])}
    )
    assert info["seed"].tolist() == [9, 6, 7] and info["t"][0] == 0 < info["t"][1]
    assert (after["markers"][1:] == before["markers"][1:]).all()
    assert not np.allclose(after["markers"][0], before["markers"][0])


def test_what_a_batch_leaves_out_is_not_left_out_silently() -> None:
    with pytest.raises(
        ParameterError,
        match=(
            r"ideal must be True .* leaves out the dynamics"
            r" and limits of robot puma560.*detector blobs"
        ),
    ):
        gymnasium.make_vec(
            "vstestbed/arm_ibvs-v0", num_envs=2, vectorization_mode="vector_entry_point"
        )
    env = gymnasium.make_vec(
        "vstestbed/arm_ibvs-v0", num_envs=2, vectorization_mode="vector_entry_point", ideal=True
    )
    shown, _ = env.reset(seed=4)
    arm = gymnasium.make("vstestbed/arm_ibvs-v0", overrides=IDEAL)
    # the arm's own start
    assert shown["markers"][0] == pytest.approx(arm.reset(seed=4)[0]["markers"], abs=0.01)
    with pytest.raises(ParameterError, match="observation must be markers"):
        made("vector_entry_point", observation="pixels")
    with pytest.raises(ParameterError, match="action_repeat must be 1"):
        made("vector_entry_point", action_repeat=2)
    with pytest.raises(ParameterError, match=r"shape \(2, 6\)"):
        env.step(np.zeros((2, 5)))
    with pytest.raises(ParameterError, match="in 3 directions"):
        made("vector_entry_point", name="omni_via_points", ideal=True)
