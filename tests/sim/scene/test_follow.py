"""The camera of films from outside: robot, target and goal stay in the picture, and the robot large
enough to be known.
"""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np
import pytest

import vstestbed as vs
from tests.shortcuts import one_quick
from vstestbed.camera import Perspective
from vstestbed.core.geometry import FLIP, Array, exp, inverse, log, transform
from vstestbed.scenario.scenario import Scenario
from vstestbed.sim.replay import FREE
from vstestbed.sim.scene.follow import LEAST_SHARE, FixedView, FollowCamera, Things
from vstestbed.sim.scene.scene import Scene

WIDTH, HEIGHT = 640, 360
RATE_HZ = 12.5


class Filmed:
    """A scenario's stage with the camera that follows, and what it sees."""

    def __init__(self, scenario: Scenario):
        self.scenario = scenario
        parts = scenario.scene
        self.stage = Scene(parts)
        self.q, self.start = parts.start
        self.T_target = parts.T_world_target
        self.things = Things(self.stage.model)
        self.follow = FollowCamera(self.stage, self.things, WIDTH / HEIGHT, FREE)
        fovy = float(self.stage.model.camera("overview").fovy[0])
        self._lens = Perspective(width=WIDTH, height=HEIGHT, fovy_deg=fovy)

    def show(
        self, t: float, T_camera: Array, T_goal: Array | None, T_target: Array | None = None
    ) -> None:
        """One frame."""
        self.stage.place(t, self.T_target if T_target is None else T_target, self.q, T_camera)
        self.follow.place(t, T_goal)

    @property
    def pose(self) -> Array:
        """Pose (4, 4) of the camera that follows."""
        camera, T = self.stage.data.camera("overview"), np.eye(4)
        T[:3, :3], T[:3, 3] = camera.xmat.reshape(3, 3) @ FLIP[:3, :3], camera.xpos
        return T

    def pixels(self, points: Array) -> Array:
        """Pixels (N, 2) of points (N, 3) in the world."""
        return self._lens.project(transform(inverse(self.pose), points))

    def robot(self) -> Array:
        """Points (N, 3) round the robot."""
        return self.things.points(self.stage.data)[self.things.own].reshape(-1, 3)


@pytest.mark.parametrize("name", ["quadrotor_hover", "car_line"])
def test_the_points_round_a_robot_are_on_its_geoms(name: str) -> None:
    film = Filmed(vs.load(name))
    film.stage.place(0.0, film.T_target, film.q, film.start)
    model, data, kinds = film.stage.model, film.stage.data, mujoco.mjtGeom
    for geom, points in zip(film.things.geoms, film.things.points(data), strict=True):
        local = (points - data.geom_xpos[geom]) @ data.geom_xmat[geom].reshape(3, 3)
        x = np.abs(local - model.geom_aabb[geom, :3]) / model.geom_aabb[geom, 3:]
        kind = kinds(model.geom_type[geom])
        if kind in (kinds.mjGEOM_SPHERE, kinds.mjGEOM_ELLIPSOID):
            np.testing.assert_allclose(np.linalg.norm(x, axis=1), 1, atol=1e-6)
        elif kind in (kinds.mjGEOM_CYLINDER, kinds.mjGEOM_CAPSULE):
            np.testing.assert_allclose(np.c_[np.hypot(x[:, 0], x[:, 1]), x[:, 2]], 1, atol=1e-6)
        else:
            np.testing.assert_allclose(x, 1, atol=1e-6)


def shows(uv: Array) -> bool:
    """Whether all pixels are in the picture, clear of the inset's column and of the caption."""
    return bool((uv >= 0).all() and (uv[:, 0] <= FREE * WIDTH).all() and (uv[:, 1] <= HEIGHT).all())


def towards(a: Array, b: Array) -> Callable[[float], Array]:
    """Poses from a to b (4, 4): straight in ten seconds, turning in the last three of them, then
    five more there.
    """
    R = np.eye(4)
    R[:3, :3] = a[:3, :3].T @ b[:3, :3]
    turn = log(R)

    def at(t: float) -> Array:
        share, turned = min(t / 10, 1.0), np.clip((t - 7) / 3, 0.0, 1.0)
        T = a @ exp(turned * turn)
        T[:3, 3] = (1 - share) * a[:3, 3] + share * b[:3, 3]
        return T

    return at


