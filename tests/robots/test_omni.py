"""The mecanum base as a robot: wheel kinematics both ways, limits, motion basis, odometry; no
physics.
"""

import numpy as np
import pytest

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Pose, exp, inverse
from vstestbed.core.planar import GroundPose, moved, pose_on_ground
from vstestbed.robots.allocation import Mount
from vstestbed.robots.base import Reading
from vstestbed.robots.omni import PLATFORM, WHEELS, Omni
from vstestbed.robots.vehicle import GroundBox, GroundStart

BASE = Omni()
PERIOD = 0.04
MOUNTS = {
    "on the base": Pose(),
    "forward": Pose(xyz=(0.2, 0.1, 0.3), rpy_deg=(-90, 0, -90)),
    "forward and 45 degrees up": Pose(xyz=(0.2, 0.1, 0.3), rpy_deg=(-45, 0, -90)),
    "straight up": Pose(xyz=(0.2, 0.1, 0.3)),
    "any": Pose(xyz=(-0.3, 0.2, 0.5), rpy_deg=(20, -50, 130)),
}
MOTIONS = [(0.3, 0.0, 0.0), (0.0, -0.2, 0.0), (0.0, 0.0, 0.7), (0.2, -0.1, -0.5)]


def readings(q):
    return Reading(np.asarray(q, dtype=float), np.zeros(len(q)))


@pytest.fixture(params=MOUNTS)
def mount(request) -> Mount:
    return Mount.of(MOUNTS[request.param].T)


class TestKinematics:
    def test_of_print(self):
        # Taheri, Qiao & Ghaeminezhad 2015, wheels front left, front right, rear left, rear right; y
        # to the left.
        k = PLATFORM.wheelbase_m / 2 + PLATFORM.track_m / 2
        printed = (
            np.array([[1, -1, -k], [1, 1, k], [1, 1, -k], [1, -1, k]]) / PLATFORM.wheel_radius_m
        )
        np.testing.assert_allclose(PLATFORM.wheel_matrix(rollers=np.inf), printed, rtol=1e-12)

    def test_nine_rollers_carry_it_two_percent_less_far_sideways(self):
        phi = (np.arange(100_000) + 0.5) / 100_000 * np.pi / 9
        # the mean over half a roller's turn, by the midpoint rule: 1e-11
        kappa = np.cos(phi).mean()
        np.testing.assert_allclose(PLATFORM.W[:, 0], 1 / PLATFORM.wheel_radius_m, rtol=1e-12)
        np.testing.assert_allclose(
            np.abs(PLATFORM.W[:, 1]), 1 / PLATFORM.wheel_radius_m / kappa, rtol=1e-9
        )
        np.testing.assert_allclose(
            np.abs(PLATFORM.W[:, 2]),
            (PLATFORM.wheelbase_m / 2 / kappa + PLATFORM.track_m / 2) / PLATFORM.wheel_radius_m,
            rtol=1e-9,
        )

    def test_both_ways(self):
        np.testing.assert_allclose(PLATFORM.W_inverse @ PLATFORM.W, np.eye(3), atol=1e-14)

    def test_wheels_that_fight_each_other_move_nothing(self):
        # Four speeds, three motions: the front pair against the rear pair is none.
        np.testing.assert_allclose(PLATFORM.W_inverse @ [1, 1, -1, -1], np.zeros(3), atol=1e-14)


class TestMotionBasis:
    def test_is_the_cameras_twist_by_finite_differences(self, mount):
        basis, at, dt = (
            BASE.motion_basis(mount, BASE.start_joints()),
            np.array([1.0, -2.0, 0.7]),
            1e-6,
        )
        for column in range(3):
            motion = np.eye(3)[column]
            ends = [pose_on_ground(moved(at, motion, t)) @ mount.T_flange_camera for t in (-dt, dt)]
            step = (inverse(ends[0]) @ ends[1] - np.eye(4)) / (2 * dt)
            twist = [*step[:3, 3], step[2, 1], step[0, 2], step[1, 0]]
            # First order in dt = 1e-6 at the turning frame's start instead of its middle.
            np.testing.assert_allclose(basis[:, column], twist, atol=3e-6)

    def test_a_camera_aside_is_carried_sideways_by_yaw(self):
        # What a reduced Jacobian of three columns leaves out: .2 m ahead and .1 m left, turning at
        # 1 rad/s, it moves by (-.1, .2).
        aside = BASE.motion_basis(Mount.of(MOUNTS["straight up"].T), BASE.start_joints())
        np.testing.assert_allclose(aside[:, 2], [-0.1, 0.2, 0, 0, 0, 1], atol=1e-15)


