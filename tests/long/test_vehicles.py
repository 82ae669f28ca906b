"""Vehicles from 20 random starts each, rendered; one line a start (-s shows them)."""

import numpy as np
import pytest

import vstestbed as vs

pytestmark = pytest.mark.study


def arrivals(name: str, position_m: float, rotation_deg: float, **settings: object) -> int:
    """How many of the seeds 0 to 19 end `converged` and truly that near."""
    there = 0
    for seed in range(20):
        recording = vs.run(vs.load(name, settings, seed=seed))
        m = recording.summary()
        good = recording.outcome.name == "converged"
        good = (
            good
            and m["final_position_error_m"] < position_m
            and m["final_rotation_error_deg"] < rotation_deg
        )
        there += bool(good)
        where = f"{m['final_position_error_m']:.4f} m {m['final_rotation_error_deg']:.3f} deg"
        print(name, seed, m["outcome"], f"{m['time_to_converge_s']} s {where}", flush=True)
    return there


@pytest.mark.parametrize("name", ["omni_ibvs", "omni_ibvs_up", "omni_catadioptric"])
def test_the_omnidirectional_base_arrives(name):
    assert arrivals(name, 0.02, 0.5) >= 19


@pytest.mark.parametrize("name", ["car_pbvs", "car_parking", "car_catadioptric"])
def test_the_car_arrives(name):
    assert arrivals(name, 0.10, 5.0) >= 18


@pytest.mark.parametrize("name", ["car_pbvs", "car_parking", "car_catadioptric"])
def test_the_steering_does_not_hunt_at_the_goal(name):
    """Back and forth over the last 20 cm: 1.5 to 5 rad where each frame's curvature counts by
    itself.
    """
    for seed in range(1, 11):
        r = vs.run(vs.load(name, seed=seed))
        steering = r["q_steering"][r["position_error_m"] < 0.2]
        swing = float(np.abs(np.diff(steering)).sum() - abs(steering[-1] - steering[0]))
        print(name, seed, r.outcome.name, f"{swing:.2f} rad", flush=True)
        assert swing < 0.8
