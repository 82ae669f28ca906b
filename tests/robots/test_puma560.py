"""The Puma as a robot: commands become joint speeds within limits, as a whole; what it measures of
its own motion.
"""

import numpy as np
import pytest

from tests.shortcuts import forward, jacobian
from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Pose, inverse
from vstestbed.robots import Mount, Puma560
from vstestbed.robots.arm import LIMIT_HORIZON_S, LIMIT_MARGIN, Positions
from vstestbed.robots.base import Reading
from vstestbed.robots.puma560 import JOINT_LIMITS, SPEED_LIMITS, UPPER_ARM, PumaStart

ARM = Puma560()
Q0 = ARM.configuration()
MOUNT = Mount.of(Pose(xyz=(0.02, -0.03, 0.05), rpy_deg=(10, -20, 30)).T)
PERIOD = 0.04


def at_rest(q):
    return Reading(np.asarray(q, dtype=float), np.zeros(6))


def test_a_small_command_is_made_exactly():
    twist = np.array([0.05, -0.02, 0.03, 0.1, -0.05, 0.2])
    made = ARM.allocate(twist, at_rest(Q0), MOUNT, PERIOD)
    np.testing.assert_allclose(made.twist, twist, atol=1e-12)  # no damping away from singularities
    assert (made.scale, made.limit) == (pytest.approx(1.0), "")
    # Not by the same Jacobian: the camera's pose a little later, by forward kinematics alone.
    dt = 1e-6
    T0, T1 = (forward(Q0 + made.setpoint * t) @ MOUNT.T_flange_camera for t in (0.0, dt))
    step = (inverse(T0) @ T1) / dt
    np.testing.assert_allclose(step[:3, 3], twist[:3], atol=1e-6)  # first order in dt
    np.testing.assert_allclose([step[2, 1], step[0, 2], step[1, 0]], twist[3:], atol=1e-6)


def test_a_fast_command_is_scaled_as_a_whole():
    twist = np.array([3.0, -1.0, 2.0, 1.0, 0.5, -2.0])
    made = ARM.allocate(twist, at_rest(Q0), MOUNT, PERIOD)
    assert made.limit == "speed"
    assert np.max(np.abs(made.setpoint) / SPEED_LIMITS) == pytest.approx(1.0)
    np.testing.assert_allclose(made.twist, twist * made.scale, atol=1e-12)  # the direction is kept


def test_a_joint_slows_towards_its_limit_and_stops_before_it():
    twist = np.zeros(6)
    twist[5] = 1.0  # about the optical axis of a camera on the flange: joint 6 alone
    mount = Mount.of(np.eye(4))
    q = Q0.copy()
    for room, limited in ((0.02, True), (1.0, False)):
        q[5] = JOINT_LIMITS[5, 1] - LIMIT_MARGIN - room
        made = ARM.allocate(twist, at_rest(q), mount, PERIOD)
        assert (made.limit == "joint_limit") is limited
        assert made.setpoint[5] == pytest.approx(min(1.0, room / LIMIT_HORIZON_S))
    q[5] = JOINT_LIMITS[5, 1]
    assert ARM.allocate(twist, at_rest(q), mount, PERIOD).scale == 0.0
    # away from it: free
    assert ARM.allocate(-twist, at_rest(q), mount, PERIOD).scale == pytest.approx(1.0)


def test_a_motion_that_a_singular_arm_cannot_make_is_named():
    q = Q0.copy()
    q[4] = 0.0  # axes of joints 4 and 6 in line
    # The twist that no joint speeds make: the last left singular vector of the Jacobian, lengths in
    # units of the reach.
    unit = np.array([UPPER_ARM] * 3 + [1.0] * 3)
    lost = np.linalg.svd(jacobian(q) / unit[:, None])[0][:, -1] * unit
    made = ARM.allocate(lost, at_rest(q), Mount.of(np.eye(4)), PERIOD)
    assert made.limit == "singular"
    assert made.scale < 0.02
    assert np.abs(made.setpoint).max() < np.abs(SPEED_LIMITS).max()


def test_its_encoders_tell_the_cameras_motion():
    speeds = np.array([0.1, -0.2, 0.15, 0.3, -0.1, 0.2])
    before, now = at_rest(Q0), at_rest(Q0 + speeds * PERIOD)
    twist = ARM.measured_twist(before, now, PERIOD, np.full(6, np.nan), MOUNT)
    ends = [forward(e.q) @ MOUNT.T_flange_camera for e in (before, now)]
    moved = inverse(ends[0]) @ ends[1]
    # The middle of the way against its chord: they differ in the third order of .01 rad.
    np.testing.assert_allclose(twist[:3], (moved[:3, 3] / PERIOD), atol=2e-3)
    np.testing.assert_array_equal(
        ARM.measured_twist(before, before, 0.0, np.ones(6), MOUNT), np.zeros(6)
    )


def test_a_start_outside_the_limits_is_refused():
    with pytest.raises(ParameterError, match="joint_3's range, -225 to 45 deg"):
        Puma560(start=PumaStart(nominal=Positions(q_deg=(0, 45, 180, 0, 45, -45))))


def test_random_starts_need_a_box():
    with pytest.raises(ParameterError, match=r"robot\.start\.random is missing"):
        ARM.randomised(np.random.default_rng(0))
