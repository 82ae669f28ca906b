"""The car as a robot: kinematics both ways, limits, what its instruments tell, its onboard servos.
Its body has its own tests.
"""

import math

import numpy as np
import pytest

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Pose, inverse
from vstestbed.core.planar import GroundPose, moved, pose_on_ground
from vstestbed.robots.allocation import Mount
from vstestbed.robots.base import Reading
from vstestbed.robots.car import BUGGY, Car, CarLimits, Compass
from vstestbed.robots.vehicle import GroundBox, GroundStart

CAR = Car()
MOUNT = Mount.of(Pose(xyz=(0.2, 0.1, 0.5), rpy_deg=(-90, 0, -90)).T)
"""The book's: looks ahead, z forward and y down."""
PERIOD = 0.04


def reading(steering: float = 0.0, left: float = 0.0, right: float = 0.0) -> Reading:
    """Wheels standing at angles [rad]; the front wheels' angles are of no matter."""
    return Reading(np.array([steering, 0.0, 0.0, left, right, 0.0, 0.0]), np.zeros(7))


def camera_twist(v: float, w: float) -> np.ndarray:
    return CAR.motion_basis(MOUNT, CAR.start_joints()) @ [v, w]


class TestKinematics:
    def test_the_mount_looks_ahead(self):
        np.testing.assert_allclose(MOUNT.T_flange_camera[:3, :3] @ [0, 0, 1], [1, 0, 0], atol=1e-12)
        np.testing.assert_allclose(
            MOUNT.T_flange_camera[:3, :3] @ [0, 1, 0], [0, 0, -1], atol=1e-12
        )

    def test_basis_is_the_cameras_motion_along_an_arc(self):
        rng, dt = np.random.default_rng(0), 1e-6
        for _ in range(5):
            mount = Mount.of(
                Pose(xyz=tuple(rng.uniform(-1, 1, 3)), rpy_deg=tuple(rng.uniform(-180, 180, 3))).T
            )
            v, w = rng.uniform(-1, 1, 2)
            place = rng.uniform(-3, 3, 3)
            T0, T1 = (
                pose_on_ground(moved(place, np.array([v, 0, w]), t)) @ mount.T_flange_camera
                for t in (0.0, dt)
            )
            step = inverse(T0) @ T1 / dt
            twist = [*step[:3, 3], step[2, 1], step[0, 2], step[1, 0]]
            np.testing.assert_allclose(
                CAR.motion_basis(mount, CAR.start_joints()) @ [v, w], twist, atol=1e-5
            )  # first order in dt, and rounding over dt

    @pytest.mark.parametrize(
        ("v", "w"), [(0.5, 0.2), (0.5, -0.2), (-0.5, 0.2), (-0.5, -0.2), (0.7, 0.0)]
    )
    def test_an_order_within_its_limits_is_made_as_it_is(self, v, w):
        made = CAR.allocate(camera_twist(v, w), reading(), MOUNT, PERIOD)
        speed, steering = made.setpoint
        assert (speed, speed * np.tan(steering) / BUGGY.wheelbase_m) == (
            pytest.approx(v),
            pytest.approx(w),
        )
        np.testing.assert_allclose(made.twist, camera_twist(v, w), atol=1e-12)
        assert (made.scale, made.limit) == (pytest.approx(1.0), "")

    def test_in_reverse_the_wheels_point_the_other_way(self):
        """Backwards and turning left: the nose swings left, so the front wheels point right."""
        setpoint = CAR.allocate(camera_twist(-0.5, 0.2), reading(), MOUNT, PERIOD).setpoint
        assert setpoint[1] == pytest.approx(-np.arctan(0.4))

    def test_what_a_car_cannot_do_is_left_out(self):
        aside = MOUNT.to_camera @ np.array([0.4, 0.3, -0.2, 0.1, 0.5, 0.1])
        made = CAR.allocate(aside, reading(), MOUNT, PERIOD)
        np.testing.assert_allclose(made.twist, camera_twist(0.4, 0.1), atol=1e-12)


