"""Losses in bursts, against the theory of the chain."""

import numpy as np
import pytest

import vstestbed as vs
from vstestbed.core.errors import ScenarioError
from vstestbed.timing.clock import BurstLoss, bursty_link, directions

MANY = 100_000
IDEAL = {"camera.rate_hz": 25, "detector": {"kind": "oracle", "field_of_view": "unlimited"}}


def losses(loss: BurstLoss, n: int = MANY) -> np.ndarray:
    loses = bursty_link(loss, np.random.default_rng(7))
    return np.array([loses(k) for k in range(n)])


def test_a_run_begins_in_the_state_that_the_chain_has_in_the_long_run():
    loss = BurstLoss(enter_probability=0.1, leave_probability=0.3)
    first = [bursty_link(loss, np.random.default_rng(seed))(0) for seed in range(2000)]
    assert np.mean(first) == pytest.approx(0.25, abs=4 * np.sqrt(0.25 * 0.75 / 2000))


def bursts(lost: np.ndarray) -> np.ndarray:
    """Lengths of the runs of losses."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], lost.astype(int), [0]])))
    return edges[1::2] - edges[::2]


@pytest.mark.parametrize(("p", "r"), [(0.02, 0.2), (0.1, 0.1), (0.3, 0.9)])
def test_share_and_length_of_gilberts_bursts(p: float, r: float):
    lost = losses(BurstLoss(enter_probability=p, leave_probability=r))
    # The variance of the mean of a chain with correlation c = 1 - p - r is s (1 - s) (1 + c) / (1 -
    # c) / n; four deviations.
    share, c = p / (p + r), 1 - p - r
    assert lost.mean() == pytest.approx(
        share, abs=4 * np.sqrt(share * (1 - share) * (1 + c) / (1 - c) / MANY)
    )
    length = bursts(lost)
    assert length.mean() == pytest.approx(
        1 / r, abs=4 * np.sqrt(1 - r) / r / np.sqrt(len(length)) + 1e-3
    )
    assert length.var() == pytest.approx((1 - r) / r**2, rel=0.15)  # geometric


def test_elliotts_losses_in_both_states():
    p, r, good, bad = 0.05, 0.2, 0.02, 0.7
    lost = losses(BurstLoss(enter_probability=p, leave_probability=r, good_loss=good, bad_loss=bad))
    assert lost.mean() == pytest.approx((r * good + p * bad) / (p + r), rel=0.03)
    # P(lost at k and at k + 1): both states have their own, and the chain is in the bad one with
    # the share p / (p + r).
    pi = np.array([r, p]) / (p + r)
    both = pi * [good, bad] @ np.array([[1 - p, p], [r, 1 - r]]) @ [good, bad]
    assert (lost[1:] & lost[:-1]).mean() == pytest.approx(both, rel=0.05)


def test_directions_are_independent_and_each_may_be_safe():
    rng = lambda: np.random.default_rng(1)  # noqa: E731 - the same numbers each time it is called
    pictures, commands = directions(BurstLoss(), rng())
    assert pictures is not None and commands is not None
    a, b = (np.array([loses(k) for k in range(20_000)]) for loses in (pictures, commands))
    assert abs(np.corrcoef(a, b)[0, 1]) < 0.06
    only, none = directions(BurstLoss(carries="pictures"), rng())
    assert none is None and only is not None and [only(k) for k in range(20_000)] == a.tolist()
    assert directions(None, rng()) == (None, None)


@pytest.mark.parametrize(
    "wrong",
    [{"leave_probability": 0}, {"enter_probability": 1.1}, {"good_loss": 1.0}, {"carries": "all"}],
)
def test_a_link_over_which_nothing_ever_comes_is_refused(wrong):
    with pytest.raises(ScenarioError, match=r"timing\.link"):
        vs.load("ibvs_book", {"timing.link": wrong})


class TestInRuns:
    def test_the_robot_keeps_its_last_command_until_it_ends(self):
        link = {"carries": "commands", "enter_probability": 0.3, "leave_probability": 0.25}
        r = vs.run(
            vs.load(
                "ibvs_book",
                IDEAL
                | {
                    "timing.link": link,
                    "timing.command_timeout_s": 0.2,
                    "stop.duration_s": 6,
                    "seed": 1,
                },
            )
        )
        lost, applied = (
            r["command_lost"].astype(bool),
            np.column_stack([r[f"applied_{n}"] for n in ("vx", "vy", "vz", "wx", "wy", "wz")]),
        )
        act = np.column_stack([r[f"act_{n}"] for n in ("vx", "vy", "vz", "wx", "wy", "wz")])
        last, ended, kept = None, 0, 0
        for k in range(len(lost)):
            if last is not None:
                alive = r["t"][k] - r["t"][last] <= 0.2 + 1e-9
                np.testing.assert_allclose(act[k], applied[last] if alive else 0.0, atol=1e-12)
                ended, kept = ended + (not alive), kept + (alive and last < k - 1)
            last = last if lost[k] else k
        assert ended > 3 and kept > 10
        s = r.summary()
        assert (
            s["commands_lost"] == lost.sum() > 20
            and s["pictures_lost"] == 0
            and "pictures_refused" not in s
        )

    def test_pictures_are_lost_in_bursts_and_counted(self):
        r = vs.run(
            vs.load(
                "ibvs_book",
                IDEAL | {"timing.link": {"carries": "pictures"}, "stop.duration_s": 20, "seed": 3},
            )
        )
        gaps = np.diff(r["frame"]) - 1
        assert r.summary()["pictures_lost"] == gaps.sum() + r["frame"][0] >= 10 and gaps.max() > 4
        assert "command_lost" not in r.columns
