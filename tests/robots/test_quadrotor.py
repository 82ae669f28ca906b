"""The quadrotor as a robot: its block, its instruments, setpoints, and flights with noise, bias,
wind and ground.
"""

import math

import numpy as np
import pytest

from tests.robots.flying import Flown, perfect
from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Pose, adjoint, inverse
from vstestbed.robots.allocation import Mount
from vstestbed.robots.attitude import Imu
from vstestbed.robots.flight import HOLD, Instruments, descend
from vstestbed.robots.flight_sensors import Filtered, Flow
from vstestbed.robots.quadrotor import (
    LOWEST_M,
    STANDING_M,
    FlightBox,
    FlightPose,
    FlightStart,
    Quadrotor,
)
from vstestbed.robots.rotors import X4

DOWN = Mount.of(Pose(xyz=(0.1, 0.0, -0.05), rpy_deg=(180, 0, 90)).T)
SENSORS = {
    "gyro": [0.0] * 3,
    "accelerometer": [0.0, 0.0, 9.81],
    "velocity": [0.0] * 3,
    "range": [2.0],
}
NO_JOINTS = np.zeros(0)


def read(robot: Quadrotor, sensors: dict[str, list[float]] = SENSORS) -> Instruments:
    """What a craft's instruments read, with the first noise of a seed."""
    return robot.instruments(np.random.default_rng(0))(NO_JOINTS, NO_JOINTS, sensors)


RAW = read(Quadrotor())


class TestBlock:
    def test_start(self):
        robot = Quadrotor(start=FlightStart(nominal=FlightPose(xyz=(0.5, -0.3, 2.0), yaw_deg=30)))
        np.testing.assert_allclose(robot.configuration(), [0.5, -0.3, 2.0, math.pi / 6])
        T = robot.flange_pose(robot.configuration())
        np.testing.assert_allclose(T, Pose(xyz=(0.5, -0.3, 2.0), rpy_deg=(0, 0, 30)).T, atol=1e-12)

    def test_a_start_in_the_ground_is_refused(self):
        with pytest.raises(ParameterError, match=r"start\.nominal\.xyz\.2"):
            # on its feet it does not hover
            Quadrotor(start=FlightStart(nominal=FlightPose(xyz=(0, 0, STANDING_M))))

    def test_random_starts_fill_their_box_and_stay_above_the_ground(self):
        robot = Quadrotor(
            start=FlightStart(
                nominal=FlightPose(xyz=(0, 0, 2.0)), random=FlightBox(xyz=(2, 1, 3), yaw_deg=180)
            )
        )
        rng = np.random.default_rng(0)
        q = np.array([robot.randomised(rng).configuration() for _ in range(300)])
        assert np.all(np.abs(q) <= [2, 1, 5, math.pi])
        assert q[:, 2].min() == pytest.approx(LOWEST_M)
        assert np.all(np.ptp(q[:, [0, 1, 3]], axis=0) > [3.8, 1.9, 6.0])

    def test_a_box_may_have_a_middle_of_its_own(self):
        box = FlightBox(xyz=(1, 1, 1), about=FlightPose(xyz=(5, 6, 7)))
        robot = Quadrotor(start=FlightStart(random=box)).randomised(np.random.default_rng(0))
        assert np.all(np.abs(robot.configuration()[:3] - [5, 6, 7]) <= 1)
        assert robot.start.random == box  # drawn again, it is drawn from the same box

    def test_no_box_no_random_start(self):
        with pytest.raises(ParameterError, match="random"):
            Quadrotor().randomised(np.random.default_rng(0))


