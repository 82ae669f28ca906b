"""Lamps, windows and floors against the equations of light, in the pictures of both renderers."""

import itertools
import math
from pathlib import Path

import cv2
import numpy as np
import pytest

import vstestbed as vs
from tests.sim.scene.views import DOWN, LENS, pixel_of, seen
from vstestbed.core.errors import EnvironmentLackError, ParameterError, ScenarioError
from vstestbed.core.geometry import Image, Pose
from vstestbed.sim.base import SceneDescription
from vstestbed.sim.render.opengl import OpenGLRenderer
from vstestbed.sim.render.rays import refuse
from vstestbed.sim.render.still import StillView
from vstestbed.sim.scene.scene import Scene
from vstestbed.sim.scene.world import Floor, Light, Plate, WindowPane, World
from vstestbed.targets.base import Square
from vstestbed.targets.markers import Disc, Tag
from vstestbed.targets.motion import Line, Sinusoid
from vstestbed.targets.picture import PictureTarget


@pytest.fixture
def paper(tmp_path: Path):
    """A picture of one grey level as a file."""

    def made(grey: int) -> str:
        file = tmp_path / f"grey_{grey}.png"
        cv2.imwrite(str(file), np.full((32, 32, 3), grey, np.uint8))
        return str(file)

    return made


def at(image: np.ndarray, point: tuple[float, float, float], view: Pose = DOWN) -> np.ndarray:
    u, v = np.rint(pixel_of(point, view)).astype(int)
    return image[v, u].astype(float)


class TestLambert:
    """grey = 255 albedo (ambient + brightness cos), for each channel of the lamp's colour."""

    @pytest.mark.parametrize("tilt_deg", [0, 30, 60, 80])
    def test_a_marker(self, tilt_deg: float):
        marker = Disc(radius=0.1, albedo=0.8, saturation=0.5)
        target = Square(side=0.3, pose=Pose(xyz=(0, 0, 1)), marker=marker)
        a = math.radians(tilt_deg)
        light = Light(
            direction=(math.sin(a), 0, math.cos(a)),
            brightness=0.7,
            ambient=0.2,
            color=(1, 0.5, 0.8),
        )
        with seen(World(floor_z=-20, light=light), target) as view:
            images = view(Pose())
        ground = np.array([0.8, 0.4, 0.4])  # the first marker: hue 0, S 0.5, V 0.8
        expected = 255 * ground * [1, 0.5, 0.8] * (0.2 + 0.7 * math.cos(a))
        for image in images:
            np.testing.assert_allclose(at(image, (-0.15, -0.15, 1), Pose()), expected, atol=1.0)

    @pytest.mark.parametrize("slant", [0.0, 0.5, 1.5])
    def test_a_textured_floor(self, paper, slant: float):
        world = World(
            floor=Floor(texture=paper(200), albedo=0.6),
            light=Light(direction=(slant, 0, -1), brightness=0.8, ambient=0.1),
        )
        with seen(world) as view:
            for image in view():
                expected = 200 * 0.6 * (0.1 + 0.8 / math.hypot(1, slant))
                np.testing.assert_allclose(image[20:-20, 20:-20], expected, atol=1.5)

    def test_a_marker_that_is_not_lit_and_the_paper_of_a_picture_and_a_tag(self, paper):
        world = World(floor_z=-20, light=Light(direction=(0, 0, 1), brightness=0.5, ambient=0.1))
        shown = PictureTarget(
            file=paper(220), width=1.0, draw_markers=False, albedo=0.5, pose=Pose(xyz=(0, 0, 1))
        )
        with seen(world, shown) as view:
            assert all(
                abs(int(image[120, 160, 0]) - 220 * 0.5 * 0.6) <= 1 for image in view(Pose())
            )
        tag = Square(
            side=0.5, pose=Pose(xyz=(0, 0, 1)), marker=Tag(size=0.2, albedo=0.5, lit=False)
        )
        with seen(world, tag) as view:
            for image in view(Pose()):
                region = image[60:180, 60:260].reshape(-1, 3)
                grey = region[np.ptp(region.astype(int), axis=1) == 0][:, 0]
                assert np.isclose(np.sort(grey), 127, atol=1).sum() > 100  # its white


