"""The field at the picture's border: how strong, which way, and for which laws."""

from __future__ import annotations

import numpy as np
import pytest

from tests.laws.flight import book_camera
from vstestbed.features import Point
from vstestbed.geometry import Array, Pose, transform
from vstestbed.laws import IBVS, Hybrid, Law
from vstestbed.laws.base import ConstantGain
from vstestbed.laws.visibility import Visibility
from vstestbed.observation import Goal, Observation
from vstestbed.target import Square
from vstestbed.vision.homography import relative_view

CAMERA, POINTS = book_camera(), Square(side=0.5, pose=Pose()).points
GOAL = Goal.from_view(CAMERA, POINTS, Pose(xyz=(0, 0, 1)).T)
FIELD = Visibility(margin_px=100, strength_pxps=20)
MARKER_0_NEAR_LEFT = Pose(xyz=(-0.33, 0, 1)).T  # the left markers at u = 499.5 - .58 * 800 = 35.5


def view(T: Array) -> Observation:
    p = transform(T, POINTS)
    uv = CAMERA.project(p)
    xy = CAMERA.normalise(uv)
    return Observation(t=0, uv=uv, xy=xy, depth=p[:, 2], T_camera_target=T, relative=relative_view(GOAL.xy, xy, np.array([0, 0, 1.0])))


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
    assert sizes[-1] == pytest.approx(20 * (1 / 0.2 - 1) / 0.2**2, rel=1e-6)  # within a fifth of the margin it grows no more


def test_all_markers_at_the_border_make_the_camera_back_off():
    near = Pose(xyz=(0, 0, 0.42)).T
    u = FIELD.push(view(near), GOAL, np.eye(6))
    assert u[2] < 0
    assert np.abs(u[[0, 1, 3, 4, 5]]).max() < 1e-6


@pytest.mark.parametrize("law", [IBVS, Hybrid], ids=lambda law: law.__name__)
def test_laws_add_it_to_their_own_motion(law: type[IBVS | Hybrid]):
    def twist(made: Law) -> Array:  # type: ignore[type-arg]
        return made.step(made.init(GOAL), view(MARKER_0_NEAR_LEFT), GOAL, np.eye(6))[1].twist

    gain = ConstantGain(value=0.5)
    push = FIELD.push(view(MARKER_0_NEAR_LEFT), GOAL, np.eye(6))
    assert twist(law(gain=gain, visibility=FIELD)) == pytest.approx(twist(law(gain=gain)) + push, abs=1e-12)
