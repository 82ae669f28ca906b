"""The bundled learned policies: what their form promises, what they reach, and that weights and
curves are kept.
"""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

import numpy as np
import polars as pl
import pytest

import vstestbed as vs
from tests.shortcuts import one_quick

POLICIES = Path(__file__).parents[2] / "scenarios" / "policies"
RECURRENT = {
    "kind": "policy",
    "file": f"{POLICIES}/recurrent.py:Recurrent",
    "limits": {"speed_mps": 10, "rate_radps": 10},
}
GREY = {"kind": "policy", "file": f"{POLICIES}/grey.py:Grey", "picture_px": [80, 60]}
GOAL = np.array([[224.0, 144], [416, 144], [416, 336], [224, 336]], np.float32)


def module(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, POLICIES / f"{name}.py")
    assert spec is not None and spec.loader is not None
    found = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(found)
    return found


def seen(markers: np.ndarray, *hidden: int) -> dict[str, np.ndarray]:
    there = np.ones(4, np.float32)
    there[list(hidden)] = 0
    return {
        "markers": np.where(there[:, None] > 0, markers, 0).astype(np.float32),
        "goal": GOAL,
        "seen": there,
    }


def test_at_the_goal_the_recurrent_policy_rests_whatever_it_remembers():
    policy = module("recurrent").Recurrent()
    rng = np.random.default_rng(0)
    moves = [
        policy.act(seen(GOAL + rng.normal(0, 40, (4, 2)).astype(np.float32))) for _ in range(10)
    ]
    assert max(np.abs(u).max() for u in moves) > 0.01
    policy.past[:] = 0  # its last commands are over
    policy.act(seen(GOAL))
    policy.past[:] = 0
    assert np.abs(policy.h).max() > 0.1 and not policy.act(seen(GOAL)).any()


def test_a_hidden_marker_stays_where_it_was_and_the_first_view_must_be_whole():
    here = GOAL + np.array([[30, -20], [25, -18], [28, -25], [33, -22]], np.float32)
    first, second = (module("recurrent").Recurrent() for _ in range(2))
    assert first.act(seen(here, 2)) is None
    np.testing.assert_array_equal(first.act(seen(here)), second.act(seen(here)))
    rest = first.act(seen(here, 2))
    # it knows that it is hidden
    assert (
        rest is not None
        and np.abs(rest).max() < 10
        and not np.array_equal(rest, second.act(seen(here)))
    )
    np.testing.assert_array_equal(first.last, second.last)


def test_pixels_of_another_lens_are_the_same_view_to_it():
    here = GOAL + np.array([[30, -20], [25, -18], [28, -25], [33, -22]], np.float32)
    other = {"markers": 2 * here + 100, "goal": 2 * GOAL + 100, "seen": np.ones(4, np.float32)}
    np.testing.assert_allclose(
        module("recurrent").Recurrent().act(other),
        module("recurrent").Recurrent().act(seen(here)),
        atol=1e-6,
    )


@pytest.mark.parametrize("latency", one_quick(0.16, 0.0, 0.08))
def test_the_recurrent_policy_brings_the_arm_to_its_goal_with_late_pictures(latency: float):
    run = vs.run(
        vs.load("arm_ibvs", {"detector": "oracle", "camera.latency_s": latency, "law": RECURRENT})
    )
    assert run.outcome.name == "converged" and run.summary()["time_to_converge_s"] < 6


def test_it_follows_a_circle_closer_than_its_lag_would_let_it():
    changes = {"detector": "oracle", "target.side": 0.5, "law": RECURRENT, "stop.duration_s": 12}
    summary = vs.run(vs.load("arm_track_circle", changes)).summary()
    # a lag of the pictures' 40 ms alone is 0.1 m * 2 pi * 0.2 Hz * 0.04 s = 5 mm; of a gain of 4
    # 1/s 31 mm
    assert summary["tracking_rms_m"] < 0.016


def test_the_grey_policy_rests_at_its_goal_picture_and_reaches_it_from_nearby():
    policy, rng = module("grey").Grey(), np.random.default_rng(1)
    picture = rng.integers(0, 255, (60, 80, 3), dtype=np.uint8)
    assert not policy.act({"pixels": picture.copy(), "goal_pixels": picture}).any()
    run = vs.run(
        vs.load(
            "arm_photometric",
            {"law": GREY, "stop.duration_s": 6, "stop.converged": {"error_grey": 2, "hold_s": 0.2}},
        )
    )
    assert run.outcome.name == "converged"


@pytest.mark.parametrize(("name", "column"), [("recurrent", "loss"), ("grey", "relative_error")])
def test_weights_are_small_and_the_curve_of_the_training_is_kept(name: str, column: str):
    assert (POLICIES / f"{name}.npz").stat().st_size < 1e6
    curve = pl.read_csv(POLICIES / f"{name}.csv")
    assert len(curve) > 10 and curve[column][-1] < 0.7 * curve[column][0]
