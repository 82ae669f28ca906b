"""Lines on the floor in rendered pictures:
where they cross the look distances, against the truth.
"""

import mujoco
import numpy as np
import pytest

from vstestbed.camera import Fisheye, Perspective, Picture, SphericalCamera
from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Pose, inverse
from vstestbed.core.planar import GroundPose
from vstestbed.imaging.chain import Chain
from vstestbed.imaging.sensor import ImageNoise
from vstestbed.robots import Omni
from vstestbed.robots.vehicle import GroundStart
from vstestbed.sim.base import SceneDescription
from vstestbed.sim.render.image_sensor import ImageSensor
from vstestbed.sim.render.pictures import servo_renderer
from vstestbed.sim.scene.scene import Scene
from vstestbed.sim.scene.world import Plate, World
from vstestbed.targets.ground_lines import GroundLines
from vstestbed.targets.route import FigureEight, Piece, Track
from vstestbed.vision import Lines

WAY = Track(
    pieces=(Piece(length_m=3), Piece(turn_deg=90, radius_m=2.0), Piece(turn_deg=-90, radius_m=2.0))
)
MOUNT = Pose(xyz=(0.2, 0, 0.4), rpy_deg=(-150, 0, -90))
CAMERA = Perspective(fovy_deg=100, mount=MOUNT)
RNG = np.random.default_rng(0)


class Bench:
    """A base that is put anywhere over painted lines, and pictures from it."""

    def __init__(self, lines, camera, sigma=0.0, world=None):
        robot = Omni(wheels="planar", start=GroundStart(nominal=GroundPose()))
        self.lines, self.camera = lines, camera
        self.stage = Scene(
            SceneDescription(robot, camera, lines, world or World(), 0.002),
            samples=camera.multisampling,
        )
        noise = ImageNoise(sigma, np.random.default_rng(1))
        self.eye = ImageSensor(
            self.stage, servo_renderer(self.stage, camera, sigma > 0), Chain(noise=noise)
        )

    def frame(self, x, y, heading_deg, regions=None):
        T = GroundPose(x=x, y=y, heading_deg=heading_deg).T @ self.camera.mount.T
        self.stage.place(0.0, self.lines.pose.T, np.zeros(3), T)
        mujoco.mj_forward(self.stage.model, self.stage.data)
        return self.eye.capture(0.0, regions), T

    def errors(self, places):
        """Measured less true pixels of all points at each place, (places, N, 2); each picture on
        its own.
        """
        detector, out = Lines(), []
        for place in places:
            frame, T = self.frame(*place)
            true = self.camera.project(self.lines.seen_from(inverse(self.lines.pose.T) @ T))
            out.append(
                detector.detect(detector.init(), frame, None, self.camera, self.lines, RNG)[1].uv
                - true
            )
        self.stage.close()
        return np.array(out)


PLACES = [
    (0.5, 0.0, 0),
    (1, 0.3, 20),
    (1, 0.3, -20),
    (1.3, -0.3, -20),
    (2.6, 0.05, 3),
    (4.4, 0.6, 40),
    (5.02, 2.0, 88),
    (5.4, 3.3, 60),
]
"""On the straight, beside it and turned as far as it has to recover from, into the bend, in it,
where it turns the other way.
"""


@pytest.mark.parametrize("renderer", ["gl", "rays"])
def test_points_are_where_the_lines_cross(renderer):
    bench = Bench(GroundLines(route=WAY), Perspective(fovy_deg=100, mount=MOUNT, renderer=renderer))
    errors = bench.errors(PLACES if renderer == "gl" else PLACES[::2])
    # One sample a pixel: a border is off by .29 px, a row's centroid by .2, a line through nine
    # rows by .07 to .2 (all rows alike).
    assert (
        np.isfinite(errors).all()
        and np.sqrt((errors**2).mean()) < 0.1
        and np.abs(errors).max() < 0.3
    )


def test_of_two_lines_each_by_its_hue():
    errors = Bench(GroundLines(route=WAY, offsets_m=(0.2, -0.2)), CAMERA).errors(PLACES)
    seen = np.isfinite(errors[..., 0])
    assert seen[[0, 4, 5, 6]].all()  # near the way both are in the picture
    assert np.sqrt(np.nanmean(errors**2)) < 0.1


def test_any_lens():
    for camera in (
        Fisheye(width=480, height=480, fov_deg=170, mount=MOUNT),
        SphericalCamera(mount=MOUNT),
    ):
        errors = Bench(
            GroundLines(route=WAY, marker={"kind": "stripe", "width_m": 0.05}), camera
        ).errors(PLACES[:6])
        assert np.isfinite(errors).all() and np.sqrt((errors**2).mean()) < 0.1


def test_lines_are_found_in_noise():
    errors = Bench(GroundLines(route=WAY), CAMERA, sigma=10).errors(PLACES)
    # 10 grey levels of 255 over nine rows of some ten pixels: less than what the pixels' raster
    # does.
    assert np.isfinite(errors).all() and np.sqrt((errors**2).mean()) < 0.1


def test_what_stands_before_a_line_hides_it():
    plate = Plate(pose=Pose(xyz=(1.3, -0.02, 0.05), rpy_deg=(0, 0, 0)), width=0.15, height=0.06)
    errors = Bench(GroundLines(route=WAY), CAMERA, world=World(plates=(plate,))).errors(
        [(1.0, 0.0, 0.0)]
    )
    assert np.isnan(errors[0, 0]).all()  # it covers the near crossing, at x = 1.3
    assert np.isfinite(errors[0, 1]).all()


def test_where_a_way_crosses_itself_it_keeps_its_own():
    way = FigureEight(length_m=10, width_m=5)
    bench, detector = Bench(GroundLines(route=way), CAMERA), Lines()
    state, offs = detector.init(), []
    for s in np.arange(-0.8, 0.1, 0.04):
        x, y, heading, _ = way.at(s)
        frame, T = bench.frame(x, y, np.degrees(heading))
        state, found = detector.detect(state, frame, None, CAMERA, bench.lines, RNG)
        offs.append(found.uv - CAMERA.project(bench.lines.seen_from(T)))
    bench.stage.close()
    # Where both branches run into one another the stripe is wider than a stripe, and the point is
    # not told: 3 of 46.
    assert np.nanmax(np.abs(offs)) < 0.5 and np.isnan(np.array(offs)[..., 0]).sum() < 6


def test_only_the_strips_are_looked_at():
    camera = Perspective(fovy_deg=100, mount=MOUNT, renderer="rays")
    bench, detector = Bench(GroundLines(route=WAY), camera), Lines()
    frame, _ = bench.frame(*PLACES[1])
    state, whole = detector.detect(detector.init(), frame, None, camera, bench.lines, RNG)
    regions = detector.regions_of_interest(state, camera, bench.lines)
    assert (
        regions is not None
        and sum((r - a) * (b - t) for a, t, r, b in regions[0]) < 0.2 * 640 * 480
    )
    part, _ = bench.frame(*PLACES[1], regions=regions)
    assert not part.whole
    np.testing.assert_array_equal(
        detector.detect(state, part, None, camera, bench.lines, RNG)[1].uv, whole.uv
    )
    bench.stage.close()


def test_refuses_a_floor_that_it_does_not_see():
    up = Perspective(mount=Pose(xyz=(0, 0, 0.3)))
    frame = Picture(0.0, (np.zeros((480, 640, 3), np.uint8),))
    with pytest.raises(ParameterError, match="within the floor that the camera sees"):
        Lines().detect(Lines().init(), frame, None, up, GroundLines(route=WAY), RNG)
