"""A repulsion field at the picture's border, for every image-based law."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from annotated_types import Ge, Gt

from vstestbed.features import Point
from vstestbed.geometry import Array
from vstestbed.laws.select import usable_rows
from vstestbed.laws.solve import least_squares
from vstestbed.observation import Goal, Observation
from vstestbed.spec import spec

NEAREST = 0.2
"""The field grows no more nearer to the border than this share of the margin."""
STEP_PX = 0.5
"""A pixel's motion is turned into normalised coordinates by a difference over this [px]."""

_POINT = Point()


@spec
class Visibility:
    """Markers within a margin of the picture's border are pushed inwards.

    With d the distance of a marker to a border, d0 the margin and x = d/d0, the field is the negative gradient of the
    potential (1/x - 1)^2 / 2: the marker's image is to move inwards at  f = strength (1/x - 1)/x^2  [px/s], nothing beyond
    the margin; the camera makes as much of it as it can: u = pinv(L B) f with the rows of the markers concerned. One marker at the border
    pans the camera; all of them, as under a large rotation, make it back off.

    Args:
        margin_px: d0 [px]; 0 switches the field off.
        strength_pxps: speed at which the field pushes half a margin off the border, over 4 [px/s].

    Reference: Corke & Hutchinson 2001, section IV, doi:10.1109/70.954764 (the potential, there for translation along the
    optical axis only).
    """

    margin_px: Annotated[float, Ge(0)] = 0.0
    strength_pxps: Annotated[float, Gt(0)] = 20.0

    def push(self, observation: Observation, goal: Goal, basis: Array) -> Array:
        """The motion (n,) that keeps markers off the border; zero where none is near it. `goal` knows the lens."""
        rows = usable_rows(observation, ("xy", "depth"), 1)
        nothing = np.zeros(basis.shape[1])
        if isinstance(rows, str):
            return nothing
        camera, uv = goal.camera, observation.uv[rows]
        speed = self._inwards(uv, camera.width, camera.height)
        near = speed.any(axis=1)
        if not near.any():
            return nothing
        uv, speed, depth = uv[near], speed[near], observation.depth[rows][near]
        size = np.linalg.norm(speed, axis=1, keepdims=True)
        xy = camera.normalise(uv)
        flow = (camera.normalise(uv + STEP_PX * speed / size) - xy) / STEP_PX * size
        return least_squares(_POINT.interaction(xy, depth) @ basis, flow.ravel())

    def _inwards(self, uv: Array, width: int, height: int) -> Array:
        """Wanted speed of pixels uv (N, 2) in the image [px/s], shape (N, 2)."""
        high = np.array([width, height]) - 0.5
        return self._speed(uv + 0.5) - self._speed(high - uv)

    def _speed(self, distance: Array) -> Array:
        x = np.clip(distance / self.margin_px, NEAREST, 1.0)
        return self.strength_pxps * (1 / x - 1) / x**2