class TestAllocation:
    @pytest.mark.parametrize("motion", MOTIONS)
    def test_a_small_command_is_made_exactly(self, mount, motion):
        twist = BASE.motion_basis(mount, BASE.start_joints()) @ motion
        made = BASE.allocate(twist, readings(np.zeros(4)), mount, PERIOD)
        np.testing.assert_allclose(made.twist, twist, atol=1e-12)
        np.testing.assert_allclose(made.setpoint, PLATFORM.W @ motion, atol=1e-10)
        assert (made.scale, made.limit) == (1.0, "")

    @pytest.mark.parametrize("motion", MOTIONS)
    def test_a_fast_command_is_scaled_as_a_whole(self, mount, motion):
        twist = BASE.motion_basis(mount, BASE.start_joints()) @ (20 * np.array(motion))
        made = BASE.allocate(twist, readings(np.zeros(4)), mount, PERIOD)
        assert made.limit == "speed" and 0 < made.scale < 1
        assert np.abs(made.setpoint).max() == pytest.approx(PLATFORM.wheel_speed_radps)
        # the direction is kept
        np.testing.assert_allclose(made.twist, twist * made.scale, atol=1e-12)

    def test_what_no_wheel_can_make_is_left_out(self):
        mount = Mount.of(np.eye(4))
        made = BASE.allocate(
            np.array([0.1, 0.2, 5.0, 5.0, 5.0, 0.3]), readings(np.zeros(4)), mount, PERIOD
        )
        np.testing.assert_allclose(made.twist, [0.1, 0.2, 0, 0, 0, 0.3], atol=1e-12)
        assert made.scale == 1.0

    def test_who_believes_in_larger_wheels_turns_them_slower(self):
        mount, twist = Mount.of(np.eye(4)), np.array([0.2, 0.1, 0, 0, 0, 0.3])
        wrong = Omni(wheel_radius_error=0.02).allocate(twist, readings(np.zeros(4)), mount, PERIOD)
        np.testing.assert_allclose(
            PLATFORM.W_inverse @ wrong.setpoint, np.array([0.2, 0.1, 0.3]) / 1.02, atol=1e-12
        )
        # what it stands for is what the robot believes
        np.testing.assert_allclose(wrong.twist, twist, atol=1e-12)


class TestOdometry:
    @pytest.mark.parametrize("motion", MOTIONS)
    def test_an_arc_from_the_wheels(self, mount, motion):
        before = np.array([1.0, 2.0, 3.0, 4.0])
        now = before + PLATFORM.W @ motion * PERIOD
        twist = BASE.measured_twist(
            readings(before), readings(now), PERIOD, np.full(6, np.nan), mount
        )
        self.leads_along_the_arc(twist, motion, mount)

    @pytest.mark.parametrize("motion", MOTIONS)
    def test_an_arc_in_the_plane(self, mount, motion):
        before = np.array([3.0, -1.0, 2.5])
        now = moved(before, motion, PERIOD)
        twist = Omni(wheels="planar").measured_twist(
            readings(before), readings(now), PERIOD, np.full(6, np.nan), mount
        )
        self.leads_along_the_arc(twist, motion, mount)

    @staticmethod
    def leads_along_the_arc(twist, motion, mount):
        at = np.array([0.5, 0.2, 1.0])
        start, end = (
            pose_on_ground(at_t) @ mount.T_flange_camera for at_t in (at, moved(at, motion, PERIOD))
        )
        np.testing.assert_allclose(start @ exp(twist * PERIOD), end, atol=1e-12)

    def test_a_circle_closes(self):
        motion = np.array([0.3, 0.1, 0.5])
        steps = 100
        dt = 2 * np.pi / motion[2] / steps
        at, q = np.zeros(3), np.zeros(4)
        for _ in range(steps):
            q_next = q + PLATFORM.W @ motion * dt
            at, q = moved(at, BASE.odometry(readings(q), readings(q_next), dt), dt), q_next
        np.testing.assert_allclose(at, [0, 0, 2 * np.pi], atol=1e-11)

    @pytest.mark.parametrize("wheels", ["rollers", "planar"])
    def test_larger_wheels_believed_are_a_longer_way_told(self, wheels):
        motion = np.array([0.2, 0.1, 0.3])
        now = (
            PLATFORM.W @ motion * PERIOD
            if wheels == "rollers"
            else moved(np.zeros(3), motion, PERIOD)
        )
        robot = Omni(wheels=wheels, wheel_radius_error=0.02)
        told = robot.odometry(readings(np.zeros(len(now))), readings(now), PERIOD)
        np.testing.assert_allclose(told, 1.02 * motion, atol=1e-12)

    @pytest.mark.parametrize("wheels", ["rollers", "planar"])
    def test_no_time_no_motion(self, wheels):
        robot = Omni(wheels=wheels)
        at = readings(np.ones(len(robot.joints)))
        np.testing.assert_array_equal(
            robot.measured_twist(at, at, 0.0, np.ones(6), Mount.of(np.eye(4))), np.zeros(6)
        )


class TestSpec:
    def test_models_and_joints(self):
        assert (BASE.body.file, BASE.joints) == ("omni.xml", WHEELS)
        planar = Omni(wheels="planar")
        assert (planar.body.file, planar.joints) == (
            "omni_planar.xml",
            ("root_x", "root_y", "root_yaw"),
        )

    def test_it_starts_where_it_is_told(self):
        start = GroundStart(nominal=GroundPose(x=-6, y=2, heading_deg=30))
        np.testing.assert_allclose(Omni(start=start).configuration(), [-6, 2, np.pi / 6])

    def test_a_random_start_keeps_the_rest(self):
        robot = Omni(
            wheels="planar",
            start=GroundStart(random=GroundBox(x=1, y=1, heading_deg=10)),
            wheel_radius_error=0.01,
        )
        drawn = robot.randomised(np.random.default_rng(0))
        assert (drawn.wheels, drawn.wheel_radius_error, drawn.start.random) == (
            "planar",
            0.01,
            robot.start.random,
        )
        assert drawn.start.nominal != robot.start.nominal

    def test_random_starts_need_a_box(self):
        with pytest.raises(ParameterError, match=r"robot\.start\.random is missing"):
            BASE.randomised(np.random.default_rng(0))

    def test_unknown_wheels_are_refused(self):
        with pytest.raises(ParameterError, match="wheels"):
            Omni(wheels="tracks")

    def test_setpoints_go_to_the_servos_as_they_are(self):
        assert BASE.onboard is None