class TestInstruments:
    def test_noise_bias_and_scale_are_as_told(self):
        robot = Quadrotor(
            imu=Imu(
                gyro_sigma_radps=0.01,
                gyro_bias_radps=(0.1, 0.2, 0.3),
                accel_sigma_mps2=0.5,
                accel_bias_mps2=(1, 2, 3),
            ),
            velocity=Flow(sigma_mps=0.1, scale_error=0.5),
            range_sigma_m=0.2,
        )
        sense, sensors = (
            robot.instruments(np.random.default_rng(0)),
            SENSORS | {"velocity": [1.0, 2.0, 0.0]},
        )
        rows = [sense(NO_JOINTS, NO_JOINTS, sensors) for _ in range(4000)]
        expected = {
            "gyro": ([0.1, 0.2, 0.3], 0.01),
            "force": ([1, 2, 12.81], 0.5),
            "velocity": ([1.5, 3, 0], 0.1 * math.sqrt(20)),  # 20 readings of 1 ms make one of 20 ms
            "range_m": (2.0, 0.2),
        }
        for name, (mean, sigma) in expected.items():
            a = np.array([getattr(row, name) for row in rows])
            # Four standard errors of 4000 draws.
            np.testing.assert_allclose(a.mean(axis=0), mean, atol=4 * sigma / math.sqrt(4000))
            np.testing.assert_allclose(a.std(axis=0), sigma, rtol=4 / math.sqrt(2 * 4000))

    def test_without_noise_they_are_exact(self):
        reading = read(perfect(range_sigma_m=0.0))
        for field, sensor in (
            ("gyro", "gyro"),
            ("force", "accelerometer"),
            ("velocity", "velocity"),
        ):
            np.testing.assert_array_equal(getattr(reading, field), SENSORS[sensor])
        assert reading.range_m == 2.0

    def test_a_range_finder_that_meets_nothing_reads_infinity(self):
        """MuJoCo's own value for that is -1."""
        sensors = SENSORS | {"range": [-1.0]}
        assert read(Quadrotor(), sensors).range_m == math.inf

    def test_noise_is_drawn_ahead_as_one_reading_at_a_time_would(self):
        sense, rng = (
            perfect(imu=Imu()).instruments(np.random.default_rng(1)),
            np.random.default_rng(1),
        )
        imu, still = Imu(), SENSORS | {"gyro": [0.0, 0.0, 0.0]}
        for _ in range(150):
            gyro = np.array(sense(NO_JOINTS, NO_JOINTS, still).gyro)
            np.testing.assert_array_equal(
                gyro, imu.gyro_sigma_radps * rng.standard_normal(10)[:3] + imu.gyro_bias_radps
            )

    def test_one_seed_one_noise(self):
        logs = [Flown(Quadrotor(), seed=5).fly([0.5, 0, 0, 0.2], 0.5) for _ in range(2)]
        np.testing.assert_array_equal(logs[0].position, logs[1].position)


