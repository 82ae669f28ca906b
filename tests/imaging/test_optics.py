"""The circle of confusion against the textbook's depth of field; what a lens cannot have."""

from __future__ import annotations

import numpy as np
import pytest

from vstestbed.camera import Catadioptric, Perspective, SphericalCamera
from vstestbed.core.errors import ParameterError
from vstestbed.imaging.optics import Defocus, Optics

F, N, FOCUS, PITCH = 0.016, 2.0, 0.8, 3.45e-6
LENS = Defocus(focus_m=FOCUS, f_number=N, focal_length_m=F)


def circle(z: float, f_px: float) -> float:
    return float(LENS.circle_px(np.array([[z]], np.float32), f_px, F)[0, 0])


def test_the_circle_on_the_sensor_is_that_of_the_thin_lens():
    # the sensor's distance from the lens in pixels: what a calibration finds
    f_px = F * FOCUS / (FOCUS - F) / PITCH
    for z in (0.3, 0.7, 0.8, 1.5, 20.0):
        on_sensor = F / N * abs(z - FOCUS) / z * F / (FOCUS - F)
        assert abs(circle(z, f_px)) * PITCH == pytest.approx(on_sensor, rel=1e-4, abs=1e-10)
    assert circle(0.3, f_px) > 0 > circle(1.5, f_px)


def test_the_sky_has_the_circle_of_the_hyperfocal_distance():
    f_px = F * FOCUS / (FOCUS - F) / PITCH
    assert abs(circle(np.inf, f_px)) * PITCH == pytest.approx(F * F / (N * (FOCUS - F)), rel=1e-4)


@pytest.mark.parametrize("allowed_m", [5e-6, 2e-5])
def test_the_depth_of_field_is_the_textbooks(allowed_m: float):
    hyperfocal = F * F / (N * allowed_m) + F
    near = FOCUS * (hyperfocal - F) / (hyperfocal + FOCUS - 2 * F)
    far = FOCUS * (hyperfocal - F) / (hyperfocal - FOCUS)
    f_px = F * FOCUS / (FOCUS - F) / PITCH
    for z in (near, far):
        assert abs(circle(z, f_px)) * PITCH == pytest.approx(allowed_m, rel=1e-3)


def test_a_lens_without_a_focal_length_or_an_image_is_refused():
    for given, field, words in (
        (
            {"optics": Optics(defocus=Defocus(focus_m=0.5, f_number=2))},
            "optics.defocus.focal_length_m",
            "needed",
        ),
        (
            {"optics": Optics(defocus=LENS), "focal_length_m": F, "pixel_size_m": PITCH},
            "optics.defocus.focal_length_m",
            "leave one of the two out",
        ),
        (
            {"optics": Optics(defocus=Defocus(focus_m=0.01, f_number=2, focal_length_m=F))},
            "optics.defocus.focus_m",
            "farther than the focal length",
        ),
    ):
        with pytest.raises(ParameterError, match=words) as caught:
            Perspective(**given)
        assert caught.value.field == field


@pytest.mark.parametrize("optics", [Optics(cos4=True), Optics(defocus=LENS)])
def test_wide_lenses_have_neither_the_cos4_law_nor_defocus(optics: Optics):
    Catadioptric(optics=Optics(vignetting=0.3, red_px=1.0))
    with pytest.raises(ParameterError, match="camera perspective"):
        Catadioptric(optics=optics)


def test_a_camera_of_several_pictures_has_none_of_it():
    with pytest.raises(ParameterError, match="one picture"):
        SphericalCamera(optics=Optics(vignetting=0.3))
