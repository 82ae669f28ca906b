"""What an episode is worth: the scenario's own law against giving up and against running into an
end, at every discount.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest

from tests.shortcuts import one_quick
from vstestbed.apps.learn.rollout import Rollout
from vstestbed.tasks.judged import Reward, RewardKind

DISCOUNTS = 0.9, 0.95, 0.99, 1.0
BUNDLED = "arm_ibvs", "arm_pbvs", "omni_ibvs", "car_pbvs", "quadrotor_hover", "arm_track_circle"
Policy = Callable[[Rollout], np.ndarray]


def motions(rollout: Rollout) -> int:
    return len(rollout.action_unit)


def still(rollout: Rollout) -> np.ndarray:
    return np.zeros(motions(rollout))


def at_random() -> Policy:
    rng = np.random.default_rng(0)
    return lambda rollout: rng.uniform(-1, 1, motions(rollout))


def along(motion: int, way: int) -> Policy:
    return lambda rollout: way * np.eye(motions(rollout))[motion]


def flown(rollout: Rollout, policy: Policy) -> tuple[list[float], dict[str, Any]]:
    """The rewards of the episode of seed 0, and the info at its end."""
    rollout.reset(0)
    rewards, over = [], False
    while not over:
        _, reward, terminated, truncated, info = rollout.step(policy(rollout))
        rewards.append(reward)
        over = terminated or truncated
    return rewards, info


def returned(rewards: list[float], discount: float) -> float:
    return sum(discount**k * reward for k, reward in enumerate(rewards))


def soonest_lost(rollout: Rollout) -> Policy:
    """The motion at full speed that loses the target, or runs into another end, first."""
    found = []
    for k in range(2 * motions(rollout)):
        policy = along(k // 2, 1 - 2 * (k % 2))
        rewards, info = flown(rollout, policy)
        if info["outcome"] != "timed_out" and not info["is_success"]:
            found.append((len(rewards), k, policy))
    return min(found)[2]


@pytest.mark.parametrize("ends", [True, False])
@pytest.mark.parametrize("discount", one_quick(*DISCOUNTS))
def test_the_law_wins_against_giving_up_and_against_an_end(
    quick: Path, discount: float, ends: bool
) -> None:
    def worth(policy: Policy) -> tuple[float, str]:
        given = {
            "reward": "negative_error",
            "discount": discount,
            "end_on_rest": ends,
            "end_on_loss": ends,
        }
        rewards, info = flown(
            Rollout(
                quick, success_bonus=0.0, overrides={"law.gain": 1.0, "stop.duration_s": 8}, **given
            ),
            policy,
        )
        return returned(rewards, discount), info["outcome"]

    best, outcome = worth(Rollout.expert)
    others = {"still": worth(still), "random": worth(at_random()), "away": worth(along(4, 1))}
    assert outcome == "converged"
    assert {name: how for name, (_, how) in others.items()} == (
        {"still": "local_minimum", "random": "target_lost", "away": "target_lost"}
        if ends
        else dict.fromkeys(others, "timed_out")
    )
    assert all(best > other for other, _ in others.values())


def test_an_end_is_charged_with_the_worst_error_of_all_steps_left() -> None:
    reward = Reward("negative_error", discount=0.9, success_bonus=2.0)
    assert reward.of_step(0.5, 0.4, terminated=True, success=False, left=3) == pytest.approx(
        -0.6 - 0.9 - 0.9**2 - 0.9**3
    )
    # also by the clock
    assert reward.of_step(0.5, 0.4, terminated=False, success=False, left=3) == pytest.approx(-0.6)
    assert reward.of_step(0.5, 1.0, terminated=True, success=True, left=3) == pytest.approx(2.0)
    assert (
        Reward("negative_error", discount=1.0).of_step(
            0.5, 0.0, terminated=True, success=False, left=700
        )
        == -701
    )


@pytest.mark.study
@pytest.mark.parametrize("name", BUNDLED)
def test_the_law_wins_in_bundled_scenarios(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every reward at every discount; each episode is flown once, and its steps are then valued by
    each of them.
    """
    steps: list[tuple[Any, ...]] = []
    value = Reward.of_step
    monkeypatch.setattr(Reward, "of_step", lambda reward, *step: steps.append(step) or 0.0)

    def episode(rollout: Rollout, policy: Policy) -> list[tuple[Any, ...]]:
        steps.clear()
        flown(rollout, policy)
        return list(steps)

    for ends in (True, False):
        rollout = Rollout(name, reward="negative_error", end_on_rest=ends, end_on_loss=ends)
        policies = {"still": still, "random": at_random()} | (
            {"lost": soonest_lost(rollout)} if ends else {}
        )
        best, others = (
            episode(rollout, Rollout.expert),
            {name: episode(rollout, policy) for name, policy in policies.items()},
        )
        rollout.close()
        for kind in get_args(RewardKind):
            for discount in DISCOUNTS:
                reward = Reward(kind, discount)
                expert, *worths = (
                    returned([value(reward, *step) for step in one], discount)
                    for one in (best, *others.values())
                )
                print(
                    name,
                    ends,
                    kind,
                    discount,
                    f"{expert:.4g}",
                    dict(zip(others, (f"{w:.4g}" for w in worths), strict=True)),
                )
                # A bonus that is hundreds of steps away is less than the rounding of the sum, at a
                # small discount.
                slack = 0.0 if kind == "negative_error" else 1e-12
                assert all(expert > worth - slack for worth in worths)
