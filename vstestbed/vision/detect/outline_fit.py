"""From the border of a region in a picture to the points of the target's outline, in the target's order."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from vstestbed.camera import Panel
from vstestbed.core.geometry import Array
from vstestbed.features.observation import Goal
from vstestbed.targets import Target
from vstestbed.targets.polygons import centroid, covariance, evenly_along
from vstestbed.targets.regions import LEAST_AHEAD
from vstestbed.vision.detect.polygon_fit import fit_polygon, roundness

CLOSE = 200
"""Points of a polygon's outline by which it is compared with the border in the picture."""


@dataclass(frozen=True, slots=True)
class Border:
    """The border of a region found in one panel of a camera.

    Attributes:
        edge: points on it (K, 2) [px]. middle: the region's centroid (2,) [px]. spread: covariance of its area (2, 2) [px^2].
    """

    edge: Array
    middle: Array
    spread: Array
    panel: Panel

    @property
    def size_px(self) -> float:
        """Standard deviation of the region's pixels, the geometric mean of both axes [px]."""
        return math.sqrt(math.sqrt(max(float(np.linalg.det(self.spread)), 0.0)))

    def rays(self, uv: Array) -> Array:
        """Unit rays (K, 3) in the camera's frame of pixels (K, 2) of the panel."""
        return self.panel.lens.ray(uv) @ self.panel.R_camera_panel.T

    def project(self, p: Array) -> Array:
        """Pixels (K, 2) of the panel of directions (K, 3) in the camera's frame; NaN where its lens does not see one."""
        return self.panel.lens.project(p @ self.panel.R_camera_panel)


@dataclass(frozen=True, slots=True)
class OutlineFit:
    """The outline that fits a border best.

    Attributes:
        p: its points as directions in the camera's frame, shape (M, 3), in the target's order.
        off_px: distance of each point of the border from it, shape (K,) [px].
        close: directions along it (S, 3), evenly: of a polygon closer together than its points, of what is round the points.
        turn: how the target is turned in the picture (`PolygonFit.turn`) [rad]; 0 for what is round.
    """

    p: Array
    off_px: Array
    close: Array
    turn: float = 0.0


def fit_outline(border: Border, target: Target, turn: float | None, expected: float) -> OutlineFit | None:
    """The fit of the target's outline to the border; None where there is none.

    Args:
        border: in the picture. target: a ball or a shape.
        turn: the rotation in the last picture [rad]; None where it is to be sought all round.
        expected: the rotation that is taken where several fit alike [rad].
    """
    rays = border.rays(border.edge)
    if target.figure_corners is not None:
        return _polygon(border, rays, target, target.figure_corners, turn, expected)
    # A round region of pixels with standard deviation s has the radius 2 s.
    found = target.round_outline(rays)
    return None if found is None else OutlineFit(found.p, found.off * 2 * border.size_px, found.p)


def turn_at(goal: Goal, target: Target) -> float:
    """How a shape is turned in the goal view [rad]; 0 for what is round."""
    if target.figure_corners is None or not np.isfinite(goal.xy).all():
        return 0.0
    seen, flat = goal.xy, target.points[:, :2]
    # The affine map that fits best, without what makes both shapes round: a rotation.
    to, _, _, _ = np.linalg.lstsq(np.column_stack([flat, np.ones(len(flat))]), seen, rcond=None)
    R = roundness(covariance(seen)) @ to[:2].T @ np.linalg.inv(roundness(covariance(flat)))
    return math.atan2(R[1, 0] - R[0, 1], R[0, 0] + R[1, 1])


def _polygon(border: Border, rays: Array, target: Target, corners: Array, turn: float | None, expected: float) -> OutlineFit | None:
    """The image of a polygon with `corners` (E, 2) that fits rays (K, 3)."""
    if not (rays[:, 2] > LEAST_AHEAD).all():
        return None
    xy = rays[:, :2] / rays[:, 2:]
    middle, J = _linearised(border)
    plane, turns = (centroid(corners), covariance(corners)), () if turn is None else (turn,)
    found = fit_polygon(xy, middle, J @ border.spread @ J.T, corners, plane, turns, expected)
    if found is None:
        return None
    p, close = (_before(np.column_stack([xy, np.ones(len(xy))]) @ found.H.T) for xy in (target.points[:, :2], evenly_along(corners, CLOSE)))
    return OutlineFit(p, found.off * border.size_px, close, found.turn)


def _before(p: Array) -> Array:
    """Directions (K, 3), each turned to lie before the camera."""
    return p * np.sign(p[:, 2:])


def _linearised(border: Border) -> tuple[Array, Array]:
    """Normalised coordinates (2,) of the region's centroid, and their derivative (2, 2) by pixels."""
    uv = border.middle + np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    ray = border.rays(uv)
    xy = ray[:, :2] / ray[:, 2:]
    return xy[0], (xy[1:] - xy[0]).T
