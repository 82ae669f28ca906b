"""Whatever makes a robot's twist another one than was commanded has a name: in the allocation, in
the order, in the log.
"""

from __future__ import annotations

import numpy as np
import pytest

import vstestbed as vs
from vstestbed.laws import Command
from vstestbed.robots import ROBOTS, Mount
from vstestbed.robots.allocation import LIMITS, Order
from vstestbed.robots.base import Reading
from vstestbed.robots.puma560 import Puma560

NAMES = (
    "ibvs_book",
    "arm_wrist",
    "arm_panda",
    "arm_jaco",
    "mobile_ibvs",
    "omni_ibvs",
    "car_pbvs",
    "quadrotor_hover",
)
PERIOD, DRAWS = 0.04, 150
SAME = 1e-5  # ten times what counts as rounding, relative


def robot_of(name: str):
    scenario = vs.load(name)
    return scenario.robot, Mount.of(scenario.camera.mount.T)


def joints_of(robot, rng, k: int):
    """Anywhere within the limits; every second time with a joint at zero, where wrists and elbows
    are aligned.
    """
    chain = getattr(robot, "chain", None)
    if chain is None:
        return robot.start_joints() + rng.normal(0, 0.1, len(robot.joints))
    low, high = np.clip(chain.limits, -np.pi, np.pi).T
    q = rng.uniform(low, high)
    if k % 2:
        q[rng.integers(len(q))] = 0.0
    return np.clip(q, low, high)


def test_each_kind_of_robot_is_among_them():
    assert {robot_of(name)[0].kind for name in NAMES} == set(ROBOTS.members)


@pytest.mark.parametrize("name", ["arm_ibvs", "omni_ibvs"])
def test_rates_that_make_another_twist_than_their_law_says_are_named(name):
    """A law of others that orders velocities of joints or wheels, with a twist that they do not
    make.
    """
    controller = vs.Controller(vs.load(name))
    robot = controller.scenario.robot
    q = (
        np.array([0.3, 0.9, -2.8, 0.2, 0.9, -0.5])
        if robot.base == "fixed"
        else robot.start_joints()
    )
    reading, named = Reading(q, np.zeros_like(q), 0.1), []
    mount = controller._mount_at(q)
    model = robot.own_model(reading, mount)
    for off in (0.0, 0.05):
        rates = np.full(len(model.names), 0.01)
        twist = model.J @ rates
        made = controller._allocate(
            Command(twist, twist + off * np.eye(6)[3], rates=rates), reading, mount
        )
        named.append(Order.of(made).reason)
    assert named[0] == "" and "it moves another way than was commanded" in named[1]


@pytest.mark.parametrize("name", NAMES)
def test_a_twist_that_is_not_the_commanded_one_names_its_limit(name):
    """Orders from 1 mm/s to 10 m/s along the robot's motions, at 150 configurations: the robot
    itself says why it differs.
    """
    (robot, mount), rng = robot_of(name), np.random.default_rng(0)
    limited = 0
    for k in range(DRAWS):
        q = joints_of(robot, rng, k)
        reading, basis = Reading(q, np.zeros_like(q)), robot.motion_basis(mount, q)
        twist = basis @ rng.normal(0, 10 ** rng.uniform(-3, 1), basis.shape[1])
        made = robot.allocate(twist, reading, mount, PERIOD)
        off = np.linalg.norm(made.twist - twist) / np.linalg.norm(twist)
        assert made.limit or off < SAME, (k, off)
        told = made.told(twist)
        along = made.twist @ twist / max(np.linalg.norm(made.twist) * np.linalg.norm(twist), 1e-12)
        if along < 1 - SAME and made.twist.any():
            assert told.turned_rad == pytest.approx(np.arccos(max(-1, along)), abs=1e-6)
            assert "another way" in Order.of(told).reason
        assert bool(Order.of(told).reason) == bool(told.limit)
        limited += bool(made.limit)
    assert (limited == 0) if robot.kind == "free" else 0 < limited < DRAWS


@pytest.mark.parametrize("name", ["omni_ibvs", "car_pbvs", "quadrotor_hover"])
def test_a_motion_that_the_robot_has_not_is_named(name):
    (robot, mount), rng = robot_of(name), np.random.default_rng(1)
    q = robot.start_joints()
    for _ in range(20):
        twist = rng.normal(0, 0.01, 6)  # in all six directions
        order = Order.of(robot.allocate(twist, Reading(q, 0 * q), mount, PERIOD).told(twist))
        assert (
            order.reason.startswith((LIMITS["motion"], LIMITS["joint_limit"]))
            and "another way" in order.reason
        )


def test_an_aligned_wrist_that_turns_the_motion_says_so():
    """Joint 5 at zero: of 300 poses, many get another direction at a scale near .6, where no name
    was given.
    """
    robot, mount, rng, turned = Puma560(), Mount.of(np.eye(4)), np.random.default_rng(0), []
    for k in range(300):
        q = joints_of(robot, rng, 0)
        q[4] = 0.0
        twist = rng.normal(0, 0.02, 6)
        made = robot.allocate(twist, Reading(q, 0 * q), mount, PERIOD).told(twist)
        assert made.limit and Order.of(made).reason, k
        turned.append(made.turned_rad)
    assert np.degrees(np.median(turned)) > 10


@pytest.mark.parametrize("name", ["mobile_ibvs", "arm_panda"])
def test_an_order_to_rest_is_rest_also_near_a_singular_configuration(name):
    """The motion in the null space of a redundant arm does not move its camera."""
    (robot, mount), rng = robot_of(name), np.random.default_rng(0)
    for k in range(DRAWS):
        q = joints_of(robot, rng, k)
        made = robot.allocate(np.zeros(6), Reading(q, 0 * q), mount, PERIOD)
        assert np.abs(made.twist).max() < 1e-9, k  # rounding of speeds of some rad/s


def test_the_log_of_a_run_names_it_and_one_without_a_loss_keeps_its_columns():
    lost = vs.run(vs.load("arm_wrist", {"detector": "oracle", "stop.duration_s": 0.2}))
    assert lost.columns[-2:] == ("limit", "turned_rad")
    number = list(LIMITS).index("singular")
    assert lost["limit"][0] == number and lost["turned_rad"][0] > 0
    none = vs.run(vs.load("ibvs_book", {"detector": "oracle", "stop.duration_s": 0.2}))
    assert not set(none.columns) & {"limit", "turned_rad"}
