"""The parameters of EMVA 1288 recovered from pictures as the standard does it: photon transfer,
dark noise, DSNU, PRNU.
"""

from __future__ import annotations

import numpy as np
import pytest

from vstestbed.core.errors import ParameterError
from vstestbed.imaging.exposure import ExposureSetting
from vstestbed.imaging.sensor import WHITE, SensorNoise, noisy, plain

SHAPE = (200, 250, 3)
CHIP = SensorNoise(bits=12, black_level_dn=100, prnu=0.01, dsnu_e=3.0, dark_noise_e=4.0)


def light(value: float) -> np.ndarray:
    return np.full(SHAPE, value, np.float32)


def two(
    chip: SensorNoise, value: float, setting: ExposureSetting, seed: int = 0
) -> tuple[float, float]:
    """Mean and temporal variance from two pictures of one light, as the standard takes them [DN,
    DN^2].
    """
    pattern = chip.pattern((SHAPE[1], SHAPE[0]), np.random.default_rng(1))
    a, b = (
        chip.converted(light(value), setting, pattern, np.random.default_rng((seed, i))).astype(
            float
        )
        for i in (0, 1)
    )
    return float((a.mean() + b.mean()) / 2), float(((a - b) ** 2).mean() / 2)


@pytest.mark.parametrize("gain", [1.0, 4.0])
def test_the_photon_transfer_curve_has_the_slope_K_and_the_dark_noise(gain: float):
    dark, dark_variance = two(CHIP, 0.0, ExposureSetting(gain=gain))
    values = np.linspace(10, 180 / gain, 8)
    points = np.array(
        [two(CHIP, v, ExposureSetting(gain=gain), i + 1) for i, v in enumerate(values)]
    )
    slope = np.polyfit(points[:, 0] - dark, points[:, 1] - dark_variance, 1)[0]
    assert slope == pytest.approx(gain * CHIP.K, rel=0.01)
    assert dark == pytest.approx(100, abs=0.1)
    assert dark_variance == pytest.approx((gain * CHIP.K * 4.0) ** 2 + 1 / 12, rel=0.02)


def test_a_longer_exposure_has_less_noise_than_a_larger_gain():
    by_time = two(CHIP, 50.0, ExposureSetting(time_s=3.0))
    by_gain = two(CHIP, 50.0, ExposureSetting(gain=3.0))
    assert by_time[0] == pytest.approx(by_gain[0], rel=0.01)
    # K g (mu - dark), with the same mean
    assert by_gain[1] / by_time[1] == pytest.approx(3.0, rel=0.05)


def test_dsnu_and_prnu_are_found_in_the_mean_of_many_pictures():
    pattern = CHIP.pattern((SHAPE[1], SHAPE[0]), np.random.default_rng(1))

    def mean(value: float) -> np.ndarray:
        n = 12
        total = sum(
            CHIP.converted(
                light(value), ExposureSetting(), pattern, np.random.default_rng((5, i))
            ).astype(float)
            for i in range(n)
        )
        return np.asarray(total) / n

    dark, bright = mean(0.0), mean(128.0)
    left = (CHIP.K * 4.0) ** 2 / 12  # temporal noise that is left in the mean
    dsnu = np.sqrt(dark.var() - left)
    assert dsnu / CHIP.K == pytest.approx(3.0, rel=0.03)
    mu = bright.mean() - dark.mean()
    prnu = np.sqrt(bright.var() - dark.var() - CHIP.K * mu / 12) / mu
    assert prnu == pytest.approx(0.01, rel=0.05)


def test_the_default_is_the_camera_that_was_measured():
    """SNR and dynamic range by the standard's equations, against the maker's table: IMX250 in the
    mvBlueFOX3-2051, 40.3 and 71.2 dB.
    """
    chip = SensorNoise(bits=12)
    dark = chip.dark_noise_e**2 + 1 / 12 / chip.K**2
    least = np.sqrt(dark + 1 / 4) + 1 / 2  # electrons at which signal and noise are equal
    assert 20 * np.log10(np.sqrt(chip.full_well_e)) == pytest.approx(40.3, abs=0.15)
    assert 20 * np.log10(chip.full_well_e / least) == pytest.approx(71.2, abs=0.25)


def test_quantisation_alone_has_a_twelfth():
    chip = SensorNoise(dark_noise_e=0, prnu=0, dsnu_e=0, full_well_e=1000, gain_dn_per_e=0.1)
    ramp = np.linspace(20, 200, 30000, dtype=np.float32).reshape(100, 100, 3)
    read = chip.converted(ramp, ExposureSetting(), None, None)
    error = read - ramp.astype(float) * 1000 / WHITE * 0.1
    assert error.var() == pytest.approx(1 / 12, rel=0.01) and abs(error.mean()) < 0.01


@pytest.mark.parametrize("mean", [0.5, 5.0, 29.0, 40.0, 4000.0])
def test_shot_noise_has_the_moments_of_poissons_distribution(mean: float):
    n = noisy(np.full(300_000, mean, np.float32), 0.0, np.random.default_rng(2)).astype(float)
    assert n.mean() == pytest.approx(mean, rel=0.01)
    assert n.var() == pytest.approx(mean, rel=0.02)
    if mean < 30:  # drawn as it is, not by the normal distribution
        assert ((n - n.mean()) ** 3).mean() / n.std() ** 3 == pytest.approx(mean**-0.5, abs=0.03)


def test_the_well_and_the_converter_are_full_where_they_should_be():
    well = SensorNoise(
        full_well_e=5000, white_e=10000, gain_dn_per_e=0.02, prnu=0, dsnu_e=0, dark_noise_e=0
    )
    read = well.converted(light(255.0), ExposureSetting(), None, None)
    assert (read == 100).all()  # 5000 e- at .02 DN/e-, though white would be 10000
    assert (CHIP.read(light(300.0), ExposureSetting(), None, None) == 255).all()
    assert (SensorNoise().read(light(255.0), ExposureSetting(), None, None) == 255).all()
    assert (
        CHIP.read(light(0.0), ExposureSetting(), None, None) == 100 >> 4
    ).all() and CHIP.black == 6.25
    with pytest.raises(ParameterError, match="half of the largest"):
        SensorNoise(black_level_dn=200)


def test_without_noise_it_is_the_plain_picture():
    ramp = np.tile(np.arange(256, dtype=np.float32)[:, None, None], (1, 2, 3))
    np.testing.assert_array_equal(
        SensorNoise().read(ramp, ExposureSetting(), None, None), plain(ramp, ExposureSetting())
    )