WHOLE = [
    "omni_ibvs",
    "quadrotor_hover",
    "arm_ibvs",
    "arm_eye_to_hand",
    "ibvs_book",
    "spherical_behind",
]
"""Their target fits into the picture beside a robot of the least size."""


@pytest.mark.parametrize(
    "name",
    one_quick(*WHOLE, "omni_via_points", "car_pbvs", "car_catadioptric", "quadrotor_path", every=3),
)
def test_robot_target_and_goal_stay_in_the_picture_and_the_robot_large(name: str) -> None:
    s = vs.load(name)
    film = Filmed(s)
    goal = film.T_target @ inverse(s.goal_poses[0])
    moving = s.robot.base != "fixed"
    # An arm's own motion follows from its joints: its target moves instead, which the view has to
    # show as well.
    way = towards(film.start, goal if moving or s.robot.body is None else film.start)
    for t in np.arange(0, 15, 1 / RATE_HZ):
        film.show(t, way(t), goal)
        robot = film.pixels(film.robot())
        assert shows(robot), (t, robot.min(axis=0), robot.max(axis=0))
        if moving:
            shift = goal @ inverse(film.stage.camera_pose())
            ghost = film.pixels(transform(shift, film.robot()))
            assert shows(ghost) or name not in WHOLE
            assert np.ptp(robot, axis=0).max() > 0.9 * LEAST_SHARE * WIDTH  # the filter lags a turn
        if name in WHOLE:
            marks = transform(film.stage.target_pose(), s.target.points)
            assert shows(film.pixels(np.vstack([marks, goal[None, :3, 3]])))


def test_a_lap_along_a_line_keeps_a_large_robot_in_the_middle() -> None:
    s = vs.load("omni_line")
    film = Filmed(s)
    sizes, middles = [], []
    for i, place in enumerate(s.target.floor_path[::4]):  # 4 cm a frame
        T = film.start.copy()
        T[:2, 3] += place - film.start[:2, 3]
        film.show(i / RATE_HZ, T, None)
        uv = film.pixels(film.robot())
        sizes.append(np.ptp(uv, axis=0).max())
        middles.append(uv.mean(axis=0))
    # of 640 px; from where the whole track of 11 x 10 m is in the picture, it had 23
    assert min(sizes) > 80
    assert np.ptp(middles, axis=0)[0] < 0.1 * WIDTH
    assert np.ptp(middles, axis=0)[1] < 0.1 * HEIGHT


