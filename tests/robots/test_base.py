"""What every robot of the room does alike: starts, mounts, bases, logs."""

import numpy as np
import pytest

import vstestbed as vs
from vstestbed.camera import Perspective
from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Pose, exp, rigid_error
from vstestbed.core.planar import GroundPose
from vstestbed.robots import Car, Free, Mount, Omni, Puma560, Quadrotor
from vstestbed.robots.arm import PositionBox, Positions
from vstestbed.robots.base import STOP_S, Reading, RobotLog, RobotState, Supervisor
from vstestbed.robots.flight import HOLD, Failsafe
from vstestbed.robots.free import Box, FreeStart
from vstestbed.robots.puma560 import PumaStart
from vstestbed.robots.quadrotor import FlightBox, FlightPose, FlightStart
from vstestbed.robots.vehicle import GroundBox, GroundStart
from vstestbed.scenario.checks import check_metres

GROUND = GroundStart(nominal=GroundPose(x=1, y=2, heading_deg=30), random=GroundBox(x=1, y=1))
ROBOTS = {
    "free": Free(
        start=FreeStart(
            nominal=Pose(xyz=(1, 2, 3), rpy_deg=(10, 20, 30)), random=Box(xyz=(0.1, 0, 0))
        )
    ),
    "puma560": Puma560(
        start=PumaStart(
            nominal=Positions(q_deg=(5, 45, -180, 10, 45, -45)), random=PositionBox(q_deg=1.0)
        )
    ),
    "car": Car(start=GROUND),
    "omni": Omni(start=GROUND),
    "omni, planar wheels": Omni(start=GROUND, wheels="planar"),
    "quadrotor": Quadrotor(
        start=FlightStart(
            nominal=FlightPose(xyz=(1, 2, 3), yaw_deg=40), random=FlightBox(xyz=(1, 1, 1))
        )
    ),
}
ELSEWHERE = {
    "free": (Pose(xyz=(1, 2, 3)).T @ exp(np.array([0.2, -0.1, 0.3, 0.4, -0.2, 1.0]))).ravel(),
    "puma560": np.array([0.1, 0.7, -3.0, 0.2, 0.9, -0.5]),
    "car": np.array([-3.0, 4.0, 2.5]),
    "omni": np.array([-3.0, 4.0, -2.5]),
    "omni, planar wheels": np.array([-3.0, 4.0, 0.5]),
    "quadrotor": np.array([-1.0, 2.0, 5.0, -1.2]),
}


@pytest.fixture(params=ROBOTS)
def name(request: pytest.FixtureRequest) -> str:
    return request.param


def test_started_elsewhere_it_stands_there_and_is_the_same_robot_otherwise(name):
    robot = ROBOTS[name]
    moved = robot.started_at(ELSEWHERE[name])
    # Through degrees, and of a pose through roll, pitch and yaw: rounding.
    np.testing.assert_allclose(moved.configuration(), ELSEWHERE[name], atol=1e-12)
    assert moved.start.random == robot.start.random and type(moved) is type(robot)
    back = moved.started_at(robot.configuration())
    assert rigid_error(
        back.flange_pose(back.configuration()), robot.flange_pose(robot.configuration())
    ) == pytest.approx((0, 0), abs=1e-7)


def test_a_start_elsewhere_keeps_all_other_parameters():
    assert (
        Omni(wheels="planar", wheel_radius_error=0.01).started_at(np.ones(3)).wheel_radius_error
        == 0.01
    )
    assert (
        Puma560(actuation="industrial", avoid_limits=2.0).started_at(ELSEWHERE["puma560"]).actuation
        == "industrial"
    )
    assert Quadrotor(max_speed_mps=3.0).started_at(ELSEWHERE["quadrotor"]).max_speed_mps == 3.0


def test_its_joints_at_the_start(name):
    robot = ROBOTS[name]
    joints = robot.start_joints()
    assert joints.shape == (len(robot.joints),)
    # An arm's configuration is its joints; a vehicle's wheels have not turned, wherever it stands.
    np.testing.assert_array_equal(joints, robot.configuration() if name == "puma560" else 0.0)


def test_an_arm_is_idealised_with_all_else_kept():
    arm = Puma560(start=ROBOTS["puma560"].start, actuation="industrial", avoid_limits=2.0)
    ideal = arm.idealised()
    assert (ideal.actuation, ideal.avoid_limits, ideal.start) == ("ideal", 2.0, arm.start)
    assert ideal.body.actuation is not None and not ideal.body.actuation.friction