class TestSetpoints:
    def test_basis_is_four_columns_of_the_mount(self):
        basis = Quadrotor().motion_basis(DOWN, NO_JOINTS)
        assert basis.shape == (6, 4)
        u = np.array([0.3, -0.2, 0.1, 0.4])
        np.testing.assert_allclose(
            basis @ u,
            adjoint(inverse(DOWN.T_flange_camera)) @ [0.3, -0.2, 0.1, 0, 0, 0.4],
            atol=1e-12,
        )

    def test_a_twist_within_limits_is_kept(self):
        robot, u = Quadrotor(), np.array([0.3, -0.2, 0.1, 0.4])
        found = robot.allocate(robot.motion_basis(DOWN, NO_JOINTS) @ u, RAW, DOWN, 0.04)
        np.testing.assert_allclose(found.setpoint, u, atol=1e-12)
        assert (found.scale, found.limit) == (1.0, "")

    @pytest.mark.parametrize(
        ("u", "scale"),
        [((4, 3, 0, 0), 0.4), ((0, 0, -2, 0), 0.5), ((0.1, 0, 0, 1.6), 0.5), ((4, 0, 4, 0), 0.25)],
    )
    def test_beyond_them_it_is_scaled_as_a_whole(self, u, scale):
        robot = Quadrotor()
        found = robot.allocate(
            robot.motion_basis(DOWN, NO_JOINTS) @ np.array(u, dtype=float), RAW, DOWN, 0.04
        )
        np.testing.assert_allclose(found.setpoint, scale * np.array(u), atol=1e-12)
        assert found.scale == pytest.approx(scale)
        assert found.limit == "speed"
        np.testing.assert_allclose(
            found.twist, robot.motion_basis(DOWN, NO_JOINTS) @ found.setpoint, atol=1e-12
        )

    def test_roll_and_pitch_rates_are_dropped(self):
        found = Quadrotor().allocate(
            DOWN.to_camera @ np.array([0.1, 0, 0, 0.7, -0.7, 0]), RAW, DOWN, 0.04
        )
        np.testing.assert_allclose(found.setpoint, [0.1, 0, 0, 0], atol=1e-12)

    def test_measured_twist_is_that_of_the_camera(self):
        """By what flies: against MuJoCo's own velocity of the craft, through the mount."""
        craft = Flown(Quadrotor())
        craft.fly([0.8, -0.3, 0.2, 0.4], 3.0)
        before = craft.robot.reported(craft.state, craft.reading())
        true = DOWN.to_camera @ np.concatenate(
            [craft.R.T @ craft.data.qvel[:3], craft.data.qvel[3:]]
        )
        found = craft.robot.measured_twist(before, before, 0.04, np.zeros(6), DOWN)
        # The estimate's noise: 2 cm/s, and a gyro reading's .002 rad/s and what is left of its
        # bias.
        np.testing.assert_allclose(found, true, atol=0.03)

    def test_an_order_that_is_no_number_holds(self):
        craft, other = Flown(perfect()), Flown(perfect())
        a, b = craft.fly([math.nan, 0, 0, 1], 0.2), other.fly(HOLD, 0.2)
        np.testing.assert_array_equal(a.ctrl, b.ctrl)


class TestHover:
    def test_it_begins_in_equilibrium(self):
        log = Flown(perfect(height=2.0)).fly(HOLD, 1.0)
        # The whole state stands still: rotors, attitude, estimates.
        assert np.abs(log.position - [0, 0, 2]).max() < 1e-9
        np.testing.assert_allclose(log.ctrl, X4.hover, rtol=1e-9)

    @pytest.mark.parametrize(
        ("velocity", "duration"),
        [
            (Flow(), 20.0),
            pytest.param(Filtered(), 20.0, marks=pytest.mark.study),
            pytest.param(Flow(), 60.0, marks=pytest.mark.study),
            pytest.param(Filtered(), 60.0, marks=pytest.mark.study),
        ],
    )
    def test_holds_with_noise_and_bias(self, velocity, duration):
        """By velocity alone, no place known, with the default noise and bias of all instruments."""
        log = Flown(Quadrotor(velocity=velocity), seed=2).fly(HOLD, duration)
        away = np.abs(log.position - [0, 0, 2.0]).max(axis=0)
        # 10 s to learn bias and trim; then a walk by the flow's noise, .03 m/s in 20 ms: 4 mm per
        # root second, 3 cm in 60 s.
        assert away.max() < 0.25
        late = log.velocity[10000:]
        assert np.abs(late.mean(axis=0)).max() < 0.006
        assert late.std(axis=0).max() < 0.015
        assert np.degrees(log.tilt[10000:]).max() < 0.6
        estimated = np.array([(m.attitude.roll, m.attitude.pitch) for m in log.state[10000:]])
        # The accelerometer's bias, .05 and .03 m/s^2: .3 and .17 degrees, and what noise adds.
        assert np.abs(np.degrees(estimated - log.rpy[10000:, :2])).max() < 0.6
        # Roll and pitch bias are learnt, yaw's is not: nothing tells of heading.
        np.testing.assert_allclose(log.state[-1].attitude.bias[:2], (0.003, -0.002), atol=0.0015)
        assert not any(m.limited_s for m in log.state)

    def test_a_gust_of_five_metres_per_second(self):
        log = Flown(Quadrotor(), seed=1).fly(
            HOLD, 10.0, lambda t: (5, 0, 0) if 1 <= t < 5 else (0, 0, 0)
        )
        # 1.5 N on 4 kg; the integral needs a second or two to lean 2.2 degrees into it. Measured:
        # .18 m/s, .37 m.
        assert 0.12 < log.velocity[:, 0].max() < 0.25
        assert 0.2 < np.abs(log.position[:, 0]).max() < 0.5
        # nose up: thrust against the wind
        assert np.degrees(log.rpy[4000:5000, 1]).mean() == pytest.approx(-2.2, abs=0.4)
        assert np.abs(log.velocity[-1000:]).max() < 0.03
        assert np.abs(log.position[:, 2] - 2.0).max() < 0.1


