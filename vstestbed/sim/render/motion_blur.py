"""The mean of the images of an exposure, each with its weight, or with one for each row of the camera's picture (rolling shutter)."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from vstestbed.camera import Camera, Look, Panel, Window
from vstestbed.core.geometry import Array
from vstestbed.sim.row_weights import Rows, RowWeight
from vstestbed.vision.colour import noise_rows
from vstestbed.vision.perturb import Images

Sum = Array | NDArray[np.float32]


class PixelRows:
    """In which row of the camera's own picture each pixel is, which says when it is exposed.

    Of a lens with panels each pixel of a panel is exposed with the row of the camera's own picture that shows the same direction.

    Args:
        camera: the lens. noisy: noise will be added: the rows from which detectors estimate its level are always drawn.
    """

    def __init__(self, camera: Camera, noisy: bool = False):
        self._camera, self._noisy = camera, noisy

    @cached_property
    def _in_panels(self) -> tuple[NDArray[np.intp], ...] | None:
        """The nearest rows (h, w) of the pixels of each panel; None for a camera whose only panel is its own picture."""
        panels = self._camera.panels
        return None if panels[0].lens is self._camera else tuple(self._rows(panel) for panel in panels)

    def _rows(self, panel: Panel) -> NDArray[np.intp]:
        lens = panel.lens
        uv = np.stack(np.meshgrid(np.arange(lens.width), np.arange(lens.height)), axis=-1).astype(float)
        v = self._camera.project(lens.ray(uv) @ panel.R_camera_panel.T)[..., 1]
        return np.clip(np.rint(np.nan_to_num(v)), 0, self._camera.height - 1).astype(np.intp)

    def weights(self, weight: RowWeight) -> tuple[RowWeight, ...]:
        """The weights of the pixels of each panel, (h, 1, 1) or (h, w, 1); a weight of the whole picture as it is."""
        if not isinstance(weight, np.ndarray):
            return (weight,) * len(self._camera.panels)
        if self._in_panels is None:
            return (weight[:, None, None],)
        return tuple(weight[v][..., None] for v in self._in_panels)

    def needed(self, look: Look | None, weights: tuple[RowWeight, ...]) -> tuple[Look | None, Rows | None]:
        """Regions of interest and rows, None for everything, without what has no weight; weights: of the pixels of each panel."""
        if not isinstance(weights[0], np.ndarray):
            return look, None
        if self._in_panels is None:
            return look if look is None else self._asked(look), band(weights[0])
        asked = self._asked(look)
        return tuple(windows if part.any() else () for windows, part in zip(asked, map(np.asarray, weights), strict=True)), None

    def _asked(self, look: Look | None) -> Look:
        """The windows that are needed of each panel."""
        lenses = [panel.lens for panel in self._camera.panels]
        if look is None:
            return tuple(((0, 0, lens.width, lens.height),) for lens in lenses)
        return tuple(windows and windows + self._noise_rows(lens) for windows, lens in zip(look, lenses, strict=True))

    def _noise_rows(self, lens: Camera) -> tuple[Window, ...]:
        """The rows from which the level of the noise is estimated; none without noise."""
        return tuple((0, v, lens.width, v + 1) for v in noise_rows(lens.height)) if self._noisy else ()


def band(weight: Array) -> Rows:
    """First row with a weight (H, ...), and the one after the last; (0, 1) where no row has any."""
    rows = np.flatnonzero(weight.reshape(len(weight), -1).any(axis=1))
    return (int(rows[0]), int(rows[-1]) + 1) if len(rows) else (0, 1)


class MotionBlur:
    """Weighted mean of the images rendered while the shutter is open.

    Grey levels are averaged as they are, that is, they are taken to be linear in the light. Weights of rows must add up to 1 in each row.

    Attributes:
        whole: all images are complete.
    """

    def __init__(self) -> None:
        self.whole = True
        self._total: float | None = 0.0
        self._sums: list[Sum | None] = []

    def add(self, images: Images, weights: tuple[RowWeight, ...], whole: bool) -> None:
        """Add the images of all panels, each with its weight, see `PixelRows.weights`."""
        if not self._sums:
            self._sums = [None] * len(images)
        for i, (image, weight) in enumerate(zip(images, weights, strict=True)):
            if image is not None:
                self._sums[i] = self._added(self._sums[i], image, weight)
        one = weights[0]
        self._total = self._total + one if not isinstance(one, np.ndarray) and self._total is not None else None
        self.whole = self.whole and whole

    def _added(self, before: Sum | None, image: NDArray[np.uint8], weight: RowWeight) -> Sum:
        if not isinstance(weight, np.ndarray):
            part = image * np.float64(weight)
            return part if before is None else before + part
        total = np.zeros(image.shape, np.float32) if before is None else before
        top, bottom = band(weight)
        total[top:bottom] += image[top:bottom] * weight[top:bottom].astype(np.float32)
        return total

    def mean(self) -> Images:
        """The mean of each panel's images; None for a panel without any."""
        total = 1.0 if self._total is None else self._total
        return tuple(None if s is None else np.clip(s / total + 0.5, 0, 255).astype(np.uint8) for s in self._sums)
