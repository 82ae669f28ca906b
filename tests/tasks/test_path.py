"""Views that move along a path: timing, velocity, distance from it."""

import numpy as np
import pytest

import vstestbed as vs
from vstestbed.core.geometry import Pose, inverse
from vstestbed.features.observation import Observation
from vstestbed.tasks import GoalPath, GoalView

WAY = (
    GoalView(T_camera_target=Pose(xyz=(1, 0, 2))),
    GoalView(T_camera_target=Pose(xyz=(-1, 0, 2))),
    GoalView(T_camera_target=Pose(xyz=(-1, 1, 2), rpy_deg=(0, 0, 60))),
)


class TestTrajectory:
    path = GoalPath(way=WAY, speed_mps=0.5, settle_s=3.0)

    def places(self, t):
        return np.array([inverse(self.path.at(x)[0])[:3, 3] for x in t])

    def test_it_waits_goes_and_stays(self):
        first, last = inverse(WAY[0].T_camera_target.T), inverse(WAY[2].T_camera_target.T)
        np.testing.assert_allclose(self.places([0.0, 3.0]), [first[:3, 3]] * 2)
        np.testing.assert_allclose(
            self.places([self.path.end_s, 99.0]), [last[:3, 3]] * 2, atol=1e-12
        )
        # The first leg: 2 m at .5 m/s at most, 15/8 of the mean.
        assert self.path.at(3.0 + 7.49)[1] == 1 and self.path.at(3.0 + 7.51)[1] == 2

    def test_it_never_exceeds_its_speed_and_stays_on_the_line(self):
        t = np.arange(3.0, 10.5, 0.01)
        x = self.places(t)
        assert np.linalg.norm(np.diff(x, axis=0), axis=1).max() / 0.01 == pytest.approx(
            0.5, rel=1e-3
        )
        assert max(self.path.off(inverse(self.path.at(s)[0]), s) for s in t) < 1e-12

    def test_off_is_the_distance_from_the_path(self):
        T = inverse(self.path.at(6.75)[0])  # halfway along the first leg
        T[:3, 3] += [0.5, 0.2, 0.1]
        assert self.path.off(T, 6.75) == pytest.approx(np.hypot(0.2, 0.1))  # a second ahead
        T[:3, 3] = inverse(WAY[0].T_camera_target.T)[:3, 3] - [0.3, 0, 0]  # before the beginning
        assert self.path.off(T, 3.0) == pytest.approx(0.3)

    def test_who_waits_on_the_path_is_off_it(self):
        first, last = (inverse(WAY[i].T_camera_target.T) for i in (0, 2))
        assert self.path.off(first, 0.0) == self.path.off(first, 5.0) == 0
        assert self.path.off(first, 10.0) == pytest.approx(
            np.linalg.norm(self.places([8.0])[0] - first[:3, 3])
        )
        assert self.path.off(last, self.path.end_s + 30) == pytest.approx(0, abs=1e-12)
        assert self.path.off(first, self.path.end_s + 30) == pytest.approx(
            np.linalg.norm(last[:3, 3] - first[:3, 3])
        )

    def test_its_twist_is_its_poses_derivative(self):
        path = GoalPath(way=WAY, speed_mps=0.5, settle_s=3.0, lead_s=0.0)
        for t in (5.0, 9.0, 12.0, 13.5):
            h = 1e-4
            before, now, after = (inverse(path.at(t + d)[0]) for d in (-h, 0, h))
            v = now[:3, :3].T @ (after[:3, 3] - before[:3, 3]) / (2 * h)
            turn = now[:3, :3].T @ (after[:3, :3] - before[:3, :3]) / (2 * h)
            w = np.array([turn[2, 1], turn[0, 2], turn[1, 0]])
            np.testing.assert_allclose(path.twist_at(t), [*v, *w], atol=1e-5)

    def test_a_leg_of_a_turn_takes_the_time_of_the_turn(self):
        """90 degrees at 15 deg/s at most, 15/8 of the mean: 11.25 s, where a way of 0.2 m at 0.5
        m/s takes 0.75 s.
        """
        turn = (
            GoalView(T_camera_target=Pose(xyz=(0, 0, 2))),
            GoalView(T_camera_target=Pose(xyz=(0.2, 0, 2), rpy_deg=(0, 0, 90))),
        )
        path = GoalPath(way=turn, speed_mps=0.5, turn_degps=15.0, settle_s=3.0)
        assert path.end_s == pytest.approx(3.0 + 15 / 8 * 90 / 15)
        rates = [np.linalg.norm(path.twist_at(t)[3:]) for t in np.arange(3.0, path.end_s, 0.01)]
        assert max(rates) == pytest.approx(np.radians(15), rel=1e-3)


class TestReference:
    def test_the_law_is_told_the_view_of_this_time_with_its_velocity(self):
        scenario = vs.load("quadrotor_path")
        task, nothing = scenario.goal, np.zeros((4, 2))
        state = task.begin(scenario.setup, scenario.goal_views)
        for t in (0.0, task.settle_s + 1.0, task.end_s + 1.0):
            state, goal = task.reference(state, Observation(t, nothing, nothing, np.ones(4)))
            T, view = task.at(t)
            np.testing.assert_array_equal(goal.T_camera_target, T)
            np.testing.assert_array_equal(goal.twist, task.twist_at(t))
            assert goal.view == view
        assert view == len(task.way) - 1

    def test_it_has_the_errors_of_the_calibration_that_the_views_have(self):
        scenario = vs.load("quadrotor_path", {"calibration": {"depth_factor": 1.2}})
        nothing = np.zeros((4, 2))
        state = scenario.goal.begin(scenario.setup, scenario.goal_views)
        goal = scenario.goal.reference(state, Observation(0.0, nothing, nothing, np.ones(4)))[1]
        np.testing.assert_allclose(goal.depth, scenario.goal_views[0].depth)
        np.testing.assert_allclose(goal.range, scenario.goal_views[0].range)

    def test_its_error_is_the_cameras_distance_from_the_path(self):
        scenario = vs.load("quadrotor_path")
        task, setup, T_target = scenario.goal, scenario.setup, scenario.target.T_world_start
        T_camera = T_target @ inverse(task.at(0.0)[0])
        T_camera[:3, 3] += T_target[:3, 2] * 0.25  # square to the first leg, which is level
        assert task.error_m(
            setup, T_camera @ inverse(setup.camera.mount.T), T_target, 0.0
        ) == pytest.approx(0.25)
