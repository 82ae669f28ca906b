"""How long a shutter is open for one picture, and when the images are drawn of which the picture is composed."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from vstestbed.core.geometry import Array
from vstestbed.sim.row_weights import of_exposure


@dataclass(frozen=True)
class Opening:
    """One opening of the shutter, in physics steps from the picture's middle.

    Attributes:
        exposure_s: exposure time, with a rolling shutter of each row [s]. half: from the middle to the end of it all.
        most: number of images, at most. step_s: of the physics [s].
        exact: the exposure need not be whole pairs of steps: the images' weights make up for it (`row_weights.of_exposure`).
    """

    exposure_s: float
    half: int
    most: int
    step_s: float
    exact: bool = False

    @cached_property
    def offsets(self) -> tuple[int, ...]:
        """Steps at which images are drawn, symmetric; the middle is one of them."""
        n = min(2 * self.half + 1, self.most - 1 + self.most % 2)  # odd
        return tuple(np.round(np.linspace(-self.half, self.half, n)).astype(int).tolist()) if self.half else (0,)

    @cached_property
    def nodes(self) -> Array:
        """The same as times (K,) [s]."""
        return np.array(self.offsets) * self.step_s

    @cached_property
    def weights(self) -> tuple[float, ...]:
        """Weight of each image in a picture whose rows are all exposed at once, sum 1."""
        if self.half == 0:
            return (1.0,)
        if self.exact:
            return tuple(of_exposure(self.nodes, self.exposure_s).tolist())
        # Rounded to whole steps they are unevenly spaced: the weights are those of the trapezoidal rule, so that the mean stays unbiased.
        weights: Array = np.gradient(np.array(self.offsets, dtype=float))
        weights[[0, -1]] /= 2
        return tuple((weights / weights.sum()).tolist())
