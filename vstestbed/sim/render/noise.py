"""Noise and gain drift of the image sensor, the same for every renderer."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from annotated_types import Ge, Lt

from vstestbed.camera import Image, Picture
from vstestbed.core.quantity import PositiveTime
from vstestbed.core.spec import spec
from vstestbed.vision.perturb import GREY


@spec
class Drift:
    """Slow drift of the sensor's gains, with a = 2 pi t / period_s:

    red   (1 + brightness sin a) (1 + color cos a)
    green (1 + brightness sin a)
    blue  (1 + brightness sin a) (1 - color cos a)

    then the contrast of all, I' = (1 + contrast sin a) (I - 128) + 128. Values beyond 0 to 255 are clipped.

    Args:
        brightness: largest relative change of all channels [1]; e.g. `0.2`.
        color: largest relative change of red, and the opposite one of blue [1]; e.g. `0.1`.
        contrast: largest relative change of the contrast [1]; e.g. `0.2`.
        period_s: period of all of them [s].
    """

    brightness: Annotated[float, Ge(0), Lt(1)] = 0.0
    color: Annotated[float, Ge(0), Lt(1)] = 0.0
    contrast: Annotated[float, Ge(0), Lt(1)] = 0.0
    period_s: PositiveTime = 10.0

    def gains(self, t: float) -> tuple[float, float, float]:
        """Gains of red, green and blue at time t [s]."""
        a = 2 * math.pi * t / self.period_s
        all_three, red = 1 + self.brightness * math.sin(a), self.color * math.cos(a)
        return all_three * (1 + red), all_three, all_three * (1 - red)

    def of(self, picture: Picture) -> Picture:
        """The picture with the gains of its time; the same object where nothing drifts."""
        if self.brightness == self.color == self.contrast == 0:
            return picture
        return replace(picture, images=tuple(None if image is None else self._of_image(image, picture.t) for image in picture.images))

    def _of_image(self, image: Image, t: float) -> Image:
        # A lookup table of 256 entries for each channel is quicker than arithmetic on every pixel.
        c = 1 + self.contrast * math.sin(2 * math.pi * t / self.period_s)
        tables = [np.clip(c * np.arange(256) * gain + (1 - c) * GREY + 0.5, 0, 255).astype(np.uint8) for gain in self.gains(t)]
        return np.stack([table[image[..., i]] for i, table in enumerate(tables)], axis=-1)


NO_DRIFT = Drift()


class ImageNoise:
    """Gaussian noise of an image sensor, drawn anew for each picture.

    Args:
        sigma: standard deviation on each channel [grey levels of 255].
        rng: source of the noise; None for none.
    """

    def __init__(self, sigma: float = 0.0, rng: np.random.Generator | None = None):
        self._sigma, self._rng = sigma, rng if sigma > 0 else None

    @property
    def acts(self) -> bool:
        """Whether there is any."""
        return self._rng is not None

    def next(self) -> PictureNoise:
        """The noise of the next picture."""
        return PictureNoise(self._sigma, None if self._rng is None else int(self._rng.integers(2**63)))


@dataclass(frozen=True, slots=True)
class PictureNoise:
    """The noise of one picture: a function of pixel and panel alone, whichever of them are drawn, and however often.

    Attributes:
        sigma: standard deviation [grey levels]. seed: of this picture; None for no noise.
    """

    sigma: float
    seed: int | None

    def added(self, images: tuple[Image | None, ...]) -> tuple[Image | None, ...]:
        """The panels' images (H, W, 3) with the noise, rounded and clipped; the same objects where there is none."""
        if self.seed is None:
            return images
        return tuple(None if image is None else self._added(image, np.random.default_rng((self.seed, i))) for i, image in enumerate(images))

    def _added(self, image: Image, rng: np.random.Generator) -> Image:
        noise = rng.standard_normal(image.shape, dtype=np.float32) * np.float32(self.sigma)
        return np.clip(image + noise + 0.5, 0, 255).astype(np.uint8)
