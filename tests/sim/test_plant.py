"""The plants: truth of this very instant, servos as fast and as exact as their figures say, the
exact ideal camera.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import closing

import numpy as np
import pytest

import vstestbed as vs
from tests.shortcuts import forward
from vstestbed.core.geometry import Array, Pose, adjoint, exp, inverse, rigid_error
from vstestbed.robots import Mount
from vstestbed.sim.base import Plant, Truth
from vstestbed.sim.build import PictureSetup, build_plant

MOUNT = {"xyz": [0.03, -0.02, 0.1], "rpy_deg": [20, -30, 50]}
STEP = 0.002
Build = Callable[..., Plant]


@pytest.fixture
def arm() -> Iterator[Build]:
    """arm(actuation, mount): the plant of arm_ibvs without pictures."""
    made: list[Plant] = []

    def build(actuation: str = "industrial", mount: dict | None = None) -> Plant:
        s = vs.load("arm_ibvs", {"robot.actuation": actuation, "camera.mount": mount or {}})
        plant, renderer = build_plant(s.scene)
        assert (plant.step_s, plant.steps_per_frame, renderer) == (STEP, 20, "none")
        made.append(plant)
        return plant

    yield build
    for plant in made:
        plant.close()


def one_joint(joint: int, speed: float) -> Array:
    return speed * np.eye(6)[joint]


def truths(plant: Plant, steps: int) -> list[Truth]:
    """The truth after each of so many steps."""
    out = []
    for _ in range(steps):
        assert plant.advance(1)
        out.append(plant.capture()[1])
    return out


class TestTruth:
    def test_camera_pose_is_of_now(self, arm: Build):
        plant = arm("industrial", MOUNT)
        plant.apply(np.array([0.4, 0.2, -0.3, 0.5, 0.5, -0.5]))
        plant.advance(100)
        before = plant.capture()[1]
        plant.advance(1)
        now = plant.capture()[1]
        mount = Pose(**MOUNT).T
        # Kinematics in numpy of the joints as they are now: rounding. The pose moves by .5 mm a
        # step here, which is what MuJoCo's own step would leave it behind.
        np.testing.assert_allclose(now.T_world_camera, forward(now.q) @ mount, atol=1e-12)
        assert rigid_error(before.T_world_camera, now.T_world_camera)[0] > 2e-4
        np.testing.assert_array_equal(plant.reading().q, now.q)
        np.testing.assert_array_equal(plant.reading().qd, now.qd)
        np.testing.assert_array_equal(now.ctrl, [0.4, 0.2, -0.3, 0.5, 0.5, -0.5])

    def test_twist_is_the_derivative_of_the_pose(self, arm: Build):
        plant = arm("industrial", MOUNT)
        plant.apply(np.array([0.4, 0.2, -0.3, 0.5, 0.5, -0.5]))
        plant.advance(200)  # past the servos' rise
        before, now, after = truths(plant, 3)
        D = (
            inverse(now.T_world_camera) @ after.T_world_camera
            - inverse(now.T_world_camera) @ before.T_world_camera
        )
        differences = np.array([*D[:3, 3], D[2, 1], D[0, 2], D[1, 0]]) / (2 * STEP)
        # Semi-implicit steps: q moves by the speed at a step's end, so that central differences see
        # the mean of two speeds a step apart, 1 mm/s at .5 m/s^2.
        np.testing.assert_allclose(now.twist, differences, atol=1e-3)
        assert np.linalg.norm(now.twist[:3]) > 0.2 and np.linalg.norm(now.twist[3:]) > 0.2

    def test_a_captured_truth_does_not_change_later(self, arm: Build):
        plant = arm()
        plant.apply(one_joint(0, 0.5))
        then = plant.capture()[1]
        kept = then.q.copy(), then.T_world_camera.copy(), then.ctrl.copy()
        plant.advance(50)
        plant.capture()
        for a, b in zip(kept, (then.q, then.T_world_camera, then.ctrl), strict=True):
            np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("actuation", ["ideal", "industrial", "raw"])
def test_the_arm_starts_in_equilibrium(arm: Build, actuation: str):
    plant = arm(actuation)
    start = plant.capture()[1].T_world_camera
    plant.apply(np.zeros(6))
    plant.advance(500)
    position, angle = rigid_error(start, plant.capture()[1].T_world_camera)
    # One second: 1 um and 1 urad are under 1/1000 px at 1 m. Without its load an industrial joint 2
    # sags by 2 mrad.
    assert position < 1e-6 and angle < 1e-6


class TestSpeeds:
    """Commanded and measured joint speed through the plant, at .2 rad/s: the figures that the
    README names.
    """

    SPEED = 0.2
    # models/puma560.xml, raw
    KV, FRICTION, DAMPING = (
        {0: 400.0, 4: 40.0},
        {0: 25.9836, 4: 0.854445},
        {0: 5.80182, 4: 0.427285},
    )

    def measure(self, plant: Plant, joint: int) -> tuple[float, float]:
        """Steady speed as a part of the commanded one, and the time from 10 to 90 % of it [s]."""
        plant.apply(one_joint(joint, self.SPEED))
        v = np.array([t.qd[joint] for t in truths(plant, 250)]) / self.SPEED
        steady = float(v[-50:].mean())
        return steady, STEP * float(np.argmax(v > 0.9 * steady) - np.argmax(v > 0.1 * steady))

    @pytest.mark.parametrize("joint", [0, 4])
    def test_ideal(self, arm: Build, joint: int):
        steady, rise = self.measure(arm("ideal"), joint)
        # A baseline must not be told from a servo without dynamics: .5 %, and a quarter of a camera
        # frame.
        assert steady == pytest.approx(1, abs=0.005) and rise < 0.010

    @pytest.mark.parametrize("joint", [0, 4])
    def test_industrial(self, arm: Build, joint: int):
        steady, rise = self.measure(arm("industrial"), joint)
        # Integral action: no error but what gravity's change under the arm leaves; real arms rise
        # in tens of milliseconds.
        assert steady == pytest.approx(1, abs=0.005) and 0.030 < rise < 0.055

    @pytest.mark.parametrize("joint", [0, 4])
    def test_raw(self, arm: Build, joint: int):
        steady, rise = self.measure(arm("raw"), joint)
        kv, friction, damping = self.KV[joint], self.FRICTION[joint], self.DAMPING[joint]
        # Balance of torques kv (u - v) = friction + damping v; 1e-3 for friction's softness.
        assert steady == pytest.approx((kv - friction / self.SPEED) / (kv + damping), abs=1e-3)
        assert rise < 0.040

    @pytest.mark.parametrize("joint", [0, 4])
    def test_raw_dead_band(self, arm: Build, joint: int):
        plant, dead = arm("raw"), self.FRICTION[joint] / self.KV[joint]
        plant.apply(one_joint(joint, 0.95 * dead))
        plant.advance(250)
        # MuJoCo's friction is a stiff damper: under .1 mrad/s leaks through, a thousandth of the
        # command.
        assert abs(plant.reading().qd[joint]) < 1e-4
        plant.apply(one_joint(joint, 1.5 * dead))
        plant.advance(250)
        kv, damping = self.KV[joint], self.DAMPING[joint]
        assert plant.reading().qd[joint] == pytest.approx(
            0.5 * dead * kv / (kv + damping), rel=0.02
        )

    def test_a_camera_twist_comes_out_as_ordered(self, arm: Build):
        s = vs.load("arm_ibvs", {"robot.actuation": "ideal", "camera.mount": MOUNT})
        plant, twist = arm("ideal", MOUNT), np.array([0.05, -0.04, 0.03, 0.1, -0.05, 0.2])
        for _ in range(10):
            allocation = s.robot.allocate(
                twist, plant.reading(), Mount.of(s.camera.mount.T), s.camera.period
            )
            # far from limits and singularities
            np.testing.assert_allclose(allocation.twist, twist, atol=1e-12)
            plant.apply(allocation.setpoint)
            plant.advance(20)
        # Joint speeds hold still for 40 ms while the Jacobian turns by |w| 40 ms = 1 %; the servo's
        # own .5 %.
        np.testing.assert_allclose(
            plant.capture()[1].twist, twist, atol=0.015 * np.linalg.norm(twist)
        )


def test_the_ideal_camera_moves_by_the_exact_exponential():
    s = vs.load("ibvs_book", {"camera.mount": MOUNT})
    plant, renderer = build_plant(s.scene, PictureSetup(needs_image=False, needs_truth=True))
    start = s.robot.start.nominal.T @ Pose(**MOUNT).T
    twist = np.array([0.3, -0.2, 0.5, 0.4, -0.6, 1.5])
    plant.apply(adjoint(Pose(**MOUNT).T) @ twist)  # the flange's
    for steps in (1, 7, 42, 450):
        assert plant.advance(steps)
    truth = plant.capture()[1]
    # Rounding of four products, whatever the steps' lengths: no integration error.
    np.testing.assert_allclose(truth.T_world_camera, start @ exp(twist * 500 * STEP), atol=1e-13)
    np.testing.assert_allclose(truth.twist, twist, atol=1e-14)
    p = (
        inverse(truth.T_world_camera)
        @ s.target.pose.T
        @ np.column_stack([s.target.points, np.ones(4)]).T
    ).T[:, :3]
    np.testing.assert_allclose(truth.p_camera, p, atol=1e-13)
    assert renderer == "none"


class TestSteps:
    @pytest.mark.parametrize("steps", [1, 2, 7])
    def test_a_stage_steps_as_dm_control_does(self, arm: Build, steps: int):
        ours, theirs = (arm("industrial")._stage for _ in range(2))  # pyright: ignore[reportAttributeAccessIssue]
        for stage in (ours, theirs):
            stage.data.ctrl[:] = 0.3
        for _ in range(20):
            assert ours.step(steps)
            theirs.physics.step(steps)
        for name in ("qpos", "qvel", "act", "sensordata", "site_xpos"):
            np.testing.assert_array_equal(getattr(ours.data, name), getattr(theirs.data, name))

    def test_an_unstable_simulation_is_told(self, arm: Build):
        plant = arm("industrial")
        assert plant.advance(1)
        plant._stage.data.qvel[:] = 1e12  # pyright: ignore[reportAttributeAccessIssue]
        assert not plant.advance(1)


def test_of_further_cameras_without_a_detector_it_knows_the_places_alone():
    plant, renderer = build_plant(vs.load("arm_stereo").scene)
    with closing(plant):
        (other,) = plant.others.values()
        _, truth = other.capture()
    assert renderer == "none" and truth.T_world_camera.shape == (4, 4)