class TestLimits:
    def test_too_fast_becomes_slower_on_the_same_arc(self):
        made = CAR.allocate(camera_twist(-4.0, 2.0), reading(), MOUNT, PERIOD)
        np.testing.assert_allclose(made.setpoint, [-1.0, -np.arctan(0.5)])
        np.testing.assert_allclose(made.twist, camera_twist(-1.0, 0.5), atol=1e-12)
        assert (made.scale, made.limit) == (pytest.approx(0.25), "speed")

    @pytest.mark.parametrize(
        ("v", "w", "sign"), [(0.2, 1.0, 1), (0.2, -1.0, -1), (-0.2, 1.0, -1), (-0.2, -1.0, 1)]
    )
    def test_too_tight_becomes_the_tightest_to_the_same_side(self, v, w, sign):
        made = CAR.allocate(camera_twist(v, w), reading(), MOUNT, PERIOD)
        np.testing.assert_allclose(made.setpoint, [v, sign * 1.0])
        turn = abs(v) * np.tan(1.0) * np.sign(w)
        np.testing.assert_allclose(made.twist, camera_twist(v, turn), atol=1e-12)
        assert (made.scale, made.limit) == (pytest.approx(turn / w), "joint_limit")

    def test_on_the_spot_it_keeps_its_wheels(self):
        held = reading(steering=-0.3)
        made = CAR.allocate(camera_twist(0.0, 0.7), held, MOUNT, PERIOD)
        np.testing.assert_allclose(made.setpoint, [0.0, -0.3], atol=1e-12)
        np.testing.assert_allclose(made.twist, 0, atol=1e-12)
        assert (made.scale, made.limit) == (0.0, "singular")
        rest = CAR.allocate(np.zeros(6), held, MOUNT, PERIOD)
        np.testing.assert_allclose(rest.setpoint, [0.0, -0.3])
        assert (rest.scale, rest.limit) == (1.0, "")

    def test_other_limits(self):
        fast = Car(limits=CarLimits(speed_mps=3, steering_rad=0.5))
        np.testing.assert_allclose(
            fast.allocate(camera_twist(2.5, 0.5), reading(), MOUNT, PERIOD).setpoint,
            [2.5, np.arctan(0.2)],
        )
        np.testing.assert_allclose(
            fast.allocate(camera_twist(0.5, 1.0), reading(), MOUNT, PERIOD).setpoint, [0.5, 0.5]
        )
        with pytest.raises(ParameterError, match="speed_mps"):
            CarLimits(speed_mps=4)
        with pytest.raises(ParameterError, match="steering_rad"):
            CarLimits(steering_rad=1.2)


class TestCompass:
    def readings(self, car: Car, heading: float, n: int) -> np.ndarray:
        sensors = {"heading": [math.cos(heading), math.sin(heading), 0.01]}
        rng = np.random.default_rng(1)
        sense = car.instruments(rng)
        return np.array([sense(np.zeros(7), np.zeros(7), sensors).heading for _ in range(n)])

    def test_noise_and_bias(self):
        told = np.degrees(
            self.readings(Car(compass=Compass(bias_deg=5, sigma_deg=0.5)), np.radians(40), 4000)
        )
        # Standard errors of 4000 readings: .008 deg of the mean, .0056 of the spread; four of each.
        assert told.mean() == pytest.approx(45, abs=0.032)
        assert told.std() == pytest.approx(0.5, abs=0.023)
        assert abs(np.corrcoef(told[1:], told[:-1])[0, 1]) < 0.07  # white

    def test_it_wraps(self):
        told = self.readings(CAR, np.pi - 1e-4, 200)
        assert np.all((told >= -np.pi) & (told < np.pi)) and told.min() < -3 and told.max() > 3

    def test_the_truth_does_not_pass(self):
        q, sensors = np.arange(7.0), {"heading": [1.0, 0.0, 0.0]}
        measured = CAR.instruments(np.random.default_rng(0))(q, np.zeros(7), sensors)
        # nothing but encoders and compass
        assert type(measured) is Reading and measured.tilt is None and measured.heading != 0.0
        np.testing.assert_array_equal(measured.q, q)

    def test_same_seed_same_readings(self):
        np.testing.assert_array_equal(self.readings(CAR, 1.0, 5), self.readings(CAR, 1.0, 5))


