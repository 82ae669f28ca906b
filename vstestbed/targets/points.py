"""Targets of markers: a square, or any points."""

from __future__ import annotations

from functools import cached_property
from typing import Annotated, ClassVar, Literal

import numpy as np
from annotated_types import Len

from vstestbed.core.geometry import Array
from vstestbed.core.quantity import Position, PositiveLength
from vstestbed.core.spec import spec
from vstestbed.targets.base import Target

BOARD_MARGIN = 1.5  # the board behind a square reaches this many marker radii beyond the markers' edges


@spec
class Square(Target):
    """Four markers at the corners of a square in z = 0: (-,-), (+,-), (+,+), (-,+) times side/2.

    Args:
        side: edge of the square, between centres of markers [m].
    """

    kind: Literal["square"] = "square"
    side: PositiveLength
    one_sided: ClassVar[bool] = True

    def __post_init__(self) -> None:
        self._check_markers()

    @cached_property
    def points(self) -> Array:
        """Corners in the target frame, shape (4, 3)."""
        h = self.side / 2
        return np.array([[-h, -h, 0], [h, -h, 0], [h, h, 0], [-h, h, 0]])

    @property
    def board_half_m(self) -> tuple[float, float]:
        """The board reaches BOARD_MARGIN marker radii beyond the markers' edges."""
        half = self.side / 2 + (1 + BOARD_MARGIN) * self.marker.radius
        return half, half


@spec
class Points(Target):
    """Markers at any places.

    Args:
        at: the markers' centres in the target frame, a list of [x, y, z] [m].
    """

    kind: Literal["points"] = "points"
    at: Annotated[tuple[Position, ...], Len(1, 24)]

    def __post_init__(self) -> None:
        self._check_markers()

    @cached_property
    def points(self) -> Array:
        """Marker centres in the target frame, shape (N, 3)."""
        return np.array(self.at, dtype=float)
