"""A repulsive potential at the border of the image, for all image-based laws."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from vstestbed.camera import Camera
from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array
from vstestbed.core.quantity import Pixels, PositivePixels
from vstestbed.core.spec import spec
from vstestbed.features.observation import Goal, Observation
from vstestbed.laws.carry import points
from vstestbed.laws.select import usable_rows
from vstestbed.laws.solve import least_squares

NEAREST = 0.2
"""Least distance to the border, as a share of the margin, that enters the field: at the border itself the potential is infinite."""
STEP = 1e-6
"""Step of the finite differences by which a lens is differentiated [m, rad]."""


@spec
class Visibility:
    """Markers within a margin of the border of the image are pushed inwards.

    The border is that of the image; for fisheye and catadioptric lenses also the image circle (and the blind spot of a mirror). A
    marker is lost when its edge passes the border, not its centre.

    With d the distance of a marker's edge to a border, d0 the margin and x = d/d0, the field is the negative gradient of the
    potential (1/x - 1)^2 / 2: the desired image velocity inwards is  f = strength (1/x - 1)/x^2  [px/s], zero beyond the margin. The
    camera follows it in the least-squares sense, u = pinv(L B) f with the rows of the pixels in the margin. One marker at the border
    pans the camera; all of them, as in a large rotation, make it retreat.

    Args:
        margin_px: d0 [px]; 0 switches the field off.
        strength_pxps: a quarter of the speed of the field at half the margin (x = 1/2) [px/s].

    Reference: Corke & Hutchinson 2001, section IV, doi:10.1109/70.954764 (the potential, there for translation along the
    optical axis only).
    """

    margin_px: Pixels = 0.0
    strength_pxps: PositivePixels = 20.0

    @property
    def inputs(self) -> tuple[str, ...]:
        """The fields of an Observation that the field needs besides those of its law: none where it is off."""
        return ("radius_px",) if self.margin_px > 0 else ()

    def check(self, goal: Goal, marker_radius_m: float, called: Callable[[int], str] = str) -> None:
        """Refuse a goal with a marker inside the margin: the field would keep the camera away from it.

        called: what messages call a marker.

        Raises:
            ParameterError: a marker of the goal view is inside the margin, or the image has no border.
        """
        if self.margin_px == 0:
            return
        if len(goal.camera.panels) > 1:
            words = "must be 0 with a camera that sees all round: its image has no border"
            raise ParameterError("law.visibility.margin_px", words, self.margin_px)
        check_margin("law.visibility.margin_px", self.margin_px, goal, marker_radius_m, called)

    def push(self, observation: Observation, goal: Goal, basis: Array) -> Array:
        """The additional motion (n,) [m/s, rad/s] that drives markers off the border; zero if none is near. `goal` has the lens."""
        nothing = np.zeros(basis.shape[1])
        around = observation.ray is not None and observation.range is not None
        # Rays where the law has them: points beside or behind a wide lens have no xy.
        rows = usable_rows(observation, ("ray", "range") if around else ("xy", "depth"), 1)
        if isinstance(rows, str):
            return nothing
        radius = 0.0 if observation.radius_px is None else observation.radius_px[rows]
        speed = self._inwards(goal.camera, observation.uv[rows], radius)
        near = speed.any(axis=1)
        if not near.any():
            return nothing
        L = pixel_interaction(goal.camera, points(observation)[rows][near])
        return least_squares(L.reshape(-1, 6) @ basis, speed[near].ravel())

    def _inwards(self, camera: Camera, uv: Array, radius: Array | float) -> Array:
        """Desired image velocity (N, 2) [px/s] of markers at pixels uv (N, 2), of apparent radii (N,) [px]."""
        distance, inwards = camera.borders(uv)
        x = np.clip((distance - np.reshape(radius, (-1, 1))) / self.margin_px, NEAREST, 1.0)
        return np.einsum("nb,nbk->nk", self.strength_pxps * (1 / x - 1) / x**2, inwards)


def check_margin(field: str, margin_px: float, goal: Goal, marker_radius_m: float, called: Callable[[int], str]) -> None:
    """Refuse a goal with a marker inside a margin of the border, which would keep it from there.

    Raises:
        ParameterError: it names the field.
    """
    radius = goal.camera.half_size(goal.ray * goal.range[:, None], marker_radius_m).max(axis=1)
    nearest = np.where(goal.counted is None or goal.counted, goal.camera.borders(goal.uv)[0].min(axis=1) - radius, np.inf)
    marker = int(nearest.argmin())
    if nearest[marker] <= margin_px:
        words = f"reaches marker {called(marker)} of the goal view, whose edge is {nearest[marker]:.4g} px from the border"
        words += ", and would keep it"
        raise ParameterError(field, f"{words} off its goal; use less, or a goal farther back", margin_px)


def pixel_interaction(camera: Camera, p: Array) -> Array:
    """L (N, 2, 6) of the pixels of points p (N, 3) [m] in any lens, uv_dot = L v, by central differences along p_dot = -v - w x p."""
    flow = np.concatenate([np.broadcast_to(-np.eye(3)[:, None], (3, len(p), 3)), -np.cross(np.eye(3)[:, None], p)])
    L = (camera.project(p + STEP * flow) - camera.project(p - STEP * flow)) / (2 * STEP)
    return np.nan_to_num(np.moveaxis(L, 0, -1))  # NaN: at the rim of the field of view, where a step leaves it
