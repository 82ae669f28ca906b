"""The quadrotor from 20 random starts each, from rendered pictures and noisy instruments; one line
a start (-s shows them).
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import vstestbed as vs
from vstestbed.loop.recording import Recording

pytestmark = pytest.mark.study
SEEDS = range(20)


def fly(name: str, seed: int, **settings: Any) -> tuple[Recording, dict[str, Any]]:
    """One run, printed in a line; its time is that to converge,
    of runs that do not the whole one.
    """
    recording = vs.run(vs.load(name, settings, seed=seed))
    m = recording.summary()
    where = f"{m['final_position_error_m']:.4f} m {m['final_rotation_error_deg']:.3f} deg"
    print(
        name,
        *settings.values(),
        seed,
        m["outcome"],
        f"{m['time_to_converge_s'] or m['sim_time_s']:.1f} s",
        where,
        recording.reason,
        flush=True,
    )
    return recording, m


@pytest.mark.parametrize("name", ["quadrotor_hover", "quadrotor_perspective"])
def test_it_arrives_and_touches_nothing(name):
    runs = [fly(name, seed)[1] for seed in SEEDS]
    there = [
        m["outcome"] == "converged"
        and m["final_position_error_m"] < 0.05
        and m["final_rotation_error_deg"] < 1
        for m in runs
    ]
    assert sum(there) >= 19
    assert not any(m["outcome"] == "collided" for m in runs)


def test_it_holds_for_a_minute():
    for seed in SEEDS[:5]:
        never = {"stop.converged.error_px": 1e-3, "stop.duration_s": 90}
        r, _ = fly("quadrotor_hover", seed, **never)
        farthest = r["position_error_m"][r["t"] > 30].max()
        print(f"  farthest in the last minute {farthest:.4f} m", flush=True)
        assert farthest < 0.05


def test_derotation_takes_the_overshoot_away():
    over = {
        kind: np.array(
            [
                fly("quadrotor_aggressive", seed, derotation=kind)[1]["feature_overshoot"]
                for seed in SEEDS
            ]
        )
        for kind in ("none", "exact", "first_order", "as_printed")
    }
    for kind, o in over.items():
        print(kind, np.percentile(o, [25, 50, 75]), flush=True)
    assert np.median(over["none"] / over["exact"]) > 1.5
    assert np.median(over["as_printed"] - over["first_order"]) > 0.1


def test_it_stays_by_its_path():
    for seed in SEEDS:
        r, m = fly("quadrotor_path", seed)
        farthest = np.abs(r["task_error_m"][r["t"] > r.scenario.goal.settle_s]).max()
        print(f"  farthest {farthest:.4f} m", flush=True)
        assert m["outcome"] == "completed"
        assert farthest < 0.15


def test_gusts_blow_it_off_and_it_comes_back():
    for seed in SEEDS:
        r, m = fly("quadrotor_gust", seed)
        print(f"  farthest {r['position_error_m'][r['t'] > 5].max():.3f} m", flush=True)
        assert m["outcome"] == "converged"
        assert m["final_position_error_m"] < 0.1


def test_it_lands_on_a_car_that_drives_a_circle():
    runs = [
        fly("quadrotor_land", seed, **{"target.motion.speed_mps": (0.5, 0.75, 1.0)[seed % 3]})[1]
        for seed in SEEDS
    ]
    # within pad_m = .2 m at under touch_mps = .5 m/s
    assert sum(m["outcome"] == "landed" for m in runs) >= 18
