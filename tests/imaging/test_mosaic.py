"""A mosaic of colour filters: where markers are in its pictures, what plain surfaces keep, and
whose noise is alike.
"""

from __future__ import annotations

import functools

import numpy as np
import pytest

from vstestbed.camera import Perspective
from vstestbed.imaging.exposure import AutoExposure, ExposureControl, ExposureSetting
from vstestbed.imaging.sensor import SensorNoise

PATTERNS, WAYS = ("rggb", "grbg", "gbrg", "bggr"), ("linear", "edge_aware")
FINE = 16
Floats = np.ndarray


@functools.cache
def disc(
    u: float, v: float, radius: float, colour: tuple[float, float, float], ground: float = 90.0
) -> Floats:
    """A disc on grey (48, 64, 3) [0 to 255]; each pixel has the mean over its area."""
    y, x = (np.mgrid[0 : 48 * FINE, 0 : 64 * FINE] + 0.5) / FINE - 0.5
    share = (
        ((x - u) ** 2 + (y - v) ** 2 <= radius**2)
        .reshape(48, FINE, 64, FINE)
        .mean(axis=(1, 3))[..., None]
    )
    return (share * colour + (1 - share) * ground).astype(np.float32)


def centroid(image: Floats, ground: float = 90.0) -> Floats:
    away = np.abs(image.astype(float) - ground).sum(axis=2)
    away[away < 20] = 0
    vv, uu = np.mgrid[0:48, 0:64]
    return np.array([(away * uu).sum(), (away * vv).sum()]) / away.sum()


def through(light: Floats, pattern: str, way: str) -> Floats:
    sensor = SensorNoise(mosaic=pattern, demosaic=way)
    return (
        sensor.demosaiced(np.rint(sensor.filtered(light.astype(np.float32)) * 16).astype(np.uint16))
        / 16
    )


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("pattern", PATTERNS)
def test_a_marker_stays_where_it_is(pattern: str, way: str):
    rng, shifts, white = np.random.default_rng(1), [], []
    for _ in range(12):
        u, v = np.array([32.0, 24.0]) + rng.uniform(-1, 1, 2)
        for colour, found in (((200, 40, 40), shifts), ((230, 230, 230), white)):
            light = disc(u, v, 7.3, colour)
            found.append(centroid(through(light, pattern, way)) - centroid(light))
    assert (
        np.abs(np.mean(shifts, axis=0)).max() < 0.03 and np.sqrt(np.mean(np.square(shifts))) < 0.05
    )
    assert np.abs(white).max() < 0.05


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("pattern", PATTERNS)
def test_plain_surfaces_keep_their_colour(pattern: str, way: str):
    for colour in ((117, 117, 117), (200, 40, 90)):
        np.testing.assert_array_equal(
            through(np.broadcast_to(colour, (47, 63, 3)), pattern, way)[1:-1, 1:-1],
            np.broadcast_to(colour, (45, 61, 3)),
        )


def test_edges_of_a_white_plate_have_colours():
    light = np.full((48, 64, 3), 30.0, np.float32)
    light[:, 31:] = 220
    spread = {way: np.ptp(through(light, "rggb", way)[4:-4, 4:-4], axis=2) for way in WAYS}
    assert not np.ptp(light, axis=2).any()
    for seen in spread.values():
        # two pixels on either side
        assert seen[:, 25:29].max() > 20 and not seen[:, :24].any() and not seen[:, 32:].any()
    assert spread["edge_aware"].sum() <= spread["linear"].sum()


def test_noise_is_shared_with_neighbours_as_interpolation_has_it():
    sensor = SensorNoise(mosaic="rggb", demosaic="linear", bits=12, prnu=0, dsnu_e=0)
    light = np.full((240, 320, 3), 120, np.float32)
    raw = sensor.converted(
        sensor.filtered(light), ExposureSetting(), None, np.random.default_rng(3)
    )
    own = float(raw.astype(float).var())
    mu = 120 / 255 * sensor.full_well_e * sensor.K
    # one pixel, as EMVA has it
    assert own == pytest.approx(
        (sensor.K * sensor.dark_noise_e) ** 2 + 1 / 12 + sensor.K * mu, rel=0.02
    )
    filled = sensor.demosaiced(raw)[2:-2, 2:-2].astype(float)
    filled -= filled.mean(axis=(0, 1))
    for channel, share, alike in ((0, 9 / 16, 2 / 3), (1, 5 / 8, 2 / 5), (2, 9 / 16, 2 / 3)):
        one = filled[..., channel]
        assert (one**2).mean() / own == pytest.approx(share, rel=0.03)
        for a, b in ((one[:, :-1], one[:, 1:]), (one[:-1], one[1:])):
            assert (a * b).mean() / (one**2).mean() == pytest.approx(alike, abs=0.02)


def test_a_cameras_pictures_have_it():
    image = disc(32, 24, 7.3, (200, 40, 40)).astype(np.uint8)
    taken = {}
    for mosaic in ("none", "rggb"):
        exposure = ExposureControl(auto=AutoExposure(target_grey=80))
        camera = Perspective(
            width=64, height=48, exposure=exposure, sensor=SensorNoise(mosaic=mosaic, bits=10)
        )
        imaging = camera.imaging(np.random.default_rng(2))
        assert imaging is not None
        noisy, clean = imaging.taken(0.0, (image,), None)[0], imaging.clean(0.0, (image,), None)[0]
        assert noisy is not None and clean is not None and noisy.shape == (48, 64, 3)
        # metered as without
        assert noisy.mean() == pytest.approx(80, abs=1.5)
        assert clean.mean() == pytest.approx(80, abs=1.5)
        taken[mosaic] = noisy.astype(float) - clean
    mosaicked, plain = (taken[name][2:16, 2:-2].var() for name in ("rggb", "none"))
    assert 0.5 < mosaicked / plain < 0.8  # of the linear way 9/16 and 5/8, and rounding
