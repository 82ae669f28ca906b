"""A sensor's noise, the same whoever draws the picture."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Annotated

import numpy as np
from annotated_types import Ge, Gt, Lt

from vstestbed.camera import Frame, Image
from vstestbed.core.spec import spec


@spec
class Drift:
    """The camera's gains drift: brightness by 1 + brightness sin a, colour by red * (1 + color cos a) and blue * (1 - color cos a),

    with a = 2 pi t / period_s; what goes over 255 is clipped.

    Args:
        brightness: largest relative change of all channels. color: of red against blue. period_s: [s].
    """

    brightness: Annotated[float, Ge(0), Lt(1)] = 0.0
    color: Annotated[float, Ge(0), Lt(1)] = 0.0
    period_s: Annotated[float, Gt(0)] = 10.0

    def gains(self, t: float) -> tuple[float, float, float]:
        """Of red, green and blue at a time [s]."""
        a = 2 * math.pi * t / self.period_s
        all_three, red = 1 + self.brightness * math.sin(a), self.color * math.cos(a)
        return all_three * (1 + red), all_three, all_three * (1 - red)

    def of(self, frame: Frame) -> Frame:
        """The frame as the drifting camera gives it; itself where nothing drifts."""
        if self.brightness == 0 and self.color == 0:
            return frame
        return replace(frame, images=tuple(None if image is None else self._of_image(image, frame.t) for image in frame.images))

    def _of_image(self, image: Image, t: float) -> Image:
        tables = [np.clip(np.arange(256) * gain + 0.5, 0, 255).astype(np.uint8) for gain in self.gains(t)]
        return np.stack([table[image[..., i]] for i, table in enumerate(tables)], axis=-1)


NO_DRIFT = Drift()


def noisy(image: Image, sigma: float, rng: np.random.Generator | None) -> Image:
    """A picture (H, W, 3) with Gaussian noise of standard deviation `sigma` [grey levels] on each channel, rounded and clipped.

    Without noise, or without a generator that it comes from, the picture itself.
    """
    if sigma <= 0 or rng is None:
        return image
    noise = rng.standard_normal(image.shape, dtype=np.float32) * np.float32(sigma)
    return np.clip(image + noise + 0.5, 0, 255).astype(np.uint8)
