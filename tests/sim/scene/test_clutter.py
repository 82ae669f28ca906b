"""Decoys and clutter: what is drawn and placed, and what it does to a detector of colours."""

from __future__ import annotations

import colorsys
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy import stats

import vstestbed as vs
from tests.sim.scene.views import LENS, pixel_of, seen
from vstestbed.camera import Image, Perspective, Picture
from vstestbed.core.errors import ParameterError, ScenarioError
from vstestbed.core.geometry import Pose, transform
from vstestbed.sim.render.opengl import OpenGLRenderer
from vstestbed.sim.scene.world import Clutter, Decoy, Light, World
from vstestbed.targets.base import Square
from vstestbed.targets.markers import Disc
from vstestbed.vision import Blobs

CAMERA = Perspective()  # 640 x 480
TARGET = Square(side=0.3, pose=Pose(xyz=(0, 0, 1)), marker=Disc(radius=0.02))
HUES = TARGET.hues_deg
BEHIND = Pose(xyz=(0, 0, 1.5), rpy_deg=(180, 0, 0))
LIT = Light(direction=(0, 0, 1), brightness=0.5, ambient=0.5)


def picture(
    *decoys: Decoy, target: Square = TARGET, clutter: Clutter | None = None, light: Light = LIT
) -> Image:
    world = World(floor_z=-20, light=light, decoys=decoys, clutter=clutter)
    with seen(world, target, CAMERA, (OpenGLRenderer,)) as view:
        return view(Pose())[0]


def found(image: Image, target: Square = TARGET) -> tuple[list[bool], float]:
    """Which markers the colour blobs report, and the largest error of a reported one [px]."""
    uv = Blobs().detect(
        Blobs().init(),
        Picture(t=0.0, images=(image,)),
        None,
        CAMERA,
        target,
        np.random.default_rng(0),
    )[1]
    true = CAMERA.project(transform(target.pose.T, target.points))
    error = np.abs(uv.uv - true)[uv.seen]
    return uv.seen.tolist(), float(error.max(initial=0.0))


def twin(x: float, y: float, hue: int, radius: float = 0.02) -> Decoy:
    """A disc like a marker, in the target's plane."""
    return Decoy(
        xyz=(x, y, 0.999), shape="disc", radius=radius, hue_deg=HUES[hue], rpy_deg=(0, 180, 0)
    )


class TestDraws:
    CLUTTER = Clutter(
        pose=Pose(xyz=(1, 2, 3)), size_m=(2.0, 1.0, 0.5), count=100, radius_m=(0.01, 0.03)
    )

    def all_of(self, clutter: Clutter) -> list[Decoy]:
        return [
            one for seed in range(10) for one in clutter.draw(np.random.default_rng(seed), HUES)
        ]

    def test_places_and_sizes_are_uniform(self):
        objects = self.all_of(self.CLUTTER)
        for axis, (low, size) in enumerate(((0.0, 2.0), (1.5, 1.0), (2.75, 0.5))):
            assert (
                stats.kstest(
                    [one.xyz[axis] for one in objects], stats.uniform(low, size).cdf
                ).pvalue
                > 0.001
            )
        assert (
            stats.kstest([one.radius for one in objects], stats.uniform(0.01, 0.02).cdf).pvalue
            > 0.001
        )

    def test_hues_are_those_of_the_markers_or_any(self):
        hues, count = np.unique(
            [one.hue_deg for one in self.all_of(self.CLUTTER)], return_counts=True
        )
        assert hues.tolist() == sorted(HUES)
        assert stats.chisquare(count).pvalue > 0.001
        anyhow = self.all_of(Clutter(pose=Pose(), count=100, hues="any"))
        assert (
            stats.kstest([one.hue_deg for one in anyhow], stats.uniform(0, 360).cdf).pvalue > 0.001
        )

    def test_it_stands_in_the_axes_of_its_box(self):
        turned = Clutter(pose=Pose(rpy_deg=(0, 90, 0)), size_m=(1.0, 1e-3, 1e-3), count=50)
        z = np.array([one.xyz for one in turned.draw(np.random.default_rng(0), HUES)])
        assert np.ptp(z[:, 2]) > 0.8 and np.abs(z[:, :2]).max() < 1e-3

    def test_object_i_is_the_same_whatever_their_number(self):
        few = Clutter(pose=Pose(), count=5).draw(np.random.default_rng(1), HUES)
        assert Clutter(pose=Pose(), count=9).draw(np.random.default_rng(1), HUES)[:5] == few

    def test_a_scenario_states_what_its_seed_placed(self):
        block: dict[str, Any] = {
            "detector": "oracle",
            "world.clutter": {"pose": {"xyz": [1.8, 0, 0.7]}, "count": 6},
        }
        s = vs.load("arm_ibvs", block, 4).resolved
        assert len(s.world.distractors) == 6
        assert s == vs.load("arm_ibvs", block, 4).resolved
        assert s.world.distractors != vs.load("arm_ibvs", block, 5).resolved.world.distractors
        assert s.robot == vs.load("arm_ibvs", {"detector": "oracle"}, 4).resolved.robot

    def test_sizes_in_the_wrong_order_are_refused(self):
        with pytest.raises(
            ScenarioError, match=r"world.clutter.radius_m: needs the form .smallest, largest"
        ):
            vs.load("arm_ibvs", {"world.clutter": {"pose": {}, "radius_m": [0.3, 0.1]}})


