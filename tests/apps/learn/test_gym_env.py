"""The Gymnasium environments: checked by Gymnasium's own checker, seeded as runs are, without a
trace of truth in what a policy sees.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
import vstestbed.env
from gymnasium.utils.env_checker import check_env

import vstestbed as vs
from tests.robots.arms import where_installed
from tests.shortcuts import one_quick
from vstestbed.apps.learn.gym_env import GymServo
from vstestbed.apps.learn.lerobot import make_env
from vstestbed.core.errors import EnvironmentLackError, ParameterError, ScenarioError, SessionError
from vstestbed.core.named_files import bundled_scenarios
from vstestbed.endings import Termination
from vstestbed.laws.policy import MOST_PX
from vstestbed.robots import Mount
from vstestbed.sim.base import IdealPlant, Truth
from vstestbed.sim.plant import MujocoPlant

MODES = "markers", "pixels", "both"
ROBOTS = "arm_ibvs", "car_pbvs", "omni_via_points", "quadrotor_hover", "ibvs_book"


def same(a: dict[str, Any], b: dict[str, Any]) -> bool:
    return a.keys() == b.keys() and all(
        a[k].dtype == b[k].dtype and a[k].tobytes() == b[k].tobytes() for k in a
    )


def moved(env: gymnasium.Env[Any, Any], seed: int, steps: int = 4) -> list[Any]:
    """What an episode of small random actions shows."""
    rng = np.random.default_rng(5)
    return [
        env.reset(seed=seed)[0],
        *(env.step(rng.uniform(-0.2, 0.2, env.action_space.shape))[0] for _ in range(steps)),
    ]


def test_there_is_an_id_for_every_bundled_scenario() -> None:
    ids = {name for name in gymnasium.registry if name.startswith("vstestbed/")}
    assert ids == {f"vstestbed/{name}-v0" for name in (*bundled_scenarios(), "scenario")}


@pytest.mark.parametrize(("name", "mode"), one_quick(("arm_ibvs", "both"), ("car_pbvs", "markers")))
def test_gymnasiums_checker_has_nothing_to_say(name: str, mode: str) -> None:
    checked_without_a_warning(name, mode)


@pytest.mark.study
@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("name", where_installed(bundled_scenarios()))
def test_the_checker_has_nothing_to_say_of_any_scenario(name: str, mode: str) -> None:
    checked_without_a_warning(name, mode)


def checked_without_a_warning(name: str, mode: str) -> None:
    env = gymnasium.make(f"vstestbed/{name}-v0", observation=mode)
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        check_env(env.unwrapped)  # also every render mode, by the id
    env.close()
    assert [str(warning.message) for warning in said] == []


@pytest.mark.parametrize(
    "name", [*ROBOTS[:2], *(pytest.param(name, marks=pytest.mark.study) for name in ROBOTS[2:])]
)
def test_a_seed_is_that_of_a_run(name: str) -> None:
    """The first picture, before any action, and the log's first row."""
    env = gymnasium.make(
        f"vstestbed/{name}-v0", observation="both", overrides={"stop.duration_s": 0.4}
    )
    shown, info = env.reset(seed=7)
    run = vs.run(vs.load(name, {"stop.duration_s": 0.4}, seed=7))
    with vs.Session(vs.load(name, {"stop.duration_s": 0.4}, seed=7), pictures=True) as session:
        frame = session.reset()
        assert frame.image is not None and shown["pixels"].tobytes() == frame.image.tobytes()
        while frame.outcome is None:
            frame = session.step(np.zeros(len(env.action_space.low)))
        resting = session.recording()
    assert (
        info["seed"] == 7
        and shown["markers"].tobytes() == frame_markers(run, len(shown["seen"])).tobytes()
    )
    np.testing.assert_allclose(info["truth"]["T_world_camera"], run.camera_poses()[0].A, atol=1e-12)
    over = False
    while not over:
        _, _, terminated, truncated, _ = env.step(np.zeros(env.action_space.shape))
        over = terminated or truncated
    assert isinstance(env.unwrapped, GymServo)
    assert env.unwrapped.recording().table.tobytes() == resting.table.tobytes()
    env.close()


