"""A vehicle's facts: the ideal bicycle's way, distances from it, what a camera sees of a plane."""

from __future__ import annotations

import numpy as np
import pytest

import vstestbed as vs
from vstestbed.camera import Perspective, SphericalCamera
from vstestbed.core.geometry import Array
from vstestbed.report import Setting
from vstestbed.report.run.tracks import ideal_bicycle_path, largest_deviation, visible_region

AHEAD = np.array([[0, 0, 1.0, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
"""T_world_camera of a camera that looks along x, upright, 0 m up."""
UP = np.array([[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 1], [0, 0, 0, 1]])
"""One that looks straight up from 1 m."""


def test_distances_are_to_the_line_between_the_points():
    line = np.array([[0, 0], [10.0, 0], [10, 10]])
    assert largest_deviation(np.array([[5, 0.2], [9.9, 0.1]]), line) == pytest.approx(0.2)
    # beyond its end: to the end
    assert largest_deviation(np.array([[-3, 4.0]]), line) == pytest.approx(5)
    assert largest_deviation(line, line) == 0


def area(seen: tuple[Array, Array, Array], middle: tuple[float, float]) -> float:
    """Area [m^2] of what is seen, by the rings and directions of the grid round its middle."""
    x, y, inside = seen
    r = np.hypot(x - middle[0], y - middle[1])[:, 0]
    return float((inside[:, :-1].mean(axis=1) * 2 * np.pi * r).sum() * (r[1] - r[0]))


def test_a_camera_that_looks_ahead_sees_a_wedge_at_its_own_height():
    camera = Perspective(fovy_deg=64, width=640, height=480)
    x, y, inside = visible_region(camera, AHEAD, 0.0, 3.0)
    bearing = np.arctan2(y, x)
    half = np.arctan(320 / camera.f)
    # Half a pixel is .1 degrees, a step between directions .7.
    assert (
        inside[np.abs(bearing) < half - 0.02].all()
        and not inside[np.abs(bearing) > half + 0.02].any()
    )


def test_a_camera_that_looks_up_sees_a_rectangle_of_the_plane_above():
    camera = Perspective(fovy_deg=64, width=640, height=480)
    seen = visible_region(camera, UP, 3.0, 5.0)
    width, height = 2 * 640 / camera.f, 2 * 480 / camera.f  # in a plane 2 m before it
    assert area(seen, (0, 0)) == pytest.approx(width * height, rel=0.03)  # the grid's step is 4 cm
    assert not visible_region(camera, UP, 0.5, 5.0)[2].any()  # a plane behind it


def test_a_camera_that_sees_everything_sees_all_of_a_plane():
    assert visible_region(SphericalCamera(), AHEAD, 1.0, 3.0)[2].all()


def test_only_what_drives_has_a_ride():
    assert not Setting.of(vs.load("arm_ibvs")).planar
    setting = Setting.of(vs.load("omni_via_points"))
    assert (
        setting.planar
        and len(setting.goals) == 4
        and setting.band_m is None
        and setting.expected_path is None
    )
    setting = Setting.of(vs.load("car_pursuit"))
    assert (
        setting.planar
        and setting.band_m == pytest.approx(0.25)
        and setting.settle_s == 8
        and not len(setting.goals)
    )
    # a figure of eight of 14 by 8 m, turned
    assert np.ptp(setting.reference_path, axis=0) == pytest.approx([14, 14], abs=4)


def test_lines_on_the_floor_are_the_route():
    s = vs.load("omni_line", {"target.pose": {"xyz": [1, 2, 0], "rpy_deg": [0, 0, 90]}})
    setting = Setting.of(s)
    assert setting.band_m == 0.05
    start, first = s.target.route.start, setting.reference_path[1] - setting.reference_path[0]
    assert setting.reference_path[0] == pytest.approx([1 - start.y, 2 + start.x])
    assert np.arctan2(*first[::-1]) == pytest.approx(np.pi / 2 + start.heading)
    assert setting.points is None  # what moves along with the camera is no landmark


@pytest.mark.parametrize("name", ["car_pbvs", "car_parking"])
def test_the_ideal_way_leads_from_the_start_to_the_goal(name: str):
    s = vs.load(name)
    ideal, goal = ideal_bicycle_path(s), s.goal_view.place
    assert ideal is not None and goal is not None
    np.testing.assert_array_equal(ideal[0], s.robot.configuration()[:2])
    # within the law's rest_m, by steps of 4 cm and less
    assert np.linalg.norm(ideal[-1] - goal[:2]) < 2 * 0.01
    last = ideal[-1] - ideal[-10]
    facing = np.array([np.cos(goal[2]), np.sin(goal[2])])
    # along the goal's heading: forward, or in reverse
    assert abs(last @ facing) > 0.99 * np.linalg.norm(last)
