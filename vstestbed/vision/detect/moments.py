"""From blobs to marker centres: perspective bias corrected, blobs that do not fit the pose rejected."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from vstestbed.camera import Camera, Panel
from vstestbed.core.geometry import Array, lengths
from vstestbed.targets.base import Target
from vstestbed.vision.detect.assign import allowed_px
from vstestbed.vision.detect.centre import Outlines, ball_bias, centre_bias
from vstestbed.vision.detect.colour_blobs import Blob
from vstestbed.vision.detect.track import BlobsMemory
from vstestbed.vision.pose.pnp import solve_pose_from_rays, three_ray_poses

AREA_NOISE_PX = 3.5
"""Error of a blob's area by rounding to pixels, three standard deviations [px^2] (drawn ellipses of 2 to 8 px radius)."""
SAME_BIAS_PX = 0.02
"""The bias has converged when it changes by less than this [px]; another round would change it by a tenth of that."""
MOST_ROUNDS = 3
"""Most poses solved for one picture, besides one for each rejected marker."""
SURPRISE = 0.15
"""Sum over three markers of |log(area / predicted)|: under .05 for the right pose of rendered discs, over .6 for most others."""


class MarkerFit:
    """Fits one picture's blobs by a pose of the target; pixels are those of the panel in which each blob was found.

    Args:
        camera: the camera.
        target: the marker layout, of N markers.
        panels: index of the panel of each marker's blob, N of them.
        area_tolerance: largest relative difference between a blob's area and the predicted one.
        edge: error of a blob's border, inwards or outwards [px].
    """

    def __init__(self, camera: Camera, target: Target, panels: list[int], area_tolerance: float, edge: float):
        self._camera, self._target, self._tolerance, self._edge = camera, target, area_tolerance, edge
        self._of = None if len(camera.panels) == 1 else _by_panel(camera, panels)
        self.outliers = np.zeros(len(target.points), dtype=bool)
        """Which blobs are no markers of this target: they lie far from where the pose of the others predicts them, (N,)."""

    def centres(self, blobs: list[Blob | None], memory: BlobsMemory, correct: bool) -> tuple[Array, Array | None, Array]:
        """Marker centres (N, 2) in the camera's own pixels, the pose (4, 4), and the perspective bias (N, 2) in the panels'.

        Args:
            blobs: of each marker; None where none was found.
            memory: the last picture, whose bias and pose start the iteration.
            correct: subtract the bias from the centres.
        """
        centroid, area = _whole(blobs)
        assumed = np.zeros_like(centroid) if memory.bias is None else memory.bias
        T, bias = self._fitted(centroid, area, assumed, memory.T_camera_target)
        if T is None:
            bias = self._bias_without_pose(centroid, area, bias, memory.T_camera_target)
        uv = centroid - bias if correct else centroid
        return (uv if self._of is None else self._camera.project(self._rays(uv))), T, bias

    def _fitted(self, centroid: Array, area: Array, assumed: Array, previous: Array | None) -> tuple[Array | None, Array]:
        """The pose (4, 4) that fits the markers, None where there is none, and their bias (N, 2) [px].

        Alternates between the pose from the centroids less the assumed bias and the bias under that pose, until the bias has
        converged. Rejected markers become NaN in `centroid` (N, 2) and `area` (N,), in place.
        """
        T = self._pose(centroid - assumed, area, previous)
        for _ in range(len(centroid) + MOST_ROUNDS):
            if T is None:
                break
            expected = self._expected(T)
            bias = expected.bias
            worst, misfit = self._worst(area, expected.area)
            outlier = self._outlier(centroid, expected, area, previous, misfit)
            if outlier is not None:
                worst, T, assumed = outlier
                centroid[worst] = area[worst] = np.nan
                continue
            if misfit > 1:
                centroid[worst] = area[worst] = np.nan
            elif not np.abs(bias - assumed).max() > SAME_BIAS_PX:  # "not >" so that the NaN of lost markers ends the loop
                break
            assumed = bias
            T = self._pose(centroid - assumed, area, T if previous is None else previous)
        return T, assumed

    def _bias_without_pose(self, centroid: Array, area: Array, assumed: Array, previous: Array | None) -> Array:
        """Bias (N, 2) [px] of markers too few for a pose: of balls by their size, of discs under the last pose."""
        if self._target.marker.height_m:
            return self._by_size(centroid, area)
        return assumed if previous is None else self._expected(previous).bias

    def _outlier(
        self, centroid: Array, expected: Outlines, area: Array, previous: Array | None, misfit: float
    ) -> tuple[int, Array, Array] | None:
        """The blob that is not this target's, with the pose and bias of the others; None where the pose of all explains them.

        Leave one out: that blob is dropped without which the others fit best, by position and, since three points always have a
        pose, by area. Four blobs of which one is another object may have a pose that nearly fits their positions, but hardly
        one that fits their areas too.
        """
        if self._of is not None:
            return None
        seen = np.flatnonzero(np.isfinite(centroid[:, 0]))
        if len(seen) < 4:
            return None
        allowed = allowed_px(centroid)
        if misfit <= 1 and _off(centroid, expected)[seen].max() <= allowed:
            return None
        best, found = math.inf, None
        for i in seen.tolist():
            others, left = centroid.copy(), area.copy()
            others[i] = left[i] = np.nan
            pose = self._of_others(others - expected.bias, left, previous)
            if pose is None:
                continue
            there = self._expected(pose)
            surprise = float(np.nanmean(np.abs(np.log(left / there.area)))) / SURPRISE
            score = surprise + float(np.nanmax(_off(others, there))) / allowed
            if score < best:
                best, found = score, (i, pose, there)
        if found is None:
            return None
        index, pose, there = found
        self.outliers[index] = _off(centroid, there)[index] > allowed
        return index, pose, there.bias

    def _of_others(self, uv: Array, area: Array, previous: Array | None) -> Array | None:
        """The pose without one blob; of three, the one that continues the last pose, unless their areas contradict it."""
        seen = np.isfinite(uv[:, 0])
        pose = self._pose(uv, area, previous)
        if np.count_nonzero(seen) > 3 or (pose is not None and self._surprise(pose, area) < SURPRISE):
            return pose
        return self._first_of_three(self._rays(uv[seen]), area)

    def _surprise(self, T: Array, area: Array) -> float:
        """Sum of |log(area / predicted)| of areas (N,) under a pose."""
        return float(np.nansum(np.abs(np.log(area / self._expected(T).area))))

    def _expected(self, T_camera_target: Array) -> Outlines:
        """Predicted outline of each marker in its panel."""
        if self._of is None:
            return centre_bias(self._camera, self._target, T_camera_target)
        n = len(self._target.points)
        out = Outlines(np.full((n, 2), np.nan), np.full(n, np.nan), np.full((n, 2), np.nan))
        for panel, mine in self._of:
            T = T_camera_target.copy()
            T[:3] = panel.R_camera_panel.T @ T[:3]
            for all_of_them, there in zip(out, centre_bias(panel.lens, self._target, T), strict=True):
                all_of_them[mine] = there[mine]
        return out

    def _by_size(self, centroid: Array, area: Array) -> Array:
        """Perspective bias (N, 2) [px] of balls, from the apparent size of each; 0 for those not seen."""
        radius = self._target.marker.radius
        if self._of is None:
            bias = ball_bias(self._camera, radius, centroid, area)
        else:
            bias = np.zeros_like(centroid)
            for panel, mine in self._of:
                bias[mine] = ball_bias(panel.lens, radius, centroid[mine], area[mine])
        return np.where(np.isfinite(bias), bias, 0.0)

    def _rays(self, uv: Array) -> Array:
        """Unit rays (N, 3) in the camera frame of the markers' pixels (N, 2), each in its panel."""
        if self._of is None:
            return self._camera.ray(uv)
        rays = np.empty((len(uv), 3))
        for panel, mine in self._of:
            rays[mine] = panel.lens.ray(uv[mine]) @ panel.R_camera_panel.T
        return rays

    def _pose(self, uv: Array, area: Array, previous: Array | None) -> Array | None:
        """The pose (4, 4) from the images of the centres (N, 2) [px]; None with fewer than three."""
        seen = np.isfinite(uv[:, 0])
        n = int(np.count_nonzero(seen))
        if n < 3:
            return None
        rays, points = self._rays(uv), self._target.points
        if n < len(seen):
            rays, points = rays[seen], points[seen]
        if len(points) == 3 and previous is None:
            return self._first_of_three(rays, area)
        return solve_pose_from_rays(rays, points, previous)

    def _first_of_three(self, rays: Array, area: Array) -> Array | None:
        """Of the poses that three rays (3, 3) leave, the one that fits the areas (N,) best; None if even that does not fit."""
        poses = three_ray_poses(rays, self._target.points[np.isfinite(area)])
        best = min(poses, key=lambda T: self._surprise(T, area), default=None)
        return best if best is not None and self._surprise(best, area) < SURPRISE else None

    def _worst(self, area: Array, expected: Array) -> tuple[int, float]:
        """Index of the area (N,) farthest from the predicted one, and that difference over the one allowed; NaN areas are skipped."""
        worst, most = 0, -1.0
        # A loop in Python: on these few numbers it is quicker than NumPy.
        for i, (a, e) in enumerate(zip(area.tolist(), expected.tolist(), strict=True)):
            if math.isnan(a):
                continue
            allowed = self._tolerance * e + AREA_NOISE_PX + self._edge * 2 * math.sqrt(math.pi * e)
            misfit = math.inf if math.isnan(e) else abs(a - e) / allowed
            if misfit > most:
                worst, most = i, misfit
        return worst, most


def _off(centroid: Array, expected: Outlines) -> Array:
    """Distance of each centroid (N, 2) from its prediction, shape (N,) [px]."""
    return lengths(centroid - (expected.centre + expected.bias))[:, 0]


def _by_panel(camera: Camera, panels: list[int]) -> list[tuple[Panel, slice | NDArray[np.bool_]]]:
    """The panels in which markers are, each with which they are: all of them (a slice, which is quicker), or (N,) bool."""
    if min(panels) == max(panels):
        return [(camera.panels[panels[0]], slice(None))]
    of = np.array(panels)
    return [(camera.panels[panel], of == panel) for panel in set(panels)]


def _whole(blobs: list[Blob | None]) -> tuple[Array, Array]:
    """Centroids (N, 2) [px] and areas (N,) [px^2] of the blobs that are whole, NaN for the others."""
    whole = [b if b and b.whole else None for b in blobs]
    return np.array([(b.u, b.v) if b else (np.nan, np.nan) for b in whole]), np.array([b.area if b else np.nan for b in whole])
