"""Setpoints between two orders, against their closed forms, finite differences and quadrature."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from vstestbed.loop.ego_motion import CommandHistory
from vstestbed.timing.setpoints import Interpolator, Mode, Profile, SetpointBuffer

U0, U1, A0 = np.array([0.3, -2.0]), np.array([1.0, 1.0]), np.array([4.0, -7.0])
PERIOD_S, STEP_S, STEPS = 0.04, 0.002, 20
U = np.array([1.0, -2.0])
LED: tuple[Mode, ...] = ("ramp", "smooth")


def stops(setpoint: np.ndarray, elapsed_s: float) -> np.ndarray:
    return setpoint * max(0.0, 1.0 - elapsed_s / 0.1)


def orders(mode: Mode, every: int, lasts: float = np.inf) -> SetpointBuffer:
    return SetpointBuffer(stops, None, lasts, STEP_S, Interpolator(mode, every, STEPS))


class TestProfile:
    def test_a_ramp_is_a_straight_line(self):
        profile = Profile("ramp", U0, A0, U1, PERIOD_S)
        for t in (0.0, 0.013, 0.02, 0.04):
            np.testing.assert_allclose(profile.at(t), U0 + (U1 - U0) * t / PERIOD_S, atol=1e-15)
        assert profile.at(PERIOD_S) is U1 and profile.at(1.0) is U1
        np.testing.assert_allclose(profile.slope(0.01), (U1 - U0) / PERIOD_S)

    def test_a_smooth_way_begins_with_value_and_slope_and_ends_at_rest(self):
        profile = Profile("smooth", U0, A0, U1, PERIOD_S)
        np.testing.assert_allclose(profile.at(0.0), U0)
        np.testing.assert_allclose(profile.slope(0.0), A0)
        np.testing.assert_allclose(profile.at(PERIOD_S * (1 - 1e-9)), U1, atol=1e-8)
        np.testing.assert_allclose(profile.slope(PERIOD_S * (1 - 1e-9)), 0.0, atol=1e-6)

    @pytest.mark.parametrize("mode", ["hold", "ramp", "smooth"])
    def test_slope_and_way_are_derivative_and_integral(self, mode: Mode):
        profile, h = Profile(mode, U0, A0, U1, PERIOD_S), 1e-6
        for t in (0.011, 0.029, 0.055):
            np.testing.assert_allclose(
                profile.slope(t),
                (profile.at(t + h) - profile.at(t - h)) / (2 * h),
                rtol=1e-6,
                atol=1e-6,
            )
            np.testing.assert_allclose(
                profile.at(t), (profile.way(t + h) - profile.way(t - h)) / (2 * h), rtol=1e-6
            )

    @pytest.mark.parametrize("mode", LED)
    def test_it_is_late_by_half_its_time(self, mode: Mode):
        behind = U1 * 3 * PERIOD_S - Profile(mode, U0, np.zeros(2), U1, PERIOD_S).way(3 * PERIOD_S)
        np.testing.assert_allclose(behind, (U1 - U0) * PERIOD_S / 2, rtol=1e-12)

    def test_the_jerk_of_a_smooth_way_keeps_its_bound(self):
        """The third derivative of the way is that of a cubic's slope: a straight line, largest at
        an end.
        """
        t = np.linspace(0, PERIOD_S * (1 - 1e-9), 4001)
        u = np.array([Profile("smooth", U0, A0, U1, PERIOD_S).at(s) for s in t])
        jerk = np.abs(np.diff(u, 2, axis=0)).max(axis=0) / (t[1] - t[0]) ** 2
        bound = 6 * np.abs(U1 - U0) / PERIOD_S**2 + 4 * np.abs(A0) / PERIOD_S
        assert (jerk <= bound * 1.001).all() and (jerk > 0.5 * bound).any()
        from_rest = (
            np.abs(
                np.diff([Profile("smooth", U0, 0 * A0, U1, PERIOD_S).at(s) for s in t], 2, axis=0)
            ).max(axis=0)
            / (t[1] - t[0]) ** 2
        )
        np.testing.assert_allclose(from_rest, 6 * np.abs(U1 - U0) / PERIOD_S**2, rtol=0.01)

    def test_there_is_no_way_to_infinity(self):
        off = np.array([0.0, -np.inf])
        assert (
            Profile("ramp", U0, A0, off, PERIOD_S).at(0.0) is off
            and Profile("smooth", off, A0, U1, PERIOD_S).at(0.0) is U1
        )


class TestSetpointBuffer:
    def test_a_ramp_in_closed_form_at_each_setpoint(self):
        led = orders("ramp", every=5)
        led.give(0, U)
        led.give(STEPS, 3 * U)
        for step in range(STEPS, 3 * STEPS):
            share = min(1.0, (step // 5 * 5 - STEPS + 2.5) / STEPS)  # the middle of the five steps
            np.testing.assert_allclose(led.at(step), U + 2 * U * share)

    @pytest.mark.parametrize(("every", "count"), [(1, 20), (2, 10), (5, 4), (8, 3)])
    def test_the_number_of_setpoints_a_period(self, every: int, count: int):
        """500 Hz at 25 Hz pictures: twenty; also where the period is no multiple of theirs, and
        asked as the plants ask.
        """
        led, step, found = orders("smooth", every), 0, []
        led.give(0, U)
        while step < 100:
            found.append(led.at(step))
            step += led.unchanged(step, 100 - step)
        assert sum(not np.array_equal(a, b) for a, b in itertools.pairwise(found)) == count

    @pytest.mark.parametrize("mode", ["hold", *LED])
    @pytest.mark.parametrize("every", [1, 3, 7])
    def test_what_they_say_of_the_steps_to_come_is_true(self, mode: Mode, every: int):
        led, rng = orders(mode, every, lasts=24), np.random.default_rng(2)
        due = sorted(rng.integers(0, 200, 7).tolist())
        for step in range(220):
            for _ in range(due.count(step)):
                led.give(step, rng.normal(size=2))
            if step <= due[0]:
                continue
            ahead = led.unchanged(step, 9)
            assert 1 <= ahead <= 9
            following = any(step < d < step + ahead for d in due)
            if not following and not np.array_equal(led.at(step), led.at(step + ahead - 1)):
                assert ahead <= 5  # while it stops, it is renewed every 10 ms

    def test_a_held_order_waits_for_its_turn(self):
        led = orders("hold", every=10)
        led.give(0, U)
        led.give(13, 2 * U)
        assert led.at(19) is U
        np.testing.assert_array_equal(led.at(20), 2 * U)
        led.give(21, 3 * U)
        led.give(24, 4 * U)  # the later of two counts
        np.testing.assert_array_equal(led.at(29), 2 * U)
        np.testing.assert_array_equal(led.at(30), 4 * U)

    @pytest.mark.parametrize("mode", LED)
    def test_there_is_no_jump_whenever_orders_come(self, mode: Mode):
        led, rng, before = orders(mode, every=1), np.random.default_rng(4), np.zeros(2)
        # the steepest cubic between -1 and 1, whose slope at the start is the last one's
        most = 1.5 * 2 * 2 / STEPS + 1e-9
        for step in range(400):
            if rng.random() < 0.1 or step == 0:
                led.give(step, rng.uniform(-1, 1, 2))
            now = led.at(step)
            assert now is not None and np.abs(now - before).max() <= 2 * most
            before = now

    def test_it_stops_from_where_it_is(self):
        led = orders("ramp", every=1, lasts=10)
        led.give(0, U)
        half = U * 10.5 / STEPS
        np.testing.assert_allclose(led.at(10), half)
        np.testing.assert_allclose(led.at(11), half * (1 - STEP_S / 0.1))
        start = half * (1 - 2 * STEP_S / 0.1)
        led.give(12, U)  # and sets out again from there
        np.testing.assert_allclose(led.at(12), start + (U - start) * 0.5 / STEPS)
        led.give(15, U, "stop")
        before = led.at(14)
        assert before is not None
        np.testing.assert_allclose(led.at(15), before * (1 - STEP_S / 0.1))

    @pytest.mark.parametrize("mode", LED)
    @pytest.mark.parametrize("every", [1, 5])
    def test_the_controller_knows_the_way_of_its_orders(self, mode: Mode, every: int):
        """The integral of what the actuators get, and that of the controller, which knows nothing
        of the physics clock.
        """
        led, known, rng, way = (
            orders(mode, every),
            CommandHistory(2, mode, PERIOD_S),
            np.random.default_rng(0),
            np.zeros(2),
        )
        for step in range(200):
            if step % 20 == 0 or step in (45, 55, 130):
                u = rng.normal(size=2)
                led.give(step, u)
                known.add(step * STEP_S, u)
            now = led.at(step)
            assert now is not None
            way += STEP_S * now
        np.testing.assert_allclose(known.displacement(200 * STEP_S), way, atol=1e-12)
