"""The view from outside: a vehicle's whole way is in the picture, and large enough to be known."""

from __future__ import annotations

from itertools import pairwise

import mujoco
import numpy as np
import pytest

import vstestbed as vs
from tests.shortcuts import one_quick
from vstestbed.core.geometry import FLIP, Array, transform
from vstestbed.core.named_files import model_path
from vstestbed.core.planar import moved
from vstestbed.report.run.tracks import Setting, ideal_bicycle_path
from vstestbed.scenario.scenario import Scenario
from vstestbed.sim.scene.attach import extent_of
from vstestbed.sim.scene.compose import compose
from vstestbed.sim.scene.overview import WIDE_PICTURE, frame_drive
from vstestbed.targets.ground_lines import GroundLines

WIDTH, HEIGHT = 960, 540
SCENARIOS = [
    "car_catadioptric",
    "car_line",
    "car_parking",
    "car_pbvs",
    "car_pursuit",
    "omni_catadioptric",
    "omni_ibvs",
    "omni_ibvs_up",
    "omni_line",
    "omni_via_points",
]


def overview(model: mujoco.MjModel) -> tuple[Array, float]:
    """Pose (4, 4) of the outside view, computer-vision axes, and its focal length [px]."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_camlight(model, data)
    camera = model.camera("overview").id
    T = np.eye(4)
    T[:3, :3] = data.cam_xmat[camera].reshape(3, 3) @ FLIP[:3, :3]
    T[:3, 3] = data.cam_xpos[camera]
    return T, HEIGHT / 2 / np.tan(np.radians(model.cam_fovy[camera] / 2))


def projected(T: Array, f: float, points: Array) -> Array:
    """Pixels (N, 2) of points (N, 3) in the world, from the picture's middle; all of them ahead."""
    p = transform(np.linalg.inv(T), points)
    assert (p[:, 2] > 0).all()
    return f * p[:, :2] / p[:, 2:]


def way(s: Scenario) -> Array:
    """Places (K, 2) where the vehicle will be: the ideal car's way, along the route, or straight
    from goal to goal.
    """
    start, goals = s.robot.configuration(), [g.place for g in s.goal_views if g.place is not None]
    ideal = ideal_bicycle_path(s)
    if ideal is not None:
        return ideal
    if isinstance(s.target, GroundLines):
        return np.concatenate([[start[:2]], Setting.of(s).reference_path[::4]])
    if not goals:
        return np.concatenate([[start[:2]], s.target.motion.route.samples[1][::20]])
    corners = np.array([start[:2], *(g[:2] for g in goals)])
    share = np.linspace(0, 1, 20)[:, None]
    return np.concatenate([a + share * (b - a) for a, b in pairwise(corners)])


@pytest.mark.parametrize("name", one_quick(*SCENARIOS, every=3))
def test_way_goals_and_landmarks_are_in_the_picture(name: str):
    s = vs.load(name)
    T, f = overview(compose(s.scene).compile())
    places, size = way(s), extent_of(s.robot)
    corners = (
        np.array([[i, j, k] for i in (-0.5, 0.5) for j in (-0.5, 0.5) for k in (0, 0.8)]) * size
    )
    vehicle = (np.c_[places, np.zeros(len(places))][:, None] + corners).reshape(-1, 3)
    marks = (
        np.empty((0, 3))
        if isinstance(s.target, GroundLines)
        else transform(s.target.T_world_start, s.target.points)
    )
    shown = np.concatenate([vehicle, marks])
    uv = projected(T, f, shown)
    assert np.abs(uv).max(axis=0)[0] < WIDTH / 2 and np.abs(uv).max(axis=0)[1] < HEIGHT / 2
    # The vehicle can be known where it starts: a base of .4 m has 55 px of 960 in 7 m, and 34 at
    # the far end of a track of 11 by 10 m.
    assert np.ptp(projected(T, f, vehicle[:8]), axis=0).max() > 30


def test_a_turn_away_from_the_goal_is_in_the_picture():
    # A car that sets out square to its goal swings out by its turning circle of 1 m in 6 m.
    scene = mujoco.MjSpec.from_file(str(model_path("world.xml")))
    frame_drive(scene, np.array([[0, 0, 0], [6.0, 0, 0]]), np.zeros((0, 3)), size=1.5)
    T, f = overview(scene.compile())
    turn = np.array(
        [
            moved(np.array([0, 0, np.pi / 2]), np.array([1.0, 0, -1.0]), t)[:2]
            for t in np.linspace(0, np.pi / 2, 20)
        ]
    )
    uv = projected(T, f, np.c_[turn, np.zeros(20)])
    assert (
        np.abs(uv[:, 0]).max() < HEIGHT * WIDE_PICTURE / 2 and np.abs(uv[:, 1]).max() < HEIGHT / 2
    )


def test_the_light_that_casts_shadows_covers_the_way():
    s = vs.load("omni_ibvs")
    model = compose(s.scene).compile()
    light = model.light("key")
    along = np.array([0.45, 0.45, -1]) / np.linalg.norm([0.45, 0.45, -1])
    reach = model.vis.map.shadowclip * model.stat.extent
    for point in (
        *np.c_[way(s), np.zeros(len(way(s)))],
        *transform(s.target.T_world_start, s.target.points),
    ):
        step = point - light.pos
        assert step @ along > 0  # before the light
        # within its depth map, a square of twice that side
        assert np.linalg.norm(np.cross(step, along)) <= reach + 1e-9
