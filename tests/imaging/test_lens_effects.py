"""Discs of defocus against the moments and the edge of a disc in closed form; lateral colour and
vignetting in pixels.
"""

from __future__ import annotations

import numpy as np
import pytest

from vstestbed.camera import Perspective
from vstestbed.imaging.optics import Defocus, LensEffects, Optics, defocused, disc

WIDE, HIGH = 160, 120
CAMERA = Perspective(width=WIDE, height=HIGH)
SHAPE = (HIGH, WIDE)


def effects(optics: Optics, camera: Perspective = CAMERA) -> LensEffects:
    return LensEffects(optics, (WIDE, HIGH), camera.centre, camera.ray, camera.f)


def edge(value: float = 200.0) -> np.ndarray:
    image = np.zeros((*SHAPE, 3), np.float32)
    image[:, WIDE // 2 :] = value
    return image


def spread(profile: np.ndarray) -> tuple[float, float]:
    """Mean [px] and variance [px^2] of the line that an edge's profile is the integral of."""
    line = np.diff(profile)
    at = np.arange(len(line)) + 0.5
    mean = (line * at).sum() / line.sum()
    return float(mean), float((line * (at - mean) ** 2).sum() / line.sum())


@pytest.mark.parametrize("c", [1.0, 2.7, 6.0, 15.3])
def test_a_disc_has_the_variance_of_a_disc(c: float):
    kernel = disc(c)
    at = np.arange(len(kernel)) - len(kernel) // 2
    assert kernel.sum() == pytest.approx(1, abs=1e-5)
    # A disc's variance along an axis is (c/2)^2 / 4; a pixel's own 1/12 is added, as each has its
    # share of the area.
    assert (kernel.sum(axis=0) * at**2).sum() == pytest.approx(
        c * c / 16, abs=0.09 + 0.005 * c * c / 16
    )


@pytest.mark.parametrize("c", [3.0, 8.0, 20.0])
def test_an_edge_becomes_the_integral_of_a_disc(c: float):
    profile = defocused(edge(), np.full(SHAPE, c, np.float32))[60, :, 0] / 200
    x = np.clip((np.arange(WIDE) - (WIDE // 2 - 0.5)) / (c / 2), -1, 1)
    expected = 0.5 + (x * np.sqrt(1 - x * x) + np.arcsin(x)) / np.pi
    np.testing.assert_allclose(profile, expected, atol=0.02)
    mean, _ = spread(profile)
    assert mean == pytest.approx(WIDE // 2 - 0.5, abs=0.01)  # an edge stays where it is


def test_a_slanted_plane_is_blurred_everywhere_by_its_own_depth():
    stripes = np.zeros((*SHAPE, 3), np.float32)
    stripes[:, 80:] = 200
    circle = np.repeat(np.linspace(1, 9, HIGH, dtype=np.float32)[:, None], WIDE, axis=1)
    image = defocused(stripes, circle)
    for row in (20, 60, 100):
        mean, variance = spread(image[row, :, 0].astype(float))
        c = float(circle[row, 0])
        assert mean == pytest.approx(79.5, abs=0.02)
        # Layers of which each is off by .25 px + 5 % at most, mixed at their seams.
        assert np.sqrt(16 * (variance - 1 / 12 * (c < 1))) == pytest.approx(c, abs=0.5 + 0.1 * c)
    flat = defocused(np.full_like(stripes, 90), circle)
    np.testing.assert_allclose(flat, 90, rtol=1e-4)  # no seam between the layers


def test_what_is_sharp_in_front_stays_sharp_and_what_is_blurred_in_front_covers():
    image, circle = edge(), np.zeros(SHAPE, np.float32)
    circle[:, : WIDE // 2] = -8.0  # dark, far and blurred; the bright half in focus
    after = defocused(image, circle)
    np.testing.assert_allclose(after, image, atol=1e-3)
    circle = np.zeros(SHAPE, np.float32)
    circle[:, WIDE // 2 :] = 8.0  # bright, near and blurred: it spills over the sharp dark half
    after = defocused(image, circle)
    assert after[60, WIDE // 2 - 3, 0] > 10 and after[60, WIDE // 2 - 6, 0] < 1


def test_the_depth_decides_through_the_lens_of_the_camera():
    optics = Optics(defocus=Defocus(focus_m=0.5, f_number=1.4, focal_length_m=0.008))
    camera = Perspective(width=WIDE, height=HIGH, optics=optics)
    lens, image = effects(optics, camera), edge().astype(np.uint8)
    assert lens.needs_depth
    sharp = lens.of(image, np.full(SHAPE, 0.5, np.float32))
    np.testing.assert_allclose(sharp, image, atol=1e-4)
    c = 0.008 / 1.4 * camera.f * (1 / 0.05 - 1 / 0.5)
    _, variance = spread(lens.of(image, np.full(SHAPE, 0.05, np.float32))[60, :, 0].astype(float))
    assert np.sqrt(16 * variance) == pytest.approx(c, rel=0.02)


def test_lateral_colour_moves_red_and_blue_along_the_radius():
    optics = Optics(red_px=2.0, blue_px=-1.0)
    image = np.zeros((*SHAPE, 3), np.uint8)
    v, u = np.ogrid[:HIGH, :WIDE]
    spots = [(130.0, 95.0), (30.0, 60.0), (79.5, 20.0)]
    for x, y in spots:
        blob = 200 * np.exp(-((u - x) ** 2 + (v - y) ** 2) / 18)
        image = np.maximum(image, blob[..., None].astype(np.uint8))
    after = effects(optics).of(image, None)
    corner = np.hypot(79.5, 59.5)
    for x, y in spots:
        window = (np.abs(u - x) < 14) & (np.abs(v - y) < 14)
        for channel, px in enumerate((2.0, 0.0, -1.0)):
            at = [
                (after[..., channel] * window * axis).sum() / (after[..., channel] * window).sum()
                for axis in (u, v)
            ]
            before = [
                (image[..., 1] * window * axis).sum() / (image[..., 1] * window).sum()
                for axis in (u, v)
            ]
            moved = np.array([x - 79.5, y - 59.5]) * px / corner
            np.testing.assert_allclose(np.array(at) - before, moved, atol=0.05)


def test_vignetting_is_the_cos4_law_and_the_share_in_the_corner():
    white = np.full((*SHAPE, 3), 200, np.uint8)
    natural = effects(Optics(cos4=True)).of(white, None)[..., 0]
    for u, v in ((0, 0), (79, 59), (159, 60), (80, 119)):
        tangent2 = ((u - 79.5) ** 2 + (v - 59.5) ** 2) / CAMERA.f**2
        assert natural[v, u] == pytest.approx(200 / (1 + tangent2) ** 2, rel=1e-4)
    mechanical = effects(Optics(vignetting=0.4)).of(white, None)[..., 0]
    assert mechanical[0, 0] == pytest.approx(120, rel=1e-4)
    assert mechanical[60, 80] == pytest.approx(200, rel=1e-3)


def test_a_blurred_picture_has_no_negative_light() -> None:
    """Of large discs OpenCV multiplies Fourier transforms, and shot noise has no negative
    expectation.
    """
    light = np.zeros((60, 80, 3), np.float32)
    light[20:40, 30:50] = 255
    assert defocused(light, np.full((60, 80), 25.0, np.float32)).min() == 0
