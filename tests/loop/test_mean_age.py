"""What is latency to a loop: half of the readout, of the exposure and of a ramp to each setpoint;
and what latency does to its time.

A loop of gain g whose commands are tau old has e' = -g e(t - tau). Its error decays by exp(-s t)
with s = g exp(s tau), so that s > g: the older the picture, the faster, until it swings. From two
measured rates the difference of both ages follows: tau = ln(s / g) / s.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import vstestbed as vs
from tests.shortcuts import one_quick
from vstestbed.core.geometry import Array

GAIN, LATENCY_S, PERIOD_S = 0.5, 0.04, 0.04
PLAIN: dict[str, Any] = {
    "robot.actuation": "ideal",
    "detector": {"kind": "oracle", "field_of_view": "limited"},
    "camera.latency_s": LATENCY_S,
    "law": {
        "kind": "ibvs",
        "gain": GAIN,
        "feature": "point",
        "interaction": "mean",
        "depth": "pnp",
    },
    "stop": {"duration_s": 9, "converged": {"error_px": 0.01, "hold_s": 0.5}, "lost_after_s": 1},
}


def errors(change: dict[str, Any]) -> tuple[Array, Array]:
    """Times and image errors of a run of the arm from start 1."""
    recording = vs.run(vs.load("arm_ibvs", PLAIN | change, seed=1))
    return recording["t"], recording["error_px"]


def age_s(t: Array, error: Array) -> float:
    """The mean age of the pictures by which the arm moves, from the rate at which its error decays
    when only one mode is left.
    """
    late = (t > 4) & (t < 8.5)
    rate = -float(np.polyfit(t[late], np.log(error[late]), 1)[0])
    return math.log(rate / GAIN) / rate


@pytest.fixture(scope="module")
def plain() -> tuple[Array, Array]:
    return errors({})


def test_a_held_command_is_half_a_period_old_on_top_of_the_latency(
    plain: tuple[Array, Array],
) -> None:
    assert age_s(*plain) == pytest.approx(LATENCY_S + PERIOD_S / 2, abs=0.003)


@pytest.mark.parametrize(
    ("change", "older_s", "within_s"),
    one_quick(
        ({"camera.latency_s": LATENCY_S + 0.02}, 0.02, 0.001),
        ({"timing.exposure_s": 0.02}, 0.01, 0.001),
        # of markers at half the height; they are where they are
        ({"camera.readout_s": 0.03}, 0.015, 0.003),
        ({"timing.interpolation": "ramp", "timing.command_hz": 500}, PERIOD_S / 2, 0.001),
    ),
    ids=["latency", "exposure", "readout", "ramps"],
)
def test_half_of_exposure_readout_and_ramp_are_latency(
    plain: tuple[Array, Array], change: dict[str, Any], older_s: float, within_s: float
) -> None:
    t, error = errors(change)
    assert age_s(t, error) - age_s(*plain) == pytest.approx(older_s, abs=within_s)
    # the time from e0 to e1 changes by older_s (1 - ln(e0 / e1)): it sets off later, and decays
    # faster
    e0, e1 = float(error[0]), 2.0
    times = [
        float(np.interp(-math.log(e1), -np.log(e[k]), t[k]))
        for t, e, k in ((t, e, e > 0) for t, e in ((t, error), plain))
    ]
    assert times[0] - times[1] == pytest.approx(older_s * (1 - math.log(e0 / e1)), rel=0.25)
