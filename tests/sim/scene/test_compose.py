"""The composed scene: promised names, poses, clock and servos,
and a model.xml that stands alone.
"""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

import vstestbed as vs
from tests.shortcuts import forward
from vstestbed.camera import Perspective
from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import FLIP, Pose, transform
from vstestbed.robots.puma560 import ACTUATIONS, JOINT_LIMITS
from vstestbed.scenario.scenario import Scenario
from vstestbed.sim.build import scene_files
from vstestbed.sim.scene.compose import compose
from vstestbed.timing.clock import Clock

MOUNT = {"xyz": [0.03, -0.02, 0.1], "rpy_deg": [20, -30, 50]}
TILTED = {"xyz": [1.2, 0.1, 0.8], "rpy_deg": [10, 70, -20]}


def compiled(scenario: Scenario) -> mujoco.MjModel:
    s = scenario
    return compose(s.scene).compile()


def at_start(model: mujoco.MjModel) -> mujoco.MjData:
    data = mujoco.MjData(model)
    if model.nkey:
        mujoco.mj_resetDataKeyframe(model, data, model.key("start").id)
    mujoco.mj_forward(model, data)
    return data


def pose_of(xpos: np.ndarray, xmat: np.ndarray) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = xmat.reshape(3, 3), xpos
    return T


@pytest.mark.parametrize(("name", "nu", "nq"), [("arm_ibvs", 6, 6), ("ibvs_book", 0, 0)])
def test_model_xml_loads_alone(name: str, nu: int, nq: int, tmp_path: Path):
    s = vs.load(
        name,
        {
            "camera.mount": MOUNT,
            "target.pose": TILTED,
            "goal.T_camera_target": {"xyz": [0, 0, 1.2]},
        },
    )
    file = tmp_path / "model.xml"
    file.write_text(scene_files(s.scene)[0])
    alone, composed = mujoco.MjModel.from_xml_path(str(file)), compiled(s)
    for model in (alone, composed):
        assert (model.nq, model.nu, model.ncam) == (nq, nu, 2)
        assert {model.camera(i).name for i in range(2)} == {"eye", "overview"}
    assert alone.opt.timestep == composed.opt.timestep
    data = at_start(alone)
    # The text has all digits; the start pose is the scenario's.
    eye = pose_of(data.site("eye").xpos, data.site("eye").xmat)
    np.testing.assert_allclose(
        eye, s.robot.flange_pose(s.robot.configuration()) @ s.camera.mount.T, atol=1e-12
    )
    expected = transform(s.target.pose.T, s.target.points)
    markers = [data.site(f"target/marker_{i}").xpos for i in range(4)]
    np.testing.assert_allclose(markers, expected, atol=5e-6)


def test_markers_stand_where_the_target_says():
    s = vs.load("arm_ibvs", {"target.pose": TILTED})
    data = at_start(compiled(s))
    markers = [data.site(f"target/marker_{i}").xpos for i in range(4)]
    # Rounding of one rotation.
    np.testing.assert_allclose(markers, transform(s.target.pose.T, s.target.points), atol=1e-12)


@pytest.mark.parametrize("mount", [{}, MOUNT])
def test_the_eye_sits_on_the_flange(mount: dict):
    s = vs.load("arm_ibvs", {"camera.mount": mount})
    model = compiled(s)
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    for _ in range(5):
        data.qpos[:] = rng.uniform(*JOINT_LIMITS.T)
        mujoco.mj_forward(model, data)
        expected = forward(data.qpos) @ Pose(**mount).T
        # Rounding of eight products, and of the mount's quaternion.
        np.testing.assert_allclose(
            pose_of(data.site("eye").xpos, data.site("eye").xmat), expected, atol=1e-12
        )
        # MuJoCo's camera looks along -z: the one place of the flip.
        np.testing.assert_allclose(
            pose_of(data.camera("eye").xpos, data.camera("eye").xmat) @ FLIP, expected, atol=1e-12
        )


