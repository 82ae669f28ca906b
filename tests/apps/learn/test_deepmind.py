"""The dm_env environments: dm_env's own conformance tests, on episodes that end by a success, by a
failure and by the clock.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import dm_env
import numpy as np
import pytest
import vstestbed.env
from absl.testing import absltest
from dm_env import test_utils

import vstestbed as vs


class Conformance(test_utils.EnvironmentTestMixin):
    settings: dict[str, Any]

    def make_object_under_test(self) -> dm_env.Environment:
        return vstestbed.env.dm(**self.settings, seed=0)

    def make_action_sequence(self) -> Iterator[Any]:
        for _ in range(25):
            yield 0.3 * self.make_action() + 0.1


class TestArm(Conformance, absltest.TestCase):
    settings = {  # noqa: RUF012 - a test's
        "scenario": "arm_ibvs",
        "observation": "both",
        "overrides": {"stop.duration_s": 0.4},
    }


@pytest.mark.study
class TestCar(Conformance, absltest.TestCase):
    settings = {  # noqa: RUF012 - a test's
        "scenario": "car_pbvs",
        "overrides": {"stop.duration_s": 0.4},
        "reward": "negative_error",
    }


class TestIdealCamera(Conformance, absltest.TestCase):
    settings = {  # noqa: RUF012 - a test's
        "scenario": "ibvs_book",
        "overrides": {"detector": "oracle", "stop.duration_s": 1.0},
    }


@pytest.mark.opengl
def test_it_is_the_gymnasium_environment_in_other_words() -> None:
    env, gym = vstestbed.env.dm("arm_ibvs"), vstestbed.env.make("arm_ibvs")
    first, (shown, info) = env.reset_to(4), gym.reset(seed=4)
    assert first.first() and env.info["seed"] == info["seed"] == 4
    np.testing.assert_equal(first.observation, shown)
    step, (shown, reward, *_, info) = env.step(np.full(6, 0.2)), gym.step(np.full(6, 0.2))
    np.testing.assert_equal(step.observation, shown)
    np.testing.assert_equal(env.info, info)
    assert step.mid() and step.reward == reward and step.discount == 1.0
    assert env.render().shape == (360, 640, 3)
    env.close()
    gym.close()


@pytest.mark.parametrize(
    ("ending", "discount"),
    [(vs.Outcome.timed_out, 1.0), (vs.Outcome.collided, 0.0), (vs.Outcome.converged, 0.0)],
)
def test_only_the_clock_leaves_a_future(
    ending: vs.Outcome, discount: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    from vstestbed.endings import Termination

    monkeypatch.setattr(
        Termination, "verdict", lambda termination, frame: (ending, "so") if frame.t > 0.1 else None
    )
    env = vstestbed.env.dm(
        "ibvs_book", overrides={"detector": "oracle"}, success_bonus=5.0, reward="sparse"
    )
    env.reset()
    last = [env.step(np.zeros(6)) for _ in range(2)][-1]
    assert (
        last.last()
        and last.discount == discount
        and last.reward == (5.0 if ending.success else 0.0)
    )
    assert env.info["is_success"] is ending.success
    assert env.step(np.zeros(6)).first()
    env.close()


def test_a_seed_repeats_the_sequence_of_episodes() -> None:
    def seeds(seed: int | None) -> list[int]:
        env = vstestbed.env.dm("ibvs_book", overrides={"detector": "oracle"}, seed=seed)
        return [env.info["seed"] for _ in range(3) if env.reset()]

    assert seeds(1) == seeds(1) != seeds(2)
    assert seeds(None) != seeds(None) and len(set(seeds(1))) == 3
