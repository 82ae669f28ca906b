"""Noise of the image sensor: as strong as asked for, of its generator, the same at a pixel whatever
else is drawn.
"""

from __future__ import annotations

import numpy as np
import pytest

from vstestbed.camera import Image
from vstestbed.imaging.sensor import Drift, ImageNoise

GREY: Image = np.full((200, 160, 3), 128, np.uint8)
SIGMA = 3.0


def noise(seed: int) -> ImageNoise:
    return ImageNoise(SIGMA, np.random.default_rng(seed))


def test_it_is_that_of_the_generator_and_new_in_each_picture():
    of_five = noise(5)
    first, second = (of_five.next()((GREY,))[0] for _ in range(2))
    assert first is not None and second is not None
    np.testing.assert_array_equal(first, noise(5).next()((GREY,))[0])
    assert not np.array_equal(first, second)
    assert not np.array_equal(first, noise(6).next()((GREY,))[0])
    # 3 grey levels and 1/12 of rounding; 1e5 samples determine it to a quarter of a per cent.
    assert (first.astype(float) - 128).std() == pytest.approx(np.sqrt(SIGMA**2 + 1 / 12), rel=0.01)


def test_it_depends_on_pixel_and_panel_alone():
    of_picture = noise(5).next()
    part = GREY.copy()
    part[:, 50:] = 60
    whole = of_picture((GREY, GREY, GREY))
    some = of_picture((part, None, GREY))
    assert some[0] is not None and some[1] is None
    np.testing.assert_array_equal(some[0][:, :50], whole[0][:, :50])
    # the same number, rounded in another place
    np.testing.assert_allclose(some[0][:, 50:] + 68.0, whole[0][:, 50:], atol=1)
    np.testing.assert_array_equal(some[2], whole[2])
    assert not np.array_equal(whole[0], whole[2])


def test_without_noise_nothing_is_copied():
    for none in (ImageNoise(), ImageNoise(0.0, np.random.default_rng(0))):
        assert none.next()((GREY,))[0] is GREY


def test_contrast_drifts_about_the_middle_grey():
    levels: Image = np.repeat(np.array([[28, 128, 228]], np.uint8)[..., None], 3, axis=2)
    # a quarter of a period before the end: -1
    after = Drift(contrast=0.5, period_s=4.0).of((levels,), 3.0)[0]
    assert after is not None and after[0, :, 1].tolist() == [78, 128, 178]
