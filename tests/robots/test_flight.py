"""The loops in closed loop with MuJoCo: step responses of rates, attitude and velocity, tilt limit,
levelling.
"""

import math

import numpy as np
import pytest

from tests.robots.flying import DT, Flown, Log, Response, perfect
from tests.shortcuts import one_quick
from vstestbed.core.geometry import Array
from vstestbed.core.quantity import GRAVITY
from vstestbed.robots.attitude import Filter, level, to_body
from vstestbed.robots.flight import HOLD, MAX_TILT_RATE, Gains, aim, attitude_loop, rate_loop
from vstestbed.robots.rotors import X4, mix, speed_control


def inner(
    duration: float, rates: tuple[float, float, float] | None = None, lean: float = 0.0
) -> tuple[Array, Array, Array]:
    """Rate loop, mixer and rotors alone under an order of rates, or with the attitude loop under a
    lean [rad]; true attitude and rates.

    Returns:
        t (n,), body rates (n, 3), angle of the craft's z forward of the vertical (n,).
    """
    craft, gains, W, trim, rows = Flown(perfect()), Gains(), (X4.hover,) * 4, (0.0, 0.0), []
    for _ in range(round(duration / DT)):
        R = level(tuple(craft.R[2].tolist()))
        wanted = rates or (
            *attitude_loop(to_body(R, (math.sin(lean), 0.0, math.cos(lean))), gains),
            0.0,
        )
        trim, torque = rate_loop(
            trim, wanted, tuple(craft.data.sensor("robot/gyro").data.tolist()), gains, X4, DT
        )
        W, craft.data.ctrl[:] = speed_control(
            W, mix(X4.mass_kg * GRAVITY, torque, X4)[0], gains.rotor_s, DT, X4
        )
        craft.step()
        rows.append([*craft.data.qvel[3:], math.atan2(craft.R[0, 2], craft.R[2, 2])])
    a = np.array(rows)
    return np.arange(1, len(a) + 1) * DT, a[:, :3], a[:, 3]


class TestSteps:
    """Measured figures stand in the assertions; a change of gains, rotors or drag shows here."""

    @pytest.mark.parametrize("axis", [0, 1])
    @pytest.mark.parametrize("order", [0.2, 1.0, 3.0])
    def test_rate(self, axis, order):
        t, rates, _ = inner(0.5, rates=tuple(order * (i == axis) for i in range(3)))
        found = Response.of(t, rates[:, axis], order)
        # .11 s up to 1 rad/s, .13 at 3, where full voltage bounds the rotors.
        assert 0.09 < found.rise < 0.14
        assert found.overshoot < 0.06
        assert abs(found.error) < 0.03  # the integral unwinds in seconds
        # Where the lead reaches full voltage one rotor of a pair is slower up than the other down:
        # some drag torque is left over.
        assert np.abs(np.delete(rates, axis, axis=1)).max() < 1e-3 * order

    def test_yaw_rate(self):
        t, rates, _ = inner(3.0, rates=(0.0, 0.0, 0.5))
        found = Response.of(t, rates[:, 2], 0.5)
        # .45 rad/s^2 is what yaw may ask of the rotors: .5 rad/s takes more than a second.
        assert 0.8 < found.rise < 1.1
        assert found.overshoot < 0.01
        assert abs(found.error) < 0.005

    @pytest.mark.parametrize("degrees", [5, 20, 30])
    def test_attitude(self, degrees):
        t, _, lean = inner(2.0, lean=math.radians(degrees))
        found = Response.of(t, lean, math.radians(degrees))
        assert 0.2 < found.rise < 0.3
        assert found.overshoot < 0.02
        assert found.settled < 0.45
        assert abs(found.error) < 0.01

    @pytest.mark.parametrize("axis", one_quick(0, 1))
    @pytest.mark.parametrize("speed", [0.5, 2.0])
    def test_velocity_along_the_ground(self, axis, speed):
        order = np.zeros(4)
        order[axis] = speed
        log = Flown(perfect()).fly(order, 5.0)
        found = Response.of(log.t, log.level[:, axis], speed)
        assert 0.55 < found.rise < 0.75
        assert found.overshoot < 0.01
        assert abs(found.error) < 0.005
        assert found.settled < 1.1
        assert np.abs(log.position[:, 2] - 10.0).max() < 0.03  # height is kept while it leans
        assert np.abs(log.level[:, 1 - axis]).max() < 0.01

    @pytest.mark.parametrize("lag", one_quick(0.092, 0.14))
    def test_other_motors_fly_too(self, lag):
        """Motors of efficiency .85 and .75 under speed controllers tuned for .8."""
        craft = Flown(perfect())
        craft.model.actuator_dynprm[:, 0] = lag
        log = craft.fly([1.0, 0, 0, 0], 4.0)
        found = Response.of(log.t, log.level[:, 0], 1.0)
        assert found.overshoot < 0.03 and abs(found.error) < 0.01
        assert np.abs(log.rates[-500:]).max() < 1e-3  # no ringing

    def test_by_the_imu_alone_tilt_and_velocity_err(self):
        """What taking the velocity's rate from the accelerometer is for (Martin & Salaun 2010)."""
        log = Flown(perfect(attitude=Filter(acceleration="imu"))).fly([2.0, 0, 0, 0], 5.0)
        aided = Flown(perfect()).fly([2.0, 0, 0, 0], 5.0)

        def worst(flight: Log) -> float:
            estimated = np.array([m.attitude.pitch for m in flight.state])
            return float(np.degrees(np.abs(estimated - flight.rpy[:, 1]).max()))

        assert worst(log) > 4.0 and worst(aided) < 0.2  # measured 5.4 and .09 degrees
        assert Response.of(log.t, log.level[:, 0], 2.0).overshoot > 0.2

    def test_climb(self):
        log = Flown(perfect()).fly([0, 0, 0.5, 0], 5.0)
        found = Response.of(log.t, log.level[:, 2], 0.5)
        assert 0.7 < found.rise < 0.95
        assert found.overshoot < 0.02
        assert abs(found.error) < 0.01

    def test_yaw_order(self):
        log = Flown(perfect()).fly([0, 0, 0, 0.5], 4.0)
        found = Response.of(log.t, log.rates[:, 2], 0.5)
        # The order's own slope, .4 rad/s^2: 1 s from 10 to 90 %.
        assert 0.9 < found.rise < 1.2
        assert found.overshoot < 0.01
        assert np.abs(log.position - [0, 0, 10]).max() < 0.005

    @pytest.mark.study
    def test_forward_while_turning_is_a_circle(self):
        log = Flown(perfect()).fly([1.0, 0, 0, 0.8], 4.0 + 2.5 * math.pi)
        np.testing.assert_allclose(
            log.level[4000:], np.tile([1.0, 0, 0], (len(log.t) - 4000, 1)), atol=0.05
        )
        circle = log.position[-int(2500 * math.pi) :, :2]
        # v / r = 1.25 m of radius; drag and lag leave 4 %.
        assert np.ptp(circle, axis=0) == pytest.approx([2.5, 2.5], rel=0.04)


