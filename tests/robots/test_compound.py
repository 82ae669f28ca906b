"""A mobile manipulator: its chain against MuJoCo's poses, how platform and arm share a motion, and
what it refuses.
"""

from __future__ import annotations

from contextlib import closing
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import vstestbed as vs
from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import exp, inverse, log
from vstestbed.loop.plants import plant_of
from vstestbed.robots.compound import Compound
from vstestbed.sim.plant import MujocoPlant

STILL = vs.Mount.of(np.eye(4))


@pytest.fixture(scope="module")
def scenario() -> vs.Scenario:
    return vs.load("mobile_ibvs", {"detector": "oracle"})


@pytest.fixture(scope="module")
def robot(scenario: vs.Scenario) -> Compound:
    assert isinstance(scenario.robot, Compound)
    return scenario.robot


def test_its_own_kinematics_are_those_of_the_model_of_both(
    scenario: vs.Scenario, robot: Compound
) -> None:
    rng = np.random.default_rng(0)
    with closing(plant_of(scenario, False, 0.0)[0]) as plant:
        assert isinstance(plant, MujocoPlant)
        stage = plant._stage
        for _ in range(5):
            q = robot.configuration() + rng.uniform(-1, 1, 9) * [
                2,
                2,
                3,
                0.5,
                0.5,
                0.3,
                0.5,
                0.5,
                0.5,
            ]
            stage.place(0.0, stage.target_pose(), q)
            assert robot.flange_pose(q) == pytest.approx(
                stage.camera_pose() @ stage.mount_inverse, abs=1e-6
            )


def test_its_jacobian_is_the_derivative(robot: Compound) -> None:
    q, h = robot.configuration() + 0.1, 1e-6
    T, J = robot.kinematics(q)
    for i, d in enumerate(np.eye(9)):
        step = log(inverse(T) @ robot.flange_pose(q + h * d)) / h
        assert step == pytest.approx(J[:, i], abs=1e-5)


def test_the_camera_gets_its_twist_and_the_arm_is_drawn_to_its_middle_in_what_is_left(
    robot: Compound,
) -> None:
    q = robot.configuration() + np.array([1.0, -0.5, 0.4, 0.3, -0.2, 0.2, 0.1, 0.2, -0.1])
    twist = np.array([0.02, -0.01, 0.03, 0.01, 0.02, -0.01])
    made = robot.allocate(twist, vs.Reading(q, np.zeros(9)), STILL, 0.04)
    assert made.scale == pytest.approx(1.0) and made.twist == pytest.approx(twist, abs=1e-9)
    rest = robot.allocate(np.zeros(6), vs.Reading(q, np.zeros(9)), STILL, 0.04)
    assert rest.twist == pytest.approx(np.zeros(6), abs=1e-9)
    away = (q - robot.configuration())[3:]
    # the platform makes room for it
    assert rest.setpoint[3:] @ away < 0 and np.abs(rest.setpoint[:3]).max() > 0


def test_the_platform_goes_where_the_arm_does_not_reach(
    scenario: vs.Scenario, robot: Compound
) -> None:
    run = vs.run(scenario)
    assert run.outcome is vs.Outcome.converged
    moved = np.array([run[f"q_{name}"][-1] - run[f"q_{name}"][0] for name in robot.joints])
    assert moved[0] > 1.5 and np.abs(moved[3:]).max() < 0.4
    alone = vs.load(
        "arm_ibvs", {"detector": "oracle", "target": scenario.target, "stop": scenario.stop}
    )
    assert not vs.run(alone).outcome.success


def test_forces_and_speeds_of_the_platform_are_those_of_its_wheels(robot: Compound) -> None:
    p = robot.platform
    force = 4 * p.motor_torque_nm / p.wheel_radius_m
    lever = (p.wheelbase_m + p.track_m) / 2
    assert robot.largest_torques[:3] == pytest.approx([force, force, force * lever])
    assert robot.joint_speeds[:3] == pytest.approx([1.0, 1.0, 1.0 / lever])  # 20 rad/s times 50 mm
    with closing(plant_of(vs.load("mobile_ibvs", {"detector": "oracle"}), False, 0.0)[0]) as plant:
        assert isinstance(plant, MujocoPlant)
        plant.apply(np.array([1.0, 0, 0, 0, 0, 0, 0, 0, 0]))
        plant.advance(20)
        tau = plant.truth().tau
        assert abs(tau[0]) <= force + 1e-6
        for _ in range(20):  # a command lasts for half a second
            plant.apply(np.array([1.0, 0, 0, 0, 0, 0, 0, 0, 0]))
            plant.advance(49)
        q = plant.reading().q
    assert q[0] == pytest.approx(2.0, abs=0.15)  # a metre a second for two seconds, less its start


def test_it_starts_and_stops_as_other_arms_do_with_inner_loops(scenario: vs.Scenario) -> None:
    for loop in ("computed_torque", "impedance"):
        run = vs.run(
            replace(
                scenario,
                robot=replace(scenario.robot, controller={"kind": loop}),
                stop=replace(scenario.stop, duration_s=6.0),
            )
        )
        assert run["position_error_m"][-1] < 0.15 * run["position_error_m"][0]


def test_an_arm_of_ones_own_may_be_on_it(robot: Compound) -> None:
    reach = robot.flange_pose(robot.configuration())
    other = vs.load("arm_jaco").robot
    made = replace(
        robot, arm=other, start={"nominal": {"q_deg": [0, 0, 0, *other.start.nominal.q_deg]}}
    )
    up = exp(np.array([0, 0, 0.119, 0, 0, 0]))
    assert made.flange_pose(made.configuration()) == pytest.approx(
        up @ other.flange_pose(other.configuration()), abs=1e-9
    )
    assert len(made.joints) == 3 + len(other.joints) and reach.shape == (4, 4)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"gears": {"stiffness_nmprad": (1e4,)}}, "gears is for an arm on a base that stands"),
        ({"start": {"nominal": {"q_deg": [0, 0]}}}, r"start\.nominal\.q_deg must be 9 positions"),
    ],
)
def test_what_does_not_fit_is_refused(robot: Compound, change: dict[str, Any], words: str) -> None:
    with pytest.raises(ParameterError, match=words):
        replace(robot, **change)
