"""Automatic exposure: step responses in closed form, limits, the condition for stability."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from vstestbed.camera import Perspective
from vstestbed.core.errors import ParameterError
from vstestbed.imaging.exposure import (
    SKIP,
    AutoExposure,
    ExposureControl,
    ExposureLoop,
    ExposureSetting,
)
from vstestbed.imaging.sensor import plain

PERIOD = 0.04
RENDERED = np.repeat(
    np.repeat(np.linspace(35, 45, 64 * 64 * 3, dtype=np.float32).reshape(64, 64, 3), SKIP, axis=0),
    SKIP,
    axis=1,
)
"""A ramp, in whose mean the rounding of grey levels averages out; each metered pixel stands for
those round it.
"""


def taken(setting: ExposureSetting) -> NDArray[np.uint8]:
    return plain(RENDERED, setting)


def part(setting: ExposureSetting) -> NDArray[np.uint8]:
    return plain(RENDERED[::SKIP, ::SKIP], setting)


def means(
    auto: AutoExposure, pictures: int, light: tuple[tuple[float, float], ...]
) -> NDArray[np.float64]:
    """Mean of each picture, before it is rounded [grey levels]."""
    loop, made = ExposureLoop(ExposureControl(light=light, auto=auto), PERIOD), []
    for k in range(pictures):
        setting = loop.setting(k * PERIOD, part)
        made.append(40.0 * setting.collected * setting.gain)
        loop.saw(taken(setting))
    return np.array(made)


def stops(mean: NDArray[np.float64], target: float) -> NDArray[np.float64]:
    return np.log2(mean / target)


@pytest.mark.parametrize("factor", [0.5, 1.5])
def test_a_step_of_the_light_decays_exponentially(factor: float):
    auto = AutoExposure(target_grey=100, lag_s=0.3, delay_pictures=0)
    step = 10
    error = stops(means(auto, 60, ((step * PERIOD, factor),)), 100)
    assert np.abs(error[:step]).max() < 2e-3  # it has settled before
    t = np.arange(60 - step) * PERIOD
    np.testing.assert_allclose(error[step:], math.log2(factor) * np.exp(-t / 0.3), atol=2e-3)


def test_with_a_delay_it_follows_the_difference_equation():
    auto = AutoExposure(target_grey=100, lag_s=0.15, delay_pictures=3)
    a, step, n = auto.share(PERIOD), 5, 3
    error = stops(means(auto, 50, ((step * PERIOD, 0.6),)), 100)
    expected = [0.0] * step + [math.log2(0.6)] * (n + 1)
    while len(expected) < 50:
        expected.append(expected[-1] - a * expected[-1 - n])
    np.testing.assert_allclose(error, expected, atol=2e-3)
    assert np.ptp(error[step : step + n + 1]) < 1e-3  # nothing happens for the delay


def test_the_refused_lags_are_those_that_oscillate():
    for n in (0, 1, 3, 8):
        most = 2 * math.sin(math.pi / (2 * (2 * n + 1)))
        for share, stable in ((0.98 * most, True), (1.02 * most, False)):
            # Largest root of z^(n+1) - z^n + a = 0.
            polynomial = np.zeros(n + 2)
            polynomial[0] = 1.0
            polynomial[1] -= 1.0
            polynomial[-1] += share
            assert (np.abs(np.roots(polynomial)).max() < 1) == stable
    least = -PERIOD / math.log1p(-2 * math.sin(math.pi / 14))
    Perspective(exposure=ExposureControl(auto=AutoExposure(delay_pictures=3, lag_s=1.01 * least)))
    with pytest.raises(ParameterError, match="oscillates"):
        Perspective(
            exposure=ExposureControl(auto=AutoExposure(delay_pictures=3, lag_s=0.99 * least))
        )


def test_time_is_used_up_before_gain_and_both_have_limits():
    auto = AutoExposure(
        target_grey=200,
        lag_s=0.05,
        delay_pictures=0,
        longest_s=0.01,
        largest_gain=4,
        shortest_s=0.001,
    )
    for light, time_s, gain in (
        (1.0, 0.01, 2.5),
        (0.1, 0.01, 4.0),
        (5.0, 0.005, 1.0),
        (100.0, 0.001, 1.0),
    ):
        setting = ExposureLoop(ExposureControl(light=((0.0, light),), auto=auto), PERIOD).setting(
            0.0, part
        )
        assert (setting.time_s, setting.gain) == pytest.approx((time_s, gain), rel=0.01)


def test_unsettled_it_begins_as_set():
    auto = AutoExposure(settled=False)
    loop = ExposureLoop(ExposureControl(time_s=0.01, gain=1.5, auto=auto), PERIOD)
    first = loop.setting(0.0, part)
    assert (first.time_s, first.gain, first.collected) == pytest.approx((0.015, 1.0, 3.0))


def test_the_centre_is_metered_by_itself():
    image = np.zeros((48, 64, 3), np.uint8)
    image[12:36, 16:48] = 200
    assert AutoExposure(metering="centre").metered(image) == 200
    assert AutoExposure(metering="mean").metered(image) == pytest.approx(50)


def test_fixed_exposure_scales_the_light_and_clips():
    loop = ExposureLoop(ExposureControl(time_s=0.01, light=((1.0, 2.5), (2.0, 0.5))), PERIOD)
    for t, value in ((0.0, 80), (1.0, 200), (2.0, 40)):
        assert taken(loop.setting(t, part)).mean() == pytest.approx(value, rel=0.01)
    with pytest.raises(ParameterError, match="rising"):
        ExposureControl(light=((1.0, 3.0), (1.0, 0.5)))
