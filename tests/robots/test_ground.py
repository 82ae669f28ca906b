"""What vehicles share: the columns of their log, and how fast they slip over the floor,
in truth.
"""

import numpy as np
import pytest

from vstestbed.core.planar import moved, pose_on_ground
from vstestbed.robots.base import Reading, RobotState, Supervisor
from vstestbed.robots.vehicle import VehicleLog

ORIGIN = np.zeros(3)
NO_READING = Reading(np.zeros(0), np.zeros(0))


def state(t, true, odometry, known=ORIGIN):
    """A vehicle at a true place (x, y, heading), where its encoders and its landmarks have it."""
    return RobotState(
        t,
        pose_on_ground(np.array(true)),
        np.array(known),
        np.array(odometry),
        NO_READING,
        np.zeros(0),
        np.zeros(3),
    )


def slip(true, odometry, duration):
    """Slip [m/s, rad/s] between two frames with true places and places by odometry, a pair each."""
    log = VehicleLog(Supervisor(), ORIGIN)
    log.row(state(0.0, true[0], odometry[0]))
    return tuple(log.row(state(duration, true[1], odometry[1]))[-3:-1])


class TestSlip:
    def test_a_vehicle_that_turns_on_the_spot_unnoticed_slips_in_yaw_alone(self):
        # across the half turn
        linear, yaw = slip(([1.0, 2.0, 3.1], [1.0, 2.0, -3.1]), (ORIGIN, ORIGIN), 0.1)
        assert linear == pytest.approx(0, abs=1e-12)
        assert yaw == pytest.approx((2 * np.pi - 6.2) / 0.1)

    def test_wheels_that_spin_while_it_stands_slip_too(self):
        assert slip((ORIGIN, ORIGIN), (ORIGIN, [0.03, 0.04, -0.2]), 0.1) == pytest.approx(
            (0.5, 2.0)
        )

    def test_what_the_encoders_notice_is_none(self):
        before, now = [1.0, 2.0, 0.3], [1.1, 2.05, 0.5]
        assert slip((before, now), (before, now), 0.04) == pytest.approx((0, 0), abs=1e-9)

    def test_a_step_is_told_in_the_vehicles_own_frame(self):
        """Odometry starts at zero wherever the vehicle stands: only the steps are compared."""
        step, start = np.array([0.05, 0.01, 0.1]), np.array([4.0, -1.0, 2.0])
        assert slip(
            (start, moved(start, step, 1.0)), (ORIGIN, moved(ORIGIN, step, 1.0)), 0.04
        ) == pytest.approx((0, 0), abs=1e-9)

    def test_none_in_the_first_frame_nor_without_time(self):
        row = VehicleLog(Supervisor(), ORIGIN).row(state(0.0, [1, 2, 3], ORIGIN))
        assert row[-3:-1].tolist() == [0.0, 0.0]
        assert slip((ORIGIN, [1.0, 0, 0]), (ORIGIN, ORIGIN), 0.0) == (0.0, 0.0)


def test_true_known_and_reckoned_places_stand_under_their_names():
    start = np.array([4.0, -1.0, np.pi / 2])
    log = VehicleLog(Supervisor(), start)
    found = dict(
        zip(
            log.columns,
            log.row(state(0.0, [4.1, 1.0, 1.6], [2.0, 0.0, 0.03], known=[4.2, 1.1, 1.7])),
            strict=True,
        )
    )
    assert [found[f"base_{part}"] for part in ("x", "y", "heading")] == pytest.approx(
        [4.1, 1.0, 1.6]
    )
    assert [found[f"est_{part}"] for part in ("x", "y", "heading")] == [4.2, 1.1, 1.7]
    # Two metres ahead by its wheels, from where it really stood: along the world's y.
    assert [found[f"odo_{part}"] for part in ("x", "y", "heading")] == pytest.approx(
        [4.0, 1.0, np.pi / 2 + 0.03]
    )