@pytest.mark.parametrize("shape", ["ball", "disc", "box"])
def test_both_renderers_draw_its_shape_in_its_colour(shape: Any):
    decoy = Decoy(
        xyz=(0.1, -0.1, 0.5),
        shape=shape,
        radius=0.05,
        hue_deg=90,
        saturation=0.5,
        albedo=0.8,
        rpy_deg=(180, 0, 0),
    )
    even = Light(brightness=0, ambient=1)
    with seen(World(floor_z=-20, light=even, decoys=(decoy,))) as view:
        images = view(Pose())
    u, v = np.rint(pixel_of((0.1, -0.1, 0.5), Pose())).astype(int)
    expected = 255 * np.array(colorsys.hsv_to_rgb(0.25, 0.5, 0.8))
    areas = []
    for image in images:
        np.testing.assert_allclose(image[v, u], expected, atol=1)
        areas.append(int((np.abs(image - expected).max(axis=-1) < 3).sum()))
    r = LENS.f * 0.05 / (0.45 if shape == "box" else 0.5)
    assert areas[0] == pytest.approx(areas[1], rel=0.02)
    assert areas[1] == pytest.approx(
        4 * r * r if shape == "box" else np.pi * r * r, rel=0.3 if shape == "box" else 0.05
    )


class TestWhatItDoesToColourBlobs:
    def test_a_few_beside_the_target_are_told_apart_by_its_geometry(self):
        assert found(picture(*(twin(-0.4 + 0.25 * m, 0.33, m) for m in range(4)))) == (
            [True] * 4,
            pytest.approx(0, abs=0.1),
        )

    def test_four_larger_ones_of_every_hue_leave_it_without_an_answer(self):
        """The assignment looks at the four largest blobs of a hue: the markers are not among them,
        and nothing wrong is reported.
        """
        many = [
            twin(-0.55 + 0.28 * k, (-0.4, -0.3, 0.3, 0.4)[m], m, 0.026)
            for m in range(4)
            for k in range(5)
        ]
        seen_, _ = found(picture(*many))
        assert seen_ == [False] * 4

    @pytest.mark.parametrize(("off_m", "lost"), [(0.02, True), (0.039, True), (0.045, False)])
    def test_one_that_touches_a_marker_of_its_colour_loses_it(self, off_m: float, lost: bool):
        """They are one blob as long as their middles are nearer than two radii, 0.04 m; it is no
        disc, and nothing wrong is reported.
        """
        x, y = TARGET.points[0, :2].tolist()
        assert found(picture(twin(x + off_m, y, 0))) == (
            [not lost, True, True, True],
            pytest.approx(0, abs=0.1),
        )

    def test_markers_that_are_hardly_saturated_are_not_found(self):
        pale = Square(side=0.3, pose=Pose(xyz=(0, 0, 1)), marker=Disc(radius=0.02, saturation=0.1))
        assert found(picture(target=pale), pale)[0] == [False] * 4
        dark = Square(
            side=0.3, pose=Pose(xyz=(0, 0, 1)), marker=Disc(radius=0.02, saturation=0.6, albedo=0.6)
        )
        assert found(picture(target=dark), dark) == ([True] * 4, pytest.approx(0, abs=0.1))
        dim = Light(direction=(0, 0, 1), brightness=0.1, ambient=0.1)
        # 255 .6 .2 (1 - .4) = 18 grey levels of chroma
        assert found(picture(target=dark, light=dim), dark)[0] == [False] * 4


@pytest.mark.study
def test_the_more_clutter_the_rarer_an_answer_and_none_is_wrong():
    """In a box behind the target, 1.4 m x 1 m: of 40 pictures all markers are found in 40, 37 and
    27 with 20, 40 and 80 objects.
    """
    answers = []
    for count in (0, 20, 40, 80):
        box = Clutter(
            pose=Pose(xyz=(0, 0, 1.3), rpy_deg=(180, 0, 0)), size_m=(1.4, 1.0, 0.3), count=count
        )
        drawn = [
            replace(box, placed=box.draw(np.random.default_rng(seed), HUES)) for seed in range(40)
        ]
        results = [found(picture(clutter=clutter)) for clutter in drawn]
        assert max(error for _, error in results) < 0.5
        answers.append(sum(all(seen_) for seen_, _ in results))
    assert answers[:2] == [40, 40] and 40 > answers[2] > answers[3] > 20


def test_the_share_of_a_decoy_is_refused_beyond_one():
    with pytest.raises(ParameterError, match="saturation"):
        Decoy(xyz=(0, 0, 1), saturation=1.5)
