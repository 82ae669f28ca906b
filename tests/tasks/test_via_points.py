"""Views in turn: when the next one counts, and how far it is to the last."""

import numpy as np
import pytest

import vstestbed as vs
from vstestbed.core.errors import ParameterError, ScenarioError
from vstestbed.core.geometry import inverse, quaternion_wxyz
from vstestbed.tasks.frame import ImageError


def test_a_view_is_passed_only_with_all_that_counts_in_sight():
    """An error over one marker of three says little: what the end asks for, all seen, a via point asks for too."""
    scenario = vs.load("omni_via_points")
    task = scenario.goal
    memory = task.begin(scenario.setup, scenario.goal_views)
    for error in (ImageError(False, False, 0.1), ImageError(False, True, 3.1)):
        memory, begun = task.passed(memory, error)
        assert begun is None and memory.view == 0
    memory, begun = task.passed(memory, ImageError(False, True, 2.9))
    assert memory.view == 1 and begun is scenario.goal_views[1]  # the law begins anew with it
    assert task.reference(memory, None)[1] is scenario.goal_views[1]


def test_at_the_last_view_it_stays():
    scenario = vs.load("omni_via_points")
    memory = scenario.goal.begin(scenario.setup, scenario.goal_views)
    for _ in scenario.goal_views:
        memory, begun = scenario.goal.passed(memory, ImageError(False, True, 0.0))
    assert memory.view == len(scenario.goal_views) - 1 and begun is None


def test_nothing_in_sight_passes_no_view():
    scenario = vs.load("omni_via_points")
    memory = scenario.goal.begin(scenario.setup, scenario.goal_views)
    assert scenario.goal.passed(memory, ImageError(True, False, np.nan)) == (memory, None)


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
    log |= {f"tgt_q{a}": quaternion_wxyz(T_target[None, :3, :3])[:, i] for i, a in enumerate("wxyz")}
    log |= {f"cam_{a}": np.array([T_camera[i, 3] + d]) for i, (a, d) in enumerate(zip("xyz", (3.0, 4.0, 0.0), strict=True))}
    assert scenario.goal.distance_to_go_m(log, scenario.goal_poses) == pytest.approx(5.0)


@pytest.mark.parametrize(
    ("views", "words"),
    [
        ([{"view_from": {"x": -2}}], "goal.views: must be a list of 2 or more views; one alone"),
        ([{"view_from": {"x": -2}}, {"view_from": {"z": 1}}], "goal.views.1.view_from.z: unknown field"),
    ],
)
def test_views_that_are_none_are_refused(views, words):
    with pytest.raises((ParameterError, ScenarioError)) as told:
        vs.load("omni_via_points", {"goal.views": views})
    assert words in str(told.value)