class TestWindows:
    PANE = WindowPane(
        pose=Pose(xyz=(0, 0, 1.5), rpy_deg=(180, 0, 0)), width=0.6, height=0.5, brightness=3.0
    )
    """On the ceiling, seen by nobody: it shines down."""
    DARK = Light(brightness=0.0, ambient=0.0)

    def test_the_light_on_the_floor(self, paper):
        world = World(floor=Floor(texture=paper(255)), windows=(self.PANE,), light=self.DARK)
        aside = Pose(xyz=(0, -2.0, 1.2), rpy_deg=(-120, 0, 0))
        with seen(world) as view:
            images = view(aside)
        for x, y in itertools.product((-0.4, 0.0, 0.4), (-0.2, 0.4, 1.0)):
            d2 = x * x + y * y + 1.5**2
            expected = 255 * 3.0 * (1.5**2 / d2) * 0.3 / (0.3 + math.pi * d2)
            for image in images:
                assert at(image, (x, y, 0), aside)[0] == pytest.approx(expected, abs=1.5)

    @pytest.mark.parametrize(("d", "within"), [(0.5, 0.12), (1.5, 0.02), (4.0, 0.003)])
    def test_the_equation_against_the_integral_over_the_pane(self, d: float, within: float):
        """cos a cos b / (pi r^2) summed over the pane (view factor of an element): the disc's
        closed form is that of a small pane.
        """
        n = 400
        x, y = np.meshgrid(
            (np.arange(n) + 0.5) / n * 0.6 - 0.3, (np.arange(n) + 0.5) / n * 0.5 - 0.25
        )
        for beside in (0.0, 0.5 * d):
            r2 = (x - beside) ** 2 + y**2 + d**2
            exact = float((d**2 / (math.pi * r2**2)).mean() * 0.3)
            far2 = beside**2 + d**2
            assert d**2 / far2 * 0.3 / (0.3 + math.pi * far2) == pytest.approx(
                exact, rel=within if beside == 0 else 2 * within
            )

    def test_the_pane_is_white_and_grey_of_its_brightness(self):
        for brightness, grey in ((0.4, 102), (5.0, 255)):
            pane = WindowPane(pose=Pose(xyz=(0, 0, 2), rpy_deg=(180, 0, 0)), brightness=brightness)
            with seen(World(floor_z=-20, windows=(pane,))) as view:
                assert all(abs(int(image[120, 160, 0]) - grey) <= 1 for image in view(Pose()))

    def test_it_hides_markers_from_the_oracle(self):
        assert World(windows=(self.PANE,)).hides


class TestGloss:
    VIEW = Pose(xyz=(0.3, -1.5, 1.0), rpy_deg=(-120, 0, 0))

    @pytest.mark.parametrize(
        ("light", "mirror"),
        # the camera's mirror image below the floor is on the line from the lamp through the
        # highlight
        [
            (
                Light(xyz=(-0.2, 2.5, 2.0), direction=(0, -0.5, -1), brightness=1, ambient=0),
                (0.3 - 0.5 / 3, -1.5 + 4 / 3, 0),
            ),
            (Light(direction=(0.2, -1.2, -1), brightness=1, ambient=0), (0.3 - 0.2, -1.5 + 1.2, 0)),
        ],
    )
    def test_a_highlight_is_where_the_mirror_direction_says(
        self, paper, light: Light, mirror: tuple[float, float, float]
    ):
        world = World(floor=Floor(texture=paper(0), gloss=0.8), light=light)
        with seen(world) as view:
            # OpenGL has it at the corners of a grid alone
            for image, within in zip(view(self.VIEW), (10, 1), strict=True):
                bright = image[..., 0].astype(float)
                assert bright.max() == pytest.approx(255 * 0.8, abs=within)
                v, u = np.argwhere(bright == bright.max()).mean(axis=0)
                # 8 px: a cell of the grid
                assert np.hypot(*(pixel_of(mirror, self.VIEW) - [u, v])) < (
                    8 if within > 1 else 1.5
                )

    def test_it_falls_to_a_half_where_its_exponent_says(self, paper):
        world = World(
            floor=Floor(texture=paper(0), gloss=1, sharpness=45),
            light=Light(direction=(0, 0, -1), brightness=1, ambient=0),
        )
        a = 2 * math.acos(2 ** (-1 / 45))  # of the ray: h turns by half of it
        with seen(world) as view:
            for image in view():
                assert at(image, (2 * math.tan(a), 0, 0))[0] == pytest.approx(127.5, abs=3)

    def test_the_highlight_of_a_window(self, paper):
        pane = WindowPane(
            pose=Pose(xyz=(0.3, 4, 1.0), rpy_deg=(90, 0, 0)), width=0.6, height=0.5, brightness=2.0
        )
        world = World(
            floor=Floor(texture=paper(0), gloss=0.7),
            windows=(pane,),
            light=Light(brightness=0, ambient=0),
        )
        d2 = 2.75**2 + 1.0  # halfway between equal heights
        expected = (
            255 * 0.7 * 2.0 * (2.75 / math.sqrt(d2)) * 0.3 / (0.3 + math.pi * d2) * (45 / 4 + 1) / 2
        )
        with seen(world) as view:
            for image, within in zip(view(self.VIEW), (0.25, 0.03), strict=True):
                assert at(image, (0.3, 1.25, 0), self.VIEW)[0] == pytest.approx(
                    expected, rel=within
                )


