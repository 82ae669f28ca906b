"""Coloured markers: found as blobs, tracked in windows, corrected for perspective, dropped where they are cut."""

from __future__ import annotations

import math
from typing import Annotated, ClassVar, Literal

import numpy as np
from annotated_types import Ge, Gt, Le, Lt

from vstestbed.camera import Camera, Look, Perspective, Picture, Window
from vstestbed.core.errors import ParameterError
from vstestbed.core.spec import spec
from vstestbed.targets.base import Target
from vstestbed.vision.base import Detection, TruthView
from vstestbed.vision.detect.assign import choose
from vstestbed.vision.detect.colour_blobs import Blob, Image, find_blobs, noise_level
from vstestbed.vision.detect.moments import Measure
from vstestbed.vision.detect.track import BlobsMemory, at_border, hand_over, largest, look_of, moves_of, windows

EDGE_PX = 0.15
"""How far inside or outside of the true border a smoothed, shaded blob's border may lie [px] (rendered balls of 5 px and more)."""


Found = tuple[int, Blob] | None
"""A marker's blob and the panel of the camera in which it is; None: not found."""


@spec
class Blobs:
    """Markers by colour: chroma mask, contours, moments; told apart by the hue at the centroid.

    A tracked marker is looked for in a window round its predicted position (last + last move); when one is lost, the
    whole picture is searched. In a camera with panels it is handed from one panel to the next before it comes to a border;
    where the panels overlap it counts once. What is reported are images of marker centres: the centroid less perspective's bias, from
    the pose that the markers themselves give. A blob is not reported if it touches the picture's border, if its shape
    is not an ellipse's, or if its area is not what the pose makes expect (something stands before it); the worst such
    marker is left out and the pose solved anew until all fit. Nor is a blob reported that is far from where the pose of the others
    has its marker: a thing of the marker's colour somewhere else; of several of one hue, that is taken which one pose of the
    target explains together with the others (`match.choose`). Three markers and no pose before: of the poses they leave,
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

    def look(self, memory: BlobsMemory, camera: Camera, target: Target) -> Look | None:
        """Windows round the predicted markers, in a camera with panels also where they may cross a seam; None where one is lost."""
        return look_of(memory, camera, self.window_margin_px) if memory.blobs else None

    def detect(
        self, memory: BlobsMemory, frame: Picture | None, view: TruthView | None, camera: Camera, target: Target, rng: np.random.Generator
    ) -> tuple[BlobsMemory, Detection]:
        """Marker centres (N, 2) [px] in one picture, NaN where not seen, and the pose (4, 4) where it can be solved.

        Raises:
            ParameterError: there is no picture.
        """
        if frame is None or all(image is None for image in frame.images):
            raise ParameterError("frame", "is missing: detector blobs needs a picture; use detector oracle where there is none")
        noise = max(noise_level(image) for image in frame.images if image is not None)
        found = self._track(frame, noise, memory, camera, target) or self._search(frame, noise, memory, camera, target)
        blobs, panels = [f[1] if f else None for f in found], [f[0] if f else 0 for f in found]
        edge = EDGE_PX if noise > 0 or _smooth(camera.panels[0].lens) else 0.0
        measure = Measure(camera, target, panels, self.area_tolerance, edge)
        uv, T, bias = measure.centres(blobs, memory, self.correct_centre)
        kept = T if T is not None else memory.T_camera_target
        blobs = [None if alien else b for b, alien in zip(blobs, measure.aliens, strict=True)]
        after = BlobsMemory(tuple(blobs), moves_of(memory, blobs, panels, camera), kept, bias, tuple(panels))
        if len(camera.panels) > 1:
            after = hand_over(after, camera, self.window_margin_px)
        return after, Detection(uv=uv, T_camera_target=T)

    def _look(self, image: Image, window: Window, noise: float, lens: Camera) -> list[Blob]:
        rim = self.moments if _smooth(lens) or (noise > 0 and self.moments == "binary") else "sharp"
        return find_blobs(image, window, self.chroma, self.least_area_px, rim, noise)

    def _track(self, frame: Picture, noise: float, memory: BlobsMemory, camera: Camera, target: Target) -> list[Found] | None:
        """Each marker's blob, the nearest to its prediction in a window of its own; None: whole pictures must be searched."""
        own = windows(memory, camera, self.window_margin_px)
        if own is None:
            return None
        found: list[Found] = []
        for hue, last, (du, dv), panel, window in zip(target.hues_deg, memory.blobs, memory.moves, memory.panels, own, strict=True):
            image, lens = frame.images[panel], camera.panels[panel].lens
            if image is None:
                return None
            mine = [b for b in self._look(image, window, noise, lens) if self._is_of(b, hue, len(own))]
            u, v = (last.u + du, last.v + dv) if last else (math.nan, math.nan)
            blob = min(mine, key=lambda b: math.hypot(b.u - u, b.v - v), default=None)
            if blob is None or blob.cut_by(window, lens.width, lens.height):
                return None
            if len(camera.panels) > 1 and at_border(blob, lens):
                return None  # another panel may have the whole of it
            found.append((panel, blob))
        return found

    def _search(self, frame: Picture, noise: float, memory: BlobsMemory, camera: Camera, target: Target) -> list[Found]:
        """Each marker's blob in whole pictures: of those with its hue the one that the target's geometry asks for.

        In a camera with panels, whole ones first, the largest.
        """
        found: list[tuple[int, Blob]] = []
        for panel, image in enumerate(frame.images):
            if image is not None:
                lens = camera.panels[panel].lens
                found += [(panel, b) for b in self._look(image, (0, 0, lens.width, lens.height), noise, lens)]
        hues = target.hues_deg
        mine = [[f for f in found if self._is_of(f[1], hue, len(hues))] for hue in hues]
        if len(camera.panels) == 1 and any(len(some) > 1 for some in mine):
            return list(choose(mine, camera, target, memory.T_camera_target))
        return [largest(some, camera) for some in mine]

    def _is_of(self, blob: Blob, hue_deg: float, n_hues: int) -> bool:
        """Whether a blob has a marker's hue."""
        tolerance = min(self.hue_tolerance_deg, 180 / n_hues)
        return abs((blob.hue_deg - hue_deg + 180) % 360 - 180) <= tolerance


def _smooth(lens: Camera) -> bool:
    """Whether pixels at a marker's rim mix colours: several samples a pixel, or a picture interpolated for a lens."""
    plain = isinstance(lens, Perspective) and lens.distortion is None
    return lens.multisampling > 0 or not plain