class TestTilt:
    def test_a_large_order_leans_to_the_limit_and_keeps_height(self):
        log = Flown(perfect(gains=Gains(tilt_deg=20))).fly([8.0, 0, 0, 0], 2.0)
        assert np.degrees(log.tilt).max() == pytest.approx(20, abs=1.0)
        assert np.abs(log.position[:, 2] - 10).max() < 0.15

    @pytest.mark.parametrize(
        ("degrees", "seconds", "sinks"),
        one_quick((30, 0.3, 0.15), (70, 1.3, 1.2), (120, 1.5, 6.0), (179, 1.5, 14.0)),
    )
    def test_it_levels_from_any_tilt(self, degrees, seconds, sinks):
        craft = Flown(perfect(height=40.0))
        craft.tilt(roll=math.radians(degrees))
        log = craft.fly(HOLD, 8.0)
        # To 15 degrees for good: what it leans to stop its own drift is in it. Then .35 g is all
        # that stops the fall.
        assert log.t[np.nonzero(np.degrees(log.tilt) > 15)[0][-1]] < seconds
        assert 40 - log.position[:, 2].min() < sinks
        assert np.linalg.norm(log.velocity[-1]) < 0.3
        assert log.state[0].loops.levelling == (degrees > 60)
        assert log.state[0].overturned == (degrees > 60)
        assert not log.state[-1].loops.levelling

    def test_aim(self):
        force, thrust = aim((0.0, 0.0, 0.0), 1.0, Gains(), X4.mass_kg)
        assert force == (0.0, 0.0, 1.0)
        # the true weight, no round 40 N
        assert thrust == pytest.approx(X4.mass_kg * GRAVITY, rel=1e-12)
        force, _ = aim((100.0, 0.0, 0.0), 1.0, Gains(), X4.mass_kg)
        assert math.degrees(math.atan2(force[0], force[2])) == pytest.approx(30)
        assert aim((0.0, 0.0, 0.0), math.cos(0.5), Gains(), X4.mass_kg)[1] * math.cos(
            0.5
        ) == pytest.approx(X4.mass_kg * GRAVITY)  # the vertical part is kept

    def test_attitude_loop_turns_z_to_the_force(self):
        gains = Gains()
        # force forward: nose down, +y
        wx, wy = attitude_loop((math.sin(0.1), 0.0, math.cos(0.1)), gains)
        assert (wx, wy) == pytest.approx((0.0, 0.1 * gains.attitude))
        # force left: left side down, -x
        wx, wy = attitude_loop((0.0, math.sin(0.1), math.cos(0.1)), gains)
        assert (wx, wy) == pytest.approx((-0.1 * gains.attitude, 0.0))
        assert math.hypot(*attitude_loop((0.0, 0.0, -1.0), gains)) == MAX_TILT_RATE