def frame_markers(run: vs.Recording, n: int) -> np.ndarray:
    return np.nan_to_num(np.array([[run[f"u_{i}"][0], run[f"v_{i}"][0]] for i in range(n)])).astype(
        np.float32
    )


def test_episodes_without_a_seed_differ_and_a_seeded_first_one_repeats_them() -> None:
    env = gymnasium.make("vstestbed/arm_ibvs-v0")
    env.reset(seed=1)
    after = [env.reset() for _ in range(2)]
    assert not same(after[0][0], after[1][0]) and after[0][1]["seed"] != after[1][1]["seed"]
    env.reset(seed=1)
    assert same(env.reset()[0], after[0][0])
    env.close()


def test_a_scenario_without_random_starts_has_its_noise_seeded() -> None:
    env = vstestbed.env.make(
        "ibvs_retreat", overrides={"noise.pixel_sigma_px": 0.5, "detector": "oracle"}
    )
    first, again, other = (env.reset(seed=seed) for seed in (1, 1, 2))
    assert same(first[0], again[0]) and not same(first[0], other[0])
    np.testing.assert_array_equal(
        first[1]["truth"]["T_world_camera"], other[1]["truth"]["T_world_camera"]
    )
    env.close()


@pytest.mark.parametrize("name", ROBOTS)
def test_actions_are_shares_of_the_largest_velocities(name: str) -> None:
    env = vstestbed.env.make(
        name,
        overrides={
            "law.limits": {"speed_mps": 0.2, "rate_radps": 0.1},
            "timing.command_latency_s": 0,
        },
    )
    servo = env.unwrapped
    assert isinstance(servo, GymServo)
    env.reset(seed=0)
    action = np.zeros(env.action_space.shape)
    action[0], action[-1] = 5.0, -0.5  # clipped, and half
    env.step(action)
    log, robot = servo.recording(), servo.scenario.robot
    sent = [log[f"cmd_{c}"][0] for c in ("vx", "vy", "vz", "wx", "wy", "wz")]
    u = np.zeros(len(action))
    u[0], u[-1] = 0.2, -0.05
    basis = robot.motion_basis(Mount.of(servo.scenario.camera.mount.T), robot.start_joints())
    np.testing.assert_allclose(sent, basis @ u, atol=1e-12)
    env.close()


@pytest.mark.parametrize("name", ROBOTS)
def test_what_it_senses_of_itself_is_no_truth_and_follows_its_motion(name: str) -> None:
    env = vstestbed.env.make(name, disable_env_checker=True)
    robot = vs.load(name).robot
    shown = moved(env, seed=2, steps=6)
    env.close()
    if not robot.proprioception_names:
        assert "agent_pos" not in shown[0]
        return
    felt = np.array([one["agent_pos"] for one in shown])
    assert felt.shape == (7, len(robot.proprioception_names)) and np.isfinite(felt).all()
    assert (felt[0] != felt[-1]).any()
    if robot.base == "planar":
        # the place in the world is not what encoders tell
        np.testing.assert_array_equal(felt[0, :3], 0.0)


@pytest.mark.parametrize("name", ROBOTS)
def test_a_policy_as_a_law_is_shown_the_same_and_its_actions_mean_the_same(
    name: str, tmp_path: Path
) -> None:
    scenario = vs.load(name)
    mount = Mount.of(scenario.camera.mount.T)
    motions = scenario.robot.motion_basis(mount, scenario.robot.start_joints()).shape[1]
    source = f"""import numpy as np
def act(shown):
    keys = [key for key in ("markers", "seen", "goal", "agent_pos") if key in shown]
    sums = [np.sum(np.sin(shown[key])) for key in keys]
    return 0.1 * np.sin(np.arange({motions}) + sum(sums))
"""
    (tmp_path / "mine.py").write_text(source, encoding="utf-8")
    exec(source, own := {})
    law = {
        "kind": "policy",
        "file": f"{tmp_path / 'mine.py'}:act",
        "agent_pos": True,
        "depth": "floor" if scenario.robot.base == "planar" else "pnp",
    }
    env = GymServo(name, overrides={"law": law})
    shown, _ = env.reset(seed=1)
    for _ in range(3):
        np.testing.assert_allclose(env.expert(), own["act"](shown), atol=1e-7)
        shown, *_ = env.step(env.expert())
    env.close()


