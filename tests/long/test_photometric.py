"""How far the photometric law reaches, beside that of points, and what light and an obstacle do to
it. With -s it prints the tables.
"""

from __future__ import annotations

import numpy as np
import pytest

import vstestbed as vs

pytestmark = pytest.mark.study

LATERAL_M = (0.0, 0.03, 0.06, 0.09, 0.12)
TURN_DEG = (0, 10, 20, 30, 45)
SMALL = {
    "camera.width": 160,
    "camera.height": 120,
    "camera.focal_length_m": 0.00435,
    "law.margin_px": 5,
    "stop.duration_s": 12,
}
LAWS = {
    "as printed, without blur": SMALL | {"law.smooth_px": 0.0},
    "as printed, blur 1.5 px": SMALL,
    "mean, 4 levels": SMALL | {"law.interaction": "mean", "law.levels": 4, "law.gain": 10},
    "points": {
        "law": {"kind": "ibvs", "gain": 10},
        "detector": {"kind": "oracle", "field_of_view": "unlimited"},
        "stop.converged": {"error_px": 0.2},
        "stop.duration_s": 12,
    },
}
NEAR = {
    "robot.start.nominal": {"xyz": [0.02, -0.01, -1.05], "rpy_deg": [1, 1, 4]},
    "law.interaction": "mean",
    "law.levels": 4,
    "law.gain": 10,
    "law.damping.after_s": 1,
    "stop.duration_s": 8,
}
PLATE = [{"pose": {"xyz": [-0.06, 0, -0.3]}, "width": 0.08, "height": 0.1, "from_s": 0.5}]
TROUBLES: dict[str, dict[str, object]] = {
    "nothing": {},
    "moving shadow": {"noise.perturb": [{"kind": "shadow"}]},
    "plate before the poster": {"world.plates": PLATE},
    "goal taken 5 % darker": {"goal.picture": {"brightness": 0.95}},
    "goal taken 10 % darker": {"goal.picture": {"brightness": 0.9}},
    "the same, light fitted": {"goal.picture": {"brightness": 0.9}, "law.light": "gain_offset"},
    "noise of 8 grey levels": {"noise.image_sigma": 8, "stop.converged.error_grey": 1.5},
}


def _ends(settings: dict[str, object]) -> tuple[bool, float]:
    """Whether a run reached its goal by its own judgement and by the truth, and its distance from
    there [m].
    """
    r = vs.run(vs.load("camera_photometric", settings))
    far = float(r["position_error_m"][-1])
    return r.outcome.success and far < 5e-3, far


def test_basin() -> None:
    """Lateral displacement (down) and turn about the optical axis (across); smoothing, or the
    pyramid, reaches farther.
    """
    share = {}
    for name, settings in LAWS.items():
        reached = [
            [
                _ends(
                    {
                        **settings,
                        "robot.start.nominal": {"xyz": [x, 0, -1.0], "rpy_deg": [0, 0, turn]},
                    }
                )[0]
                for turn in TURN_DEG
            ]
            for x in LATERAL_M
        ]
        share[name] = float(np.mean(reached))
        print(
            f"\n{name}: {share[name]:.0%} of {len(LATERAL_M) * len(TURN_DEG)};"
            f" turn {TURN_DEG} deg across"
        )
        for x, row in zip(LATERAL_M, reached, strict=True):
            print(f"  {100 * x:4.0f} cm  {'  '.join('.#'[int(ok)] for ok in row)}")
    assert share["points"] == 1
    assert share["as printed, blur 1.5 px"] > share["as printed, without blur"]
    assert share["mean, 4 levels"] > share["as printed, without blur"]


def test_light_and_obstacles() -> None:
    """Least squares fail under a moving shadow and behind a plate, the M-estimator does not; other
    light at teaching breaks all.
    """
    far: dict[str, dict[str, float]] = {}
    for robust in ("none", "huber", "tukey"):
        far[robust] = {
            name: _ends({**NEAR, "law.robust": robust, **trouble})[1]
            for name, trouble in TROUBLES.items()
        }
        print(
            f"\n{robust}: "
            + ", ".join(f"{name} {1e3 * d:.2f} mm" for name, d in far[robust].items())
        )
    assert far["none"]["moving shadow"] > 10e-3
    assert far["tukey"]["moving shadow"] < 2e-3
    assert far["none"]["plate before the poster"] > 20e-3
    assert far["tukey"]["plate before the poster"] < 5e-3
    assert min(by["goal taken 5 % darker"] for by in far.values()) > 10e-3
    assert max(by["the same, light fitted"] for by in far.values()) < 2e-3
