"""`robot.parameters`: MuJoCo's own figures of the changed bodies, closed forms of their motions,
mistakes, servo loops from pictures.
"""

import dataclasses

import mujoco
import numpy as np
import pytest

import vstestbed as vs
from tests.shortcuts import one_quick
from vstestbed.core.errors import ParameterError
from vstestbed.core.named_files import model_path
from vstestbed.core.planar import motion_between
from vstestbed.robots import Car, Omni, Quadrotor, Robot
from vstestbed.robots.car import CarLimits, CarParameters, ackermann
from vstestbed.robots.omni import OmniParameters
from vstestbed.robots.rotors import QuadrotorParameters
from vstestbed.sim.scene.attach import _compiled, add_robot

HEAVY = QuadrotorParameters(
    mass_kg=8, arm_m=0.5, rotor_radius_m=0.25, thrust_coefficient=2.8e-5, drag_coefficient=3e-7
)
LONG = CarParameters(mass_kg=90, wheelbase_m=1.5, motor_torque_nm=40)
WIDE = OmniParameters(mass_kg=16, wheelbase_m=0.5, track_m=0.45, wheel_radius_m=0.075)
TALL = CarParameters(
    mass_kg=120, wheelbase_m=1.2, track_m=0.9, wheel_radius_m=0.2, motor_torque_nm=80
)
CALM = CarLimits(steering_rad=0.8)
CHANGED = [
    *(Car(parameters=LONG), Car(parameters=TALL, limits=CALM), Quadrotor(parameters=HEAVY)),
    *(Omni(parameters=WIDE), Omni(parameters=WIDE, wheels="planar")),
]


def scene(robot: Robot, step: float = 0.002) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """The robot on the world's floor."""
    world = mujoco.MjSpec.from_file(str(model_path("world.xml")))
    world.option.timestep, world.compiler.degree = step, False
    add_robot(world, robot, "robot/", None)
    model = world.compile()
    return model, mujoco.MjData(model)


