"""Motion blur: the mean of pictures taken while the shutter is open."""

from __future__ import annotations

import numpy as np

from vstestbed.camera import Frame, Image, Look
from vstestbed.core.geometry import Array
from vstestbed.sim.base import Eyes


class Exposure:
    """Collects the light of one picture after the other; the sensor's noise comes once, when the shutter has closed.

    Brightness is summed as the pictures' grey levels tell it, which are taken to be linear in the light.

    Args:
        eye: makes the pictures.
    """

    def __init__(self, eye: Eyes):
        self._eye = eye
        self._sums: list[Array | None] = []
        self._weight, self._whole = 0.0, True

    def add(self, weight: float, look: Look | None = None) -> None:
        """What is seen now, for a share of the exposure."""
        images = self._eye.glimpse(look, clean=True)
        if not self._sums:
            self._sums, self._whole = [None] * len(images), True
        for i, image in enumerate(images):
            if image is not None:
                part, before = image * np.float64(weight), self._sums[i]
                self._sums[i] = part if before is None else before + part
        self._weight += weight
        self._whole = self._whole and self._eye.whole

    def developed(self, t: float) -> Frame:
        """The picture of all since the last one, stamped t [s]."""
        images: list[Image | None] = [
            None if s is None else self._eye.grained(np.clip(s / self._weight + 0.5, 0, 255).astype(np.uint8)) for s in self._sums
        ]
        self._sums, self._weight = [], 0.0
        return Frame(t, tuple(images), self._whole)
