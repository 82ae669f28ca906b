"""models/car.xml on the floor of world.xml: weight, springs, Ackermann angles, turning circles,
servos, ice.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import mujoco
import numpy as np
import pytest

from tests.shortcuts import one_quick
from vstestbed.core.planar import moved
from vstestbed.laws.pose_controller import polar_law
from vstestbed.robots.allocation import Mount
from vstestbed.robots.base import Reading
from vstestbed.robots.car import BUGGY, Car, CarLimits, drive

MODELS = Path(__file__).parents[2] / "models"
G = 9.81
WHEELS = ("front_left", "front_right", "rear_left", "rear_right")
STEP = 0.002


def compose(friction: float | None = None, timestep: float = STEP) -> mujoco.MjModel:
    """The car in the world, on a floor and with wheels of at most a friction; sim/scene does the
    same.
    """
    world = mujoco.MjSpec.from_file(str(MODELS / "world.xml"))
    car = mujoco.MjSpec.from_file(str(MODELS / "car.xml"))
    car.option.timestep = timestep
    world.option.timestep, world.option.cone, world.option.impratio = (
        timestep,
        mujoco.mjtCone.mjCONE_ELLIPTIC,
        10,
    )
    world.attach(car, prefix="robot/", frame=world.worldbody.add_frame())
    for geom in world.geoms:
        if friction is not None:
            geom.friction = [min(geom.friction[0], friction), *geom.friction[1:]]
    return world.compile()


@dataclass
class Driver:
    """A car in MuJoCo with its onboard servos."""

    model: mujoco.MjModel
    car: Car = field(default_factory=Car)

    def __post_init__(self) -> None:
        self.data = mujoco.MjData(self.model)
        self.state = self.car.begin()
        self.q = [self.model.joint(f"robot/{name}").qposadr[0] for name in self.car.joints]
        self.qd = [self.model.joint(f"robot/{name}").dofadr[0] for name in self.car.joints]
        mujoco.mj_forward(self.model, self.data)

    @property
    def reading(self) -> Reading:
        return Reading(self.data.qpos[self.q].copy(), self.data.qvel[self.qd].copy())

    @property
    def place(self) -> np.ndarray:
        """True (x, y, heading)."""
        x, y, _, w, i, j, k = self.data.qpos[:7]
        return np.array([x, y, np.arctan2(2 * (w * k + i * j), 1 - 2 * (j * j + k * k))])

    def joint(self, name: str) -> float:
        return float(self.data.joint(f"robot/{name}").qpos[0])

    def go(
        self, duration: float, setpoint: Callable[[float], tuple[float, float]]
    ) -> Iterator[float]:
        """Drive, one control period after the other; yields the time since the call."""
        period = self.car.control_period_s
        assert period is not None
        for k in range(round(duration / period)):
            order = np.array(setpoint(k * period))
            self.state, self.data.ctrl[:] = self.car.actuate(
                self.state, order, self.reading, period
            )
            mujoco.mj_step(self.model, self.data, nstep=round(period / self.model.opt.timestep))
            yield (k + 1) * period

    def drive(self, duration: float, speed: float, steering: float) -> np.ndarray:
        """Drive at one setpoint; true places (T, 3), headings unwrapped, at each control period
        from the first.
        """
        places = np.array(
            [self.place, *(self.place for _ in self.go(duration, lambda _: (speed, steering)))]
        )
        places[:, 2] = np.unwrap(places[:, 2])
        return places

    def normal_forces(self) -> np.ndarray:
        """Normal force at each contact [N]."""
        force = np.zeros(6)
        out = []
        for i in range(self.data.ncon):
            mujoco.mj_contactForce(self.model, self.data, i, force)
            out.append(force[0])
        return np.array(out)


def ackermann(steering: float) -> np.ndarray:
    """Angles of the left and the right front wheel: each at right angles to its line to the centre
    of the turn.
    """
    if steering == 0:
        return np.zeros(2)
    radius = BUGGY.wheelbase_m / np.tan(steering)
    return np.array(
        [
            np.arctan(BUGGY.wheelbase_m / (radius - BUGGY.track_m / 2)),
            np.arctan(BUGGY.wheelbase_m / (radius + BUGGY.track_m / 2)),
        ]
    )


@pytest.fixture(scope="module")
def rubber() -> mujoco.MjModel:
    return compose()


@pytest.fixture(scope="module")
def ice() -> mujoco.MjModel:
    return compose(friction=0.05)


class TestFigures:
    def test_python_and_the_file_have_one_geometry(self, rubber):
        data = Driver(rubber).data
        at = np.array([data.body(f"robot/{name}_wheel").xpos for name in WHEELS])
        half = BUGGY.track_m / 2
        # Springs at their rest, wheels where they touch the floor.
        places = [
            [BUGGY.wheelbase_m, half, BUGGY.wheel_radius_m],
            [BUGGY.wheelbase_m, -half, BUGGY.wheel_radius_m],
            [0, half, BUGGY.wheel_radius_m],
            [0, -half, BUGGY.wheel_radius_m],
        ]
        np.testing.assert_allclose(at, places, atol=1e-12)
        np.testing.assert_allclose(
            [rubber.geom(f"robot/{name}_contact").size[[0, 2]] for name in WHEELS],
            BUGGY.wheel_radius_m,
        )
        assert [rubber.actuator(i).name for i in range(rubber.nu)] == [
            f"robot/{name}" for name in Car().body.actuators
        ]

    def test_sixty_kilograms(self, rubber):
        assert rubber.body("robot/base").subtreemass[0] == pytest.approx(60, abs=1e-9)

    def test_colours_stay_grey(self, rubber):
        rgb = rubber.mat_rgba[:, :3]
        assert np.all(rgb.max(axis=1) - rgb.min(axis=1) < 0.18)

    def test_the_deck_is_flat_and_free(self, rubber):
        """Rays down from above meet the deck, or the lining on it, over all its area."""
        data = Driver(rubber).data
        hit = np.zeros(1, dtype=np.int32)
        for x in np.linspace(-0.17, 0.77, 20):
            for y in np.linspace(-0.27, 0.27, 12):
                down = mujoco.mj_ray(
                    rubber, data, np.array([x, y, 2.0]), np.array([0, 0, -1.0]), None, 1, -1, hit
                )
                assert 2.0 - down == pytest.approx(0.40, abs=1e-3)

    @pytest.mark.parametrize("steering", [0.0, 1.0, -1.0])
    def test_a_camera_under_the_belly_sees_the_floor(self, rubber, steering):
        driver = Driver(rubber)
        driver.data.joint("robot/steering").qpos = steering
        (
            driver.data.joint("robot/front_left_steer").qpos,
            driver.data.joint("robot/front_right_steer").qpos,
        ) = ackermann(steering)
        mujoco.mj_kinematics(rubber, driver.data)
        hit, eye = np.zeros(1, dtype=np.int32), np.array([0.5, 0, 0.3])
        for tilt in np.radians(np.arange(0, 46, 5)):  # a picture of 90 degrees across the middle
            for turn in np.linspace(0, 2 * np.pi, 24, endpoint=False):
                ray = np.array(
                    [np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), -np.cos(tilt)]
                )
                mujoco.mj_ray(rubber, driver.data, eye, ray, None, 1, -1, hit)
                assert rubber.geom(int(hit[0])).name == "floor"

    def test_a_camera_ahead_looks_over_the_bonnet(self, rubber):
        """From .1 above the deck: nothing of the car down to 8.5 degrees below the horizon, over
        120 degrees.
        """
        driver = Driver(rubber)
        hit, eye = np.zeros(1, dtype=np.int32), np.array([0.2, 0, 0.5])
        for down in np.radians([-60, -30, 0, 5, 8.5]):
            for aside in np.radians(np.linspace(-60, 60, 25)):
                ray = np.array(
                    [np.cos(aside) * np.cos(down), np.sin(aside) * np.cos(down), -np.sin(down)]
                )
                mujoco.mj_ray(rubber, driver.data, eye, ray, None, 1, -1, hit)
                assert hit[0] < 0 or rubber.geom(int(hit[0])).name == "floor"


class TestAtRest:
    @pytest.mark.parametrize("timestep", [0.001, 0.002])
    def test_wheels_carry_the_weight_and_nothing_creeps(self, timestep):
        driver = Driver(compose(timestep=timestep))
        before = driver.drive(1.0, 0.0, 0.0)[-1]
        # At rest it is exact but for the last of the springs' motion.
        assert driver.normal_forces().sum() == pytest.approx(60 * G, rel=1e-3)
        assert driver.data.ncon == 4
        after = driver.drive(5.0, 0.0, 0.0)[-1]
        np.testing.assert_allclose(after, before, atol=1e-6)  # a micrometre in 5 s

    def test_it_stands_at_the_height_drawn(self, rubber):
        driver = Driver(rubber)
        driver.drive(1.0, 0.0, 0.0)
        assert driver.data.qpos[2] == pytest.approx(0, abs=2e-4)  # .1 mm of tyre
        for name in WHEELS:
            assert driver.joint(f"{name}_spring") == pytest.approx(0, abs=2e-4)

    def test_springs_settle_within_a_second(self, rubber):
        driver = Driver(rubber)
        driver.data.qpos[2] += 0.03  # dropped from 3 cm
        heights = np.array([driver.data.qpos[2] for _ in driver.go(1.5, lambda _: (0.0, 0.0))])
        assert heights.min() < -0.005  # it did dip
        assert np.abs(heights[60:]).max() < 5e-4  # by .6 s
        assert driver.normal_forces().sum() == pytest.approx(60 * G, rel=1e-3)

    def test_weight_in_a_bend_too(self, rubber):
        driver = Driver(rubber)
        driver.drive(3.0, 1.0, 0.5)
        forces = driver.normal_forces()
        assert forces.sum() == pytest.approx(60 * G, rel=0.01)
        assert forces.max() / forces.min() > 1.2  # the outer wheels carry more


class TestSteering:
    @pytest.mark.parametrize(
        "steering", one_quick(-1.0, -0.7, -0.25, -0.1, 0.1, 0.25, 0.5, 0.8, 1.0, every=4)
    )
    def test_front_wheels_stand_at_ackermann_angles(self, rubber, steering):
        driver = Driver(rubber)
        driver.drive(1.5, 0.3, steering)
        now = driver.joint("steering")
        assert now == pytest.approx(steering, abs=1e-3)  # the servo's droop under the tyres' torque
        # The fit is within .12 mrad; 1 mrad is what matters (a toe of 1 mrad costs .03 % of speed).
        np.testing.assert_allclose(
            [driver.joint("front_left_steer"), driver.joint("front_right_steer")],
            ackermann(now),
            atol=3e-4,
        )

    def test_they_keep_them_on_the_way(self, rubber):
        driver, worst = Driver(rubber), 0.0
        for _ in driver.go(4.0, lambda t: (1.0, np.sin(3 * t))):
            now = np.array([driver.joint("front_left_steer"), driver.joint("front_right_steer")])
            worst = max(worst, float(np.abs(now - ackermann(driver.joint("steering"))).max()))
        assert worst < 2e-3  # the links give a little at 2 rad/s

    @pytest.mark.parametrize(
        ("speed", "steering", "within"),
        # Slow: the kinematic circle. At 1 m/s on the tightest one (1.6 m/s^2) the body leans and
        # the tyres slip by .4 %.
        one_quick(
            (0.3, 0.1, 0.002),
            (0.3, 0.25, 0.002),
            (0.3, 0.5, 0.002),
            (0.3, 1, 0.002),
            (-0.3, 0.25, 0.002),
            (0.3, -0.25, 0.002),
            (1, 1, 0.01),
            every=3,
        ),
    )
    def test_turning_circle(self, rubber, speed, steering, within):
        driver = Driver(rubber)
        driver.drive(2.5, speed, steering)
        places = driver.drive(4.0, speed, steering)
        way = np.linalg.norm(np.diff(places[:, :2], axis=0), axis=1).sum()
        radius = way / (places[-1, 2] - places[0, 2])
        assert radius * np.sign(speed) == pytest.approx(
            BUGGY.wheelbase_m / np.tan(steering), rel=within
        )
        # An open differential: each rear wheel rolls on its own circle.
        left, right = driver.reading.qd[3:5]
        inner = (BUGGY.wheelbase_m / np.tan(steering) - BUGGY.track_m / 2) / (
            BUGGY.wheelbase_m / np.tan(steering) + BUGGY.track_m / 2
        )
        assert left / right == pytest.approx(inner, rel=0.01)

    def test_straight_stays_straight(self, rubber):
        places = Driver(rubber).drive(5.0, 1.0, 0.0)
        assert places[-1, 0] > 4
        np.testing.assert_allclose(places[:, 1:], 0, atol=1e-5)


class TestServos:
    def test_speed_is_kept_whatever_rolls_against_it(self, rubber):
        for speed, steering in ((0.2, 0.0), (1.0, 0.0), (1.0, 1.0), (-0.5, 0.3)):
            driver = Driver(rubber)
            driver.drive(2.5, speed, steering)
            places = driver.drive(1.0, speed, steering)
            way = np.linalg.norm(np.diff(places[:, :2], axis=0), axis=1).sum()
            assert way == pytest.approx(abs(speed), rel=0.003)  # tyres creep by .1 %, sum of chords

    def test_acceleration_and_steering_rate_are_limited(self, rubber):
        car = Car(limits=CarLimits(acceleration_mps2=1.0, steering_rate_radps=0.5))
        driver, speeds, angles = Driver(rubber, car), [], []
        for _ in driver.go(2.5, lambda _: (1.0, 1.0)):
            speeds.append(driver.reading.qd[3:5].mean() * BUGGY.wheel_radius_m)
            angles.append(driver.joint("steering"))
        slope, rate = np.diff(speeds) / 0.01, np.diff(angles) / 0.01
        # A servo behind a ramp follows with its slope; it may pass it by a little while it catches
        # up.
        assert np.max(slope) < 1.2 and np.mean(slope[20:80]) == pytest.approx(1.0, abs=0.05)
        assert np.max(rate) < 0.55 and np.mean(rate[20:150]) == pytest.approx(0.5, abs=0.01)
        assert speeds[-1] == pytest.approx(1.0, abs=0.01)
        assert angles[-1] == pytest.approx(1.0, abs=2e-3)

    def test_it_brakes_to_a_stand(self, rubber):
        driver = Driver(rubber)
        driver.drive(2.0, 1.0, 0.2)
        driver.drive(1.0, 0.0, 0.2)
        at = driver.place
        # Springs and the motor's grip let go of the last 20 micrometres.
        np.testing.assert_allclose(driver.drive(2.0, 0.0, 0.2)[-1], at, atol=5e-5)


class TestOdometry:
    def way(self, model: mujoco.MjModel, car: Car | None = None) -> tuple[np.ndarray, np.ndarray]:
        """True and dead-reckoned place after 8 s of slalom at 1 m/s, read at 25 Hz."""
        driver = Driver(model, car or Car())
        place, before = driver.place, driver.reading
        for k, _ in enumerate(driver.go(8.0, lambda t: (1.0, 0.8 * np.sin(1.5 * t)))):
            if k % 4 == 3:
                now = driver.reading
                place = moved(place, driver.car.odometry(before, now, 0.04), 0.04)
                before = now
        return driver.place, place

    def test_on_rubber_it_is_true(self, rubber):
        true, told = self.way(rubber)
        assert np.linalg.norm(true[:2]) > 5
        np.testing.assert_allclose(told[:2], true[:2], atol=0.01)  # .1 % of 7 m
        assert told[2] == pytest.approx(true[2], abs=0.003)

    def test_on_ice_it_is_not(self, ice):
        true, told = self.way(ice)
        assert np.linalg.norm(told - true) > 1.0  # it spins and slides straight on

    def test_a_wrong_radius_scales_it(self, rubber):
        """2 % too large: wheels turn 2 % slower, odometry says what was commanded."""
        driver = Driver(rubber, Car(wheel_radius_error=0.02))
        driver.drive(2.0, 1.0, 0.0)
        before, start = driver.reading, driver.place
        end = driver.drive(2.0, 1.0, 0.0)[-1]
        told = driver.car.odometry(before, driver.reading, 2.0)
        assert told[0] == pytest.approx(1.0, abs=0.003)
        assert (end - start)[0] / 2 == pytest.approx(1 / 1.02, abs=0.003)


def test_on_ice_it_starts_slowly_and_ploughs_on(ice, rubber):
    slow, fast = Driver(ice).drive(1.0, 1.0, 0.0), Driver(rubber).drive(1.0, 1.0, 0.0)
    # Rear wheels with 60 % of the weight push by .05 of that at most; 1.5 m/s^2 are asked for.
    assert slow[-1, 0] < 0.5 * 0.05 * G * 0.7
    assert fast[-1, 0] > 0.6
    bend = Driver(ice).drive(5.0, 1.0, 0.6)
    assert bend[-1, 2] < 0.6 * Driver(rubber).drive(5.0, 1.0, 0.6)[-1, 2]


def test_at_three_metres_a_second_it_slides_and_does_not_tip(rubber):
    driver = Driver(rubber, Car(limits=CarLimits(speed_mps=3.0)))
    driver.drive(3.0, 3.0, 0.0)
    up = [driver.data.body("robot/base").xmat[8] for _ in driver.go(3.0, lambda _: (3.0, 1.0))]
    assert np.degrees(np.arccos(min(up))) < 6


@pytest.mark.parametrize(
    ("start", "way"),
    one_quick(((2, 2, 0.35), 1), ((7, 8.5, 2.2), -1)),
    ids=["the book's start, forward", "a park in reverse"],
)
def test_under_the_polar_law_it_drives_as_the_ideal_bicycle(rubber, start, way):
    """The law knows the true place, at 25 Hz; what differs is lag, tyres and springs."""
    goal, gains, mount = np.array([5, 5, np.pi / 2]), (1, 4, -2.5), Mount.of(np.eye(4))
    driver, order = Driver(rubber), [0.0, 0.0]
    driver.data.qpos[[0, 1, 3, 6]] = *start[:2], np.cos(start[2] / 2), np.sin(start[2] / 2)
    basis, limits = driver.car.motion_basis(mount, driver.reading.q), driver.car.limits
    places = []
    for k, _ in enumerate(driver.go(12.0, lambda _, order=order: (order[0], order[1]))):
        if k % 4 == 3:
            u = np.array(polar_law(driver.place, goal, np.array(way), gains, 1.0))
            order[:] = driver.car.allocate(basis @ u, driver.reading, mount, 0.04).setpoint
        places.append(driver.place)
    ideal = drive(
        lambda p: polar_law(p, goal, np.array(way), gains, 1.0),
        np.array(start),
        BUGGY.wheelbase_m,
        limits,
        12.0,
        0.04,
    )
    apart = np.linalg.norm(np.array(places)[::5, None, :2] - ideal.place[:, :2], axis=2).min(axis=1)
    assert apart.max() < 0.04  # measured .008 and .018: less than a servo's lag of .05 s at 1 m/s
    assert np.linalg.norm(places[-1][:2] - goal[:2]) < 0.03
    assert abs(places[-1][2] - goal[2]) < np.radians(1)


def test_its_ends_and_its_tightest_circle_are_what_scenarios_are_checked_against():
    """The bumpers' ends by the compiled boxes round all geoms; the circle is that of the turning
    tests at the steering's limit.
    """
    model = compose()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    ends = ends_of(model, data)
    assert ends == pytest.approx(Car().ends_m, abs=1e-3)
    assert (
        Car().turning_radius_m
        == pytest.approx(BUGGY.wheelbase_m / np.tan(1.0))
        == pytest.approx(0.642, abs=1e-3)
    )


def ends_of(model: mujoco.MjModel, data: mujoco.MjData) -> tuple[float, float]:
    """Least and largest x of a vehicle's geoms [m]."""
    own = np.flatnonzero(model.geom_bodyid > 0)
    middle = np.array(
        [data.geom_xpos[g] + data.geom_xmat[g].reshape(3, 3) @ model.geom_aabb[g, :3] for g in own]
    )
    half = np.array([np.abs(data.geom_xmat[g].reshape(3, 3)) @ model.geom_aabb[g, 3:] for g in own])
    return float((middle - half)[:, 0].min()), float((middle + half)[:, 0].max())
