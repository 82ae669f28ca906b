"""Noise and gain drift of the image sensor, the same for every renderer."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Annotated

import numpy as np
from annotated_types import Ge, Lt

from vstestbed.camera import Image, Picture
from vstestbed.core.quantity import PositiveTime
from vstestbed.core.spec import spec


@spec
class Drift:
    """Slow drift of the sensor's gains, with a = 2 pi t / period_s:

    red   (1 + brightness sin a) (1 + color cos a)
    green (1 + brightness sin a)
    blue  (1 + brightness sin a) (1 - color cos a)

    Values above 255 are clipped.

    Args:
        brightness: largest relative change of all channels [1].
        color: largest relative change of red, and the opposite one of blue [1].
        period_s: period of both [s].
    """

    brightness: Annotated[float, Ge(0), Lt(1)] = 0.0
    color: Annotated[float, Ge(0), Lt(1)] = 0.0
    period_s: PositiveTime = 10.0

    def gains(self, t: float) -> tuple[float, float, float]:
        """Gains of red, green and blue at time t [s]."""
        a = 2 * math.pi * t / self.period_s
        all_three, red = 1 + self.brightness * math.sin(a), self.color * math.cos(a)
        return all_three * (1 + red), all_three, all_three * (1 - red)

    def of(self, picture: Picture) -> Picture:
        """The picture with the gains of its time; the same object where nothing drifts."""
        if self.brightness == 0 and self.color == 0:
            return picture
        return replace(picture, images=tuple(None if image is None else self._of_image(image, picture.t) for image in picture.images))

    def _of_image(self, image: Image, t: float) -> Image:
        # A lookup table of 256 entries for each channel is quicker than arithmetic on every pixel.
        tables = [np.clip(np.arange(256) * gain + 0.5, 0, 255).astype(np.uint8) for gain in self.gains(t)]
        return np.stack([table[image[..., i]] for i, table in enumerate(tables)], axis=-1)


NO_DRIFT = Drift()


def noisy(image: Image, sigma: float, rng: np.random.Generator | None) -> Image:
    """An image (H, W, 3) with Gaussian noise of standard deviation `sigma` [grey levels] on each channel, rounded and clipped.

    The same object where sigma is 0 or no generator is given.
    """
    if sigma <= 0 or rng is None:
        return image
    noise = rng.standard_normal(image.shape, dtype=np.float32) * np.float32(sigma)
    return np.clip(image + noise + 0.5, 0, 255).astype(np.uint8)
