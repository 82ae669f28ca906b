"""The segment between two points in the image."""

from __future__ import annotations

from typing import Any, ClassVar, Literal

import numpy as np

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array
from vstestbed.core.spec import spec
from vstestbed.features.angles import FLOOR, wrap
from vstestbed.features.base import checked
from vstestbed.features.point import Point
from vstestbed.features.rated import Rated, angle, at_least, square

_POINT = Point()


@spec
class Segment:
    """Midpoint (xc, yc), length l and angle alpha of the segment between two markers; rows in this order.

    With (x1, y1) and (x2, y2) the first two of the markers in sight:

    xc = (x1 + x2)/2,  yc = (y1 + y2)/2,  l = hypot(x1 - x2, y1 - y2),  alpha = atan2(y1 - y2, x1 - x2),  s = (xc, yc, l, alpha)

    and normalised s = (xc/l, yc/l, 1/l, alpha): where the segment faces the camera, xc/l and yc/l do not change with the distance, and 1/l
    is proportional to it. L follows from the rows of `Point`. The segment has a direction, so that a rotation by any angle is unambiguous.
    Under l = 0.001 the rows of alpha and of the normalised form fade. Two markers leave two of six motions open (`law.redundant`).

    Args:
        normalised: s = (xc/l, yc/l, 1/l, alpha).

    Reference: Chaumette 1990, "La relation vision-commande", thesis, Université de Rennes 1, chapter 3.
    """

    kind: Literal["segment"] = "segment"
    normalised: bool = False
    inputs: ClassVar[tuple[str, ...]] = ("xy", "depth")
    rows_per_marker: ClassVar[int] = 0
    least_markers: ClassVar[int] = 2

    def measure(self, xy: Array) -> Array:
        """The vector s (..., 4) [1, 1, 1, rad] of xy (..., N, 2); ParameterError for fewer than two markers."""
        xy = np.asarray(xy, dtype=float)
        if xy.shape[-2] < self.least_markers:
            raise ParameterError("xy", "must hold at least two markers: a segment has two ends", xy.shape)
        return np.stack(self._rows(xy[..., 0, 0], xy[..., 0, 1], xy[..., 1, 0], xy[..., 1, 1]), axis=-1)

    def interaction(self, xy: Array, depth: Array) -> Array:
        """L (..., 4, 6) of xy (..., N, 2) and depth (..., N) [m].

        Raises:
            ParameterError: the shapes do not match, there is only one marker, or a depth is not positive.
        """
        xy, depth = checked(xy, depth, self.inputs, self.least_markers)
        L = _POINT.interaction(xy[..., :2, :], depth[..., :2])
        ends = [Rated(xy[..., i // 2, i % 2], L[..., i, :]) for i in range(4)]
        return np.stack([row.rate for row in self._rows(*ends)], axis=-2)

    def error(self, s: Array, s_star: Array) -> Array:
        """Error s - s* (..., 4) with alpha wrapped to (-pi, pi] rad."""
        e = np.subtract(s, s_star, dtype=float)
        e[..., 3] = wrap(e[..., 3])
        return e

    def _rows(self, x1: Any, y1: Any, x2: Any, y2: Any) -> list[Any]:
        """The four rows, of arrays (...) or of Rated."""
        along = (x1 - x2) + 1j * (y1 - y2)
        xc, yc, alpha = 0.5 * (x1 + x2), 0.5 * (y1 + y2), angle(along, FLOOR)
        length = at_least(square(along), FLOOR**2) ** 0.5
        return [xc / length, yc / length, length**-1, alpha] if self.normalised else [xc, yc, length, alpha]
