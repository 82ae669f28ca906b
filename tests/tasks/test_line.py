"""A line: offset from it, and how far along it a vehicle has come."""

import numpy as np
import pytest

import vstestbed as vs
from vstestbed.core.errors import ParameterError, ScenarioError
from vstestbed.core.planar import pose_on_ground

I4 = np.eye(4)
CIRCLE = {"target.route": {"kind": "circle", "radius_m": 2}, "goal.offset_m": 0.0}
EIGHT = {"target.route": {"kind": "figure_eight", "length_m": 12, "width_m": 5}}


def circle(radius):
    return {"kind": "circle", "radius_m": radius}


def travelled(scenario, places):
    """Distance along its line of a vehicle at these places in turn [m]."""
    _, odometer = scenario.goal.least_speeds(scenario.setup)
    assert odometer is not None
    return [odometer(pose_on_ground(np.array(place)), I4)[0] for place in places][-1]


def round_the_circle(radius, turns, heading):
    """Places on a circle about (0, 2) from its lowest point on, a vehicle `heading` off the way
    round to the left.
    """
    a = 2 * np.pi * np.linspace(0, turns, round(abs(turns) * 400) + 1)
    return np.column_stack([radius * np.sin(a), 2 - radius * np.cos(a), a + heading])


@pytest.mark.parametrize("radius", [2.0, 1.7, 2.3])
def test_it_is_the_vehicles_own_way_beside_the_line_also_round_and_round(radius):
    made = travelled(vs.load("car_line", CIRCLE), round_the_circle(radius, 1.5, 0.0))
    assert made == pytest.approx(3 * np.pi * radius, rel=1e-3)


def test_a_line_has_no_direction_of_its_own():
    """The vehicle that starts against the route's direction goes on when it drives where
    it looks.
    """
    made = travelled(vs.load("car_line", CIRCLE), round_the_circle(2.0, -0.5, np.pi))
    assert made == pytest.approx(2 * np.pi, rel=1e-3)


def test_backwards_and_turned_round_is_the_wrong_way():
    s = vs.load("car_line", CIRCLE)
    # in reverse
    assert travelled(s, round_the_circle(2.0, -0.5, 0.0)) == pytest.approx(-2 * np.pi, rel=1e-3)
    there, back = round_the_circle(2.0, 0.25, 0.0), round_the_circle(2.0, 0.25, np.pi)[::-1]
    # turned round on the line, and home again
    assert travelled(s, [*there, *back]) == pytest.approx(0.0, abs=1e-3)


def test_where_the_line_crosses_itself_it_stays_on_its_branch():
    s = vs.load("omni_line", EIGHT | {"target.offsets_m": [0.0]})
    route = s.target.route
    along = np.linspace(0, route.length, 1500)
    assert travelled(s, route.at(along)[:, :3]) == pytest.approx(route.length, rel=1e-3)


@pytest.mark.parametrize(("radius", "error"), [(2.0, -0.3), (1.7, 0.0), (2.3, -0.6)])
def test_its_error_is_the_offset_to_the_left_minus_the_one_asked_for(radius, error):
    """Round to the left the circle's centre is on the left: on a smaller circle the vehicle is to
    the left of its line.
    """
    s = vs.load("car_line", CIRCLE | {"goal.offset_m": 0.3})
    place = round_the_circle(radius, 0.3, 0.0)[-1]
    # A tenth of a millimetre: the route is sampled every centimetre.
    assert s.goal.error_m(s.setup, pose_on_ground(place), I4, 0.0) == pytest.approx(error, abs=1e-4)


def test_the_vehicle_must_make_most_of_the_speed_that_the_law_orders():
    s = vs.load("car_line", {"law.cruise_mps": 0.6})
    ((speed,), _) = s.goal.least_speeds(s.setup)
    assert speed == ("the vehicle, along its line,", 0.6, pytest.approx(0.48))


def test_a_line_that_cannot_be_driven_is_refused_with_what_would_work():
    for name, settings, words in (
        (
            "car_line",
            {"target.route": circle(0.6)},
            "target.route: has a bend of 0.6 m where the vehicle shall drive, which turns",
        ),
        (
            "car_line",
            {"target.route": circle(2), "goal.offset_m": 1.5},
            "has a bend of 0.5 m where the vehicle shall drive",
        ),
        (
            "car_line",
            {"law.cruise_mps": 1.5},
            (
                "law.cruise_mps: must be at most 1 m/s,"
                " which the limits of robot and law allow, got 1.5"
            ),
        ),
        ("omni_line", {"law.limits.speed_mps": 0.5}, "law.cruise_mps: must be at most 0.5 m/s"),
    ):
        with pytest.raises((ParameterError, ScenarioError)) as told:
            vs.load(name, settings)
        assert words in str(told.value)


def test_a_line_that_can_be_driven_is_taken():
    for name, settings in (
        ("car_line", {"target.route": circle(0.5), "goal.offset_m": -0.3}),  # outside the bend
        ("omni_line", {"target.route": circle(0.5)}),
    ):
        vs.load(name, settings)
