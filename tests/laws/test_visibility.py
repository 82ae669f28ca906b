"""The field at the picture's border: how strong, which way, and for which laws."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import vstestbed as vs
from tests.laws.flight import book_camera
from vstestbed.camera import Catadioptric, Fisheye, SphericalCamera
from vstestbed.camera.base import pixel_interaction
from vstestbed.core.errors import ParameterError, ScenarioError
from vstestbed.core.geometry import Array, Pose, transform
from vstestbed.features import Point
from vstestbed.features.observation import Goal, Observation
from vstestbed.laws import IBVS, Hybrid, Law, Partitioned
from vstestbed.laws.base import ConstantGain, inputs_of
from vstestbed.laws.points import Visibility
from vstestbed.targets.base import Square
from vstestbed.vision.homography import relative_view

CAMERA, POINTS = book_camera(), Square(side=0.5, pose=Pose()).points
GOAL = Goal.from_view(CAMERA, POINTS, Pose(xyz=(0, 0, 1)).T)
FIELD = Visibility(margin_px=100, strength_pxps=20)
MARKER_0_NEAR_LEFT = Pose(xyz=(-0.33, 0, 1)).T  # the left markers at u = 499.5 - .58 * 800 = 35.5


def view(T: Array) -> Observation:
    p = transform(T, POINTS)
    uv = CAMERA.project(p)
    xy = CAMERA.normalise(uv)
    return Observation(
        t=0,
        uv=uv,
        xy=xy,
        depth=p[:, 2],
        T_camera_target=T,
        relative=relative_view(GOAL.xy, xy, np.array([0, 0, 1.0])),
    )


def flow_px(T: Array, u: Array) -> Array:
    """Speeds of the marker pixels (4, 2) under a camera twist [px/s]."""
    o = view(T)
    return 800 * (Point().interaction(o.xy, o.depth) @ u).reshape(4, 2)


def test_nothing_in_the_middle_of_the_picture():
    assert not FIELD.push(view(GOAL.T_camera_target), GOAL, np.eye(6)).any()


def test_markers_at_the_left_are_pushed_right_at_the_fields_speed():
    u = FIELD.push(view(MARKER_0_NEAR_LEFT), GOAL, np.eye(6))
    x = (35.5 + 0.5) / 100
    expected = 20 * (1 / x - 1) / x**2
    flow = flow_px(MARKER_0_NEAR_LEFT, u)
    assert flow[[0, 3], 0] == pytest.approx([expected] * 2, rel=1e-6)
    assert flow[[0, 3], 1] == pytest.approx([0, 0], abs=1e-6)


def test_the_nearer_the_stronger_up_to_a_bound():
    def strength(x: float) -> float:
        u = FIELD.push(view(Pose(xyz=(x, 0, 1)).T), GOAL, np.eye(6))
        return float(flow_px(Pose(xyz=(x, 0, 1)).T, u)[0, 0])

    sizes = [strength(x) for x in (-0.26, -0.30, -0.33, -0.36)]
    assert sizes == sorted(sizes)
    # within a fifth of the margin it grows no more
    assert sizes[-1] == pytest.approx(20 * (1 / 0.2 - 1) / 0.2**2, rel=1e-6)


def test_all_markers_at_the_border_make_the_camera_back_off():
    near = Pose(xyz=(0, 0, 0.42)).T
    u = FIELD.push(view(near), GOAL, np.eye(6))
    assert u[2] < 0
    assert np.abs(u[[0, 1, 3, 4, 5]]).max() < 1e-6


@pytest.mark.parametrize("law", [IBVS, Hybrid], ids=lambda law: law.__name__)
def test_laws_add_it_to_their_own_motion(law: type[IBVS | Hybrid]):
    def twist(made: Law) -> Array:
        return made.step(made.init(GOAL), view(MARKER_0_NEAR_LEFT), GOAL, np.eye(6))[1].twist

    gain = ConstantGain(value=0.5)
    push = FIELD.push(view(MARKER_0_NEAR_LEFT), GOAL, np.eye(6))
    assert twist(law(gain=gain, visibility=FIELD)) == pytest.approx(
        twist(law(gain=gain)) + push, abs=1e-12
    )


class TestOtherLenses:
    EYE = Fisheye(width=640, height=640, fov_deg=180)
    """3.56 px to the degree, its circle 320 px in radius, a corner of the picture 453 px from the
    middle.
    """

    @pytest.mark.parametrize("degrees", [(75, 45), (80, 225), (50, 10)], ids=str)
    def test_the_circle_of_a_wide_lens_is_its_border(self, degrees: tuple[float, float]):
        theta, phi = np.radians(degrees)
        p = 1.5 * np.array(
            [[np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)]]
        )
        uv = self.EYE.project(p)
        goal = Goal.from_view(self.EYE, POINTS, Pose(xyz=(0, 0, 1)).T)
        u = Visibility(margin_px=60).push(
            Observation(0, uv, self.EYE.normalise(uv), p[:, 2]), goal, np.eye(6)
        )
        flow = (pixel_interaction(self.EYE, p) @ u)[0]
        off = (320 * (1 - degrees[0] / 90)) / 60
        inwards = -np.array([np.cos(phi), np.sin(phi)])
        assert flow == pytest.approx(
            inwards * (20 * (1 / off - 1) / off**2 if off < 1 else 0), abs=1e-5
        )

    def test_what_is_beside_the_camera_is_pushed_too(self):
        """At 100 degrees from the axis there are no normalised coordinates; a law of rays still
        keeps it in.
        """
        eye, theta = Fisheye(width=640, height=640, fov_deg=210), np.radians(100)
        ray = np.array([[np.sin(theta), 0, np.cos(theta)]])
        uv = eye.project(ray)
        goal = Goal.from_view(eye, POINTS, Pose(xyz=(0, 0, 1)).T)
        seen = Observation(0, uv, eye.normalise(uv), ray[:, 2] * 2, ray=ray, range=np.array([2.0]))
        flow = (
            pixel_interaction(eye, 2 * ray) @ Visibility(margin_px=60).push(seen, goal, np.eye(6))
        )[0]
        assert flow[0] < -1 and abs(flow[1]) < 1e-6

    def test_a_mirrors_blind_middle_is_a_border(self):
        mirror = Catadioptric(width=640, height=640, blind_deg=20)
        inner = mirror.f * mirror.ring[0]
        distance, inwards = mirror.borders(mirror.centre + np.array([[inner + 5, 0.0]]))
        assert distance[0, -1] == pytest.approx(5)
        assert inwards[0, -1] == pytest.approx([1, 0])

    def test_a_camera_without_a_border_is_refused(self):
        goal = Goal.from_view(SphericalCamera(), POINTS, Pose(xyz=(0, 0, 1)).T)
        with pytest.raises(
            ParameterError,
            match=r"^law.visibility.margin_px must be 0 with a camera that sees all round",
        ):
            FIELD.check(goal, 0.02)
        Visibility(margin_px=0).check(goal, 0.02)


def test_pixel_interaction_of_a_pinhole_is_that_of_points():
    o = view(MARKER_0_NEAR_LEFT)
    p = transform(MARKER_0_NEAR_LEFT, POINTS)
    assert pixel_interaction(CAMERA, p).reshape(8, 6) == pytest.approx(
        800 * Point().interaction(o.xy, o.depth), abs=1e-5
    )


class TestGoal:
    """The markers' goal is 300 px from the border of 1000, their radius of .02 m there 16 px: their
    edges are at 284 px.
    """

    def test_a_goal_within_the_margin_is_refused(self):
        Visibility(margin_px=283.9).check(GOAL, 0.02)
        words = (
            r"^law.visibility.margin_px reaches marker 0 of the goal view,"
            r" whose edge is 284 px from the border"
        )
        with pytest.raises(ParameterError, match=words):
            Visibility(margin_px=284).check(GOAL, 0.02)
        Visibility(margin_px=299).check(GOAL, 1e-6)

    def test_only_markers_that_count_are_asked(self):
        aside = Goal.from_view(CAMERA, POINTS, Pose(xyz=(0.3, 0, 1)).T)  # markers 1 and 2 at 60 px
        with pytest.raises(ParameterError, match="reaches marker 1"):
            Visibility(margin_px=100).check(aside, 0.02)
        Visibility(margin_px=100).check(
            replace(aside, counted=np.array([True, False, False, True])), 0.02
        )

    @pytest.mark.parametrize("law", ["ibvs", "partitioned", "hybrid"])
    def test_a_scenario_is_refused(self, law: str):
        # radius .03 m
        with pytest.raises(
            ScenarioError, match=r"law.visibility.margin_px: reaches marker 0 .* 276 px"
        ):
            vs.load("ibvs_book", {"law": {"kind": law, "visibility": {"margin_px": 280}}})

    def test_every_view_of_several_is_asked(self):
        """f = 384 px: the edges of the first view's outer square are 240 - 186 - 12 px from the
        border, in the last it does not count.
        """
        vs.load("arm_docking", {"law.visibility": {"margin_px": 41}})
        with pytest.raises(
            ScenarioError, match=r"reaches marker . of the goal view, whose edge is 4\d"
        ):
            vs.load("arm_docking", {"law.visibility": {"margin_px": 44}})


class TestEdge:
    """A disc is lost when its edge passes the border: the field counts from there."""

    def test_the_radius_takes_from_the_distance(self):
        o = view(MARKER_0_NEAR_LEFT)
        radius = np.array([12.0, 0.0, 0.0, 0.0])
        flow = flow_px(
            MARKER_0_NEAR_LEFT, FIELD.push(replace(o, radius_px=radius), GOAL, np.eye(6))
        )
        for i, off in ((0, (36 - 12) / 100), (3, 36 / 100)):
            assert flow[i, 0] == pytest.approx(20 * (1 / off - 1) / off**2, rel=1e-6)

    def test_a_radius_alone_brings_a_marker_into_the_margin(self):
        o = view(Pose(xyz=(-0.24, 0, 1)).T)  # the left markers' centres at 108 px
        assert not FIELD.push(o, GOAL, np.eye(6)).any()
        assert FIELD.push(replace(o, radius_px=np.full(4, 16.0)), GOAL, np.eye(6)).any()

    @pytest.mark.parametrize("law", [IBVS, Partitioned, Hybrid], ids=lambda law: law.__name__)
    def test_laws_ask_for_the_radius_only_with_a_margin(
        self, law: type[IBVS | Partitioned | Hybrid]
    ):
        assert inputs_of(law(visibility=FIELD)) == (*law().inputs, "radius_px")
        assert "radius_px" not in inputs_of(law())
