"""A marker at the middle of the goal's picture, where polar and spherical coordinates have no
angle.
"""

from __future__ import annotations

import numpy as np
import pytest

import vstestbed as vs
from tests.laws.flight import fly
from tests.shortcuts import one_quick
from vstestbed.features import Polar, Spherical
from vstestbed.features.depth import OracleDepth
from vstestbed.laws import IBVS

SQUARE_AND_CENTRE = (
    (-0.25, -0.25, 0.0),
    (0.25, -0.25, 0.0),
    (0.25, 0.25, 0.0),
    (-0.25, 0.25, 0.0),
    (0.0, 0.0, 0.0),
)


@pytest.mark.parametrize("interaction", ["current", "desired", "mean"])
@pytest.mark.parametrize("feature", [Polar(), Spherical()], ids=lambda f: f.kind)
class TestIdealCamera:
    @pytest.mark.parametrize(
        ("xyz", "rpy_deg"),
        one_quick(
            ((0.3, 0.3, -2), (0, 0, 23)),
            ((0, 0, -1), (0, 0, 180)),
            ((-0.3, 0.5, -1.5), (-20, 15, -120)),
        ),
        ids=str,
    )
    def test_arrives(self, feature, interaction, xyz, rpy_deg):
        r = fly(
            IBVS(feature=feature, interaction=interaction, depth=OracleDepth()),
            xyz,
            rpy_deg=rpy_deg,
            at=SQUARE_AND_CENTRE,
        )
        assert r.outcome is vs.Outcome.converged
        assert r.summary()["max_retreat_m"] < 0.01

    def test_rests_at_the_goal(self, feature, interaction):
        """A hundredth of a pixel beside the goal is a hundredth of a millimetre: .5 to .8 m/s with
        the bearing as it is.
        """
        law = IBVS(feature=feature, interaction=interaction, depth=OracleDepth())
        r = fly(law, (1e-5, 0, -1), at=SQUARE_AND_CENTRE, norm_px=1e-3, duration_s=2)
        assert max(np.abs(r[f"cmd_v{axis}"]).max() for axis in "xyz") < 1e-4


@pytest.mark.parametrize("feature", one_quick("polar", "spherical"))
def test_the_arm_arrives(feature):
    target = {
        "kind": "points",
        "at": [list(p) for p in SQUARE_AND_CENTRE],
        "pose": {"xyz": [1.5, 0, 0.7], "rpy_deg": [0, 90, 0]},
    }
    r = vs.run(
        vs.load("arm_polar", {"target": target, "law.feature.kind": feature, "detector": "oracle"})
    )
    assert r.outcome is vs.Outcome.converged
    assert r["position_error_m"][-1] < 0.002
