"""Views in turn: when the next one counts, and how far it is to the last."""

from dataclasses import replace

import numpy as np
import pytest

import vstestbed as vs
from vstestbed.core.errors import ParameterError, ScenarioError
from vstestbed.core.geometry import inverse, quaternion_wxyz
from vstestbed.features.observation import Observation
from vstestbed.tasks.frame import ImageError


def test_a_view_is_passed_only_with_all_that_counts_in_sight():
    """An error over one marker of three says little: what the end asks for, all seen, a via point
    asks for too.
    """
    scenario = vs.load("omni_via_points")
    task = scenario.goal
    state = task.begin(scenario.setup, scenario.goal_views)
    for error in (ImageError(False, False, 0.1), ImageError(False, True, 3.1)):
        state, begun = task.passed(state, error)
        assert begun is None and state.view == 0
    state, begun = task.passed(state, ImageError(False, True, 2.9))
    assert state.view == 1 and begun is scenario.goal_views[1]  # the law begins anew with it
    assert task.reference(state, None)[1] is scenario.goal_views[1]


def test_at_the_last_view_it_stays():
    scenario = vs.load("omni_via_points")
    state = scenario.goal.begin(scenario.setup, scenario.goal_views)
    for _ in scenario.goal_views:
        state, begun = scenario.goal.passed(state, ImageError(False, True, 0.0))
    assert state.view == len(scenario.goal_views) - 1 and begun is None


def test_nothing_in_sight_passes_no_view():
    scenario = vs.load("omni_via_points")
    state = scenario.goal.begin(scenario.setup, scenario.goal_views)
    assert scenario.goal.passed(state, ImageError(True, False, np.nan)) == (state, None)


def test_each_view_has_its_number_and_its_field():
    scenario = vs.load("omni_via_points")
    assert [view.view for view in scenario.goal_views] == list(range(len(scenario.goal.views)))
    assert scenario.goal.view_fields[1] == "goal.views.1.view_from"


def test_the_distance_to_go_is_to_the_last_of_them():
    """The log's own position error is that of the view that counts."""
    scenario = vs.load("omni_via_points")
    T_target, last = scenario.target.T_world_start, scenario.goal_poses[-1]
    T_camera = T_target @ inverse(last)
    log = {f"tgt_{a}": np.array([T_target[i, 3]]) for i, a in enumerate("xyz")}
    log |= {
        f"tgt_q{a}": quaternion_wxyz(T_target[None, :3, :3])[:, i] for i, a in enumerate("wxyz")
    }
    log |= {
        f"cam_{a}": np.array([T_camera[i, 3] + d])
        for i, (a, d) in enumerate(zip("xyz", (3.0, 4.0, 0.0), strict=True))
    }
    assert scenario.goal.distance_to_go_m(log, scenario.goal_poses) == pytest.approx(5.0)


def test_views_that_are_none_are_refused():
    for views, words in (
        ([{"view_from": {"x": -2}}], "goal.views: must be a list of 2 or more views; one alone"),
        (
            [{"view_from": {"x": -2}}, {"view_from": {"z": 1}}],
            "goal.views.1.view_from.z: is an unknown field",
        ),
    ):
        with pytest.raises((ParameterError, ScenarioError)) as told:
            vs.load("omni_via_points", {"goal.views": views})
        assert words in str(told.value)


@pytest.fixture(scope="module")
def blended():
    """`omni_blended` with the goal that moves, and with one that jumps at 3 px; pixels and wheels
    are exact.
    """
    exact = {"detector": "oracle", "robot.wheels": "planar"}
    moves = vs.run(vs.load("omni_blended", exact))
    jumps = vs.run(
        vs.load("omni_blended", {**exact, "goal.speed_mps": None, "goal.threshold_px": 3.0})
    )
    return moves, jumps


class TestBlended:
    """`speed_mps`: the goal moves from view to view, and the base does not stop at each
    (`omni_blended`).
    """

    SPEED, GAIN = 0.5, 2.0
    VIAS = ((-1.2, -1.0), (0.6, -1.2), (1.3, 0.3))

    def between_views(self, r):
        """Speed of the base [m/s] from the first view passed to the last but one."""
        passed = np.flatnonzero(np.diff(r["view"]))
        speed = np.hypot(np.gradient(r["base_x"], r["t"]), np.gradient(r["base_y"], r["t"]))
        return speed[passed[0] : passed[-1] + 1]

    def test_it_keeps_its_speed_at_the_passages(self, blended):
        moves, jumps = blended
        assert moves.outcome is jumps.outcome is vs.Outcome.converged
        # The corners turn by 71 and 67 degrees, where cos(a/2) = .81 is left; on the way in the
        # base comes from its start.
        assert self.between_views(moves).min() > 0.65 * self.SPEED
        assert self.between_views(jumps).min() < 0.4 * self.SPEED

    def test_it_passes_every_view_within_half_its_lag(self, blended):
        for r in blended:
            off = [np.hypot(r["base_x"] - x, r["base_y"] - y).min() for x, y in self.VIAS]
            assert max(off) < self.SPEED / self.GAIN / 2

    def test_the_command_does_not_jump(self, blended):
        largest = []
        for r in blended:
            command = np.column_stack(
                [r[f"cmd_{axis}"] for axis in ("vx", "vy", "vz", "wx", "wy", "wz")]
            )
            after_start = np.flatnonzero(np.diff(r["view"]))[0] - 2
            largest.append(np.linalg.norm(np.diff(command[after_start:], axis=0), axis=1).max())
        assert largest[0] < 0.06 and largest[1] > 0.6

    def test_the_goal_moves_straight_at_its_speed_and_ends_nothing(self):
        scenario = vs.load("omni_blended")
        task = scenario.goal
        seen = Observation(
            0, *(scenario.goal_views[0].xy[:0] for _ in range(2)), scenario.goal_views[0].depth[:0]
        )
        state = task.begin(scenario.setup, scenario.goal_views)
        state, begun = task.passed(state, ImageError(False, True, 1.0))
        assert begun is None and state.view == 1 and state.moves  # the law goes on

        def place(t):
            nonlocal state
            state, goal = task.reference(state, replace(seen, t=t))
            T = (
                scenario.target.T_world_start
                @ inverse(goal.T_camera_target)
                @ inverse(scenario.camera.mount.T)
            )
            return T[:2, 3], goal

        length = np.hypot(1.8, 0.2)
        for share in (0.0, 0.25, 0.75):
            at, goal = place(7 + share * length / self.SPEED)
            assert at == pytest.approx(
                np.array([-1.2, -1.0]) + share * np.array([1.8, -0.2]), abs=1e-9
            )
            assert goal.moves and goal.view == 1
            # not while it moves
            assert task.passed(state, ImageError(False, True, 0.0)) == (state, None)
        at, goal = place(7 + length / self.SPEED + 1e-6)
        assert goal is scenario.goal_views[1] and not state.moves

    def test_a_leg_that_turns_takes_as_long_as_its_turn(self):
        views = [{"view_from": {"x": 0, "heading_deg": heading}} for heading in (0, 90)]
        scenario = vs.load("omni_blended", {"goal.views": views, "goal.turn_degps": 30.0})
        state, _ = scenario.goal.passed(
            scenario.goal.begin(scenario.setup, scenario.goal_views), ImageError(False, True, 1.0)
        )
        assert scenario.goal._leg_s(state) == pytest.approx(3)
