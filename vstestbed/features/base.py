"""The interface of a feature: three functions that accept leading axes, no state."""

from __future__ import annotations

from typing import ClassVar, Protocol

import numpy as np

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array

UNEVEN = 0.01
"""Scatter of points off their plane, as a share of their largest scatter in it, from which they count as not in one plane."""
MOST_CONDITION = 500.0
"""Condition of L, its largest over its smallest singular value in units of the goal, over which its rows count as dependent. With 1300 the
camera went three to five times as far as on the straight way, or did not arrive; with 300 it went straight."""


class Feature(Protocol):
    """A feature s(x) of N markers, with e_dot = L v for a static target and v the camera twist in the camera frame.

    s may have more numbers than e has rows (a polygon's s has all segments, for example). L is the derivative of e: of
    error(s(t), s*) at s* = s.

    It may also have `check_goal(x, distance)`, which raises a ParameterError for both inputs in a goal view at which it cannot work.

    Attributes:
        inputs: the two fields of an observation and of a goal that it takes: mostly ("xy", "depth"), for features of wide lenses
            ("ray", "range").
        rows_per_marker: rows k of L and e for each marker, in the markers' order; 0 if the rows describe the set as a whole.
        least_markers: the least number of markers for which it is defined.
    """

    inputs: ClassVar[tuple[str, ...]]
    rows_per_marker: ClassVar[int]
    least_markers: ClassVar[int]

    @property
    def kind(self) -> str:
        """The feature's word in a scenario."""
        ...

    def measure(self, x: Array, /) -> Array:
        """Feature vector s of the first input, e.g. xy (..., N, 2)."""
        ...

    def interaction(self, x: Array, distance: Array, /) -> Array:
        """Interaction matrix L (..., rows, 6) of both inputs, e.g. xy (..., N, 2) and depth (..., N) [m]."""
        ...

    def error(self, s: Array, s_star: Array, /) -> Array:
        """Error e (..., rows): s - s*, angles wrapped where the feature has them."""
        ...


def checked(x: Array, distance: Array, inputs: tuple[str, ...], least: int = 1) -> tuple[Array, Array]:
    """Both inputs of a feature as floating-point arrays, validated.

    Args:
        x: coordinates (..., N, 2) for xy, (..., N, 3) for ray.
        distance: depth or range of each (..., N) [m].
        inputs: their names.
        least: the smallest N.

    Raises:
        ParameterError: the shapes do not match, the markers are too few, or a distance is not positive.
    """
    x, distance = np.asarray(x, dtype=float), np.asarray(distance, dtype=float)
    name, of = inputs
    size = 3 if name == "ray" else 2
    if x.shape[-1:] != (size,) or x.shape[:-1] != distance.shape:
        raise ParameterError(of, f"must have the shape (..., N) of {name} (..., N, {size}) = {x.shape}", distance.shape)
    if x.ndim < 2 or x.shape[-2] < least:
        raise ParameterError(name, f"must have the shape (..., N, {size}) with at least {least} markers", x.shape)
    if not np.logical_and.reduce(distance > 0, axis=None):
        behind = ": a point at or behind the lens has no image" if of == "depth" else ""
        raise ParameterError(of, f"must be > 0 m for every point{behind}")
    return x, distance


def require_plane(xy: Array, depth: Array, kind: str) -> None:
    """Refuse points xy (N, 2) at depths (N,) [m] that do not lie in one plane, for a feature of this kind.

    Raises:
        ParameterError: it names the target.
    """
    p = np.column_stack([xy, np.ones(len(xy))]) * np.asarray(depth)[:, None]
    spread = np.linalg.svd(p - p.mean(axis=0), compute_uv=False)
    if spread[-1] > UNEVEN * spread[0]:
        raise ParameterError("target", f"must have its markers in one plane for the feature {kind}; use point, or another target")


def condition(L: Array, scale: Array, depth: Array) -> float:
    """Condition of an L (rows, 6) at the goal view: its largest over its smallest singular value, inf where that is 0.

    Rows are in units of their quantities, translations in units of the mean depth. Of more than six rows, six count.

    Args:
        L: at the goal view. scale: size of each row's quantity (rows,). depth: of the markers (N,) [m].
    """
    A = L / np.asarray(scale)[:, None] * np.array([np.mean(depth)] * 3 + [1.0] * 3)
    if not np.isfinite(A).all():
        return np.inf
    singular = np.linalg.svd(A, compute_uv=False)
    return float(singular[0] / singular[-1]) if singular[-1] > 0 else np.inf
