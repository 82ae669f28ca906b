"""What a law may know of its robot: J against poses, displacements against the log, limits against
the robot's own.
"""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest

import vstestbed as vs
from tests.robots.arms import where_installed
from vstestbed.core.geometry import inverse, log
from vstestbed.laws import IBVS
from vstestbed.robots import Mount, Omni
from vstestbed.robots.own_model import OwnModel

LIMITS = {"stop": {"duration_s": 0.6}, "detector": "oracle"}


class Asks:
    """Watches a run of a law that asks for `robot`."""

    def __init__(self) -> None:
        self.frames: list[vs.Frame] = []

    def frame(self, frame: vs.Frame) -> None:
        """Keep it."""
        self.frames.append(frame)


class Asking(IBVS):
    """IBVS that names one more input."""

    @property
    def inputs(self) -> tuple[str, ...]:
        return (*super().inputs, "robot")


def models_of(name: str, changes: dict[str, Any]) -> tuple[list[OwnModel], list[vs.Frame]]:
    """What the law was told of its robot in each frame, and the frames."""
    scenario, watch = vs.load(name, LIMITS | changes), Asks()
    law = Asking(**{f.name: getattr(scenario.law, f.name) for f in fields(IBVS)})
    vs.run(replace(scenario, law=law), watch=[watch])
    return [
        model for frame in watch.frames if (model := frame.observation.robot) is not None
    ], watch.frames


@pytest.mark.parametrize("name", where_installed(["arm_ibvs", "arm_jaco", "arm_eye_to_hand"]))
def test_the_jacobian_is_the_derivative_of_the_cameras_pose(name: str) -> None:
    scenario = vs.load(name)
    robot, controller = scenario.robot, vs.Controller(scenario)
    q, n = robot.start_joints(), len(robot.joints)
    model = robot.own_model(vs.Reading(q, np.zeros(n)), controller._mount_at(q))

    def seen(at: np.ndarray) -> np.ndarray:
        # the target in the camera, or the flange in a camera that stands in the room
        T = robot.flange_pose(at)
        if scenario.target.on_gripper:
            return inverse(scenario.camera.mount.T) @ T
        return inverse(T @ scenario.camera.mount.T)

    for i in range(n):
        step = 1e-6 * np.eye(n)[i]
        # T_camera_target <- exp(-v dt) T
        twist = log(seen(q - step) @ inverse(seen(q + step))) / 2e-6
        np.testing.assert_allclose(model.J[:, i], twist, atol=1e-7)
    np.testing.assert_array_equal(model.jacobian(q), model.J)
    assert (model.low < q).all() and (q < model.high).all()


def test_displacements_are_those_of_the_joints_in_the_log() -> None:
    models, frames = models_of(
        "arm_ibvs", {"camera": {"latency_s": 0.06}, "timing": {"command_latency_s": 0.02}}
    )
    q = np.array([frame.truth.q for frame in frames])
    for k in range(1, len(models)):
        np.testing.assert_allclose(models[k].moved, q[k] - q[k - 1], atol=1e-12)
        assert models[k].since_s == pytest.approx(0.04)
        assert models[k].underway_s == pytest.approx(0.08)
    # two frames later the joints are where the model expected them when its command took effect,
    # but for the servos' lag
    ahead = np.array([model.underway for model in models[4:-2]])
    np.testing.assert_allclose(ahead, q[6 : 4 + len(ahead) + 2] - q[4 : 4 + len(ahead)], atol=2e-3)
    assert np.abs(ahead).max() > 0.01
    then = np.array([model.q_then for model in models[4:-2]])
    np.testing.assert_allclose(then, q[6 : 6 + len(then)], atol=2e-3)


def test_a_camera_without_sensors_knows_its_way_by_its_orders() -> None:
    models, frames = models_of(
        "ibvs_book", {"camera.latency_s": 0.04, "camera.rate_hz": 25, "law.gain": 0.2}
    )
    T = [frame.truth.T_world_camera for frame in frames]
    for k in range(4, len(models)):
        np.testing.assert_allclose(models[k].moved, log(inverse(T[k - 1]) @ T[k]), atol=2e-4)
    for k in range(4, len(models) - 1):  # the latency is one frame
        np.testing.assert_allclose(models[k].underway, log(inverse(T[k]) @ T[k + 1]), atol=2e-4)


def test_the_joints_ordered_are_those_of_the_last_command() -> None:
    models, frames = models_of("arm_ibvs", {})
    for model, before in zip(models[1:], frames, strict=False):
        np.testing.assert_array_equal(model.ordered, before.allocation.setpoint)


@pytest.mark.parametrize(
    ("name", "names"),
    [("omni_ibvs", ("vx", "vy", "wz")), ("car_pbvs", ("v", "w")), ("ibvs_book", None)],
)
def test_other_robots_have_the_motions_of_their_basis(
    name: str, names: tuple[str, ...] | None
) -> None:
    robot, mount = (s := vs.load(name)).robot, Mount.of(s.camera.mount.T)
    at = robot.start_joints()
    model = robot.own_model(vs.Reading(at, at), mount)
    np.testing.assert_array_equal(model.J, robot.motion_basis(mount, at))
    assert names is None or model.names == names
    assert np.isinf(model.low).all() and np.isinf(model.high).all()


def test_a_platform_at_the_edge_of_its_model_is_not_scaled_and_beyond_it_is() -> None:
    robot, mount, reading = Omni(), Mount.of(np.eye(4)), vs.Reading(np.zeros(4), np.zeros(4))
    model = robot.own_model(reading, mount)
    rates = np.array([0.3, -0.4, 0.5])
    edge = rates / np.max(np.abs(model.sums @ rates) / model.most)
    assert robot.allocate(model.J @ edge, reading, mount, 0.04).scale == pytest.approx(1.0)
    assert robot.allocate(model.J @ (1.25 * edge), reading, mount, 0.04).scale == pytest.approx(0.8)


def test_a_quadrotor_tells_its_tilt() -> None:
    models, frames = models_of("quadrotor_hover", {})
    for model, frame in zip(models, frames, strict=True):
        assert model.tilt is not None and np.abs(model.tilt).max() < model.most_tilt_rad
        assert frame.observation.robot is model
    assert models[0].acceleration[0] == pytest.approx(9.81 * np.tan(np.radians(30)))


def test_joint_speeds_ordered_directly_keep_the_limits_of_the_arm() -> None:
    scenario = vs.load("arm_ibvs")
    robot, mount = scenario.robot, Mount.of(scenario.camera.mount.T)
    q = np.zeros(6)
    model = robot.own_model(vs.Reading(q, q), mount)
    fast = robot.allocate_rates(3 * model.speed, vs.Reading(q, q), mount, 0.04)
    np.testing.assert_allclose(fast.setpoint, model.speed)
    assert fast.limit == "speed" and fast.scale == pytest.approx(1 / 3)
    np.testing.assert_allclose(fast.twist, model.J @ fast.setpoint)
    near = q.copy()
    # a degree from the margin at which it comes to rest: 4 degrees a second
    near[0] = model.high[0] - np.radians(2.0)
    slow = robot.allocate_rates(np.eye(6)[0], vs.Reading(near, q), mount, 0.04)
    assert slow.limit == "joint_limit" and slow.setpoint[0] == pytest.approx(np.radians(1.0) / 0.25)
