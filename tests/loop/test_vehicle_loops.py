"""What lags, delays and wrong radii of vehicles do to their closed loops, against the roots of the
linear ones.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache

import numpy as np
import pytest

import vstestbed as vs
from tests.shortcuts import one_quick
from vstestbed.core.quantity import GRAVITY
from vstestbed.robots.base import Reading
from vstestbed.robots.car import Car
from vstestbed.vision.floor_pose import LANDMARKS_S

ORACLE = {"detector": {"kind": "oracle", "field_of_view": "limited"}, "camera.latency_s": 0.04}
BASE = ORACLE | {
    "robot.wheels": "planar",
    "robot.start.nominal": {"x": -4.5, "y": 0.3, "heading_deg": 10},
    "target.at": [[0, 1, 2], [0, -1, 2], [0.3, 0.6, 2.5], [0, -0.5, 2.7]],
    "law": {"kind": "pbvs", "gain": 1},
    "stop": {"duration_s": 6.5},
}
CAR = ORACLE | {
    "robot.start.nominal": {"x": 5, "y": 3, "heading_deg": 90},
    "robot.compass.sigma_deg": 0,
    "stop.duration_s": 4.4,
}
FRAME_S, WHEELS_S, MOTOR_S = 0.04, 0.04, 0.03
"""Period of the camera; lags of the base's own wheel loop (models/omni.xml) and of the car's motor
(robots/car.py).
"""


def decay(gain: float, delay_s: float, passed: Callable[[float], float]) -> float:
    """The slowest s > 0 [1/s] of errors e^-st: s = gain e^(s delay) G(-s), with `passed` s -> G(-s)
    of what the loop does to a command.
    """
    s = gain
    for _ in range(200):
        s = gain * math.exp(s * delay_s) * passed(s)
    return s


def base_alone(
    gain: float = 1.0,
    lags_s: tuple[float, ...] = (),
    ramp: bool = False,
    from_m: float = 2.52,
    to_m: float = 0.01,
) -> float:
    """When a base on a line comes under a distance [s]: v = min(1, g x), a frame late and held, or
    led to by a ramp, behind lags.
    """
    x, dt, passed, orders, way = from_m, 0.001, [0.0] * (1 + len(lags_s)), [0.0, 0.0], 0
    frame = round(FRAME_S / dt)
    while x > to_m:
        if way % frame == 0:
            orders.append(min(1.0, gain * x))
        before, order = orders[-3:-1]
        v = before + (order - before) * (way % frame + 1) / frame if ramp else order
        for i, lag_s in enumerate((WHEELS_S, *lags_s)):
            passed[i] = v = v + (passed[i] - v) * math.exp(-dt / lag_s)
        x, way = x - v * dt, way + 1
    return way * dt


@cache
def measured(**changes: object) -> tuple[float, float]:
    """When the base comes under 1 cm from its goal [s], and the rate of its distance under 0.5 m
    [1/s].
    """
    rows = vs.run(
        vs.load(
            "omni_ibvs", BASE | {name.replace("__", "."): value for name, value in changes.items()}
        )
    ).rows
    t, x, y = (rows[name] for name in ("t", "base_x", "base_y"))
    distance = np.hypot(x + 2, y)
    late = distance < 0.1
    return float(np.interp(-0.01, -distance, t)), -float(
        np.polyfit(t[late], np.log(distance[late]), 1)[0]
    )


@pytest.mark.parametrize(
    ("changes", "gain", "earlier_s", "lags_s"),
    one_quick(
        ({"robot__drive_lag_s": 0.1}, 1.0, 0.0, (0.1,)),
        ({}, 1.0, 0.0, ()),
        ({"timing__interpolation": "ramp", "timing__command_hz": 500}, 1.0, -FRAME_S / 2, ()),
        ({"robot__wheel_radius_error": 0.02}, 1 / 1.02, 0.0, ()),
    ),
    ids=["drive lag", "as it is", "ramps", "radius"],
)
def test_the_base_comes_as_fast_as_its_lags_let_it(
    changes: dict[str, object], gain: float, earlier_s: float, lags_s: tuple[float, ...]
) -> None:
    """s (1 - s T_wheels) (1 - s T_drive) = g e^(s tau), tau: latency, half a period for which a
    command is held, as much for a ramp.

    A radius that is believed too large by c makes all motions smaller by 1 + c: the gain. So the
    times of a comparison change.
    """
    found_s, rate = measured(**changes)
    tau = 0.04 + FRAME_S / 2 - earlier_s
    assert rate == pytest.approx(
        decay(gain, tau, lambda s: 1 / math.prod(1 - s * lag_s for lag_s in (WHEELS_S, *lags_s))),
        rel=0.01,
    )
    ramp = "timing__interpolation" in changes
    assert found_s - measured()[0] == pytest.approx(
        base_alone(gain, lags_s, ramp) - base_alone(), abs=0.04
    )


def test_on_a_slippery_floor_rollers_hold_less_than_wheels() -> None:
    """A roller at 45 degrees turns away from all but a force along its axis: mu m g / sqrt 2 ahead,
    and a little by their bearings.
    """
    start = {
        "robot.wheels": "rollers",
        "robot.start.nominal": {"x": -5, "y": 0, "heading_deg": 0},
        "stop.duration_s": 0.8,
    }
    rows = vs.run(vs.load("omni_ibvs", BASE | start | {"world.floor_friction": 0.1})).rows
    t, x = (rows.table[:, rows.columns.index(name)] for name in ("t", "base_x"))
    late = t > 0.2
    assert 2 * np.polyfit(t[late], x[late], 2)[0] == pytest.approx(
        0.1 * GRAVITY / math.sqrt(2), rel=0.08
    )


def straight(lag_s: float, from_m: float = 2.0, to_m: float = 0.05) -> float:
    """When a car on a line comes under a distance, by its servo alone: v = min(1, rho), a frame
    late and held; motors of one lag [s].
    """
    car, dt, x, wheels = Car(drive_lag_s=lag_s), 0.01, from_m, 0.0
    state, orders, way = car.begin(), [0.0], [x]
    keep = math.exp(-dt / MOTOR_S)
    while x > to_m:
        if (len(way) - 1) % round(FRAME_S / dt) == 0:
            orders.append(min(1.0, x))
        reading = Reading(np.zeros(7), np.array([0, 0, 0, wheels, wheels, 0, 0]))
        state, ctrl = car.actuate(state, np.array([orders[-2], 0.0]), reading, dt)
        rolled = ctrl[0] * dt + (wheels - ctrl[0]) * MOTOR_S * (1 - keep)
        wheels, x = ctrl[0] + (wheels - ctrl[0]) * keep, x - car.believed_radius * rolled
        way.append(x)
    return dt * float(np.interp(-to_m, -np.array(way), np.arange(len(way))))


@cache
def arrival(**changes: object) -> float:
    """The same of the simulated car, which drives straight to its goal [s]."""
    rows = vs.run(
        vs.load(
            "car_pbvs", CAR | {name.replace("__", "."): value for name, value in changes.items()}
        )
    ).rows
    t, y = (rows.table[:, rows.columns.index(name)] for name in ("t", "base_y"))
    return float(np.interp(-0.05, y - 5, t))


def test_a_lag_of_its_drive_makes_the_car_later() -> None:
    """The integral of its speed servo takes the lag of a drive away, and rings: no error that
    decays faster, as the base's does.
    """
    assert arrival() == pytest.approx(straight(0.0), abs=0.025)
    assert arrival(robot__drive_lag_s=0.2) - arrival() == pytest.approx(
        straight(0.2) - straight(0.0), abs=0.015
    )


@pytest.mark.parametrize(
    "field", one_quick("robot__wheel_radius_error", "robot__wheel_spread__errors")
)
def test_a_radius_that_is_wrong_stretches_the_time(field: str) -> None:
    """All speeds, their limit too, are smaller by the share by which the rear wheels are smaller
    than believed; the gains with them.
    """
    value = 0.02 if field.endswith("error") else (0.0, 0.0, -0.02, -0.02)
    assert arrival(**{field: value}) - arrival() == pytest.approx(0.02 * arrival(), abs=0.02)


@pytest.mark.parametrize(("alpha", "beta"), one_quick((4.0, -2.5), (5.0, -2.0)))
def test_a_compass_that_points_wrongly_turns_the_car_by_more_than_its_bias(
    alpha: float, beta: float
) -> None:
    """Its true heading ends at e + (delta + e) k_alpha / |k_beta| off the goal's, with e = k_rho
    tau delta.

    The car goes where it points, delta off where it believes, so that alpha = -delta where the
    bearing rests, and w = 0 there. Odometry along the believed heading drifts aside by v delta,
    which landmarks take away with tau: the goal's bearing is e off besides.
    """
    bias, rho = 2.0, 1.0
    law = {"law.k_rho": rho, "law.k_alpha": alpha, "law.k_beta": beta, "law.average_m": 0}
    start = {
        "robot.start.nominal": {"x": 5, "y": 3.5, "heading_deg": 90},
        "robot.compass": {"sigma_deg": 0, "bias_deg": bias},
    }
    rows = vs.run(vs.load("car_pbvs", CAR | law | start | {"stop.duration_s": 5.5})).rows
    e = rho * LANDMARKS_S * bias
    expected = e + (bias + e) * alpha / -beta
    assert math.degrees(rows.table[-1, rows.columns.index("base_heading")]) - 90 == pytest.approx(
        expected, rel=0.12
    )
