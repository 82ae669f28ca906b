"""What no vehicle on a floor could do, or know, is refused with what would work."""

import pytest

import vstestbed as vs
from vstestbed.core.errors import ParameterError, ScenarioError

ROUTE = "target.motion.route"


def circle(radius):
    return {"kind": "circle", "radius_m": radius}


@pytest.mark.parametrize(
    ("name", "settings", "words"),
    [
        # 1 m / tan(1 rad) = .642 m
        ("car_pursuit", {ROUTE: circle(0.6)}, "target.motion.route: has a bend of 0.6 m, and the car that carries the target"),
        ("car_pursuit", {ROUTE: circle(-0.6)}, "than 0.642 m; make it wider, or use by: omni"),
        ("quadrotor_land", {ROUTE: circle(0.5)}, "turns no tighter than 0.642 m"),
        ("car_pursuit", {"target.motion.speed_mps": 1.2}, "must be at most 1 m/s, the top speed of the car that carries the target"),
        # Its bumper ends .188 m behind its origin, the follower's 1.208 m before its own, the target sits .25 m behind its origin.
        ("car_pursuit", {"goal.gap_m": 1.1}, "goal.gap_m: must be over 1.146 m: there the front of robot car, 1.208 m before its origin"),
        ("car_pursuit", {"target.motion.by": "omni", "goal.gap_m": 1.1}, "must be over 1.166 m"),
        ("car_pbvs", {"camera.mount.xyz": [0.2, 0.1, -0.1]}, "camera.mount.xyz: must have z > 0: the vehicle's frame lies on the floor"),
        ("omni_ibvs", {"camera.mount.xyz": [0.2, 0.1, 0]}, "the camera would be under it"),
        ("car_line", {"target.route": circle(0.6)}, "target.route: has a bend of 0.6 m where the vehicle shall drive, which turns"),
        ("car_line", {"target.route": circle(2), "goal.offset_m": 1.5}, "has a bend of 0.5 m where the vehicle shall drive"),
        ("car_line", {"law.cruise_mps": 1.5}, "law.cruise_mps: must be at most 1 m/s, which the limits of robot and law allow, got 1.5"),
        ("omni_line", {"law.limits.speed_mps": 0.5}, "law.cruise_mps: must be at most 0.5 m/s"),
        ("car_pbvs", {"law.rest_m": 0.05}, "law.rest_m: must be under stop.converged.position_m = 0.05 m"),
        # One point, or one above the other, beside the origin to which the gap is measured
        ("car_pursuit", {"target.at": [[0, 0.3, 0]]}, "target: has its points at one place of the floor plan"),
        ("car_pursuit", {"target.at": [[0.1, 0, 0], [0.1, 0, 0.5]]}, "put the place into target.pose, or add a point beside it"),
        ("car_pursuit", {"target.at": [[0, 0, 0.2]]}, "target: has its points at the camera's own height"),
        ("car_pursuit", {"law.depth": "pnp"}, "law pursuit needs 3 or more for this robot's motions; with law.depth floor 1 will do"),
        ("car_pbvs", {"target.at": [[4, 10, 3], [9, 9, 2]]}, "needs 3 or more for this robot's motions; with law.depth floor 2"),
        (
            "car_pbvs",
            {"target.at": [[4, 10, 3], [5, 10, 3], [6, 10, 3]]},
            "all markers lie on one line, which leaves the pose open; use",
        ),
        ("omni_ibvs", {"law.depth": "pnp"}, "which leaves the pose open; use floor, goal or estimate"),
        ("omni_via_points", {"goal.views": [{"view_from": {"x": -2}}]}, "goal.views: must be a list of 2 or more views; one alone"),
        ("omni_via_points", {"goal.views": [{"view_from": {"x": -2}}, {"view_from": {"z": 1}}]}, "goal.views.1.view_from.z: unknown field"),
    ],
)
def test_refused(name, settings, words):
    with pytest.raises((ParameterError, ScenarioError)) as told:
        vs.load(name, settings)
    assert words in str(told.value)


@pytest.mark.parametrize(
    ("name", "settings"),
    [
        ("car_pursuit", {ROUTE: circle(0.65)}),
        ("car_pursuit", {ROUTE: circle(0.3), "target.motion.by": "omni"}),
        ("car_pursuit", {"goal.gap_m": 1.2}),
        ("car_pursuit", {"target.motion": "still", "target.pose.xyz": [3, 0, 0.6], "goal.gap_m": 0.5}),  # a sign, which has no body
        ("car_pursuit", {"target.at": [[0, 0, 0.5]]}),
        ("car_line", {"target.route": circle(0.5), "goal.offset_m": -0.3}),  # outside the bend
        ("omni_line", {"target.route": circle(0.5)}),
        ("car_pbvs", {"law.rest_m": 0.04}),
    ],
)
def test_what_would_work_does(name, settings):
    vs.load(name, settings)
