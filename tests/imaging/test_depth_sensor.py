"""Depth sensors against their formulas: standard deviation, steps, range, shadows of the baseline,
raggedness, correlation.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from vstestbed.camera import DEPTH_SENSORS, Catadioptric, DepthSensor, Perspective
from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array
from vstestbed.imaging.depth import (
    Ideal,
    Stereo,
    StructuredLight,
    TimeOfFlight,
    correlated,
    incidence,
)

F, SHAPE = 400.0, (120, 160)
V, U = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
XY = np.stack([(U - 79.5) / F, (V - 59.5) / F], axis=-1)


def measured(sensor: DepthSensor, z: Array | float, seed: int = 0) -> Array:
    true = np.broadcast_to(np.asarray(z, np.float32), SHAPE)
    return sensor.measured(true, XY, F, np.random.default_rng(seed)).astype(float)


def plane(angle_deg: float, at_m: float = 1.0) -> Array:
    """Depths of a plane through (0, 0, at_m), its normal turned by an angle from the optical axis
    about y.
    """
    a = math.radians(angle_deg)
    return at_m / (1 - math.tan(a) * XY[..., 0])


@pytest.mark.parametrize("z", [0.7, 1.5, 3.0])
def test_noise_has_the_standard_deviation_of_the_formula(z: float):
    formulas = {
        Stereo(quantum_px=0): z * z * 0.08 / (F * 0.05),
        StructuredLight(quantum_px=0): 0.0012 + 0.0019 * (z - 0.4) ** 2,
        TimeOfFlight(): 1e-3 * (1.5 - 0.5 * z + 0.3 * z * z),
        Ideal(sigma_m=0.1): 0.1,
    }
    for sensor, sigma in formulas.items():
        # Over pictures, not within one: the noise is correlated over a window. Towards the corners
        # the angle adds under 1 %.
        errors = np.stack([measured(sensor, z, seed)[::8, ::8] for seed in range(10)]) - z
        assert np.nanstd(errors) == pytest.approx(sigma, rel=0.07), sensor.kind
        assert abs(np.nanmean(errors)) < 4 * sigma / math.sqrt(np.isfinite(errors).sum()), (
            sensor.kind
        )


def test_noise_grows_with_the_angle_as_nguyen_says():
    theta = math.radians(75)
    sensor, true = StructuredLight(quantum_px=0, lateral_px=0), plane(75)
    errors = np.stack(
        [(measured(sensor, true, seed) - true)[20:100:5, 79:81] for seed in range(60)]
    )
    assert errors.std() == pytest.approx(
        0.0012 + 0.0019 * 0.36 + 0.0001 * theta**2 / (math.pi / 2 - theta) ** 2, rel=0.08
    )


def test_correlated_noise_has_unit_variance_and_the_correlation_of_its_window():
    n = correlated((400, 400), 5, np.random.default_rng(0))
    assert n.std() == pytest.approx(1.0, abs=0.03)
    assert [np.mean(n[:, k:] * n[:, : 400 - k]) for k in (1, 3, 5)] == pytest.approx(
        [0.8, 0.4, 0.0], abs=0.04
    )


def test_disparity_has_steps():
    """dZ = Z^2 quantum / (f b), 6.7 mm at 2 m here; each value is one of the steps, and a step's
    error is uniform.
    """
    sensor = Ideal(baseline_m=0.075, quantum_px=0.125)
    z = np.linspace(1.95, 2.05, 160)[None] * np.ones(SHAPE)
    steps = F * 0.075 / measured(sensor, z) / 0.125
    np.testing.assert_allclose(steps, steps.round(), atol=1e-3)
    size = 4 * 0.125 / (F * 0.075)
    assert np.diff(np.unique(measured(sensor, z))).max() == pytest.approx(size, rel=0.06)
    assert (measured(sensor, z) - z).std() == pytest.approx(size / math.sqrt(12), rel=0.1)


def test_range_has_limits():
    for sensor in (Ideal(near_m=0.5, far_m=4), StructuredLight(), TimeOfFlight()):
        for z, there in (
            (sensor.near_m - 0.03, 0),
            (sensor.near_m + 0.03, 1),
            (sensor.far_m - 0.3, 1),
            (sensor.far_m + 0.3, 0),
        ):
            assert np.isfinite(measured(sensor, z)).mean() == there, (sensor.kind, z)
    assert np.isnan(measured(Stereo(), np.inf)).all()
    assert np.isnan(measured(Stereo(), 60.0)).all(), (
        "noise of metres must not bring it back into the range"
    )


@pytest.mark.parametrize(
    "near, far, baseline",
    [(1.0, 2.0, 0.05), (0.5, 1.0, 0.05), (1.0, 1.2, 0.1), (0.8, np.inf, 0.05)],
)
def test_shadow_is_as_wide_as_the_difference_of_disparities(
    near: float, far: float, baseline: float
):
    z = np.where(U > 100, near, far)
    hole = np.isnan(measured(Ideal(baseline_m=baseline), z))
    width = F * baseline * (1 / near - 1 / far)
    if np.isinf(far):
        assert not hole[:, 101:].any()
        return
    assert hole.sum(axis=1) == pytest.approx(width, abs=1.01)
    assert not hole[:, 101:].any() and not hole[:, : int(100 - width)].any(), (
        "the hole is left of the nearer surface"
    )
    assert not np.isnan(measured(Ideal(baseline_m=baseline), z[:, ::-1])).any(), (
        "at a right border both views see the same"
    )


def test_thin_object_shades_its_own_width_alone():
    # disparities 40 and 10: the shadow lies 30 px to the left
    z = np.where((U > 100) & (U <= 104), 0.5, 2.0)
    hole = np.isnan(measured(Ideal(baseline_m=0.05), z)).sum(axis=1)
    assert hole == pytest.approx(4, abs=1.01)


def test_second_picture_ends_at_its_border():
    holes = np.isnan(measured(Stereo(lateral_px=0), 0.5))
    assert holes[:, :40].all() and not holes[:, 40:].any()  # disparity 400 * 0.05 / 0.5 = 40 px


@pytest.mark.parametrize("angle", [0, 30, 60, 85])
def test_incidence_of_a_plane(angle: float):
    theta = incidence(plane(angle).astype(np.float32), XY, F)
    normal = np.array([-math.sin(math.radians(angle)), 0, math.cos(math.radians(angle))])
    ray = np.concatenate([XY, np.ones((*SHAPE, 1))], axis=-1)
    wanted = np.arccos(np.clip(ray @ normal / np.linalg.norm(ray, axis=-1), -1, 1))
    seen = plane(angle) > 0
    assert np.abs(theta - wanted)[seen].max() < math.radians(0.5)


def test_grazing_surface_is_a_hole():
    assert np.isnan(measured(Ideal(grazing_deg=80), plane(84))[:, 79:81]).all()
    assert not np.isnan(measured(Ideal(grazing_deg=80), plane(75))[:, 79:81]).any()


def test_edges_are_ragged_by_the_lateral_noise():
    """The first column that shows the nearer surface scatters; no depth lies between both."""
    z = np.where(U > 80, 1.0, 2.0)
    shown = measured(Ideal(lateral_px=1.0), z)
    assert set(np.unique(shown)) == {1.0, 2.0}
    wrong = (shown != z).mean(axis=0)
    assert wrong[:70].max() == 0 == wrong[90:].max()
    # Beside the edge a shift of half a pixel and more crosses it: P(n >= 0.5) = 0.31.
    assert wrong[[80, 81]] == pytest.approx(0.31, abs=0.1)


def test_time_of_flight_has_flying_pixels():
    z = np.where(U > 80, 1.0, 2.0)
    between = (lambda d: (d > 1.05) & (d < 1.95))(measured(TimeOfFlight(), z))
    assert (
        between[:, 80:82].mean() > 0.8 and not between[:, :80].any() and not between[:, 82:].any()
    )


def test_a_picture_is_a_function_of_its_seed():
    for kind in DEPTH_SENSORS.members.values():
        a, b, c = (measured(kind(), plane(20), seed) for seed in (1, 1, 2))
        np.testing.assert_array_equal(a, b)
        assert np.array_equal(a, c, equal_nan=True) != kind().draws


def test_wrong_sensors_are_refused():
    with pytest.raises(ParameterError, match="near_m must be under far_m"):
        Stereo(near_m=3, far_m=2)
    with pytest.raises(ParameterError, match="depth_sensor is for camera perspective"):
        Catadioptric(depth_sensor=Stereo())
    assert Perspective(depth_sensor="stereo").depth_sensor == Stereo()
