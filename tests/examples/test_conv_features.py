"""Local features of one's own, as a plugin."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import vstestbed as vs

FILE = Path(__file__).parent / "conv_features.py"
NEAR = {"robot.start.nominal": {"xyz": [0.1, 0.05, -0.7], "rpy_deg": [3, -4, 8]}, "camera.width": 320, "camera.height": 240}


def test_a_network_of_one_s_own_finds_the_points_of_the_goal_s_picture():
    changes = NEAR | {"detector.features": {"kind": "conv", "most": 300}, "stop.duration_s": 0.5, "law.gain": 2}
    s = vs.load("camera_keypoints", changes, plugins=[str(FILE)])
    r = vs.run(s)
    off = np.column_stack([np.abs(r[f"u_{i}"] - r[f"u_true_{i}"]) for i in range(s.rows)])
    assert np.isfinite(off).sum(axis=1).min() >= 12 and np.nanmedian(off) < 0.08
    assert r["error_px"][-1] < 0.6 * r["error_px"][0]