def test_via_points_change_the_goal_that_a_policy_sees() -> None:
    views = vs.load("omni_via_points").goal_views
    env = vstestbed.env.make(
        "omni_via_points", overrides={"goal.threshold_px": 1e5}, disable_env_checker=True
    )
    goals = [one["goal"] for one in moved(env, seed=0)]
    env.close()
    np.testing.assert_allclose(goals[0], views[0].uv)
    np.testing.assert_allclose(goals[-1], views[-1].uv)


class TestTruth:
    """Corrupted truth changes info, and nothing that a policy sees."""

    @staticmethod
    def corrupt(monkeypatch: pytest.MonkeyPatch) -> None:
        rng = np.random.default_rng(0)
        # one that believes the lies would end the run
        monkeypatch.setattr(Termination, "verdict", lambda termination, frame: None)
        for plant in (MujocoPlant, IdealPlant):
            true = plant.truth

            def lie(self: Any, true: Callable[[Any], Truth] = true) -> Truth:
                truth = true(self)
                poses = {
                    n: getattr(truth, n) + np.pad(rng.normal(size=(3, 1)), ((0, 1), (3, 0)))
                    for n in ("T_world_camera", "T_world_target")
                }
                garbage = {
                    n: rng.normal(size=np.shape(getattr(truth, n)))
                    for n in ("p_camera", "twist", "q", "qd", "ctrl", "act", "wind")
                }
                return truth._replace(hidden=~truth.hidden, **poses, **garbage)

            monkeypatch.setattr(plant, "truth", lie)

    @pytest.mark.parametrize(
        "name", ["arm_track_circle", "car_pbvs", "omni_via_points", "quadrotor_hover"]
    )
    def test_an_observation_has_none_of_it(
        self, name: str, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        env = gymnasium.make(f"vstestbed/{name}-v0", observation="both", disable_env_checker=True)
        honest, told = moved(env, seed=3), env.step(np.zeros(env.action_space.shape))[4]["truth"]
        self.corrupt(monkeypatch)
        lied, lies = moved(env, seed=3), env.step(np.zeros(env.action_space.shape))[4]["truth"]
        env.close()
        assert all(same(a, b) for a, b in zip(honest, lied, strict=True))
        assert not np.allclose(told["T_world_camera"], lies["T_world_camera"])

    def test_a_planted_number_is_found(self, monkeypatch: pytest.MonkeyPatch) -> None:
        from vstestbed.apps.learn.rollout import Rollout

        plain = Rollout._observation
        monkeypatch.setattr(
            Rollout,
            "_observation",
            lambda self, f: plain(self, f) | {"goal": plain(self, f)["goal"] + f.truth.twist[0]},
        )
        env = gymnasium.make("vstestbed/arm_ibvs-v0", disable_env_checker=True)
        honest = moved(env, seed=3)
        self.corrupt(monkeypatch)
        assert not all(same(a, b) for a, b in zip(honest, moved(env, seed=3), strict=True))
        env.close()


def driven(
    env: gymnasium.Env[Any, Any], seed: int
) -> tuple[list[float], list[float], bool, bool, dict[str, Any]]:
    """An episode that the scenario's own law drives: rewards, errors, how it ended."""
    servo = env.unwrapped
    assert isinstance(servo, GymServo)
    _, info = env.reset(seed=seed)
    rewards, errors, over = [], [info["error"]], (False, False)
    while not any(over):
        _, reward, *over, info = env.step(servo.expert())
        rewards.append(float(reward))
        errors.append(info["error"])
    return rewards, errors, *over, info


@pytest.fixture
def quick_env(quick: Path) -> Callable[..., gymnasium.Env[Any, Any]]:
    return lambda **settings: vstestbed.env.make(quick, **settings)


class TestEnds:
    def test_a_success_terminates_with_the_bonus(
        self, quick_env: Callable[..., gymnasium.Env[Any, Any]]
    ) -> None:
        rewards, errors, terminated, truncated, info = driven(
            quick_env(reward="sparse", success_bonus=3.0), 0
        )
        assert (terminated, truncated, info["is_success"], info["outcome"]) == (
            True,
            False,
            True,
            "converged",
        )
        assert rewards == [0.0] * (len(rewards) - 1) + [3.0]
        assert info["error"] < info["error_limit"] == 0.2 < errors[0]
        assert (
            info["error_unit"],
            info["error_by"],
        ) == ("px", "pixels")

    def test_potential_differences_telescope(
        self, quick_env: Callable[..., gymnasium.Env[Any, Any]]
    ) -> None:
        discount = 0.9
        rewards, errors, *_ = driven(quick_env(discount=discount, success_bonus=2.0), 0)
        total = sum(discount**k * reward for k, reward in enumerate(rewards))
        start = 1 - np.log1p(errors[0] / 0.2) / np.log1p(1e4)
        assert total == pytest.approx(2.0 * discount ** (len(rewards) - 1) - start)

    def test_a_negative_error_rises_to_the_goal(
        self, quick_env: Callable[..., gymnasium.Env[Any, Any]]
    ) -> None:
        rewards, errors, *_ = driven(quick_env(reward="negative_error", success_bonus=0.0), 0)
        assert (
            all(-1 <= reward <= 0 for reward in rewards)
            and rewards[-1] > rewards[0]
            and errors[0] > errors[-1]
        )

    def test_a_time_out_truncates(self, quick_env: Callable[..., gymnasium.Env[Any, Any]]) -> None:
        env = quick_env(overrides={"stop.duration_s": 0.2})
        env.reset(seed=0)
        steps = 0
        over = (False, False)
        while not any(over):
            _, _, *over, info = env.step(np.full(6, 1e-3))
            steps += 1
        assert (
            list(over) == [False, True]
            and info["outcome"] == "timed_out"
            and not info["is_success"]
        )
        assert (
            steps == env.get_wrapper_attr("_max_episode_steps") and "not enough" in info["reason"]
        )
        with pytest.raises(SessionError, match=r"the episode has ended: .*; call reset"):
            env.step(np.zeros(6))

    def test_lost_markers_have_no_error_and_the_worst_potential(
        self, quick_env: Callable[..., gymnasium.Env[Any, Any]]
    ) -> None:
        env = quick_env(overrides={"stop.lost_after_s": 0.2})
        shown, info = env.reset(seed=0)
        nearness = 1 - np.log1p(info["error"] / 0.2) / np.log1p(1e4)
        rewards, over = [], (False, False)
        while not any(over):
            shown, reward, *over, info = env.step(np.array([0, 0, 0, 1, 0, 0]))
            rewards.append(reward)
        assert (
            list(over) == [True, False]
            and info["outcome"] == "target_lost"
            and np.isnan(info["error"])
        )
        unseen = shown["seen"] == 0
        assert unseen.any() and not shown["markers"][unseen].any()
        assert rewards[-1] == 0.0
        assert sum(0.99**k * r for k, r in enumerate(rewards)) == pytest.approx(-nearness)

    def test_a_learner_may_lose_the_target_and_find_it_again(
        self, quick_env: Callable[..., gymnasium.Env[Any, Any]]
    ) -> None:
        """Turned away for far longer than `lost_after_s`, and back: the robot still obeys, and the
        law then reaches the goal.
        """
        env = quick_env(
            overrides={"stop.lost_after_s": 0.2, "stop.lost_after_m": 0.01},
            end_on_loss=False,
            end_on_rest=False,
        )
        env.reset(seed=0)
        away = np.array([0.1, 0, 0, 0, 1, 0])
        for action in (*[away] * 30, *[-away] * 30):
            shown, _, terminated, truncated, info = env.step(action)
            assert not (terminated or truncated)
            if not shown["seen"].any():
                assert np.isnan(info["error"])
        assert shown["seen"].all()
        servo, over = env.unwrapped, [False, False]
        assert isinstance(servo, GymServo)
        while not any(over):
            _, _, *over, info = env.step(servo.expert())
        assert info["outcome"] == "converged"

    def test_a_learner_may_rest_and_cross_the_plane(
        self, quick_env: Callable[..., gymnasium.Env[Any, Any]]
    ) -> None:
        ends = {}
        for off in (False, True):
            for name, action in (("rest", np.zeros(6)), ("behind", np.array([0, 0, 1.0, 0, 0, 0]))):
                env, over = (
                    quick_env(
                        overrides={"stop.duration_s": 3}, end_on_rest=not off, end_on_loss=not off
                    ),
                    [False, False],
                )
                env.reset(seed=0)
                while not any(over):
                    _, _, *over, info = env.step(action)
                ends[name, off] = info["outcome"], bool(info["truth"]["T_world_camera"][2, 3] > 2)
        assert ends == {
            ("rest", False): ("local_minimum", False),
            ("behind", False): ("target_lost", False),
            ("rest", True): ("timed_out", False),
            ("behind", True): ("timed_out", True),
        }

    def test_a_run_that_ends_with_its_first_picture_is_told_by_the_first_step(
        self, quick_env: Callable[..., gymnasium.Env[Any, Any]], monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr(
            Termination,
            "verdict",
            lambda termination, frame: (vs.Outcome.collided, "contact at the start"),
        )
        env = quick_env()
        assert env.reset(seed=0)[1]["outcome"] == "collided"
        _, _, terminated, _, info = env.step(np.zeros(6))
        assert terminated and info["reason"] == "contact at the start"
        with pytest.raises(SessionError):
            env.step(np.zeros(6))


class TestMistakes:
    @pytest.mark.parametrize("action", [np.zeros(5), np.zeros((6, 1)), "fast", 0.1])
    def test_of_the_actions_shape(self, quick: Path, action: Any) -> None:
        env = GymServo(quick)
        env.reset()
        with pytest.raises(ParameterError, match=r"action must be 6 numbers in \[-1, 1\]"):
            env.step(action)

    def test_of_numbers_that_are_none(self, quick: Path) -> None:
        env = GymServo(quick)
        env.reset()
        with pytest.raises(ParameterError, match="action must be finite"):
            env.step(np.array([0, 0, 0, 0, 0, np.nan]))

    def test_before_reset(self, quick: Path) -> None:
        env = GymServo(quick, render_mode="rgb_array")
        with pytest.raises(SessionError, match="call reset"):
            env.step(np.zeros(6))
        with pytest.raises(SessionError, match="call reset"):
            env.render()
        env.close()

    def test_of_a_setting(self, quick: Path) -> None:
        for settings, words in (
            ({"observation": "depth"}, "observation must be one of markers, pixels, both"),
            ({"reward": "dense"}, "reward must be one of potential, negative_error, sparse"),
            ({"discount": 0}, "discount must be over 0"),
            ({"success_bonus": np.nan}, "success_bonus must be finite"),
            ({"render_mode": "human"}, "render_mode must be None or rgb_array"),
        ):
            with pytest.raises(ParameterError, match=words):
                GymServo(quick, **settings)

    def test_of_the_scenario(self) -> None:
        with pytest.raises(ScenarioError, match="did you mean 'arm_ibvs'"):
            vstestbed.env.make("arm_ibv")
        with pytest.raises(ParameterError, match="overrides is for a scenario given by name"):
            GymServo(vs.load("arm_ibvs"), overrides={"seed": 1})

    def test_without_gymnasium_a_sentence_says_what_to_install(
        self, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr(vstestbed.env, "find_spec", lambda name: None)
        with pytest.raises(
            EnvironmentLackError,
            match=r"Gymnasium is not installed; pip install 'vstestbed\[env\]'",
        ):
            vstestbed.env.make("arm_ibvs")


def test_nothing_is_simulated_or_drawn_before_the_first_reset(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def refuse(*_: Any, **__: Any) -> None:
        raise RuntimeError("built")

    monkeypatch.setattr("vstestbed.loop.plants.build_plant", refuse)
    env = gymnasium.make("vstestbed/arm_ibvs-v0", observation="pixels", render_mode="rgb_array")
    with pytest.raises(RuntimeError, match="built"):
        env.reset()


@pytest.mark.opengl
def test_the_view_from_outside_is_the_films() -> None:
    env = gymnasium.make("vstestbed/arm_ibvs-v0", render_mode="rgb_array")
    env.reset(seed=0)
    first = env.render()
    env.step(np.full(6, 0.5))
    for _ in range(10):
        env.step(np.full(6, 0.5))
    last = env.render()
    env.close()
    assert isinstance(first, np.ndarray) and isinstance(last, np.ndarray)
    assert first.shape == last.shape == (360, 640, 3) and first.dtype == np.uint8
    assert 0.01 < (first != last).any(axis=2).mean() < 0.9
    assert env.unwrapped.metadata["render_fps"] == 25


@pytest.mark.study
def test_two_in_processes_give_the_numbers_of_single_ones(quick: Path) -> None:
    in_processes_as_alone(2, "vstestbed/scenario-v0", {"scenario": str(quick)})


@pytest.mark.study
@pytest.mark.parametrize("context", ["spawn", "forkserver"])
def test_four_with_pictures_in_processes_give_the_numbers_of_single_ones(context: str) -> None:
    in_processes_as_alone(4, "vstestbed/arm_ibvs-v0", {"observation": "both"}, context)


def in_processes_as_alone(
    n: int, name: str, settings: dict[str, Any], context: str = "spawn"
) -> None:
    actions = np.random.default_rng(0).uniform(-0.2, 0.2, (5, n, 6))
    vector = gymnasium.make_vec(
        name, num_envs=n, vectorization_mode="async", vector_kwargs={"context": context}, **settings
    )
    shown, rewards = [vector.reset(seed=list(range(n)))[0]], []
    for action in actions:
        seen, reward, _, _, info = vector.step(action)
        shown.append(seen)
        rewards.append(reward)
    assert not info["is_success"].any() and info["truth"]["T_world_camera"].shape == (n, 4, 4)
    assert vector.call("task_description")[0] and vector.call("_max_episode_steps")[0] > 100
    vector.close()
    for i in range(n):
        env = gymnasium.make(name, **settings)
        alone = [env.reset(seed=i)[0]]
        for k, action in enumerate(actions):
            seen, reward, *_ = env.step(action[i])
            alone.append(seen)
            assert reward == rewards[k][i]
        assert all(
            same({name: value[i] for name, value in together.items()}, one)
            for together, one in zip(shown, alone, strict=True)
        )
        env.close()


def test_an_action_may_hold_for_several_frames() -> None:
    overrides = {"detector": "oracle", "stop.duration_s": 0.5}
    once, thrice = (
        gymnasium.make("vstestbed/ibvs_book-v0", overrides=overrides, action_repeat=k)
        for k in (1, 3)
    )
    once.reset(seed=2), thrice.reset(seed=2)
    action = np.full(6, 0.02)
    for _ in range(3):
        shown, *_, info = once.step(action)
    held, reward, terminated, truncated, held_info = thrice.step(action)
    assert same(shown, held) and held_info["t"] == info["t"] and not (terminated or truncated)
    before = thrice.unwrapped._rollout._phi  # type: ignore[attr-defined] - a GymServo
    assert reward == pytest.approx(0.99 * before - potential_at_start(overrides))
    steps = 1
    while not truncated:
        _, _, _, truncated, _ = thrice.step(action)
        steps += 1
    assert steps == thrice.unwrapped._rollout.most_steps == 2  # type: ignore[attr-defined] - a GymServo
    with pytest.raises(ParameterError, match="action_repeat"):
        gymnasium.make("vstestbed/ibvs_book-v0", action_repeat=0)


def potential_at_start(overrides: dict[str, Any]) -> float:
    env = gymnasium.make("vstestbed/ibvs_book-v0", overrides=overrides)
    env.reset(seed=2)
    return env.unwrapped._rollout._phi  # type: ignore[attr-defined] - a GymServo


def test_info_has_what_the_seed_drew(tmp_path: Path) -> None:
    drawn = {
        "randomise": [{"field": "camera.latency_s", "uniform": [0.0, 0.1]}],
        "detector": "oracle",
    }
    env = gymnasium.make("vstestbed/arm_ibvs-v0", overrides=drawn)
    found = [env.reset(seed=seed)[1]["randomised"]["camera.latency_s"] for seed in (1, 2, 1)]
    assert found[0] == found[2] != found[1] and all(0 <= value <= 0.1 for value in found)
    assert found[0] == vs.load("arm_ibvs", drawn, seed=1).resolved.camera.latency_s


def test_observations_are_float32_within_the_pictures_borders() -> None:
    env = gymnasium.make(
        "vstestbed/arm_ibvs-v0", overrides={"stop.duration_s": 0.2, "noise.pixel_sigma_px": 500.0}
    )
    shown, _ = env.reset(seed=1)
    assert {value.dtype for value in shown.values()} == {np.dtype(np.float32)}
    space = env.observation_space["markers"]
    assert (space.low == -0.5).all() and (space.high == [639.5, 479.5]).all()
    # what noise puts beyond lies on them
    assert np.isin(shown["markers"], [-0.5, 639.5, 479.5]).any()
    assert env.observation_space.contains(shown)
    assert env.action_space.contains(env.unwrapped.expert())
    env.close()
    wide = GymServo(
        "ibvs_book", overrides={"detector": {"kind": "oracle", "field_of_view": "unlimited"}}
    )
    assert (wide.observation_space["markers"].high == MOST_PX).all()


def test_pictures_are_scaled_and_the_detector_sees_its_own() -> None:
    small, own = (
        gymnasium.make(
            "vstestbed/arm_ibvs-v0",
            observation="both",
            overrides={"stop.duration_s": 0.2},
            picture_px=size,
        )
        for size in ((64, 48), None)
    )
    (a, _), (b, _) = small.reset(seed=2), own.reset(seed=2)
    assert a["pixels"].shape == (48, 64, 3) == small.observation_space["pixels"].shape
    np.testing.assert_array_equal(a["markers"], b["markers"])
    means = b["pixels"].reshape(48, 10, 64, 10, 3).mean(axis=(1, 3))
    assert np.abs(a["pixels"] - means).max() <= 1
    small.close()
    own.close()
    with pytest.raises(ParameterError, match="picture_px must be two whole numbers over 0"):
        GymServo("arm_ibvs", picture_px=(64, 0))


def test_an_episode_has_values_of_its_own() -> None:
    env = gymnasium.make("vstestbed/ibvs_book-v0", overrides={"law.gain": 0.02})
    plain, _ = env.reset(seed=3)
    step = env.unwrapped.expert()
    env.reset(seed=3, options={"overrides": {"law.gain": 0.04}})
    np.testing.assert_allclose(env.unwrapped.expert(), 2 * step, rtol=1e-5)
    again, _ = env.reset(seed=3)
    np.testing.assert_allclose(env.unwrapped.expert(), step)
    np.testing.assert_array_equal(again["markers"], plain["markers"])
    with pytest.raises(
        ParameterError, match="must leave markers, robot, limits and size of pictures"
    ):
        env.reset(options={"overrides": {"camera.width": 1100}})
    with pytest.raises(ParameterError, match="by name or path"):
        GymServo(vs.load("ibvs_book")).reset(options={"overrides": {"law.gain": 2.0}})
    env.close()


def test_the_spec_tells_how_long_an_episode_may_be() -> None:
    env = gymnasium.make(
        "vstestbed/arm_ibvs-v0", overrides={"stop.duration_s": 2.0}, action_repeat=2
    )
    assert env.spec.max_episode_steps == env.unwrapped.spec.max_episode_steps == 25
    assert gymnasium.make(env.spec).spec.max_episode_steps == 25
    many = gymnasium.make_vec(
        "vstestbed/ibvs_book-v0", num_envs=2, vectorization_mode="vector_entry_point", ideal=True
    )
    assert many.spec.max_episode_steps == many.unwrapped._max_episode_steps > 100
    many.close()


def test_lerobots_evaluation_gets_its_environments() -> None:
    made = make_env(
        2,
        False,
        {"task": "arm_ibvs", "picture_px": (32, 24), "overrides": {"stop.duration_s": 0.2}},
    )
    envs = made["arm_ibvs"][0]
    shown, info = envs.reset(seed=[4, 5])
    assert (
        shown["pixels"].shape == (2, 24, 32, 3)
        and shown["agent_pos"].shape == (2, 6)
        and "markers" not in shown
    )
    assert envs.call("task_description")[0] == vs.load("arm_ibvs").description
    assert envs.call("_max_episode_steps") == (5, 5)
    assert not info.get("is_success", np.zeros(2)).any()
    envs.close()

    class Config:
        task = "ibvs_book"
        observation = "markers"

    (name,) = make_env(cfg=Config())
    assert (
        name == "ibvs_book"
        and next(iter(make_env())) == "arm_ibvs"
        and next(iter(make_env(cfg="car_pbvs"))) == "car_pbvs"
    )
