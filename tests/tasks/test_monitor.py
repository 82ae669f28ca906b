"""What all task monitors measure: columns of the log, the robot's own estimate, the error in a
picture turned level.
"""

from dataclasses import replace

import numpy as np
import pytest

import vstestbed as vs
from tests.tasks.frames import CORNERS, GOAL, frame, observed
from vstestbed.camera import Perspective
from vstestbed.core.geometry import Pose, exp
from vstestbed.features.observation import Goal
from vstestbed.robots.base import Supervisor
from vstestbed.tasks.monitor import TaskMonitor, estimated_error, has_held, held_since, level_error
from vstestbed.tasks.stop import Converged, Stop


def test_a_hold_is_measured_from_its_first_frame_and_ends_with_a_break():
    since, found = np.inf, []
    for t, holds in ((0.0, False), (0.04, True), (0.08, True), (0.12, False), (0.16, True)):
        since = held_since(since, holds, t)
        found.append(since)
    assert found == [np.inf, 0.04, 0.04, np.inf, 0.16]
    assert not has_held(np.inf, 0.0, 0.0)


def test_a_hold_does_not_miss_its_frame_by_a_rounding():
    t = start = 0.15
    for _ in range(5):
        t += 0.1
    assert t - start < 0.5 and has_held(start, t, 0.5)


class TestColumns:
    def columns(self, name, stop, views):
        return TaskMonitor(replace(vs.load(name).setup, stop=stop), views, Supervisor()).columns

    def test_each_has_its_reason(self):
        by_estimate = Stop(converged=Converged(position_m=0.05))
        assert self.columns("arm_ibvs", Stop(), 1) == ()
        assert self.columns("arm_ibvs", by_estimate, 2) == (
            "view",
            "est_position_m",
            "est_rotation_rad",
        )
        assert self.columns("quadrotor_hover", Stop(), 1) == ("level_error_px",)

    def test_values_stand_in_the_columns_order(self):
        setup = replace(
            vs.load("quadrotor_hover").setup, stop=Stop(converged=Converged(position_m=0.05))
        )
        monitor = TaskMonitor(setup, 3, Supervisor())
        values = monitor.measure(
            frame(goal=replace(GOAL, view=2), seen=observed(Pose(xyz=(0.3, 0, 1)).T))
        )
        found = dict(zip(monitor.columns, values, strict=True))
        assert found["view"] == 2
        assert (found["est_position_m"], found["est_rotation_rad"]) == (
            pytest.approx(0.3),
            pytest.approx(0.0, abs=1e-7),
        )
        # 0.3 m at 1 m along u, none along v
        assert found["level_error_px"] == pytest.approx(0.3 * GOAL.camera.f / np.sqrt(2))


class TestEstimate:
    def test_a_camera_by_the_targets_pose(self):
        T = GOAL.T_camera_target @ exp(np.array([0.03, 0, 0.04, 0, 0.2, 0]))
        distance, angle = estimated_error(observed(T), GOAL)
        seen = np.linalg.inv(T)[:3, 3] - np.linalg.inv(GOAL.T_camera_target)[:3, 3]
        assert distance == pytest.approx(np.linalg.norm(seen)) and angle == pytest.approx(0.2)

    def test_a_vehicle_by_its_place(self):
        goal = replace(GOAL, place=np.array([1.0, 2.0, 3.1]))
        distance, angle = estimated_error(
            observed(GOAL.T_camera_target, place=np.array([1.3, 2.4, -3.1])), goal
        )
        # across the half turn
        assert distance == pytest.approx(0.5) and angle == pytest.approx(2 * np.pi - 6.2)

    def test_who_cannot_tell_has_none(self):
        assert np.isnan(
            estimated_error(replace(observed(GOAL.T_camera_target), T_camera_target=None), GOAL)
        ).all()


class TestLevelError:
    def test_it_is_that_of_the_features_which_the_law_is_given(self):
        """The picture (uv) shows a craft that leans; xy are of the level camera."""
        seen = replace(observed(GOAL.T_camera_target), uv=GOAL.uv + 40.0)
        assert level_error(seen, GOAL) == pytest.approx(0.0, abs=1e-9)

    def test_of_a_camera_without_an_image_plane_by_rays(self):
        camera = Perspective()
        goal, ahead = (Goal.from_view(camera, CORNERS, Pose(xyz=(x, 0, 1)).T) for x in (0.0, 0.1))
        seen = replace(observed(goal.T_camera_target), ray=ahead.ray)
        assert level_error(seen, goal) == pytest.approx(0.1 * camera.f / np.sqrt(2))

    def test_only_what_is_seen_counts(self):
        seen = observed(GOAL.T_camera_target)
        xy = seen.xy.copy()
        xy[1:] = np.nan
        assert level_error(replace(seen, xy=xy), GOAL) == pytest.approx(0.0, abs=1e-9)
        assert np.isnan(level_error(replace(seen, xy=np.full_like(xy, np.nan)), GOAL))
