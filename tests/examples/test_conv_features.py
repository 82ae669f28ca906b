"""Local features of one's own, as a plugin."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import vstestbed as vs
import vstestbed.testing
from vstestbed.core.geometry import Array
from vstestbed.vision.local_features import Orb

pytestmark = pytest.mark.usefixtures("own_kinds")
FILE = Path(__file__).parent / "conv_features.py"
NEAR = {
    "robot.start.nominal": {"xyz": [0.1, 0.05, -0.7], "rpy_deg": [3, -4, 8]},
    "camera.width": 320,
    "camera.height": 240,
}


@pytest.mark.parametrize("kind", ["sift", "orb", "conv"])
def test_kinds_of_features_pass_their_suite(kind: str):
    vs.load("camera_keypoints", plugins=[str(FILE)])
    vs.testing.check_keypoints(vs.KEYPOINTS.members[kind]())


def test_features_that_find_other_places_fail_the_suite():
    class Aside:
        kind = "aside"

        def extract(self, image: NDArray[np.uint8]) -> tuple[Array, NDArray[np.uint8]]:
            uv, descriptors = Orb().extract(image)
            return uv + 0.02 * uv, descriptors

    with pytest.raises(AssertionError, match="aside: matches must be within"):
        vs.testing.check_keypoints(Aside(), within_px=0.5)


def test_a_network_of_one_s_own_finds_the_points_of_the_goal_s_picture():
    changes = NEAR | {
        "detector.features": {"kind": "conv", "most": 300},
        "stop.duration_s": 0.5,
        "law.gain": 2,
    }
    s = vs.load("camera_keypoints", changes, plugins=[str(FILE)])
    r = vs.run(s)
    off = np.column_stack([np.abs(r[f"u_{i}"] - r[f"u_true_{i}"]) for i in range(s.rows)])
    assert np.isfinite(off).sum(axis=1).min() >= 12 and np.nanmedian(off) < 0.08
    assert r["error_px"][-1] < 0.6 * r["error_px"][0]
