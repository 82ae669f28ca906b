"""The mixer and the speed controllers alone."""

import numpy as np
import pytest

from vstestbed.robots.rotors import X4, mix, speed_control

WEIGHT = X4.mass_kg * 9.81


def made(W) -> tuple[float, np.ndarray]:
    """Thrust [N] and torque [Nm] from forces at the rotors' places and their drag torques."""
    places = X4.arm_m * np.array([[1, 0, 0], [0, -1, 0], [-1, 0, 0], [0, 1, 0]])
    forces = np.array([[0, 0, X4.thrust_coefficient * w] for w in W])
    torque = np.cross(places, forces).sum(axis=0) + [
        0,
        0,
        X4.drag_coefficient * (-W[0] + W[1] - W[2] + W[3]),
    ]
    return float(forces[:, 2].sum()), torque


def test_hover_is_861_rad_per_s():
    W, cut = mix(WEIGHT, (0.0, 0.0, 0.0), X4)
    assert not cut
    np.testing.assert_allclose(np.sqrt(W), 861, atol=0.05)


def test_exact_where_there_is_room():
    rng = np.random.default_rng(0)
    for _ in range(200):
        torque = rng.uniform(-1, 1, 3) * [0.6, 0.6, 0.04]
        W, cut = mix(WEIGHT * rng.uniform(0.8, 1.1), tuple(torque), X4)
        assert not cut
        np.testing.assert_allclose(made(W)[1], torque, atol=1e-12)


def test_at_the_limits_attitude_comes_before_thrust_and_thrust_before_yaw():
    rng, half = np.random.default_rng(1), 0.5 * X4.limit * 2 * X4.arm_m * X4.thrust_coefficient
    kept_thrust = lost_yaw = 0
    for _ in range(2000):
        thrust, torque = rng.uniform(0, 2.2) * WEIGHT, rng.uniform(-1, 1, 3) * [5, 5, 0.5]
        W, cut = mix(thrust, tuple(torque), X4)
        assert min(W) >= -1e-6 and max(W) <= X4.limit + 1e-6
        got_thrust, got = made(W)
        # Roll and pitch: all that the rotors can do at any thrust, whatever thrust and yaw ask for.
        np.testing.assert_allclose(got[:2], np.clip(torque[:2], -half, half), atol=1e-9)
        # Thrust: the nearest that leaves room for them.
        widest = np.abs(got[:2]).max() / (2 * X4.arm_m * X4.thrust_coefficient)
        assert got_thrust == pytest.approx(
            4
            * X4.thrust_coefficient
            * np.clip(thrust / (4 * X4.thrust_coefficient), widest, X4.limit - widest),
            abs=1e-9,
        )
        # Yaw: never more than asked, never against it.
        assert abs(got[2]) <= abs(torque[2]) + 1e-12 and got[2] * torque[2] >= -1e-12
        kept = np.allclose(got, torque, atol=1e-9) and np.isclose(got_thrust, thrust)
        assert cut == (not kept)
        kept_thrust += bool(np.isclose(got_thrust, thrust))
        lost_yaw += abs(got[2]) < abs(torque[2]) - 1e-9
    assert kept_thrust > 200 and lost_yaw > 200  # both happened


def test_yaw_gets_all_the_room_that_is_left():
    W, cut = mix(WEIGHT, (1.0, 0.0, 1.0), X4)
    assert cut
    assert max(W) == pytest.approx(X4.limit)


def test_yaw_share_leaves_room_for_attitude():
    W, cut = mix(WEIGHT, (0.8, 0.0, X4.yaw_torque), X4)
    assert not cut
    assert max(W) < X4.limit


def test_speed_control_makes_the_rotor_as_quick_as_told():
    """Against the lag itself, solved exactly:
    a small step has the time constant .03 s, not .117.
    """
    W, plant, wanted = (X4.hover,) * 4, X4.hover, (X4.hover * 1.02,) * 4
    for k in range(1, 100):
        W, u = speed_control(W, wanted, 0.03, 0.001, X4)
        plant = u[0] + (plant - u[0]) * np.exp(-0.001 / X4.rotor_lag_s)
        share = (plant - X4.hover) / (0.02 * X4.hover)
        # orders are held for 1 ms
        assert share == pytest.approx(1 - np.exp(-k * 0.001 / 0.03), abs=0.01)
    assert W[0] == pytest.approx(plant, rel=1e-6)  # what it believes its rotor to turn at


def test_full_voltage_bounds_the_lead():
    _, u = speed_control((X4.hover,) * 4, (X4.limit, 0.0, X4.hover, X4.hover), 0.03, 0.001, X4)
    assert u == (X4.limit, 0.0, X4.hover, X4.hover)


def test_it_follows_a_rotor_that_is_at_its_limit():
    W, plant = (X4.hover,) * 4, X4.hover
    for _ in range(300):
        W, u = speed_control(W, (X4.limit,) * 4, 0.03, 0.001, X4)
        plant = u[0] + (plant - u[0]) * np.exp(-0.001 / X4.rotor_lag_s)
    assert W[0] == pytest.approx(plant, rel=1e-6)
