"""Imperfections of vehicles in MuJoCo, against theory: tyres, coasting, play, unequal wheels, an
uneven floor.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from pathlib import Path

import mujoco
import numpy as np
import pytest

import vstestbed as vs
from vstestbed.core.planar import place_of
from vstestbed.effects.floor import HALF_M, RELIEF, UnevenFloor
from vstestbed.effects.wheels import WHEELS, TyreForces, Tyres, WheelSpread
from vstestbed.robots.car import Car, CarLimits, CarParameters
from vstestbed.robots.omni import Omni
from vstestbed.robots.vehicle import GroundStart
from vstestbed.sim.base import SceneDescription, Truth
from vstestbed.sim.build import scene_files
from vstestbed.sim.plant import MujocoPlant
from vstestbed.sim.scene.scene import Scene
from vstestbed.sim.scene.world import World

G, STEP = 9.81, 0.002
FAST = CarLimits(speed_mps=3.0, acceleration_mps2=2.0)
Driven = Callable[..., "Drive"]


class Drive:
    """A vehicle at the origin on its plant."""

    def __init__(self, robot: Car | Omni, floor_friction: float | None = None):
        s = vs.load("car_pbvs")
        self.robot = robot
        self.stage = Scene(
            SceneDescription(robot, s.camera, s.target, World(floor_friction=floor_friction), STEP)
        )
        self.plant = MujocoPlant(self.stage, None, False, np.random.default_rng(0))
        self.model, self.data = self.stage.model, self.stage.data

    def go(self, duration: float, *setpoint: float) -> Truth:
        if setpoint:
            self.plant.apply(np.array(setpoint))
        assert self.plant.advance(round(duration / STEP))
        return self.plant.truth()

    @property
    def place(self) -> np.ndarray:
        """True (x, y, heading)."""
        assert self.stage.root is not None
        return place_of(self.stage.root.pose(self.data))

    @property
    def velocity(self) -> tuple[float, float, float]:
        """True (vx, vy, wz) of the frame on the floor, in its own axes."""
        twist, root = np.zeros(6), self.stage.root
        assert root is not None
        mujoco.mj_objectVelocity(
            self.model, self.data, mujoco.mjtObj.mjOBJ_XBODY, root.body, twist, 1
        )
        return twist[3], twist[4], twist[2]

    def body(self, name: str) -> int:
        return int(self.model.body(f"robot/{name}").id)

    def joint(self, name: str) -> int:
        return int(self.model.joint(f"robot/{name}").dofadr[0])


@pytest.fixture
def driven() -> Iterator[Driven]:
    made: list[Drive] = []

    def build(robot: Car | Omni, floor_friction: float | None = None) -> Drive:
        made.append(Drive(robot, floor_friction))
        return made[-1]

    yield build
    for drive in made:
        drive.plant.close()


class TestTyres:
    @pytest.mark.parametrize(("speed", "sigma"), [(1.0, 0.1), (2.5, 0.1), (2.5, 0.3)])
    def test_a_step_of_slip_angle_takes_the_relaxation_length(
        self, speed: float, sigma: float, driven: Driven
    ) -> None:
        """The car is led with a held slip angle from rest: the force on its wheels has 63 % of the
        last after the way sigma.
        """
        drive = driven(Car(tyres=Tyres(stiffness=6.0, relaxation_m=sigma)))
        model, data, slip = drive.model, drive.data, 0.002
        forces = TyreForces(drive.stage.body, Tyres(stiffness=6.0, relaxation_m=sigma))
        # The rear wheels: the front ones give way by their steering, by a tenth of this slip.
        bodies, slides = (
            [get(f"{name}{end}") for name in WHEELS[2:]]
            for get, end in ((drive.body, "_wheel"), (drive.joint, "_spring"))
        )
        upright = data.qpos[2:7].copy()
        found = []
        for _ in range(round(5 * sigma / speed / STEP)):
            data.qpos[2:7], data.qvel[:] = upright, 0.0
            data.qvel[:2] = speed, slip * speed
            data.qvel[[drive.joint(name) for name in WHEELS]] = speed / 0.15
            mujoco.mj_step1(model, data)
            forces.act(0.0, STEP)
            found.append(-data.xfrc_applied[bodies, 1].sum() / data.qfrc_constraint[slides].sum())
            drive.stage.step(1)
        way = (np.arange(len(found)) + 1) * speed * STEP
        assert found[-1] == pytest.approx(6.0 * slip, rel=0.02)
        assert np.interp(1 - math.exp(-1), np.array(found) / (6.0 * slip), way) == pytest.approx(
            sigma, rel=0.02
        )

    def test_a_bend_takes_its_slip_angle(self, driven: Driven) -> None:
        """The rear axle's share of m v^2 / R is c alpha of its load, b / L m g: alpha = v^2 / (R g
        c), whatever the mass.
        """
        for mass, speed in ((60.0, 1.2), (90.0, 2.0)):
            parameters = CarParameters(mass_kg=mass, motor_torque_nm=40.0)
            drive = driven(Car(tyres=Tyres(stiffness=6.0), limits=FAST, parameters=parameters))
            drive.go(3.5, speed, 0.1)
            vx, vy, wz = drive.velocity
            assert vx * wz > 0.09 * speed**2
            # the brush is softer by 2 % here
            assert -math.atan2(vy, vx) == pytest.approx(vx * wz / (G * 6.0), rel=0.03)

    def test_odometry_does_not_see_the_side_slip(self, driven: Driven) -> None:
        """The rear axle drifts outwards by v tan(alpha); by its encoders the car goes where it
        points.
        """
        drive = driven(Car(tyres=Tyres(stiffness=4.0), limits=FAST))
        drive.go(3.0, 2.0, 0.1)
        before = drive.plant.reading()
        drive.go(0.2)
        ahead, aside, _ = drive.robot.odometry(before, drive.plant.reading(), 0.2)
        vx, vy, wz = drive.velocity
        assert aside == 0.0 and vy == pytest.approx(-(vx**2) * wz / (G * 4.0), rel=0.04)
        assert 1.0 < ahead / vx < 1.01  # driven wheels turn a little faster than they roll

    def test_softer_front_tyres_understeer(self, driven: Driven) -> None:
        """The steering angle L / R + K a_y has the gradient K = (1 / c_front - 1 / c_rear) / g; a
        car with equal tyres has none.
        """
        bends = []
        for rear in (6.0, 12.0):
            drive = driven(Car(tyres=Tyres(stiffness=6.0, rear_stiffness=rear), limits=FAST))
            drive.go(3.5, 2.0, 0.1)
            vx, _, wz = drive.velocity
            bends.append((math.atan(wz / vx), vx * wz))
        (neutral, _), (under, acceleration) = bends
        assert neutral == pytest.approx(0.1, abs=1e-3)
        assert (neutral - under) / acceleration == pytest.approx((1 / 6 - 1 / 12) / G, rel=0.03)

    def test_loads_are_the_weight(self, driven: Driven) -> None:
        drive = driven(Car(tyres=Tyres()))
        drive.go(0.5)
        loads = drive.data.qfrc_constraint[[drive.joint(f"{name}_spring") for name in WHEELS]]
        assert loads.sum() == pytest.approx(60 * G, rel=1e-3)
        np.testing.assert_allclose(
            loads, 60 * G * np.array([0.2044, 0.2044, 0.2956, 0.2956]), rtol=0.01
        )

    def test_a_car_that_stands_stays_also_where_it_is_pushed(self, driven: Driven) -> None:
        """A spring of stiffness c m g / sigma for all four wheels: it gives way, and comes back."""
        drive = driven(Car(tyres=Tyres(stiffness=10.0, relaxation_m=0.15)))
        y = drive.place[1]
        drive.plant.push(np.array([0.0, 30.0, 0.0]), 2.0)
        drive.go(2.0)
        pushed = drive.place[1] - y
        # the camera's body is not the middle of the car
        assert pushed == pytest.approx(30.0 / (10.0 * 60 * G / 0.15), rel=0.25)
        drive.go(3.0)
        assert abs(drive.place[1] - y) < 0.02 * pushed

    def test_on_ice_it_slides(self, driven: Driven) -> None:
        """No more acceleration than mu g, in a bend that would take .6 m/s^2 of it at 1.4 m/s."""
        drive = driven(
            Car(tyres=Tyres(), limits=CarLimits(speed_mps=1.4, acceleration_mps2=0.3)), 0.05
        )
        drive.go(4.0, 1.4, 0.0)
        before = np.array(drive.data.qvel[:2])
        drive.go(0.5, 1.4, 0.3)
        assert np.hypot(*(drive.data.qvel[:2] - before)) / 0.5 < 0.05 * G * 1.05


class TestRolling:
    @pytest.mark.parametrize("coefficient", [0.015, 0.04])
    def test_a_car_coasts_to_rest_by_its_rolling_resistance(
        self, coefficient: float, driven: Driven
    ) -> None:
        """m_eff a = c m g, with the wheels' inertia in m_eff, beside the same car without: that has
        its bearings alone.
        """
        slowed = [
            coasting(driven(Car(rolling_resistance=c, limits=FAST)), "drive")
            for c in (0.0, coefficient)
        ]
        spin = 4 * (0.5 * 1.5 * 0.15**2 + 0.5 * 0.7 * 0.088**2)
        assert slowed[1] - slowed[0] == pytest.approx(
            coefficient * G * 60 / (60 + spin / 0.15**2), rel=0.02
        )

    def test_and_so_does_the_base(self, driven: Driven) -> None:
        bases = [driven(Omni(rolling_resistance=c)) for c in (0.0, 0.02)]
        slowed = [coasting(base, *WHEELS) for base in bases]
        assert slowed[1] - slowed[0] == pytest.approx(
            0.02 * G * 8 / (8 + 4 * 1.6e-3 / 0.05**2), rel=0.03
        )


def coasting(drive: Drive, *motors: str) -> float:
    """The deceleration without motors, from about 1 m/s [m/s^2]."""
    orders = (1.0, 0.0) if len(motors) == 1 else (20.0,) * 4
    drive.go(1.5, *orders)
    for name in motors:
        motor = drive.model.actuator(f"robot/{name}").id
        drive.model.actuator_gainprm[motor] = drive.model.actuator_biasprm[motor] = 0.0
    before = drive.velocity[0]
    drive.go(0.4)
    return (before - drive.velocity[0]) / 0.4


class TestPlay:
    CAR = Car(steering_play_deg=3.0, limits=CarLimits(steering_rate_radps=0.15))
    """Slow enough that the wheels stop with the servo, by friction."""

    def test_the_wheels_follow_behind_the_play(self, driven: Driven) -> None:
        """Servo less output is half the play on the way out, minus half of it on the way back: all
        of it is lost at a turn.
        """
        width = math.radians(3.0)
        drive = driven(self.CAR)
        servo, output = (
            drive.data.joint(f"robot/{name}") for name in ("steering", "steering_output")
        )
        lost = []
        for angle in (0.1, -0.1, 0.1):
            drive.go(1.6, 0.5, angle)
            lost.append(servo.qpos[0] - output.qpos[0])
            assert servo.qpos[0] == pytest.approx(angle, abs=4e-3)
        np.testing.assert_allclose(lost, [width / 2, -width / 2, width / 2], rtol=0.03)

    def test_a_turn_within_the_play_moves_no_wheel(self, driven: Driven) -> None:
        drive = driven(self.CAR)
        drive.go(0.8, 0.5, 0.1)
        wheel = drive.data.joint("robot/front_left_steer")
        before = float(wheel.qpos[0])
        drive.go(0.5, 0.5, 0.1 - 0.9 * math.radians(3.0))
        assert float(wheel.qpos[0]) == pytest.approx(before, abs=2e-3)

    def test_its_encoder_is_the_servos(self, driven: Driven) -> None:
        drive = driven(self.CAR)
        drive.go(0.8, 0.5, 0.1)
        assert drive.plant.reading().q[0] == pytest.approx(0.1, abs=4e-3)


class TestSpread:
    def test_dead_reckoning_turns_by_unequal_rear_wheels(self, driven: Driven) -> None:
        """Of wheels that roll, v = r (1 + e) w: odometry takes the larger one, which turns slower,
        for the one in the bend.

        The heading drifts by v (1 / (1 + e_right) - 1 / (1 + e_left)) / track.
        """
        left, right = 0.004, -0.004
        drive = driven(Car(wheel_spread=WheelSpread(errors=(0.0, 0.0, left, right))))
        drive.go(1.5, 1.0, 0.0)
        before, at, t = drive.plant.reading(), drive.place, 3.0
        drive.go(t)
        odometry = drive.robot.odometry(before, drive.plant.reading(), t)
        gone = drive.place - at
        v = math.hypot(gone[0], gone[1]) / t
        drift = odometry[2] - gone[2] / t
        assert drift == pytest.approx(v * (1 / (1 + right) - 1 / (1 + left)) / 0.6, rel=0.03)

    def test_all_wheels_larger_are_a_wrong_scale(self, driven: Driven) -> None:
        drive = driven(Omni(wheel_spread=WheelSpread(errors=(0.02,) * 4)))
        drive.go(0.5, *(10.0,) * 4)
        before, at = drive.plant.reading(), drive.place
        drive.go(1.0)
        true = np.hypot(*(drive.place - at)[:2])
        assert true / drive.robot.odometry(before, drive.plant.reading(), 1.0)[0] == pytest.approx(
            1.02, abs=2e-3
        )


class TestUnevenFloor:
    FLOOR = UnevenFloor(rms_m=0.002, correlation_m=0.4, seed=3)

    def test_rays_meet_its_heights(self, driven: Driven) -> None:
        drive = driven(Car(uneven_floor=self.FLOOR))
        heights = self.FLOOR.heights(HALF_M)
        relief = drive.model.geom(RELIEF).id
        for row, column in np.random.default_rng(0).integers(1, len(heights) - 1, (50, 2)).tolist():
            x, y = (2 * HALF_M * np.array([column, row]) / (len(heights) - 1) - HALF_M).tolist()
            way = mujoco.mj_rayHfield(
                drive.model, drive.data, relief, np.array([x, y, 1.0]), np.array([0.0, 0.0, -1.0])
            )
            assert 1.0 - way == pytest.approx(heights[row, column], abs=2e-6)

    @pytest.mark.parametrize("robot", [Car, Omni])
    def test_a_vehicle_rides_on_it(self, robot: type[Car | Omni], driven: Driven) -> None:
        """It goes up and down with the floor, stays in contact, and touches nothing that counts as
        a collision.
        """
        drive = driven(
            robot(
                uneven_floor=UnevenFloor(rms_m=0.003, correlation_m=0.5, seed=1),
                start=GroundStart(),
            )
        )
        heights = []
        for _ in range(30):
            truth = drive.go(0.1, *((1.0, 0.2) if robot is Car else (10.0,) * 4))
            assert not truth.contact
            heights.append(drive.stage.root.pose(drive.data)[2, 3])  # pyright: ignore[reportOptionalMemberAccess] - a vehicle has one
        assert 0.0005 < np.std(heights) < 0.006

    def test_it_starts_where_it_is_told(self, driven: Driven) -> None:
        drive = driven(Car(uneven_floor=UnevenFloor(rms_m=0.005), tyres=Tyres()))
        np.testing.assert_allclose(drive.place, 0.0, atol=1e-6)
        before = drive.place
        drive.go(1.0)
        # the drive's loop lets it creep where the floor slopes
        np.testing.assert_allclose(drive.place, before, atol=2e-3)

    def test_the_written_model_has_it(self, tmp_path: Path) -> None:
        s = vs.load(
            "car_pbvs",
            {
                "robot.uneven_floor": {"rms_m": 0.002, "correlation_m": 1.0},
                "robot.steering_play_deg": 1.0,
            },
        )
        xml, assets = scene_files(s.scene)
        (tmp_path / "model.xml").write_text(xml)
        for name, data in assets.items():
            (tmp_path / name).parent.mkdir(exist_ok=True)
            (tmp_path / name).write_bytes(data)
        model = mujoco.MjModel.from_xml_path(str(tmp_path / "model.xml"))
        assert model.hfield_nrow[0] == 201 and model.ntendon == 2