def place(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """(x, y, heading) of the base."""
    mujoco.mj_kinematics(model, data)
    body = data.body("robot/base")
    return np.array([*body.xpos[:2], np.arctan2(body.xmat[3], body.xmat[0])])


@pytest.mark.parametrize(
    "robot", [Car(), Omni(), Omni(wheels="planar"), Quadrotor()], ids=lambda r: r.body.file
)
def test_the_defaults_are_the_file(robot: Robot):
    plain, changed = _compiled(robot.body.file), _compiled(robot.body.file, robot.body.changes)
    arrays = [name for name in dir(plain) if isinstance(getattr(plain, name), np.ndarray)]
    assert len(arrays) > 100
    for name in arrays:
        np.testing.assert_array_equal(getattr(plain, name), getattr(changed, name), err_msg=name)


@pytest.mark.parametrize("robot", CHANGED, ids=lambda r: f"{r.body.file}-{r.parameters.mass_kg:g}")
def test_mujoco_weighs_the_mass_that_was_asked_for(robot):
    model, _ = scene(robot)
    assert model.body_subtreemass[model.body("robot/base").id] == pytest.approx(
        robot.parameters.mass_kg, rel=1e-9
    )


@pytest.mark.parametrize("robot", CHANGED, ids=lambda r: f"{r.body.file}-{r.parameters.mass_kg:g}")
def test_the_catalogue_tests_pass(robot):
    vs.testing.check_robot(robot)


class TestQuadrotor:
    def test_the_rotors_at_hover_carry_the_weight(self):
        craft = Quadrotor(parameters=HEAVY)
        model, data = scene(craft, 0.001)
        data.qpos[2], data.act[:] = 5.0, craft.body.rest_ctrl
        data.ctrl[:] = data.act
        mujoco.mj_forward(model, data)
        assert data.qfrc_actuator[2] == pytest.approx(8 * 9.81, rel=1e-9)
        np.testing.assert_allclose(data.qacc, 0, atol=1e-9)

    def test_inertia_grows_as_of_similar_bodies_unless_it_is_given(self):
        model, _ = scene(Quadrotor(parameters=HEAVY), 0.001)
        share = 2 * (0.5 / 0.315) ** 2
        np.testing.assert_allclose(
            model.body_inertia[model.body("robot/base").id], np.array([0.082, 0.082, 0.149]) * share
        )
        own = dataclasses.replace(HEAVY, inertia_kgm2=(0.3, 0.4, 0.6))
        assert own.inertia == (0.3, 0.4, 0.6)

    def test_a_rotor_torques_with_the_longer_arm(self):
        model, data = scene(Quadrotor(parameters=HEAVY), 0.001)
        data.qpos[2], data.act[0] = 5.0, 400.0**2
        mujoco.mj_forward(model, data)
        thrust = 2.8e-5 * 400**2
        np.testing.assert_allclose(
            data.qfrc_actuator[[2, 4, 5]], [thrust, -0.5 * thrust, -3e-7 * 400**2], rtol=1e-9
        )


class TestCar:
    @pytest.mark.parametrize("steering", [0.3, -0.6])
    def test_the_turning_circle_is_the_wheelbase_over_the_tangent(self, steering):
        model, data = scene(Car(parameters=LONG))
        data.ctrl[:] = 0.4 / LONG.wheel_radius_m, steering
        mujoco.mj_step(model, data, 1500)
        motion, last = [], place(model, data)
        for _ in range(4):
            mujoco.mj_step(model, data, 250)
            now = place(model, data)
            motion.append(motion_between(last, now, 0.5))
            last = now
        v, _, w = np.mean(motion, axis=0)
        assert v / w == pytest.approx(1.5 / np.tan(steering), rel=0.002)
        # the motor loop alone: the rolling resistance holds it back
        assert v == pytest.approx(0.4, rel=0.03)

    @pytest.mark.parametrize("slant", [0.05, 0.2, 0.45, 0.7])
    def test_ackermann_steering_of_any_shape(self, slant):
        body = CarParameters(wheelbase_m=1.0, track_m=2 * slant) if slant > 0.22 else None
        most = body.most_steering_rad if body else 1.0
        d = np.linspace(-most, most, 201)
        p, q = (np.polynomial.Polynomial(c) for c in ackermann(slant))
        np.testing.assert_allclose(
            q(p(d)), np.arctan2(np.sin(d), np.cos(d) - slant * np.sin(d)), atol=1e-3
        )

    def test_its_front_wheels_stand_by_ackermann(self):
        model, data = scene(Car(parameters=LONG))
        data.ctrl[:] = 0.0, 0.7
        mujoco.mj_step(model, data, 1000)
        d = data.joint("robot/steering").qpos[0]
        left, right = (
            np.arctan2(np.sin(d), np.cos(d) - sign * 0.2 * np.sin(d)) for sign in (1, -1)
        )
        assert data.joint("robot/front_left_steer").qpos[0] == pytest.approx(left, abs=2e-3)
        assert data.joint("robot/front_right_steer").qpos[0] == pytest.approx(right, abs=2e-3)


class TestOmni:
    @pytest.mark.parametrize("wheels", ["rollers", "planar"])
    @pytest.mark.parametrize("motion", [(0.3, 0.0, 0.0), (0.0, 0.3, 0.0), (0.2, -0.1, 0.5)])
    def test_wheel_speeds_make_the_motion_of_the_mecanum_equations(self, wheels, motion):
        model, data = scene(Omni(wheels=wheels, parameters=WIDE))
        vx, vy, wz = motion
        kappa, a, b = np.sinc(1 / 9), 0.25, 0.225
        speeds = [vx - vy / kappa - (a / kappa + b) * wz, vx + vy / kappa + (a / kappa + b) * wz]
        speeds += [vx + vy / kappa - (a / kappa + b) * wz, vx - vy / kappa + (a / kappa + b) * wz]
        mujoco.mj_step(model, data, 150)
        data.ctrl[:] = np.array(speeds) / 0.075
        mujoco.mj_step(model, data, 250)
        before = place(model, data)
        mujoco.mj_step(model, data, 400)
        np.testing.assert_allclose(
            motion_between(before, place(model, data), 0.8), motion, atol=0.003
        )


def test_what_cannot_be_is_told_with_what_would_work():
    for make, words in (
        (
            lambda: QuadrotorParameters(mass_kg=8),
            "mass_kg leaves a thrust of 0.675 times the weight",
        ),
        (
            lambda: QuadrotorParameters(mass_kg=8),
            (
                "mass_kg up to 4.15, or thrust_coefficient from 2.55e-05,"
                " or rotor_speed_radps from 1388"
            ),
        ),
        (
            lambda: QuadrotorParameters(arm_m=0.2),
            "rotor_radius_m must be under 0.141 m at arm_m 0.2: neighbouring rotors would meet",
        ),
        (
            lambda: QuadrotorParameters(inertia_kgm2=(0.1, 0.1, 0.3)),
            "inertia_kgm2 must have no moment over the sum of the two others",
        ),
        (
            lambda: QuadrotorParameters(inertia_kgm2=(0.9, 0.9, 0.9)),
            "inertia_kgm2 lets the rotors turn the craft by 2.4 rad/s",
        ),
        (lambda: QuadrotorParameters(mass_kg=-4), "mass_kg "),
        (
            lambda: Quadrotor(parameters=QuadrotorParameters(rotor_lag_s=0.02)),
            "gains.rotor_s must be at most 0.02 s",
        ),
        (
            lambda: CarParameters(wheelbase_m=0.4, wheel_radius_m=0.2),
            "wheelbase_m must be at least 0.5 m",
        ),
        (
            lambda: CarParameters(track_m=0.4),
            "track_m must be at least 0.422 m at wheel_radius_m 0.15: a narrower car tips",
        ),
        (
            lambda: Car(parameters=CarParameters(wheelbase_m=0.6)),
            "limits.steering_rad must be at most 0.876 rad",
        ),
        (
            lambda: Car(parameters=CarParameters(mass_kg=120)),
            "parameters.motor_torque_nm must be at least 29.6 Nm",
        ),
        (lambda: OmniParameters(wheel_radius_m=0.15), "wheelbase_m must be at least 0.36 m"),
        (
            lambda: OmniParameters(mass_kg=200),
            "mass_kg must be at most 160 kg: motor_torque_nm 2 accelerates more by under 1 m/s^2",
        ),
    ):
        with pytest.raises(ParameterError) as told:
            make()
        assert words in str(told.value)


@pytest.mark.parametrize(
    ("name", "parameters"),
    one_quick(
        ("omni_ibvs", {"wheelbase_m": 0.5, "track_m": 0.5, "mass_kg": 20}),
        ("car_pbvs", {"wheelbase_m": 1.5}),
        pytest.param(
            "car_pbvs",
            {"wheelbase_m": 1.5, "mass_kg": 120, "motor_torque_nm": 60},
            marks=pytest.mark.study,
        ),
        pytest.param(
            "quadrotor_hover",
            {f.name: getattr(HEAVY, f.name) for f in dataclasses.fields(HEAVY)},
            marks=pytest.mark.study,
        ),
        pytest.param(
            "quadrotor_land",
            {f.name: getattr(HEAVY, f.name) for f in dataclasses.fields(HEAVY)},
            marks=pytest.mark.study,
        ),
    ),
)
def test_a_changed_robot_reaches_its_goal_by_its_pictures(name, parameters):
    scenario = vs.load(name, {"robot.parameters": parameters})
    assert vs.run(scenario).outcome.name in ("converged", "landed")
