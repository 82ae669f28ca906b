"""Tasks without an end: how far what shall keep going has come, and how fast a vehicle slid, both in truth."""

import numpy as np
import pytest

import vstestbed as vs
from vstestbed.core.planar import pose_on_ground
from vstestbed.loop.task_error import Ways, band_of, slipped

I4 = np.eye(4)
CIRCLE = {"target.route": {"kind": "circle", "radius_m": 2}, "goal.offset_m": 0.0}
EIGHT = {"target.route": {"kind": "figure_eight", "length_m": 12, "width_m": 5}}


def way(scenario, places):
    """The way along its line of a vehicle at these places in turn."""
    ways = Ways(scenario)
    return [ways.after(pose_on_ground(np.array(place)), I4)[0] for place in places][-1]


def round_the_circle(radius, turns, heading):
    """Places on a circle about (0, 2) from its lowest point on, a vehicle `heading` off the way round to the left."""
    a = 2 * np.pi * np.linspace(0, turns, round(abs(turns) * 400) + 1)
    return np.column_stack([radius * np.sin(a), 2 - radius * np.cos(a), a + heading])


class TestAlongALine:
    @pytest.mark.parametrize("radius", [2.0, 1.7, 2.3])
    def test_it_is_the_vehicles_own_way_beside_the_line_also_round_and_round(self, radius):
        made = way(vs.load("car_line", CIRCLE), round_the_circle(radius, 1.5, 0.0))
        assert made == pytest.approx(3 * np.pi * radius, rel=1e-3)

    def test_a_line_has_no_direction_of_its_own(self):
        """The vehicle that starts against the route's direction goes on when it drives where it looks."""
        made = way(vs.load("car_line", CIRCLE), round_the_circle(2.0, -0.5, np.pi))
        assert made == pytest.approx(2 * np.pi, rel=1e-3)

    def test_backwards_and_turned_round_is_the_wrong_way(self):
        s = vs.load("car_line", CIRCLE)
        assert way(s, round_the_circle(2.0, -0.5, 0.0)) == pytest.approx(-2 * np.pi, rel=1e-3)  # in reverse
        there, back = round_the_circle(2.0, 0.25, 0.0), round_the_circle(2.0, 0.25, np.pi)[::-1]
        assert way(s, [*there, *back]) == pytest.approx(0.0, abs=1e-3)  # turned round on the line, and home again

    def test_where_the_line_crosses_itself_it_stays_on_its_branch(self):
        s = vs.load("omni_line", EIGHT | {"target.offsets_m": [0.0]})
        route = s.target.route
        along = np.linspace(0, route.length, 1500)
        assert way(s, route.at(along)[:, :3]) == pytest.approx(route.length, rel=1e-3)


class TestBehindAVehicle:
    def test_both_ways_count_the_leaders_by_its_own_origin(self):
        s = vs.load("car_pursuit")
        ways = Ways(s)
        for k in range(101):
            leader = pose_on_ground(np.array([0.02 * k, 0.0, 0.0]))
            made = ways.after(pose_on_ground(np.array([-3 + 0.01 * k, 0.5, 0.1])), leader @ s.target.pose.T)
        assert made == pytest.approx((2.0, 1.0))

    def test_only_a_vehicle_that_is_told_to_drive_has_a_pace(self):
        paces = band_of(vs.load("car_pursuit")).paces
        assert [p.who for p in paces] == ["the vehicle ahead", "the vehicle that follows"]
        assert [(p.told_mps, p.least_mps) for p in paces] == [(0.5, 0.4), (0.5, 0.25)]
        still = vs.load("car_pursuit", {"target.motion": "still", "target.pose.xyz": [3, 0, 0.6]})
        assert band_of(still).paces == () and Ways(still).after(I4, I4) == ()
        assert band_of(vs.load("car_pbvs")) is None


class TestSlip:
    def test_a_vehicle_that_turns_on_the_spot_unnoticed_slips_in_yaw_alone(self):
        T, turned = pose_on_ground(np.array([1.0, 2.0, 3.1])), pose_on_ground(np.array([1.0, 2.0, -3.1]))  # across the half turn
        linear, yaw = slipped(T, turned, np.zeros(3), np.zeros(3), 0.1)
        assert linear == pytest.approx(0, abs=1e-12) and yaw == pytest.approx((2 * np.pi - 6.2) / 0.1)

    def test_wheels_that_spin_while_it_stands_slip_too(self):
        linear, yaw = slipped(I4, I4, np.zeros(3), np.array([0.03, 0.04, -0.2]), 0.1)
        assert (linear, yaw) == pytest.approx((0.5, 2.0))

    def test_what_the_encoders_notice_is_none(self):
        before, now = np.array([1.0, 2.0, 0.3]), np.array([1.1, 2.05, 0.5])
        assert slipped(pose_on_ground(before), pose_on_ground(now), before, now, 0.04) == pytest.approx((0, 0), abs=1e-9)