@pytest.mark.parametrize("actuation", ACTUATIONS)
def test_actuation_keeps_one_profile(actuation: str):
    model, chosen = (
        compiled(vs.load("arm_ibvs", {"robot.actuation": actuation})),
        ACTUATIONS[actuation],
    )
    assert [model.actuator(i).name for i in range(model.nu)] == [
        f"robot/joint_{i}" for i in range(1, 7)
    ]
    assert model.na == (6 if actuation == "industrial" else 0)
    assert np.all((model.dof_frictionloss > 0) == chosen.friction)
    assert np.all((model.dof_damping > 0) == chosen.friction)
    links = [model.body(f"robot/link_{i}").id for i in range(1, 7)]
    np.testing.assert_array_equal(model.body_gravcomp[links], float(chosen.gravity_compensated))
    assert model.opt.integrator == mujoco.mjtIntegrator.mjINT_IMPLICITFAST


def test_mocap_things_touch_nothing_and_sites_are_not_drawn():
    plate = {"pose": {"xyz": [1.2, 0, 0.7], "rpy_deg": [0, 90, 0]}}
    model = compiled(vs.load("arm_ibvs", {"world.plates": [plate]}))
    loose = np.isin(
        model.geom_bodyid, [model.body(name).id for name in ("target/frame", "plate_0")]
    )
    assert loose.sum() == 4 + 1 + 1
    assert not model.geom_contype[loose].any() and not model.geom_conaffinity[loose].any()
    assert np.all(model.site_group >= 3)  # MuJoCo draws groups 0 to 2 by default


class TestClock:
    @pytest.mark.parametrize(
        ("rate_hz", "steps"), [(25, 20), (30, 17), (1000, 1), (60, 9), (0.5, 1000), (29.97, 17)]
    )
    def test_the_step_divides_the_period(self, rate_hz: float, steps: int):
        step, n = Clock().resolve(Perspective(rate_hz=rate_hz))
        assert n == steps
        # Rounding of one division; 2 ms is the largest step that the servos are tested at.
        assert n * step == pytest.approx(1 / rate_hz, rel=1e-15)
        assert step <= 0.002 * (1 + 1e-12)

    def test_a_step_of_ones_own(self):
        assert Clock(step_s=0.001).resolve(Perspective(rate_hz=25)) == (0.001, 40)

    @pytest.mark.parametrize(
        ("rate_hz", "step_s"), [(30, 0.002), (25, 0.003), (100, 0.02), (7, 0.001)]
    )
    def test_steps_that_do_not_divide_are_refused_with_both_numbers(
        self, rate_hz: float, step_s: float
    ):
        camera = Perspective(rate_hz=rate_hz)
        with pytest.raises(ParameterError) as caught:
            Clock(step_s=step_s).resolve(camera)
        words = str(caught.value)
        assert caught.value.field == "physics.step_s"
        assert str(step_s) in words and f"{1 / rate_hz:.9g} s" in words and f"{rate_hz} Hz" in words
        # What it recommends is taken.
        advice = float(words.split("; ")[1].split(" does")[0])
        assert Clock(step_s=advice).resolve(camera)[1] >= 1


@pytest.mark.parametrize(
    ("name", "foot"),
    [("car_pbvs", 0.40), ("car_catadioptric", 0.40), ("omni_ibvs", 0.119), ("car_line", 0.38)],
)
def test_a_vehicles_camera_stands_on_a_post_that_it_does_not_see(name: str, foot: float):
    """From the deck's nearest point (for the one under the chassis its lower side) to the camera's
    housing.
    """
    s = vs.load(name)
    model = compiled(s)
    data = at_start(model)
    post, body = model.geom("eye_post"), model.body("robot/base")
    assert (post.group[0], post.contype[0], post.conaffinity[0]) == (1, 0, 0)
    # grey: saturated pixels are markers
    assert post.bodyid[0] == body.id and np.ptp(post.rgba[:3]) < 0.18
    middle, along = (
        data.geom("eye_post").xpos,
        data.geom("eye_post").xmat.reshape(3, 3)[:, 2] * post.size[1],
    )
    low, high = sorted((middle - along, middle + along), key=lambda p: abs(p[2] - foot))
    assert low[2] == pytest.approx(foot, abs=1e-6)
    np.testing.assert_allclose(high, data.geom("eye_box").xpos, atol=1e-6)


def test_an_arms_camera_has_no_post():
    with pytest.raises(KeyError, match="eye_post"):
        compiled(vs.load("arm_ibvs")).geom("eye_post")
