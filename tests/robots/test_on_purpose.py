"""Limits, singularities, the arm itself, met on purpose: the arm slows, the outcome says which, no
joint exceeds its speed.
"""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

import vstestbed as vs
from tests.shortcuts import forward, jacobian, one_quick
from vstestbed.core.geometry import exp, inverse
from vstestbed.core.named_files import model_path
from vstestbed.robots.allocation import Mount
from vstestbed.robots.base import Reading
from vstestbed.robots.puma560 import JOINT_LIMITS, SPEED_LIMITS, Puma560

UNLIMITED = {"kind": "oracle", "field_of_view": "unlimited"}


def joints(recording, name="q"):
    return np.column_stack([recording[f"{name}_joint_{i}"] for i in range(1, 7)])


@pytest.mark.parametrize(
    ("name", "outcome"),
    one_quick(
        ("arm_elbow", "singular"),
        ("arm_joint_limit", "joint_limit"),
        ("arm_self_collision", "collided"),
        ("arm_wrist", "converged"),
    ),
)
def test_the_right_outcome_and_no_joint_too_fast(name, outcome):
    r = vs.run(vs.load(name, {"detector": UNLIMITED, "stop.converged.error_px": 1.0}))
    assert r.outcome.name == outcome
    # Servos of finite stiffness overshoot their order by a few percent for some milliseconds.
    assert (np.abs(joints(r, "qd")) / SPEED_LIMITS).max() < 1.05
    assert (np.abs(joints(r, "ctrl")) / SPEED_LIMITS).max() <= 1 + 1e-9
    q = joints(r)
    assert np.minimum(q - JOINT_LIMITS[:, 0], JOINT_LIMITS[:, 1] - q).min() > 0
    if outcome == "singular":
        # the elbow is straight at -90 degrees, less its offset of 2.7
        assert abs(np.degrees(q[-1, 2]) + 90) < 5
    if outcome == "joint_limit":
        assert (
            np.degrees(np.minimum(q[-1] - JOINT_LIMITS[:, 0], JOINT_LIMITS[:, 1] - q[-1]).min())
            < 1.2
        )


def test_from_an_aligned_wrist_no_joint_jumps():
    r = vs.run(
        vs.load(
            "arm_wrist", {"detector": UNLIMITED, "robot.actuation": "ideal", "stop.duration_s": 2}
        )
    )
    assert abs(r["q_joint_5"][0]) < 1e-9
    # The damping bounds what is commanded near it: |dq| <= |twist| / threshold; without, the first
    # order would be infinite.
    assert (np.abs(joints(r, "ctrl")) / SPEED_LIMITS).max() < 0.6


def test_no_touch_anywhere_near_the_usual_starts():
    model = mujoco.MjModel.from_xml_path(str(model_path("puma560.xml")))
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    nominal = np.radians(Puma560().start.nominal.q_deg)
    for _ in range(300):
        data.qpos[:] = np.clip(nominal + rng.uniform(-0.8, 0.8, 6), *JOINT_LIMITS.T)
        mujoco.mj_kinematics(model, data)
        mujoco.mj_collision(model, data)
        assert data.ncon == 0


def test_a_hand_in_the_column_is_a_touch():
    model = mujoco.MjModel.from_xml_path(str(model_path("puma560.xml")))
    data = mujoco.MjData(model)
    data.qpos[:] = np.radians([33.4, -13.0, -206.7, 62.8, -31.7, -42.2])
    mujoco.mj_kinematics(model, data)
    mujoco.mj_collision(model, data)
    assert {model.geom(i).name for i in data.contact.geom.ravel()} & {"pedestal", "waist"}


class TestOffTheLimits:
    """Two markers leave two motions open; `avoid_limits` uses them."""

    NEAR = np.radians([0, 45, -215, 0, 45, -45])  # joint 3 is 10 degrees from its limit

    def test_the_open_motion_moves_the_joint_off_and_stays_open(self):
        null_space = np.linalg.qr(np.random.default_rng(1).normal(size=(6, 2)))[0]
        arm, mount = Puma560(avoid_limits=2.0), Mount.of(np.eye(4))
        twist = arm.secondary_task(null_space, Reading(self.NEAR, np.zeros(6)), mount)
        assert np.allclose(null_space @ (null_space.T @ twist), twist)
        dq = np.linalg.solve(jacobian(self.NEAR), twist)
        assert dq[2] > 0
        assert np.allclose(
            Puma560().secondary_task(null_space, Reading(self.NEAR, np.zeros(6)), mount), 0
        )

    def test_in_the_middle_of_its_range_it_stays(self):
        middle = JOINT_LIMITS.mean(axis=1)
        assert np.allclose(
            Puma560(avoid_limits=2.0).secondary_task(
                np.eye(6)[:, :2], Reading(middle, np.zeros(6)), Mount.of(np.eye(4))
            ),
            0,
        )

    @pytest.mark.parametrize(("share", "moves"), [(0.79, False), (0.81, True)])
    @pytest.mark.parametrize("side", [-1, 1])
    def test_the_middle_is_four_fifths_of_the_range(self, share, moves, side):
        q = JOINT_LIMITS.mean(axis=1)
        q[2] += side * share * np.ptp(JOINT_LIMITS[2]) / 2
        twist = Puma560(avoid_limits=2.0).secondary_task(
            np.eye(6), Reading(q, np.zeros(6)), Mount.of(np.eye(4))
        )
        assert bool(np.abs(twist).max() > 1e-6) is moves
        assert not moves or side * np.linalg.lstsq(jacobian(q), twist, rcond=None)[0][2] < 0

    def test_it_arrives_where_it_would_have_met_a_limit(self):
        runs = [
            vs.run(vs.load("arm_avoid_limits", {"detector": "oracle", "robot.avoid_limits": k}))
            for k in (0.0, 5.0)
        ]
        assert [r.outcome.name for r in runs] == ["joint_limit", "converged"]


def test_the_twist_of_a_camera_that_watches_the_hand():
    """v_camera = -Ad(T_camera_flange) J dq against the change
    of the flange's pose in the camera.
    """
    q, dq, h = (
        np.radians([10, 40, -170, 20, 50, -30]),
        np.array([0.1, -0.2, 0.3, 0.2, -0.1, 0.4]),
        1e-6,
    )
    T_world_camera = exp(np.array([1.5, 0.2, 0.6, 0.3, -1.2, 0.5]))
    mount = Mount.facing(inverse(forward(q)) @ T_world_camera)
    twist = mount.to_camera @ (jacobian(q) @ dq)
    T0, T1 = (inverse(T_world_camera) @ forward(q + s * h * dq) for s in (-1, 1))
    # as for a camera that moves before a target that stands
    assert np.allclose(T1, exp(-twist * 2 * h) @ T0, atol=1e-9)
    assert np.allclose(mount.to_flange @ twist, jacobian(q) @ dq)
