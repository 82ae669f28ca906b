"""A view is drawn again when something has moved in it, and not otherwise."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

import vstestbed as vs
from vstestbed.camera import Window
from vstestbed.sim.render.still import UNSEEN_PX, StillView, half_tangents, pixels_per_radian

SCENE = """
<mujoco><worldbody>
  <camera name="eye" mode="fixed" pos="0 0 2"/>
  <geom type="plane" size="0 0 1"/>
  <body name="ball" mocap="true" pos="0.3 0 0.5"><geom type="sphere" size="0.1"/></body>
  <body name="stick" mocap="true" pos="0 0.3 0.5"><geom type="box" size="0.4 0.01 0.01"/></body>
</worldbody></mujoco>
"""
F = 400.0


class Counts:
    """Draws pictures whose grey level is how often it has drawn."""

    drawn = 0

    def full_image(self) -> np.ndarray:
        self.drawn += 1
        return np.full((4, 4, 3), self.drawn, np.uint8)


class TestMotion:
    @pytest.fixture(autouse=True)
    def scene(self) -> None:
        self.model = mujoco.MjModel.from_xml_string(SCENE)
        self.data = mujoco.MjData(self.model)
        self.counts = Counts()
        self.view = StillView(self.counts.full_image, self.data, "eye", F)

    def image(self) -> int:
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_camlight(self.model, self.data)
        return int(self.view.full_image()[0, 0, 0])

    def test_a_scene_at_rest_is_drawn_once_and_its_pictures_are_copies(self):
        assert self.image() == 1
        self.view.full_image()[:] = 99
        assert self.image() == 1 and self.counts.drawn == 1

    def test_small_motions_add_up(self):
        self.image()
        step = 0.3 * UNSEEN_PX * 1.5 / F  # three tenths of the limit for what is 1.5 m away
        drawn = []
        for _ in range(9):
            self.data.mocap_pos[0, 0] += step
            drawn.append(self.image())
        assert drawn[0] == 1 and 2 <= drawn[-1] <= 4

    @pytest.mark.parametrize("what", ["ball", "turn", "camera", "tilt"])
    def test_what_moves_by_a_pixel_is_drawn(self, what: str):
        self.image()
        pixel = 1.0 / F  # [rad]
        if what == "ball":
            self.data.mocap_pos[0, 1] += 1.5 * pixel
        elif what == "turn":  # the ends of a stick of .4 m, 1.5 m away
            self.data.mocap_quat[1] = [np.cos(2 * pixel), 0, 0, np.sin(2 * pixel)]
        elif what == "camera":
            self.model.cam_pos[0, 0] += 2 * pixel
        else:
            self.model.cam_quat[0] = [np.cos(pixel), np.sin(pixel), 0, 0]
        assert self.image() == 2

    @pytest.mark.parametrize(
        ("place", "drawn"),
        [((1, 0, 0.5), 1), ((0, -1, 0.5), 1), ((0, 0, 2.2), 1), ((0.7, 0, 0.5), 2)],
    )
    def test_what_is_out_of_sight_moves_unseen(self, place: tuple[float, float, float], drawn: int):
        self.view = StillView(
            self.counts.full_image, self.data, "eye", F, sides=(0.5, 0.5)
        )  # .75 m aside, 1.5 m before the camera
        self.data.mocap_pos[0] = place
        assert self.image() == 1
        self.data.mocap_pos[0, :2] *= 1.05
        self.data.mocap_pos[0, 2] += 0.01
        assert self.image() == drawn
        self.data.mocap_pos[0] = 0.1, 0.1, 0.5  # it comes into sight
        assert self.image() == drawn + 1
        self.data.mocap_pos[0] = place  # and leaves
        assert self.image() == drawn + 2


class TestParts:
    @pytest.fixture(autouse=True)
    def scene(self) -> None:
        self.model = mujoco.MjModel.from_xml_string(SCENE)
        self.data = mujoco.MjData(self.model)
        self.drawn: list[Window | None] = []
        self.view = StillView(self.full_image, self.data, "eye", F, self.part)
        self.image()

    def full_image(self) -> np.ndarray:
        return self.part(None)

    def part(self, window: Window | None) -> np.ndarray:
        self.drawn.append(window)
        return np.full((400, 640, 3), len(self.drawn), np.uint8)

    def image(self) -> np.ndarray:
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_camlight(self.model, self.data)
        return self.view.full_image()

    def test_from_a_camera_at_rest_only_where_a_geom_is_and_was(self):
        self.data.mocap_pos[0, 0] += (
            0.2  # from .3 to .5 m to the right of the axis, 1.5 m away, with a radius of .1 m
        )
        image = self.image()
        rows, columns = np.nonzero(image[..., 0] == 2)
        left, right, half = 320 + F * 0.2 / 1.5, 320 + F * 0.6 / 1.5, F * 0.1 / 1.5
        assert left - 15 < columns.min() <= left and right <= columns.max() < right + 15
        assert (
            200 - half - 5 < rows.min() <= 200 - half
            and 200 + half - 1 <= rows.max() < 200 + half + 5
        )
        assert (image[..., 0] == 1).sum() + len(rows) == 400 * 640
        # it is known to be drawn there
        assert (self.image() == image).all() and len(self.drawn) == 2

    @pytest.mark.parametrize("what", ["camera", "near"])
    def test_all_of_it_where_the_camera_moves_or_a_geom_is_before_the_lens(self, what: str):
        if what == "camera":
            self.model.cam_pos[0, 0] += 0.01
        else:
            self.data.mocap_pos[0] = 0, 0, 1.85
        assert (self.image() == 2).all()


@pytest.mark.parametrize("name", ["arm_ibvs", "spherical_book"])
def test_pixels_per_radian_are_those_of_the_lens(name: str):
    camera = vs.load(name).camera
    f = pixels_per_radian(camera)
    centre = np.array([camera.width / 2, camera.height / 2])
    there = np.linalg.norm(camera.ray(centre + [1, 0]) - camera.ray(centre))
    assert f >= 0.99 / there
    assert f < 2 / there


def test_half_tangents_are_those_of_the_lens():
    camera = vs.load("arm_ibvs").camera
    sides = half_tangents(camera)
    assert sides is not None
    assert np.allclose(
        sides, np.array([640 / 480, 1]) * np.tan(np.radians(32)), rtol=0.021
    ) and sides[1] > np.tan(np.radians(32))
    assert half_tangents(vs.load("spherical_book").camera) is None