class TestOdometry:
    def test_an_arc_from_its_wheels(self):
        v, w = 0.6, -0.4
        left, right = (
            (v + side * w * BUGGY.track_m / 2) / BUGGY.wheel_radius_m * PERIOD for side in (-1, 1)
        )
        before, now = reading(left=3, right=7), reading(left=3 + left, right=7 + right)
        np.testing.assert_allclose(CAR.odometry(before, now, PERIOD), [v, 0, w], atol=1e-12)
        np.testing.assert_allclose(
            CAR.measured_twist(before, now, PERIOD, np.zeros(6), MOUNT),
            camera_twist(v, w),
            atol=1e-12,
        )
        np.testing.assert_allclose(
            Car(wheel_radius_error=0.02).odometry(before, now, PERIOD),
            [1.02 * v, 0, 1.02 * w],
            atol=1e-12,
        )

    def test_no_time_no_motion(self):
        np.testing.assert_array_equal(
            CAR.measured_twist(reading(), reading(left=1), 0.0, np.ones(6), MOUNT), np.zeros(6)
        )


class TestServos:
    def run(
        self, car: Car, setpoint: list[float], periods: int, speed_share: float = 1.0
    ) -> np.ndarray:
        """Controls (periods, 2) when the wheels follow at once, at a share of the speed told."""
        state, ctrl, out = car.begin(), np.zeros(2), []
        for _ in range(periods):
            wheels = Reading(np.zeros(7), np.array([0, 0, 0, 1, 1, 0, 0]) * ctrl[0] * speed_share)
            state, ctrl = car.actuate(state, np.array(setpoint), wheels, 0.01)
            out.append(ctrl)
        return np.array(out)

    def test_setpoints_are_approached_at_their_rates(self):
        out = self.run(
            Car(limits=CarLimits(acceleration_mps2=1.0, steering_rate_radps=0.5)), [1.0, -0.4], 120
        )
        np.testing.assert_allclose(np.diff(out[:79, 1]), -0.005, atol=1e-12)
        assert out[-1, 1] == -0.4
        # The integral adds to the ramp what the wheels are behind; at its end nothing is left.
        np.testing.assert_allclose(np.diff(out[20:99, 0]) * BUGGY.wheel_radius_m, 0.01, rtol=0.1)
        assert out[-1, 0] * BUGGY.wheel_radius_m == pytest.approx(1.0, abs=0.03)

    def test_setpoints_beyond_the_limits_are_cut(self):
        out = self.run(CAR, [-5.0, 3.0], 400)[-1]
        assert (out[0] * BUGGY.wheel_radius_m, out[1]) == (pytest.approx(-1.0, abs=1e-3), 1.0)

    def test_the_integral_makes_up_for_a_droop(self):
        out = self.run(CAR, [1.0, 0.0], 400, speed_share=0.97)
        assert 0.97 * out[-1, 0] * BUGGY.wheel_radius_m == pytest.approx(1.0, abs=1e-3)

    def test_against_a_wall_it_does_not_wind_up(self):
        out = self.run(CAR, [1.0, 0.0], 1000, speed_share=0.0)
        assert out[-1, 0] == pytest.approx(1.0 / BUGGY.wheel_radius_m + 1.0)

    def test_it_turns_its_wheels_by_the_radius_that_it_believes_in(self):
        assert self.run(Car(wheel_radius_error=0.02), [1.0, 0.0], 400)[-1, 0] == pytest.approx(
            1 / (1.02 * BUGGY.wheel_radius_m), rel=1e-3
        )

    def test_at_rest_the_motor_holds(self):
        np.testing.assert_array_equal(self.run(CAR, [0.0, 0.0], 10, speed_share=0.5), 0)


def test_starts():
    car = Car(
        start=GroundStart(
            nominal=GroundPose(x=2, y=3, heading_deg=90), random=GroundBox(x=0.5, heading_deg=10)
        )
    )
    np.testing.assert_allclose(car.configuration(), [2, 3, np.pi / 2])
    np.testing.assert_allclose(
        car.flange_pose(car.configuration())[:3, [0, 3]].T, [[0, 1, 0], [2, 3, 0]], atol=1e-12
    )
    drawn = car.randomised(np.random.default_rng(0))
    assert (
        drawn.start.nominal.x != 2
        and abs(drawn.start.nominal.x - 2) <= 0.5
        and drawn.start.nominal.y == 3
    )
    assert drawn.limits == car.limits
    with pytest.raises(ParameterError, match=r"robot\.start\.random is missing"):
        CAR.randomised(np.random.default_rng(0))
