"""A tracked poster in whole runs: found at the start, hidden for a while, from random starts, with
laws of every kind.
"""

from __future__ import annotations

import numpy as np
import pytest

import vstestbed as vs
from vstestbed.core.geometry import Array

PLATE = {"pose": {"xyz": [1.2, 0, 0.7], "rpy_deg": [0, 90, 0]}, "width": 1.2, "height": 1.2}


def _off(r: vs.Recording) -> Array:
    """Distances of the measured corners from the true ones, (frames, 4) [px]; NaN where they are
    not seen.
    """
    return np.stack(
        [
            np.hypot(r[f"u_{i}"] - r[f"u_true_{i}"], r[f"v_{i}"] - r[f"v_true_{i}"])
            for i in range(4)
        ],
        axis=1,
    )


def test_the_suite_of_detectors():
    vs.testing.check_detector(vs.vision.PatchDetector(), within_px=0.15)


def test_a_plate_hides_the_poster_for_a_while():
    """The arm's motion goes on to its stop while nothing is seen; the poster is found again where
    it then is.
    """
    r = vs.run(
        vs.load(
            "arm_patch",
            {"stop.duration_s": 0.8, "world.plates": [PLATE | {"from_s": 0.3, "until_s": 0.5}]},
        )
    )
    lost, t = r["lost"].astype(bool), r["t"]
    assert (
        lost[(t > 0.31) & (t < 0.49)].all()
        and not lost[t < 0.29].any()
        and not lost[t > 0.55].any()
    )
    assert np.nanmax(_off(r)) < 0.3


@pytest.mark.study
def test_the_arm_goes_on_after_the_plate():
    r = vs.run(vs.load("arm_patch", {"world.plates": [PLATE | {"from_s": 2, "until_s": 2.8}]}))
    assert r.outcome is vs.Outcome.converged and 15 <= r["lost"].sum() <= 25


@pytest.mark.study
@pytest.mark.parametrize("name", ["arm_patch", "quadrotor_patch"])
def test_from_ten_random_starts(name: str, capsys: pytest.CaptureFixture[str]):
    for seed in range(10):
        r = vs.run(vs.load(name).randomised(seed))
        off = _off(r)
        with capsys.disabled():
            final = (
                f"{1e3 * r['position_error_m'][-1]:.2f} mm,"
                f" {np.degrees(r['rotation_error_rad'][-1]):.3f} deg"
            )
            print(
                (
                    f"\n{name} {seed}: {r.outcome.name}, {final},"
                    f" corners {np.nanmedian(off):.3f} px, at most {np.nanmax(off):.2f}"
                ),
                end="",
            )
        assert r.outcome is vs.Outcome.converged and not r["lost"].any()
        assert np.nanmedian(off) < 0.1


@pytest.mark.study
@pytest.mark.parametrize(
    "law",
    [{"kind": "pbvs", "gain": 0.5}, {"kind": "hybrid", "gain": 0.5, "source": "homography"}],
    ids=["pbvs", "hybrid"],
)
def test_laws_of_other_kinds(law: dict[str, object]):
    assert vs.run(vs.load("arm_patch", {"law": law})).outcome is vs.Outcome.converged
