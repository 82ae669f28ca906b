"""Every law on the arm, a wide lens and tags, from pixels, from twenty random starts each. Long:
pytest -m study -s prints the table.
"""

from __future__ import annotations

import numpy as np
import pytest

import vstestbed as vs

SEEDS = 20
SCENARIOS = (
    "arm_polar",
    "arm_spherical",
    "arm_partitioned",
    "arm_pbvs",
    "arm_hybrid",
    "arm_policy",
    "arm_fisheye",
    "arm_tags",
)
CANNOT = {
    ("arm_partitioned", 7): vs.Outcome.joint_limit,
    ("arm_partitioned", 15): vs.Outcome.joint_limit,
}
"""Starts that a law cannot handle, and how they end: the partitioned law's way takes the wrist
through its singularity (joint 5 passes zero), where joint 4 turns until it meets its limit,
whatever the gains.
"""


@pytest.mark.study
@pytest.mark.parametrize("name", SCENARIOS)
def test_arrives_from_everywhere(name: str, capsys: pytest.CaptureFixture[str]):
    runs = [vs.run(vs.load(name).randomised(seed)) for seed in range(SEEDS)]
    arrived = [r for r in runs if r.outcome.success]
    t = [r.summary()["time_to_converge_s"] for r in arrived]
    px, mm = (
        max(scale * r[column][-1] for r in arrived)
        for column, scale in (("error_px", 1), ("position_error_m", 1e3))
    )
    deg = max(np.degrees(r["rotation_error_rad"][-1]) for r in arrived)
    failed = {(name, seed): r.outcome for seed, r in enumerate(runs) if not r.outcome.success}
    with capsys.disabled():
        print(
            f"\n{name:16s} {len(arrived)}/{SEEDS}, {min(t):.1f} to {max(t):.1f} s,"
            f" worst {px:.2f} px {mm:.2f} mm {deg:.3f} deg {failed}"
        )
    assert failed == {key: outcome for key, outcome in CANNOT.items() if key[0] == name}
    assert px < 0.3 and mm < 5 and deg < 0.3