def test_overturned_is_told_until_it_is_level_again():
    """A tilt beyond 60 degrees may be over before the next picture; that it happened is told until
    it takes orders again.
    """
    craft = Flown(perfect(height=40.0))
    craft.tilt(roll=math.radians(62))
    log = craft.fly(HOLD, 2.0)
    told = np.array([m.overturned for m in log.state])
    degrees = np.degrees(log.tilt)
    # from 15 degrees on, half a degree for what its estimate is off
    level = int(np.argmax(degrees < 14.5))
    assert told[: level - 50].all() and not told[level:].any()
    assert np.ptp(degrees[told]) > 40


class TestDown:
    def test_it_descends_stands_and_stops(self):
        craft = Flown(Quadrotor(start=FlightStart(nominal=FlightPose(xyz=(0, 0, 1.0)))), seed=4)
        log = craft.fly(descend(0.3), 1.5)
        assert log.velocity[-1, 2] == pytest.approx(-0.3, abs=0.03)
        assert not craft.robot.stands(craft.state, craft.reading())
        log = craft.fly(descend(0.3), 3.0)
        assert craft.robot.stands(craft.state, craft.reading())
        assert log.position[-1, 2] == pytest.approx(STANDING_M, abs=0.002)
        craft.fly(np.full(4, -np.inf), 0.1)
        log = craft.fly(descend(0.3), 2.0)  # off is off
        # exp(-2 / .117) of hover is left.
        assert craft.data.act.max() < 1.0
        assert np.abs(log.velocity[-1]).max() < 1e-3
        assert np.degrees(log.tilt[-1]) < 0.1
        assert np.abs(log.position[-1, :2]).max() < 0.15

    @pytest.mark.parametrize("speed", [0.2, 0.4])
    def test_it_knows_at_once_that_it_stands(self, speed):
        """On a deck that moves, in wind, a craft that is light on its feet slides off: it must not
        wait for its climb loop.
        """
        craft, told, touched = (
            Flown(Quadrotor(start=FlightStart(nominal=FlightPose(xyz=(0, 0, 0.4)))), seed=4),
            [],
            [],
        )
        for _ in range(200):
            craft.fly(descend(speed), 0.01, lambda t: (6, 0, 0))
            told.append(craft.robot.stands(craft.state, craft.reading()))
            touched.append(craft.data.ncon > 0)
        first = touched.index(True)
        assert not any(told[:first])  # 5 cm before, still sinking as told
        # hundredths of a second; by its rotors alone .5 s and more
        assert told.index(True) - first < 12

    def test_hovering_low_is_not_standing(self):
        craft = Flown(Quadrotor(start=FlightStart(nominal=FlightPose(xyz=(0, 0, 0.2)))))
        craft.fly(HOLD, 0.5)
        assert not craft.robot.stands(craft.state, craft.reading())

    def test_a_rotor_at_its_limit_is_told(self):
        craft = Flown(perfect())
        # 7.5 m/s^2 up: 1.76 times the weight, rotors give 1.35
        log = craft.fly([0, 0, 3.0, 0], 0.5)
        assert log.state[99].limited_s == pytest.approx(0.1, abs=0.02)
        assert craft.robot.reported(craft.state, craft.reading()).estimate.rotor_limit_s > 0.0
        log = craft.fly(HOLD, 1.0)
        assert log.state[-1].limited_s == 0.0
