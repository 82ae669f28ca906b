"""Coloured markers: found as blobs, tracked in windows, corrected for perspective, dropped where they are cut."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

import numpy as np
from annotated_types import Ge, Gt, Le, Lt

from vstestbed.camera import Camera, Frame, Perspective
from vstestbed.errors import ParameterError
from vstestbed.geometry import Array
from vstestbed.spec import spec
from vstestbed.target import Target
from vstestbed.vision.base import Detection, TruthView
from vstestbed.vision.centre import centre_bias
from vstestbed.vision.find import Blob, Image, Window, find_blobs, noise_level
from vstestbed.vision.pose import solve_pose_from_rays, three_ray_poses
from vstestbed.vision.windows import windows_round

AREA_NOISE_PX = 3.5
"""What rounding to pixels does to a blob's area, three standard deviations [px^2] (drawn ellipses of 2 to 8 px radius)."""
EDGE_PX = 0.15
"""How far inside or outside of the true border a smoothed, shaded blob's border may lie [px] (rendered balls of 5 px and more)."""
SAME_BIAS_PX = 0.02
"""A bias that differs by less from the one assumed stands: solving the pose again would change it by a tenth of that."""
MOST_ROUNDS = 3
"""Poses solved at most for one picture, besides one for each marker that is left out."""
SURPRISE = 0.15
"""Sum over three markers of |log(area / expected)|: under .05 for the right pose of rendered discs, over .6 for most others."""


@dataclass(frozen=True, slots=True)
class BlobsMemory:
    """Each marker's blob in the last picture (None: lost) and its move since the one before [px]; the last pose and bias."""

    blobs: tuple[Blob | None, ...] = ()
    moves: tuple[tuple[float, float], ...] = ()
    T_camera_target: Array | None = None
    bias: Array | None = None


