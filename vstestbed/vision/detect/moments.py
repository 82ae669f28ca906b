"""From blobs to marker centres: perspective's bias taken off, blobs that do not fit the pose left out."""

from __future__ import annotations

import math

import numpy as np

from vstestbed.camera import Camera
from vstestbed.core.geometry import Array, transform
from vstestbed.targets.base import Target
from vstestbed.vision.detect.assign import allowed_px
from vstestbed.vision.detect.centre import ball_bias, centre_bias
from vstestbed.vision.detect.colour_blobs import Blob
from vstestbed.vision.detect.track import BlobsMemory
from vstestbed.vision.pose.pnp import solve_pose_from_rays, three_ray_poses

AREA_NOISE_PX = 3.5
"""What rounding to pixels does to a blob's area, three standard deviations [px^2] (drawn ellipses of 2 to 8 px radius)."""
SAME_BIAS_PX = 0.02
"""A bias that differs by less from the one assumed stands: solving the pose again would change it by a tenth of that."""
MOST_ROUNDS = 3
"""Poses solved at most for one picture, besides one for each marker that is left out."""
SURPRISE = 0.15
"""Sum over three markers of |log(area / expected)|: under .05 for the right pose of rendered discs, over .6 for most others."""


class Measure:
    """Measures one picture's blobs; pixels are those of the panel in which each blob was found.

    Args:
        camera: the lens. target: what is looked at. panels: of each marker's blob, N of them.
        area_tolerance: largest relative difference between a blob's area and the expected one.
        edge: how far inside or outside of the true border a blob's border may lie [px].
    """

    def __init__(self, camera: Camera, target: Target, panels: list[int], area_tolerance: float, edge: float):
        self._camera, self._target, self._tolerance, self._edge = camera, target, area_tolerance, edge
        self._of = None if len(camera.panels) == 1 else np.array(panels)
        self.aliens = np.zeros(len(target.points), dtype=bool)
        """Which blobs are no markers of this target: the pose of the others rules them out, (N,)."""

    def centres(self, blobs: list[Blob | None], memory: BlobsMemory, correct: bool) -> tuple[Array, Array | None, Array]:
        """Marker centres (N, 2) in the camera's own pixels, the pose (4, 4), and perspective's bias (N, 2) in the panels'.

        The pose is solved from centroids less the bias of the last picture, which gives this picture's bias; where that
        is not the same within SAME_BIAS_PX, once more. `correct` says whether to take the bias off the centres.
        """
        whole = [b if b and b.whole else None for b in blobs]
        centroid = np.array([(b.u, b.v) if b else (np.nan, np.nan) for b in whole])
        area = np.array([b.area if b else np.nan for b in whole])
        assumed = np.zeros_like(centroid) if memory.bias is None else memory.bias
        T = self._pose(centroid - assumed, area, memory.T_camera_target)
        for _ in range(len(blobs) + MOST_ROUNDS):
            if T is None:
                break
            bias, expected = self._expected(T)
            worst, misfit = self._worst(area, expected)
            found = self._outlier(T, centroid, bias, area, memory.T_camera_target, misfit)
            if found is not None:
                worst, T, assumed = found
                centroid[worst] = area[worst] = np.nan
                continue
            if misfit > 1:
                centroid[worst] = area[worst] = np.nan
            elif not np.abs(bias - assumed).max() > SAME_BIAS_PX:
                break
            assumed = bias
            T = self._pose(centroid - assumed, area, T if memory.T_camera_target is None else memory.T_camera_target)
        if T is None and self._target.marker.kind == "sphere":
            assumed = self._by_size(centroid, area)
        elif T is None and memory.T_camera_target is not None:
            assumed = self._expected(memory.T_camera_target)[0]
        uv = centroid - assumed if correct else centroid
        return (uv if self._of is None else self._camera.project(self._rays(uv))), T, assumed

    def _outlier(
        self, T: Array, centroid: Array, bias: Array, area: Array, previous: Array | None, misfit: float
    ) -> tuple[int, Array, Array] | None:
        """The blob that does not belong to the others, with their pose and bias, where the pose of all explains them badly.

        That one is left out whose others agree best: in place and, since three points always do, in area. Four blobs of which
        one is elsewhere may have a pose that nearly fits their places, but hardly one that fits their areas too.
        """
        seen = np.flatnonzero(np.isfinite(centroid[:, 0]))
        if self._of is not None or len(seen) < 4:
            return None
        allowed = allowed_px(centroid)
        if misfit <= 1 and self._off(T, centroid, bias)[seen].max() <= allowed:
            return None
        best, found = math.inf, None
        for i in seen.tolist():
            others, left = centroid.copy(), area.copy()
            others[i] = left[i] = np.nan
            pose = self._of_others(others - bias, left, previous)
            if pose is None:
                continue
            there, expected = self._expected(pose)
            surprise = float(np.nanmean(np.abs(np.log(left / expected)))) / SURPRISE
            score = surprise + float(np.nanmax(self._off(pose, others, there))) / allowed
            if score < best:
                best, found = score, (i, pose, there)
        if found is not None:
            self.aliens[found[0]] = self._off(found[1], centroid, found[2])[found[0]] > allowed
        return found

    def _of_others(self, uv: Array, area: Array, previous: Array | None) -> Array | None:
        """The pose of blobs without one; of three the one that continues the last pose, unless their areas ask for another."""
        seen = np.isfinite(uv[:, 0])
        pose = self._pose(uv, area, previous)
        if np.count_nonzero(seen) > 3 or (pose is not None and self._surprise(pose, area) < SURPRISE):
            return pose
        return self._first_of_three(self._rays(uv[seen]), area)

    def _surprise(self, T: Array, area: Array) -> float:
        return float(np.nansum(np.abs(np.log(area / self._expected(T)[1]))))

    def _off(self, T: Array, centroid: Array, bias: Array) -> Array:
        """How far each centroid (N, 2) is from where a pose has it, (N,) [px]."""
        uv = self._camera.project(transform(T, self._target.points)) + bias
        return np.linalg.norm(centroid - uv, axis=1)

    def _expected(self, T_camera_target: Array) -> tuple[Array, Array]:
        """Perspective's bias (N, 2) [px] and the area (N,) [px^2] of each marker in its panel."""
        if self._of is None:
            return centre_bias(self._camera, self._target, T_camera_target)
        bias, area = np.full((len(self._of), 2), np.nan), np.full(len(self._of), np.nan)
        for panel in set(self._of.tolist()):
            T = T_camera_target.copy()
            T[:3] = self._camera.panels[panel].R_camera_panel.T @ T[:3]
            mine = self._of == panel
            there = centre_bias(self._camera.panels[panel].lens, self._target, T)
            bias[mine], area[mine] = there[0][mine], there[1][mine]
        return bias, area

    def _by_size(self, centroid: Array, area: Array) -> Array:
        """Perspective's bias (N, 2) [px] of balls too few for a pose, from the size of each; 0 for what is not seen."""
        radius = self._target.marker.radius
        if self._of is None:
            bias = ball_bias(self._camera, radius, centroid, area)
        else:
            bias = np.zeros_like(centroid)
            for panel in set(self._of.tolist()):
                mine = self._of == panel
                bias[mine] = ball_bias(self._camera.panels[panel].lens, radius, centroid[mine], area[mine])
        return np.nan_to_num(bias)

    def _rays(self, uv: Array) -> Array:
        """Unit rays (N, 3) in the camera frame of pixels (N, 2) of the panels."""
        if self._of is None:
            return self._camera.ray(uv)
        rays = np.empty((len(uv), 3))
        for panel in set(self._of.tolist()):
            mine = self._of == panel
            rays[mine] = self._camera.panels[panel].lens.ray(uv[mine]) @ self._camera.panels[panel].R_camera_panel.T
        return rays

    def _pose(self, uv: Array, area: Array, previous: Array | None) -> Array | None:
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
        """Of the poses that rays (3, 3) leave, the one that makes the areas (N,) least surprising; None if even that does not fit."""
        poses = three_ray_poses(rays, self._target.points[np.isfinite(area)])
        best = min(poses, key=lambda T: self._surprise(T, area), default=None)
        return best if best is not None and self._surprise(best, area) < SURPRISE else None

    def _worst(self, area: Array, expected: Array) -> tuple[int, float]:
        """Which area (N,) is farthest from the expected one, and by how much, in units of what is allowed; unseen ones are not."""
        worst, most = 0, -1.0
        for i, (a, e) in enumerate(zip(area.tolist(), expected.tolist(), strict=True)):
            if math.isnan(a):
                continue
            allowed = self._tolerance * e + AREA_NOISE_PX + self._edge * 2 * math.sqrt(math.pi * e)
            misfit = math.inf if math.isnan(e) else abs(a - e) / allowed
            if misfit > most:
                worst, most = i, misfit
        return worst, most
