"""A quadrotor's log: what its columns hold."""

import numpy as np
import pytest

from vstestbed.core.geometry import Pose
from vstestbed.robots.base import RobotState
from vstestbed.robots.flight import SINKS, Failsafe, FlightEstimate, FlightReading
from vstestbed.robots.quadrotor import Quadrotor


def test_estimates_references_wind_rotors_and_the_failsafe():
    robot, failsafe = Quadrotor(), Failsafe(lands=False, lost_after_s=1.0, mode=SINKS)
    roll, pitch = 0.2, -0.3
    level_velocity = np.array([1.0, -2.0, 0.5])
    R_level_body = Pose(rpy_deg=(np.degrees(roll), np.degrees(pitch), 0)).T[:3, :3]
    estimate = FlightEstimate(
        velocity=R_level_body.T @ level_velocity,
        rates=np.array([0.1, 0.2, 0.3]),
        ref_tilt=np.array([0.4, 0.5]),
        ref_rates=np.array([0.6, 0.7, 0.8]),
        rotor_limit_s=0.0,
        overturned=False,
        stands=False,
    )
    none, still = np.zeros(0), np.zeros(3)
    reading = FlightReading(
        none, none, tilt=np.array([roll, pitch]), range_m=2.0, estimate=estimate
    )
    act = np.array([100.0, 400.0, 900.0, -1e-9])  # squared speeds; the last a rounding below rest
    log = robot.log(failsafe)
    row = log.row(
        RobotState(0.0, np.eye(4), still, still, reading, act, np.array([5.0, 0.0, -1.0]))
    )
    found = dict(zip(log.columns, row, strict=True))
    assert (found["est_roll"], found["est_pitch"]) == (roll, pitch)
    # turned out of body axes into the level frame
    assert [found[f"est_v{a}"] for a in "xyz"] == pytest.approx(level_velocity)
    assert [found[f"est_w{a}"] for a in "xyz"] == [0.1, 0.2, 0.3]
    assert [found[f"ref_{n}"] for n in ("roll", "pitch", "wx", "wy", "wz")] == [
        0.4,
        0.5,
        0.6,
        0.7,
        0.8,
    ]
    assert [found[f"wind_{a}"] for a in "xyz"] == [5.0, 0.0, -1.0]
    assert [found[f"speed_{name}"] for name in robot.body.actuators] == pytest.approx(
        [10, 20, 30, 0]
    )
    assert found["supervisor"] == SINKS


def test_a_twist_is_the_loops_estimate():
    none, v, w = np.zeros(0), np.array([1.0, 2, 3]), np.array([4.0, 5, 6])
    estimate = FlightEstimate(-v, -w, np.zeros(2), np.zeros(3), 0.0, False, False)
    flown = FlightReading(none, none, range_m=1.0, estimate=estimate)
    assert flown.body_twist.tolist() == [-1, -2, -3, -4, -5, -6]
