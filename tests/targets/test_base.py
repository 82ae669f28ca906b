"""What every target answers: its places, its stripes, where it leads on the floor, its board, what
moves it.
"""

import numpy as np
import pytest

from vstestbed.core.geometry import Pose
from vstestbed.core.planar import pose_on_ground
from vstestbed.targets import GroundLines, Points, Square
from vstestbed.targets.markers import Disc
from vstestbed.targets.motion import Carried, Held, Line, Still
from vstestbed.targets.route import CircularRoute, Straight

SQUARE = Square(pose=Pose(), side=0.2, marker=Disc(radius=0.02))
POINTS = Points(pose=Pose(), at=((0, 0, 0), (0.3, 0, 0), (0, 0.4, 0.1)))
LINES = GroundLines(
    route=CircularRoute(radius_m=2.0),
    offsets_m=(0.25, -0.25),
    pose=Pose(xyz=(1, 2, 0), rpy_deg=(0, 0, 90)),
)


@pytest.mark.parametrize("target", [SQUARE, POINTS])
def test_markers_are_at_their_places_and_paint_nothing(target):
    np.testing.assert_array_equal(target.places, target.points)
    assert target.stripes == () and target.painted_route is None
    assert target.floor_path.shape == (0, 2)


def test_lines_have_no_marker_with_a_place_but_edges():
    assert LINES.places.shape == (0, 3) and LINES.painted_route is LINES.route
    assert len(LINES.stripes) == 2
    for offset, edges in zip(LINES.offsets_m, LINES.stripes, strict=True):
        # Round to the left about (0, 2) in the target frame: what is to the left of the way is
        # nearer to the centre.
        radii = [np.linalg.norm(edge - [0, 2.0], axis=1) for edge in edges]
        for side, r in zip((1, -1), radii, strict=True):
            np.testing.assert_allclose(
                r, 2.0 - offset - side * LINES.marker.width_m / 2, atol=1e-12
            )


def test_where_a_target_leads_on_the_floor_is_in_the_world():
    # turned and put at (1, 2)
    np.testing.assert_allclose(
        np.linalg.norm(LINES.floor_path - [1.0 - 2.0, 2.0], axis=1), 2.0, atol=1e-12
    )
    carried = Square(
        side=0.2, motion=Carried(route=Straight(length_m=5)), pose=Pose(xyz=(0.3, 0, 0.5))
    )
    np.testing.assert_allclose(carried.floor_path[[0, -1]], [[0, 0], [5, 0]], atol=1e-12)
    # every centimetre
    assert np.linalg.norm(np.diff(carried.floor_path, axis=0), axis=1).max() == pytest.approx(
        0.01, rel=0.05
    )


def test_only_a_square_has_a_board_and_with_it_a_front():
    # one and a half marker radii beyond the markers' edges
    assert SQUARE.board_half_m == pytest.approx((0.15, 0.15))
    assert SQUARE.one_sided
    for target in (POINTS, LINES):
        assert target.board_half_m is None and not target.one_sided


def test_what_moves_it():
    for motion, moves, on_gripper in (
        (Still(), False, False),
        (Line(velocity_mps=(0.1, 0, 0)), True, False),
        (Held(), True, True),
        (Carried(route=CircularRoute(radius_m=2)), True, False),
    ):
        target = Square(pose=Pose(), side=0.2, motion=motion)
        assert (target.moves, target.on_gripper) == (moves, on_gripper)
        assert (target.carrier is motion) is isinstance(motion, Carried)


def test_it_starts_where_its_motion_puts_it():
    pose = Pose(xyz=(0.3, 0.1, 0.5), rpy_deg=(0, 90, 0))
    for motion in (Still(), Line(velocity_mps=(0.1, 0, 0)), Held()):
        np.testing.assert_allclose(
            Square(side=0.2, pose=pose, motion=motion).T_world_start, pose.T, atol=1e-12
        )
    carried = Square(
        side=0.2, pose=pose, motion=Carried(route=CircularRoute(radius_m=2), from_m=np.pi)
    )
    # samples
    np.testing.assert_allclose(
        carried.T_world_start, pose_on_ground(np.array([2.0, 2.0, np.pi / 2])) @ pose.T, atol=1e-4
    )
