"""Vehicles in a scene and on the plant's clock: they stand where they start, read their own
sensors, lead and are filmed.
"""

import mujoco
import numpy as np
import pytest

import vstestbed as vs
from vstestbed.core.geometry import inverse
from vstestbed.core.planar import place_of, relative
from vstestbed.robots.base import Reading
from vstestbed.sim.build import build_plant, scene_files
from vstestbed.sim.plant import LeadVehicle
from vstestbed.sim.scene.overview import WIDE_PICTURE, eye_for
from vstestbed.sim.scene.scene import Scene

NAMES = ["omni_ibvs", "car_pbvs", "car_pursuit"]


def plant_of(s, rng=0):
    rng = np.random.default_rng(rng)
    return build_plant(s.scene, sensor_rng=rng)[0]


@pytest.mark.parametrize("name", NAMES)
def test_it_starts_at_rest_where_it_is_told(name):
    s = vs.load(name)
    plant = plant_of(s)
    truth = plant.capture()[1]
    base = place_of(truth.T_world_camera @ inverse(s.camera.mount.T))
    # springs settle by .02 mrad
    np.testing.assert_allclose(base, s.robot.configuration(), atol=2e-4)
    assert np.abs(truth.twist).max() < 1e-6
    assert not truth.contact  # wheels on the floor are no collision
    before = truth.T_world_camera
    plant.advance(200)
    if s.target.motion.kind == "still":
        np.testing.assert_allclose(plant.capture()[1].T_world_camera, before, atol=2e-4)


@pytest.mark.parametrize("name", NAMES)
def test_the_written_model_loads_alone_and_starts_there(name, tmp_path):
    s = vs.load(name)
    xml, _ = scene_files(s.scene)
    (tmp_path / "model.xml").write_text(xml)
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "model.xml"))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("start").id)
    mujoco.mj_forward(model, data)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = data.site("eye").xmat.reshape(3, 3), data.site("eye").xpos
    np.testing.assert_allclose(
        T, s.robot.flange_pose(s.robot.configuration()) @ s.camera.mount.T, atol=2e-4
    )  # springs and rollers have settled
    assert model.opt.cone == mujoco.mjtCone.mjCONE_ELLIPTIC and model.opt.impratio == 10


def test_a_reading_stays_until_time_passes():
    plant = plant_of(vs.load("car_pbvs"))
    first = plant.reading()
    assert plant.reading() is first
    # the compass; the true heading does not come out
    assert type(first) is Reading and first.heading not in (None, 0.0)
    plant.advance(5)
    assert plant.reading() is not first


def test_the_onboard_controller_keeps_its_period_however_time_is_asked_for():
    readings = []
    for pieces in ([100], [7, 3, 40, 1, 49]):
        plant = plant_of(vs.load("car_pbvs"))
        plant.apply(np.array([1.0, 0.3]))
        for steps in pieces:
            assert plant.advance(steps)
        readings.append(plant.reading().q)
    np.testing.assert_array_equal(*readings)


class TestLeadVehicle:
    def test_it_keeps_to_its_route_and_its_speed(self):
        s = vs.load("car_pursuit")
        plant = plant_of(s)
        motion = s.target.motion
        gone, along, far, t = 0.0, None, 0.0, 0.0
        carrier = inverse(s.target.pose.T)
        while t < 20:
            plant.advance(50)
            t += 0.1
            place = place_of(plant.capture()[1].T_world_target @ carrier)
            found, offset = motion.route.nearest(place[:2], around=along or 0.0)
            far = max(far, abs(offset))
            gone += found - (along or 0.0)
            along = found
        assert far < 0.03  # a driver who steers well: the bends are 1.5 m and more
        assert gone == pytest.approx(motion.speed_mps * 20, rel=0.02)  # it starts from rest

    def test_it_needs_a_vehicle(self):
        s = vs.load("arm_ibvs")
        with pytest.raises(TypeError, match="no vehicle"):
            LeadVehicle(Scene(s.scene))


class TestOverview:
    def test_the_eye_is_the_nearest_from_which_all_is_seen(self):
        rng = np.random.default_rng(0)
        points = rng.uniform(-3, 5, (40, 3))
        right, up, half = np.array([1.0, 0, 0]), np.array([0, 0.6, 0.8]), np.tan(np.radians(19))
        forward = np.cross(up, right)
        eye = eye_for(points, right, up, half)
        d = points - eye
        across, above = (
            d @ right / (d @ forward) / (half * WIDE_PICTURE),
            d @ up / (d @ forward) / half,
        )
        most = max(1.12 * np.abs(across).max(), 1.25 * np.abs(above).max())
        # the room that is left round it, more above and below
        assert most == pytest.approx(1, rel=1e-6)

    @pytest.mark.parametrize("name", NAMES)
    def test_start_goal_landmarks_and_route_are_in_the_picture(self, name):
        s = vs.load(name)
        stage = Scene(s.scene)
        stage.place(0.0, stage.parts.T_world_target, *stage.parts.start)
        mujoco.mj_forward(stage.model, stage.data)
        camera = stage.model.camera("overview").id
        R, o = stage.data.cam_xmat[camera].reshape(3, 3), stage.data.cam_xpos[camera]
        landmarks = s.target.points if s.target.motion.kind == "still" else np.zeros((0, 3))
        points = np.concatenate(
            [
                [s.robot.flange_pose(s.robot.configuration())[:3, 3]],
                landmarks,
                np.array(s.sights).reshape(-1, 3),
            ]
        )
        p = (points - o) @ R
        half = np.tan(np.radians(stage.model.cam_fovy[camera] / 2))
        assert (np.abs(p[:, 1] / p[:, 2]) < half).all()
        assert (np.abs(p[:, 0] / p[:, 2]) < half * WIDE_PICTURE).all()
        assert (p[:, 2] < 0).all()


def test_replay_puts_vehicle_and_leader_where_the_log_has_them():
    s = vs.load("car_pursuit")
    plant = plant_of(s)
    plant.apply(np.array([0.5, 0.2]))
    plant.advance(1000)
    truth = plant.capture()[1]
    stage = Scene(s.scene)
    stage.place(2.0, truth.T_world_target, truth.q, truth.T_world_camera)
    np.testing.assert_allclose(stage.camera_pose(), truth.T_world_camera, atol=1e-12)
    np.testing.assert_allclose(stage.target_pose(), truth.T_world_target, atol=1e-12)
    assert (
        np.abs(
            relative(
                s.robot.configuration(), place_of(truth.T_world_camera @ inverse(s.camera.mount.T))
            )[:2]
        ).max()
        > 0.3
    )
