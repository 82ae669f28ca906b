"""Twenty random starts of the uncalibrated law from rendered pictures, with either estimator. Long:
pytest -m study -s.
"""

from __future__ import annotations

import numpy as np
import pytest

import vstestbed as vs


@pytest.mark.study
@pytest.mark.parametrize("estimator", ["broyden", "rls"])
def test_arrives_from_everywhere_whatever_the_calibration(
    estimator: str, capsys: pytest.CaptureFixture[str]
):
    runs = [
        vs.run(vs.load("arm_uncalibrated", {"law.estimator": estimator}).randomised(seed))
        for seed in range(20)
    ]
    t = [r.summary()["time_to_converge_s"] for r in runs if r.outcome.success]
    px, mm = (
        max(scale * r[column][-1] for r in runs)
        for column, scale in (("error_px", 1), ("position_error_m", 1e3))
    )
    with capsys.disabled():
        print(
            f"\n{estimator:8s} {len(t)}/20, {min(t):.1f} to {max(t):.1f} s,"
            f" worst {px:.2f} px {mm:.2f} mm"
        )
    assert len(t) == 20 and px < 0.3 and mm < 20
    # Nothing that the law reads depends on the calibration: another error of it changes no number.
    other = vs.run(
        vs.load(
            "arm_uncalibrated",
            {"law.estimator": estimator, "calibration.mount_error.rpy_deg": [0, 0, 100]},
        ).randomised(0)
    )
    np.testing.assert_array_equal(other["error_px"], runs[0]["error_px"])
