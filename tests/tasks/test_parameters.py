"""Parameters of tasks and of the stop block:
the ranges that are accepted, and what a task refuses.
"""

from __future__ import annotations

from typing import Any

import pytest

import vstestbed as vs
from vstestbed.core.errors import ParameterError, ScenarioError
from vstestbed.core.geometry import Pose
from vstestbed.tasks import GoalGap, GoalLanding, GoalLine, GoalPath, GoalTrack, GoalView, GoalViews
from vstestbed.tasks.stop import Converged, Stop

VIEWS = (
    GoalView(T_camera_target=Pose(xyz=(0, 0, 1))),
    GoalView(T_camera_target=Pose(xyz=(0, 0, 2))),
)
GIVEN: dict[type, dict[str, Any]] = {
    GoalGap: {"gap_m": 3.0},
    GoalLanding: {"above": Pose(xyz=(0, 0, 1))},
    GoalLine: {},
    GoalPath: {"way": VIEWS},
    GoalTrack: {"T_camera_target": Pose(xyz=(0, 0, 1))},
    GoalViews: {"views": VIEWS},
    Converged: {"error_px": 1.0},
    Stop: {},
}
ABOVE_ZERO = [
    *(
        (GoalLanding, name)
        for name in ("descend_mps", "within_m", "within_deg", "commit_m", "pad_m", "touch_mps")
    ),
    *((GoalPath, name) for name in ("speed_mps", "turn_degps", "band_m")),
    *((kind, "band_m") for kind in (GoalGap, GoalLine, GoalTrack)),
    *((GoalGap, "gap_m"), (GoalViews, "threshold_px")),
    *((Converged, name) for name in ("error_px", "position_m", "rotation_deg")),
    *((Stop, name) for name in ("duration_s", "lost_after_m")),
]
FROM_ZERO = [
    (GoalPath, "lead_s"),
    *((kind, "settle_s") for kind in (GoalPath, GoalGap, GoalLine, GoalTrack)),
]
FROM_ZERO += [(Converged, "hold_s"), *((Stop, name) for name in ("lost_after_s", "rest_after_s"))]


def test_the_least_that_is_accepted():
    for names, least, too_little in ((ABOVE_ZERO, 1e-3, 0.0), (FROM_ZERO, 0.0, -1e-3)):
        for kind, name in names:
            assert getattr(kind(**GIVEN[kind] | {name: least}), name) == least
            with pytest.raises(ParameterError):
                kind(**GIVEN[kind] | {name: too_little})


@pytest.mark.parametrize("kind", [GoalPath, GoalViews])
def test_two_to_a_hundred_views(kind: type):
    name = "way" if kind is GoalPath else "views"
    for n, valid in ((1, False), (2, True), (100, True), (101, False)):
        if valid:
            assert len(getattr(kind(**{name: VIEWS[:1] * n}), name)) == n
        else:
            with pytest.raises(ParameterError):
                kind(**{name: VIEWS[:1] * n})


class TestMarkersThatCount:
    def test_refused(self):
        for markers, words in (
            ([0, 1, 4], "must be numbers of markers, 0 to 3"),
            ([0, 1], "must be 3 or more markers for law ibvs"),
            ([0, 0, 1], "must be 3 or more markers for law ibvs"),
            ([-1, 0, 1], "goal.markers"),
            ([], "goal.markers"),
        ):
            with pytest.raises(ScenarioError, match=words):
                vs.load("arm_ibvs", {"goal.markers": markers})

    def test_accepted(self):
        (view,) = vs.load("arm_ibvs", {"goal.markers": [3, 0, 1]}).goal_views
        assert view.counted is not None and view.counted.tolist() == [True, True, False, True]
        assert vs.load("arm_ibvs").goal_view.counted is None


class TestConverged:
    def test_every_condition_given_must_hold(self):
        both = Converged(error_px=1.0, position_m=0.1, rotation_deg=10.0)
        assert both.near(True, 0.9, 0.09, 0.1)
        assert not both.near(False, 0.9, 0.09, 0.1)
        assert not both.near(True, 1.0, 0.09, 0.1)
        assert not both.near(True, 0.9, 0.1, 0.1)
        assert not both.near(True, 0.9, 0.09, 0.2)  # 11.5 degrees
        assert not both.near(True, float("nan"), 0.09, 0.1)
        assert not both.near(True, 0.9, float("nan"), 0.1)

    def test_by_the_estimate_sight_does_not_matter(self):
        for given, near in (
            ({"position_m": 0.1}, (0.05, 9.0)),
            ({"rotation_deg": 10.0}, (9.0, 0.1)),
        ):
            assert Converged(**given).by_estimate and Converged(**given).near(False, 99.0, *near)
        assert not Converged(rotation_deg=10.0).near(True, 0.0, 0.0, float("nan"))
        assert not Converged().by_estimate

    def test_in_words(self):
        assert Converged().summary == "RMS error under 0.2 px"
        assert Converged(error_px=1, rotation_deg=2).summary == "RMS error under 1 px, under 2 deg"
        assert (
            Converged(position_m=0.05, rotation_deg=4).summary
            == "by its own estimate under 0.05 m, under 4 deg off"
        )


class TestWhatATaskRefuses:
    def test_it_says_what(self):
        for name, settings, words in (
            (
                "car_line",
                {"goal": {"T_camera_target": {"xyz": [0, 0, 2]}}, "law": {"kind": "ibvs"}},
                "needs markers, and lines on the floor have none",
            ),
            (
                "car_pbvs",
                {"target.motion": {"kind": "line", "velocity_mps": [0.1, 0, 0]}},
                "needs a target that stands still",
            ),
            ("car_pbvs", {"law": {"kind": "ibvs"}}, "may not be of kind pose with law ibvs"),
            (
                "car_pbvs",
                {"law.depth": "goal"},
                "may not be goal with law pose_controller, which needs the pose itself",
            ),
            (
                "car_pbvs",
                {"stop.converged": {"error_px": 1}},
                "must have position_m or rotation_deg for a goal of kind pose",
            ),
            (
                "car_pbvs",
                {"stop.converged.position_m": 0.02},
                r"must be under stop\.converged\.position_m = 0\.02 m",
            ),
            (
                "omni_ibvs",
                {"goal": {"above": {"xyz": [0, 0, 1]}}, "law": {"kind": "ibvs"}},
                "is for a craft that flies",
            ),
            (
                "arm_ibvs",
                {"goal": {"view_from": {"x": 0}}},
                "it is for a vehicle; works: T_camera_target",
            ),
            (
                "arm_ibvs",
                {"goal": {"views": [{"view_from": {"x": 0}}, {"view_from": {"x": 1}}]}},
                "goal: may not be views with robot puma560",
            ),
        ):
            with pytest.raises(ScenarioError, match=words):
                vs.load(name, settings)