class TestFloor:
    def test_a_tile_has_its_width(self, tmp_path: Path):
        # twice as wide as high, and no power of two
        file, tile = tmp_path / "line.png", np.full((30, 60, 3), 40, np.uint8)
        tile[:, 28:32] = 220
        cv2.imwrite(str(file), tile)
        with seen(
            World(floor=Floor(texture=str(file), tile_m=0.5), light=Light(brightness=0, ambient=1))
        ) as view:
            for image in view():
                row = image[120, :, 0].astype(float)
                rises = np.flatnonzero((row[1:] >= 130) & (row[:-1] < 130))
                np.testing.assert_allclose(np.diff(rises), LENS.f * 0.5 / 2, atol=1.0)

    def test_a_mirror_shows_what_is_over_it(self):
        target = Square(
            side=0.4,
            pose=Pose(xyz=(0, 2, 0.6), rpy_deg=(-90, 0, 0)),
            marker=Disc(radius=0.04, lit=False),
        )
        view_from = Pose(xyz=(0, 0, 0.8), rpy_deg=(-105, 0, 0))
        x, y, z = (target.pose.T @ [*target.points[0], 1])[:3]
        reds = []
        for mirror in (0.0, 0.2):
            with seen(World(floor=Floor(mirror=mirror)), target, by=(OpenGLRenderer,)) as view:
                image = view(view_from)[0]
            assert at(image, (x, y, z), view_from).tolist() == [255, 0, 0]
            reds.append(at(image, (x, y, -z), view_from))
        np.testing.assert_allclose(reds[1] - reds[0], [0.2 * 255, 0, 0], atol=1)

    def test_rays_refuse_a_mirror(self):
        with pytest.raises(
            ScenarioError,
            match=r"camera.renderer: must be gl or auto: a floor that mirrors needs OpenGL",
        ):
            vs.load("arm_ibvs", {"world.floor": {"mirror": 0.3}, "camera.renderer": "rays"})
        with pytest.raises(EnvironmentLackError, match="mirrors"):
            refuse(LENS, 0.3)

    def test_a_texture_that_is_none(self):
        with pytest.raises(ScenarioError, match=r"world.floor.*no bundled texture"):
            vs.load("arm_ibvs", {"world.floor": {"texture": "texture:lava"}})


class TestALampThatMoves:
    def light(self) -> Light:
        return Light(
            direction=(0, 0, 1),
            brightness=0.8,
            ambient=0.1,
            motion=Sinusoid(amplitude=Pose(rpy_deg=(0, 40, 0)), frequency_hz=0.25),
        )

    def test_turns_the_shading(self):
        target = Square(side=0.3, pose=Pose(xyz=(0, 0, 1)), marker=Disc(radius=0.1))
        with seen(World(floor_z=-20, light=self.light()), target) as view:
            for t in (0.0, 0.5, 1.0, 2.0):
                turn = math.radians(40) * math.sin(2 * math.pi * 0.25 * t)
                for image in view(Pose(), t):
                    assert at(image, (-0.15, -0.15, 1), Pose())[0] == pytest.approx(
                        255 * (0.1 + 0.8 * math.cos(turn)), abs=1.5
                    )

    def test_moves_the_shadow_of_a_plate(self):
        """A lamp overhead turned by an angle casts the shadow of a plate at a height h by h
        tan(angle) aside.
        """
        sway = Sinusoid(amplitude=Pose(rpy_deg=(0, 30, 0)), frequency_hz=0.25)
        light = Light(direction=(0, 0, -1), brightness=0.8, ambient=0.1, motion=sway)
        plate = Plate(pose=Pose(xyz=(0, 0, 0.8)), width=0.2, height=0.2)
        lens = vs.load(
            "arm_ibvs",
            {
                "camera.shadows": True,
                "camera.width": 320,
                "camera.height": 240,
                "camera.fovy_deg": 60,
            },
        ).camera
        low = Pose(xyz=(0, 0, 0.75), rpy_deg=(180, 0, 0))  # under the plate
        with seen(World(light=light, plates=(plate,)), lens=lens, by=(OpenGLRenderer,)) as view:
            for t, angle in ((0.0, 0.0), (1.0, 30.0), (3.0, -30.0)):
                dark = view(low, t)[0].mean(axis=-1) < 60
                x = 0.75 * (np.flatnonzero(dark.any(axis=0)).mean() - 159.5) / LENS.f
                assert abs(x) == pytest.approx(abs(0.8 * math.tan(math.radians(angle))), abs=0.03)
                assert x * angle <= 0.0  # turned about +y, the rays' direction -z goes to -x

    def test_is_noticed_by_views_that_are_kept(self):
        s = vs.load("arm_ibvs")
        stage = Scene(
            SceneDescription(s.robot, s.camera, s.target, World(light=self.light()), step=0.002)
        )
        drawn = []

        def image() -> Image:
            drawn.append(stage.data.time)
            return np.zeros((4, 4, 3), np.uint8)

        view = StillView(image, stage.data, "overview", 400.0)
        for t in (0.0, 0.0, 0.1):
            stage.place(t, s.target.pose.T, s.robot.configuration())
            view.full_image()
        assert drawn == [0.0, 0.1]
        stage.close()

    def test_to_where_the_sun_does_not_show_it_is_refused(self):
        with pytest.raises(ParameterError, match="must turn a lamp"):
            Light(motion=Line(velocity_mps=(1, 0, 0)))
        path = Light(xyz=(0, 0, 2), motion=Line(velocity_mps=(1, 0, 0))).path()
        assert path(2.0)[:3, 3] == pytest.approx([2, 0, 2])
