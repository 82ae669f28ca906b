"""An exact half turn about the optical axis, at the goal's depth: which law does what (ideal
camera, oracle, no border).
"""

from __future__ import annotations

import numpy as np
import pytest

import vstestbed as vs
from tests.laws.flight import fly
from tests.shortcuts import one_quick
from vstestbed.features import LineFeature, Point, Polar, Spherical
from vstestbed.features.depth import OracleDepth
from vstestbed.laws import IBVS, PBVS, Hybrid, Law, Partitioned

TRUE = OracleDepth()


def half_turn(law: Law) -> vs.Recording:
    return fly(law, (0, 0, -1), np.pi)


def test_points_with_the_current_matrix_diverge():
    r = half_turn(IBVS(feature=Point(), interaction="current", depth=TRUE))
    assert r.outcome is vs.Outcome.diverged
    assert r.summary()["max_retreat_m"] > 100


def test_points_with_the_desired_matrix_cross_the_target():
    r = half_turn(IBVS(feature=Point(), interaction="desired", depth=TRUE))
    assert r.outcome is vs.Outcome.target_lost
    assert "crossed the plane" in r.reason


def test_points_with_the_mean_matrix_stand_still():
    r = half_turn(IBVS(feature=Point(), interaction="mean", depth=TRUE))
    assert r.outcome is vs.Outcome.local_minimum
    assert r.summary()["path_length_m"] < 1e-6
    # every marker where the opposite one should be
    assert r["error_px"][-1] == pytest.approx(2 * 200, rel=1e-3)


LAWS: dict[str, Law] = {
    "polar, current": IBVS(feature=Polar(), interaction="current", depth=TRUE),
    "polar, mean": IBVS(feature=Polar(), interaction="mean", depth=TRUE),
    "spherical, current": IBVS(feature=Spherical(), interaction="current", depth=TRUE),
    "spherical, mean": IBVS(feature=Spherical(), interaction="mean", depth=TRUE),
    "line, mean": IBVS(feature=LineFeature(), interaction="mean", depth=TRUE),
    "partitioned": Partitioned(depth=TRUE),
    "PBVS, cdMc": PBVS(),
    "PBVS, cMcd": PBVS(translation="cMcd"),
    "PBVS, cMo": PBVS(translation="cMo"),
    "2.5D, homography": Hybrid(),
    "2.5D, model": Hybrid(source="model"),
}


@pytest.mark.parametrize("name", one_quick(*LAWS, every=3))
def test_the_others_turn_on_the_spot(name: str):
    r = half_turn(LAWS[name])
    assert r.outcome is vs.Outcome.converged
    assert r.summary()["max_retreat_m"] < 0.05
    assert r.summary()["max_rotation_deg"] == pytest.approx(180, abs=0.01)