@spec
class Blobs:
    """Markers by colour: chroma mask, contours, moments; told apart by the hue at the centroid.

    A tracked marker is looked for in a window round its predicted position (last + last move); when one is lost, the
    whole picture is searched. What is reported are images of marker centres: the centroid less perspective's bias, from
    the pose that the markers themselves give. A blob is not reported if it touches the picture's border, if its shape
    is not an ellipse's, or if its area is not what the pose makes expect (something stands before it); the worst such
    marker is left out and the pose solved anew until all fit. Three markers and no pose before: of the poses they leave,
    the one whose areas fit best. Fewer than three: border and shape alone decide, and the bias is that of the last pose.

    A picture's noise is estimated from the picture (`noise_level`: 0 for a rendered one without noise). Where there is
    some, from a standard deviation of about 1 grey level, blobs are looked for in the smoothed picture, and with `grey`
    moments rim pixels count by their measured chroma, so that centroids scatter in proportion to the noise: 2 cm discs at
    1 m by .01, .02 and .05 px for 2, 8 and 20 grey levels. Above 20, markers begin to be missed; the dark sides of shaded
    balls a little before. From about 30 on, noise itself may be taken for a marker.

    Args:
        chroma: max - min of r, g, b (0..255) above which a pixel belongs to a marker; scenes keep everything else under it.
        hue_tolerance_deg: largest difference to the marker's hue; never more than half the step between two markers' hues.
        least_area_px: smaller blobs are noise.
        moments: `binary` weighs each pixel 0 or 1; `grey` by coverage, which is finer in pictures with multisampling and the
            same in pictures with neither multisampling nor noise, whose pixels are all of one colour.
        correct_centre: whether to take perspective's bias off the centroid.
        area_tolerance: largest relative difference between a blob's area and the expected one.
        window_margin_px: what a window has round the predicted blob, besides half of its last move.

    Reference: Corke 2017, Robotics, Vision & Control, sections 13.1 and 15.2 (blobs, moments, visual servoing with them).
    """

    kind: Literal["blobs"] = "blobs"
    chroma: Annotated[int, Ge(1), Lt(255)] = 60
    hue_tolerance_deg: Annotated[float, Gt(0), Le(180)] = 15.0
    least_area_px: Annotated[float, Ge(1)] = 9.0
    moments: Literal["binary", "grey"] = "grey"
    correct_centre: bool = True
    area_tolerance: Annotated[float, Gt(0), Lt(1)] = 0.06
    window_margin_px: Annotated[int, Ge(2)] = 8
    needs_image: ClassVar[bool] = True
    needs_truth: ClassVar[bool] = False
    markers: ClassVar[tuple[str, ...]] = ("disc", "sphere")

    def init(self) -> BlobsMemory:
        """Nothing seen yet."""
        return BlobsMemory()

    def detect(
        self, memory: BlobsMemory, frame: Frame | None, view: TruthView | None, camera: Camera, target: Target, rng: np.random.Generator
    ) -> tuple[BlobsMemory, Detection]:
        """Marker centres (N, 2) [px] in one picture, NaN where not seen, and the pose (4, 4) where it can be solved.

        Raises:
            ParameterError: there is no picture.
        """
        if frame is None:
            raise ParameterError("frame", "is missing: detector blobs needs a picture; use detector oracle where there is none")
        noise = noise_level(frame.image)
        blobs = self._track(frame.image, noise, memory, camera, target) or self._search(frame.image, noise, camera, target)
        uv, T, bias = self._measure(blobs, EDGE_PX if noise > 0 or _smooth(camera) else 0.0, memory, camera, target)
        kept = T if T is not None else memory.T_camera_target
        return BlobsMemory(tuple(blobs), _moves(memory, blobs), kept, bias), Detection(uv=uv, T_camera_target=T)

    def _look(self, image: Image, window: Window, noise: float, camera: Camera) -> list[Blob]:
        rim = self.moments if _smooth(camera) or (noise > 0 and self.moments == "binary") else "sharp"
        return find_blobs(image, window, self.chroma, self.least_area_px, rim, noise)

    def _track(self, image: Image, noise: float, memory: BlobsMemory, camera: Camera, target: Target) -> list[Blob | None] | None:
        """Each marker's blob, the nearest to its prediction in a window of its own; None: the whole picture must be searched."""
        height, width = image.shape[:2]
        windows = windows_round([b.box if b else None for b in memory.blobs], memory.moves, width, height, self.window_margin_px)
        if windows is None:
            return None
        blobs: list[Blob | None] = []
        for hue, last, (du, dv), window in zip(target.hues_deg, memory.blobs, memory.moves, windows, strict=True):
            mine = self._of_hue(hue, self._look(image, window, noise, camera), len(windows))
            u, v = (last.u + du, last.v + dv) if last else (math.nan, math.nan)
            blob = min(mine, key=lambda b: math.hypot(b.u - u, b.v - v), default=None)
            if blob is None or blob.cut_by(window, width, height):
                return None
            blobs.append(blob)
        return blobs

    def _search(self, image: Image, noise: float, camera: Camera, target: Target) -> list[Blob | None]:
        """Each marker's blob in the whole picture: of those with its hue, whole ones first, the largest."""
        height, width = image.shape[:2]
        found = self._look(image, (0, 0, width, height), noise, camera)
        hues = target.hues_deg
        return [max(self._of_hue(hue, found, len(hues)), key=lambda b: (b.whole, b.area), default=None) for hue in hues]

    def _of_hue(self, hue_deg: float, found: list[Blob], n_hues: int) -> list[Blob]:
        tolerance = min(self.hue_tolerance_deg, 180 / n_hues)
        return [b for b in found if abs((b.hue_deg - hue_deg + 180) % 360 - 180) <= tolerance]

    def _measure(
        self, blobs: list[Blob | None], edge: float, memory: BlobsMemory, camera: Camera, target: Target
    ) -> tuple[Array, Array | None, Array]:
        """Marker centres (N, 2), the pose, and perspective's bias (N, 2), from blobs whose borders are right within `edge` [px].

        The pose is solved from centroids less the bias of the last picture, which gives this picture's bias; where that
        is not the same within SAME_BIAS_PX, once more.
        """
        whole = [b if b and b.whole else None for b in blobs]
        centroid = np.array([(b.u, b.v) if b else (np.nan, np.nan) for b in whole])
        area = np.array([b.area if b else np.nan for b in whole])
        assumed = np.zeros_like(centroid) if memory.bias is None else memory.bias
        T = self._pose(centroid - assumed, area, memory.T_camera_target, camera, target)
        for _ in range(len(blobs) + MOST_ROUNDS):
            if T is None:
                break
            bias, expected = centre_bias(camera, target, T)
            worst, misfit = self._worst(area, expected, edge)
            if misfit > 1:
                centroid[worst] = area[worst] = np.nan
            elif not np.abs(bias - assumed).max() > SAME_BIAS_PX:
                break
            assumed = bias
            T = self._pose(centroid - assumed, area, T if memory.T_camera_target is None else memory.T_camera_target, camera, target)
        if T is None and memory.T_camera_target is not None:
            assumed = centre_bias(camera, target, memory.T_camera_target)[0]
        return (centroid - assumed if self.correct_centre else centroid), T, assumed

    def _pose(self, uv: Array, area: Array, previous: Array | None, camera: Camera, target: Target) -> Array | None:
        seen = np.isfinite(uv[:, 0])
        n = int(np.count_nonzero(seen))
        if n < 3:
            return None
        rays, points = (camera.ray(uv), target.points) if n == len(seen) else (camera.ray(uv[seen]), target.points[seen])
        if len(points) == 3 and previous is None:
            return _first_of_three(rays, area, camera, target)
        return solve_pose_from_rays(rays, points, previous)

    def _worst(self, area: Array, expected: Array, edge: float) -> tuple[int, float]:
        """Which area (N,) is farthest from the expected one, and by how much, in units of what is allowed; unseen ones are not."""
        worst, most = 0, -1.0
        for i, (a, e) in enumerate(zip(area.tolist(), expected.tolist(), strict=True)):
            if math.isnan(a):
                continue
            allowed = self.area_tolerance * e + AREA_NOISE_PX + edge * 2 * math.sqrt(math.pi * e)
            misfit = math.inf if math.isnan(e) else abs(a - e) / allowed
            if misfit > most:
                worst, most = i, misfit
        return worst, most


def _first_of_three(rays: Array, area: Array, camera: Camera, target: Target) -> Array | None:
    """Of the poses that rays (3, 3) leave, the one that makes the areas (N,) least surprising; None if even that does not fit."""

    def surprise(T: Array) -> float:
        return float(np.nansum(np.abs(np.log(area / centre_bias(camera, target, T)[1]))))

    poses = three_ray_poses(rays, target.points[np.isfinite(area)])
    best = min(poses, key=surprise, default=None)
    return best if best is not None and surprise(best) < SURPRISE else None


def _smooth(camera: Camera) -> bool:
    """Whether pixels at a marker's rim mix colours: several samples a pixel, or a picture interpolated for a lens."""
    plain = isinstance(camera, Perspective) and camera.distortion is None
    return camera.multisampling > 0 or not plain


def _moves(memory: BlobsMemory, blobs: list[Blob | None]) -> tuple[tuple[float, float], ...]:
    """By how much each blob has moved since the last picture [px]; nothing where it was not seen then or is not now."""
    before = memory.blobs or (None,) * len(blobs)
    return tuple((b.u - a.u, b.v - a.v) if a and b else (0.0, 0.0) for a, b in zip(before, blobs, strict=True))
