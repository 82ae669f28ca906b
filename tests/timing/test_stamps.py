"""Clocks of camera and robot: right unless a scenario says otherwise, and wrong by as much as it
says.
"""

from __future__ import annotations

import pytest

from vstestbed.timing.clock import CameraStamps, RobotStamps


def test_a_clock_without_errors_is_the_true_one() -> None:
    for t in (0.0, 5.0, 1000.0):
        assert CameraStamps().at(t) == t and RobotStamps().true(t) == t


def test_offset_and_drift_add_up() -> None:
    """80 ppm over 1000 s are 80 ms."""
    assert CameraStamps(offset_s=-0.02, drift_ppm=80.0).at(1000.0) == pytest.approx(
        1000.0 - 0.02 + 0.08, abs=1e-12
    )
    assert RobotStamps(offset_s=0.01, drift_ppm=80.0).true(1000.0 + 0.01 + 0.08) == pytest.approx(
        1000.0, abs=1e-9
    )
