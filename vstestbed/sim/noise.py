"""A sensor's noise, the same whoever draws the picture."""

from __future__ import annotations

import numpy as np

from vstestbed.camera import Image


def noisy(image: Image, sigma: float, rng: np.random.Generator | None) -> Image:
    """A picture (H, W, 3) with Gaussian noise of standard deviation `sigma` [grey levels] on each channel, rounded and clipped.

    Without noise, or without a generator that it comes from, the picture itself.
    """
    if sigma <= 0 or rng is None:
        return image
    noise = rng.standard_normal(image.shape, dtype=np.float32) * np.float32(sigma)
    return np.clip(image + noise + 0.5, 0, 255).astype(np.uint8)