def test_bases():
    for base, names in (
        ("fixed", {"free", "puma560"}),
        ("planar", {"car", "omni", "omni, planar wheels"}),
        ("floating", {"quadrotor"}),
    ):
        assert {name for name, robot in ROBOTS.items() if robot.base == base} == names


class TestMount:
    def test_a_vehicles_camera_must_be_over_the_floor(self, name):
        robot, target = ROBOTS[name], vs.load("ibvs_book").target
        check_metres(robot, Perspective(mount=Pose(xyz=(0.2, 0.1, 0.3))), target)
        for z in (0.0, -0.1):
            under = Perspective(mount=Pose(xyz=(0.2, 0.1, z)))
            if robot.base != "planar":
                check_metres(robot, under, target)
                continue
            with pytest.raises(ParameterError) as told:
                check_metres(robot, under, target)
            assert told.value.field == "camera.mount.xyz"
            assert (
                "must have z > 0: the vehicle's frame lies on the floor,"
                " and the camera would be under it" in str(told.value)
            )

    def test_the_motion_basis_spans_what_is_allocated(self, name):
        """A small twist within the basis is made exactly, one beside it is not made."""
        robot = ROBOTS[name]
        mount, q = (
            Mount.of(Pose(xyz=(0.1, 0.05, 0.2), rpy_deg=(20, -30, 100)).T),
            robot.start_joints(),
        )
        basis, reading = robot.motion_basis(mount, q), Reading(q, np.zeros(len(q)))
        assert basis.shape == (
            6,
            {"fixed": 6, "planar": 3, "floating": 4}[robot.base] - (name == "car"),
        )
        twist = basis @ np.full(basis.shape[1], 0.01)
        np.testing.assert_allclose(
            robot.allocate(twist, reading, mount, 0.04).twist, twist, atol=1e-9
        )


class TestSupervisorAndLog:
    def test_only_a_craft_that_flies_has_a_failsafe_and_a_setpoint_that_holds(self, name):
        robot = ROBOTS[name]
        supervisor, hold = (
            robot.supervisor(True, 0.7, 3.0),
            robot.onboard and robot.onboard.first_setpoint,
        )
        assert (supervisor.lost_after_s, supervisor.lost_after_m) == (0.7, 3.0)
        if robot.base == "floating":
            assert isinstance(supervisor, Failsafe) and supervisor.lands
            np.testing.assert_array_equal(hold, HOLD)
        else:
            assert type(supervisor) is Supervisor and hold is None

    def test_each_robot_logs_what_its_supervisor_does(self, name):
        assert ROBOTS[name].log(Supervisor()).columns[-1] == "supervisor"

    def test_the_mode_is_a_column(self, name):
        still = np.zeros(3)
        state = RobotState(0.0, np.eye(4), still, still, Reading(still, still), np.zeros(0), still)
        log = RobotLog(Supervisor(mode=2))
        assert log.columns == ("supervisor",) and log.row(state).tolist() == [2]


class TestStopping:
    """From any setpoint to rest, in the robot's own way."""

    def test_what_it_ends_at_is_rest(self, name):
        robot = ROBOTS[name]
        setpoint = robot.allocate(
            np.full(6, 0.1), Reading(robot.start_joints(), np.zeros(6)), Mount.of(np.eye(4)), 0.04
        ).setpoint
        end = robot.stopping(setpoint, 10.0)
        assert end.shape == setpoint.shape
        # a car keeps its wheels in the bend
        assert not end[:1].any() if name == "car" else not end.any()

    def test_velocities_fall_together_and_steadily(self, name):
        robot = ROBOTS[name]
        if robot.onboard is not None:
            return  # its onboard controller limits its deceleration
        u = np.array([0.4, -0.2, 0.0])
        if robot.body is None:  # a camera without mass
            assert not robot.stopping(u, 1e-9).any()
            return
        stop_s = getattr(robot, "stop_s", STOP_S)
        np.testing.assert_allclose(robot.stopping(u, 0.0), u)
        np.testing.assert_allclose(robot.stopping(u, 0.25 * stop_s), 0.75 * u)
        assert not robot.stopping(u, stop_s).any() and not robot.stopping(u, 2 * stop_s).any()


def test_of_vehicles_only_one_on_planar_wheels_cannot_slip(name):
    body = ROBOTS[name].body
    assert body is None or body.slips is (name != "omni, planar wheels")
