"""Motion blur: the mean of the images rendered while the shutter is open."""

from __future__ import annotations

import numpy as np

from vstestbed.camera import Image, Look, Picture
from vstestbed.core.geometry import Array
from vstestbed.sim.base import Renderer


class MotionBlur:
    """Weighted mean of the images of one exposure; the sensor's noise is added once, when the shutter has closed.

    Grey levels are averaged as they are, that is, they are taken to be linear in the light.

    Args:
        renderer: renders the images.
    """

    def __init__(self, renderer: Renderer):
        self._renderer = renderer
        self._sums: list[Array | None] = []
        self._weight, self._whole = 0.0, True

    def add(self, weight: float, look: Look | None = None) -> None:
        """Render the present scene and add it with a share `weight` of the exposure."""
        images = self._renderer.images(look, clean=True)
        if not self._sums:
            self._sums, self._whole = [None] * len(images), True
        for i, image in enumerate(images):
            if image is not None:
                part, before = image * np.float64(weight), self._sums[i]
                self._sums[i] = part if before is None else before + part
        self._weight += weight
        self._whole = self._whole and self._renderer.whole

    def developed(self, t: float) -> Picture:
        """The picture of all that was added since the last call, with time stamp t [s]."""
        images: list[Image | None] = [
            None if s is None else self._renderer.with_noise(np.clip(s / self._weight + 0.5, 0, 255).astype(np.uint8)) for s in self._sums
        ]
        self._sums, self._weight = [], 0.0
        return Picture(t, tuple(images), self._whole)