def test_a_target_that_moves_stays_in_an_arms_picture() -> None:
    s = vs.load("arm_track_circle")
    film, path = Filmed(s), s.target.path(np.random.default_rng(0))
    eyes = []
    for t in np.arange(0, 20, 1 / RATE_HZ):
        film.show(t, film.start, None, path(t))
        eyes.append(film.pose[:3, 3].copy())
        assert shows(film.pixels(transform(path(t), s.target.points)))
    # it has seen the whole circle, and stands
    assert np.linalg.norm(eyes[-1] - eyes[len(eyes) // 2]) < 0.005


def test_the_view_of_an_arm_rests_until_something_leaves_its_margin() -> None:
    s = vs.load("arm_ibvs")
    film, eyes = Filmed(s), []
    for k, up in enumerate([0.0, *[0.03] * 50, *[0.4] * 100]):
        T = film.T_target.copy()
        T[2, 3] += up
        film.show(k / RATE_HZ, film.start, None, T)
        eyes.append(film.pose[:3, 3].copy())
    assert (np.array(eyes[:51]) == eyes[0]).all()
    assert shows(film.pixels(transform(T, s.target.points)))
    assert np.linalg.norm(eyes[-1] - eyes[0]) > 0.1 and np.linalg.norm(eyes[-1] - eyes[-10]) < 1e-3


def test_a_free_camera_that_retreats_stays_in_the_picture() -> None:
    s = vs.load("ibvs_retreat")
    film = Filmed(s)
    for t in np.arange(0, 10, 1 / RATE_HZ):
        back = exp(np.array([0, 0, -0.3 * t, 0, 0, 0]))
        film.show(t, film.start @ back, None)
        assert shows(film.pixels(film.robot()))


def test_the_view_starts_and_stops_softly_and_keeps_up() -> None:
    film = Filmed(vs.load("car_line"))
    eyes, dt = [], 1 / RATE_HZ
    for i in range(200):
        T = film.start.copy()
        # stands, drives at 1 m/s from 1 to 10 s, stands
        T[0, 3] += 1.0 * max(min(i * dt, 10.0) - 1.0, 0.0)
        film.show(i * dt, T, None)
        eyes.append(film.pose[:3, 3].copy())
    speed = np.linalg.norm(np.diff(eyes, axis=0), axis=1) / dt
    assert speed[100] == pytest.approx(1.0, abs=1e-3)
    assert speed[-1] < 1e-3
    # [m/s] from one frame to the next; an unfiltered view has 1
    assert np.abs(np.diff(speed)).max() < 0.45
    lag = np.array(eyes[100]) - eyes[0] - [100 * dt - 1.0, 0, 0]
    assert np.linalg.norm(lag) < 0.01


def test_the_view_depends_on_the_frames_so_far_alone() -> None:
    s = vs.load("omni_ibvs")
    one, other = Filmed(s), Filmed(s)
    goal = one.T_target @ inverse(s.goal_poses[0])
    way = towards(one.start, goal)
    for t in np.arange(0, 4, 1 / RATE_HZ):
        one.show(t, way(t), goal)
        other.show(t, way(t), goal)
    np.testing.assert_array_equal(one.pose, other.pose)
    one.show(4.0, way(4.0), goal)
    other.show(4.0, way(9.0), goal)
    assert np.abs(one.pose - other.pose).max() > 1e-3


def test_the_wrist_of_an_arm_and_all_markers_are_seen() -> None:
    film = Filmed(vs.load("arm_ibvs"))
    film.show(0.0, film.start, None)
    eye, model, data = film.pose[:3, 3].copy(), film.stage.model, film.stage.data
    for name in [f"target/marker_{i}" for i in range(4)]:
        way, hit = data.geom(name).xpos - eye, np.zeros(1, np.int32)
        mujoco.mj_ray(
            model,
            data,
            eye,
            way / np.linalg.norm(way),
            np.array([1, 1, 1, 1, 1, 0], np.uint8),
            1,
            -1,
            hit,
        )
        assert model.geom(int(hit[0])).name == name
    way = film.start[:3, 3] - eye
    mujoco.mj_ray(
        model,
        data,
        eye,
        way / np.linalg.norm(way),
        np.array([1, 1, 1, 1, 1, 0], np.uint8),
        1,
        -1,
        hit,
    )
    assert any(word in model.geom(int(hit[0])).name for word in ("wrist", "hand", "camera", "eye"))


@pytest.mark.parametrize("at", [None, (0.5, 0.1, 0.8)])
@pytest.mark.parametrize(
    ("azimuth", "elevation", "distance"),
    [(120.0, -20.0, 3.0), (-30.0, 60.0, 1.5), (0.0, -90.0, 4.0)],
)
def test_a_view_of_ones_own_is_that_of_mujocos_viewer(
    azimuth: float, elevation: float, distance: float, at
) -> None:
    filmed = Filmed(vs.load("arm_ibvs"))
    filmed.stage.place(0.0, filmed.T_target, filmed.q)
    FixedView(azimuth, elevation, distance, at=None if at is None else np.array(at)).place(
        filmed.stage, filmed.things
    )
    camera, scene = mujoco.MjvCamera(), mujoco.MjvScene(filmed.stage.model, 2000)
    camera.type, camera.azimuth, camera.elevation, camera.distance = (
        mujoco.mjtCamera.mjCAMERA_FREE,
        azimuth,
        elevation,
        distance,
    )
    camera.lookat[:] = (
        filmed.things.points(filmed.stage.data).reshape(-1, 3).mean(axis=0) if at is None else at
    )
    mujoco.mjv_updateScene(
        filmed.stage.model,
        filmed.stage.data,
        mujoco.MjvOption(),
        None,
        camera,
        mujoco.mjtCatBit.mjCAT_ALL,
        scene,
    )
    eyes = scene.camera
    np.testing.assert_allclose(
        filmed.pose[:3, 3], (np.array(eyes[0].pos) + eyes[1].pos) / 2, atol=1e-5
    )
    np.testing.assert_allclose(filmed.pose[:3, 2], eyes[0].forward, atol=1e-6)
    np.testing.assert_allclose(-filmed.pose[:3, 1], eyes[0].up, atol=1e-6)
