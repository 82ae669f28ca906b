"""The depth of rendered pictures: OpenGL's depth buffer against MuJoCo's rays, exposures, regions
of interest.
"""

from __future__ import annotations

from contextlib import closing

import numpy as np
import pytest

import vstestbed as vs
from vstestbed.camera import DepthImage
from vstestbed.core.errors import ScenarioError
from vstestbed.loop.plants import plant_of
from vstestbed.sim.base import Plant
from vstestbed.sim.build import PictureSetup, build_plant
from vstestbed.sim.render.opengl import OpenGLRenderer
from vstestbed.sim.render.rays import RayRenderer
from vstestbed.sim.scene.scene import Scene

SMALL = {"camera.width": 320, "camera.height": 240}


def both(changes: dict[str, object]) -> tuple[DepthImage, DepthImage]:
    """The depth of the arm's first view, by OpenGL and by rays."""
    s = vs.load("arm_ibvs", SMALL | changes)
    stage = Scene(s.scene, s.camera.multisampling)
    stage.place(0.0, s.target.T_world_start, *stage.parts.start)
    with closing(stage):
        eyes = OpenGLRenderer(stage, s.camera), RayRenderer(stage, s.camera)
        for eye in eyes:
            # the region of interest does not matter
            eye.images((((10, 10, 20, 20),),), with_depth=True)
            assert eye.whole
    assert eyes[0].depth is not None and eyes[1].depth is not None
    return eyes[0].depth, eyes[1].depth


UNALIGNED = {
    "camera.depth_sensor": {"kind": "ideal", "lens": {"width": 640, "height": 360, "fovx_deg": 85}}
}


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"camera.principal_px": [150.25, 131.5]},
        {"camera.distortion": [-0.2, 0.05, 0, 0, 0]},
        UNALIGNED,
    ],
    ids=str,
)
def test_opengl_measures_what_rays_do(changes: dict[str, object]):
    gl, rays = both(changes)
    sky = np.isinf(rays)
    # the sky is nothing, although MuJoCo draws it as a solid
    assert 0.3 < sky.mean() < 0.7 and np.mean(np.isinf(gl) != sky) < 2e-3
    solid = ~sky & np.isfinite(gl) & (rays < (1.1 if "camera.distortion" in changes else 2.0))
    error = np.abs(gl[solid] - rays[solid])
    # The buffer has 24 bits, steps of 1e-5 Z^2 / m. Resampled, the floor towards the horizon has
    # the nearest pixel's depth.
    assert solid.mean() > 0.2 and np.median(error) < 2e-5 and np.quantile(error, 0.98) < 5e-5
    if not changes:
        far = ~sky & (rays > 5) & (rays < 20) & np.isfinite(gl)
        assert np.median(np.abs(gl[far] - rays[far]) / rays[far] ** 2) < 1e-5


def test_an_unaligned_picture_is_that_of_its_own_lens():
    """Z of the board, a plane at z = 0.01 m, along the rays of the depth camera's pixels; the
    colour picture stays as it is.
    """
    lens = {"width": 1280, "height": 720, "fovx_deg": 85}
    taken = []
    for sensor in ({"kind": "ideal"}, {"kind": "ideal", "lens": lens}):
        plant, _ = plant_of(
            vs.load("camera_vitvs", {"camera.depth_sensor": sensor}), pictures=True, plate_m=0.0
        )
        with closing(plant):
            picture, truth = plant.capture()
            assert picture is not None and picture.depth is not None
            taken.append((picture.image.copy(), picture.depth.copy()))
    assert np.array_equal(taken[0][0], taken[1][0])
    f = 640 / np.tan(np.radians(42.5))
    v, u = np.mgrid[230:250, 310:330]
    ray = (
        np.stack([(u - 639.5) / f, (v - 359.5) / f, np.ones(u.shape)], axis=-1)
        @ truth.T_world_camera[:3, :3].T
    )
    on_board = (0.01 - truth.T_world_camera[2, 3]) / ray[..., 2]
    floor = -truth.T_world_camera[2, 3] / ray[..., 2]
    error = np.minimum(
        np.abs(taken[1][1][230:250, 310:330] - on_board),
        np.abs(taken[1][1][230:250, 310:330] - floor),
    )
    assert error.max() < 2e-5 and np.abs(taken[0][1] - taken[1][1])[230:250, 310:330].min() > 0.05
    with pytest.raises(ScenarioError, match=r"depth_sensor\.lens: must be at least 640 x 480 px"):
        vs.load("camera_vitvs", {"camera.depth_sensor": {"kind": "ideal", "lens": {"width": 320}}})


def test_a_distorted_edge_has_the_depth_of_one_surface():
    """The target's board stands before the floor and the sky: no depth lies between."""
    gl, rays = both({"camera.distortion": [-0.2, 0.05, 0, 0, 0]})
    board = rays < 0.95
    beside = np.zeros_like(board)
    beside[1:-1, 1:-1] = np.logical_or.reduce(
        [np.roll(board, s, (0, 1))[1:-1, 1:-1] for s in ((0, 1), (0, -1), (1, 0), (-1, 0))]
    )
    edge = beside & (rays > 2)
    assert edge.sum() > 50
    assert not ((gl[edge] > 1.0) & (gl[edge] < 1.9)).any()


def plant(sensor: str, **changes: object) -> Plant:
    s = vs.load("arm_depth", SMALL | {"camera.depth_sensor": sensor} | changes)
    pictures = PictureSetup(needs_image=True, needs_truth=False, depth_rng=np.random.default_rng(3))
    return build_plant(s.scene, pictures)[0]


def test_an_exposure_has_the_depth_of_its_middle():
    speeds = np.array([0.6, -0.4, 0.5, 0.7, -0.6, 0.8])
    with closing(plant("ideal")) as blurred, closing(plant("ideal")) as sharp:
        for one in (blurred, sharp):
            one.apply(speeds)
            one.advance(10)
        for middle in (False, True, False):
            blurred.expose(1 / 3, middle=middle)
            blurred.advance(5)
        sharp.advance(5)
        long, instant = blurred.developed(0.0), sharp.capture()[0]
    assert (
        long is not None
        and instant is not None
        and long.depth is not None
        and instant.depth is not None
    )
    np.testing.assert_array_equal(long.depth, instant.depth)
    assert not np.array_equal(long.images[0], instant.images[0])


def test_noise_is_new_in_each_picture_and_depends_on_nothing_else():
    with closing(plant("stereo")) as one, closing(plant("stereo")) as other:
        first, second = (one.capture()[0] for _ in range(2))
        again = other.capture((((10, 10, 20, 20),),))[0]  # another region of interest
        assert other.picture_from(np.eye(4)).depth is not None  # a goal's picture draws nothing
        next_one = other.capture()[0]
    depths = [picture.depth for picture in (first, second, again, next_one) if picture is not None]
    np.testing.assert_array_equal(depths[0], depths[2])
    np.testing.assert_array_equal(depths[1], depths[3])
    change = (depths[0] - depths[1])[np.isfinite(depths[0]) & np.isfinite(depths[1])]
    assert np.median(np.abs(change)) > 1e-3
