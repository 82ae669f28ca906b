"""Coloured markers: blobs segmented by chroma, identified by hue, tracked in windows, corrected for perspective bias."""

from __future__ import annotations

import math
from typing import Annotated, ClassVar, Literal

import numpy as np
from annotated_types import Ge, Gt, Le, Lt

from vstestbed.camera import Camera, Look, Picture, Window
from vstestbed.core.errors import ParameterError
from vstestbed.core.quantity import Narrower, Pixels, PositiveAngle
from vstestbed.core.spec import spec
from vstestbed.targets.base import Target
from vstestbed.vision.base import Detection, DetectorBase, TruthView
from vstestbed.vision.detect.assign import assign_blobs
from vstestbed.vision.detect.colour_blobs import Blob, Region, Rim, find_blobs, noise_level
from vstestbed.vision.detect.moments import MarkerFit
from vstestbed.vision.detect.track import BlobsMemory, at_border, hand_over, largest, look_of, moves_of, windows

EDGE_PX = 0.15
"""Error of a smoothed, shaded blob's border, inwards or outwards [px] (measured on rendered balls of 5 px radius and more)."""

Place = tuple[int, Window]
"""Index of the camera's panel, and a window in it."""
Found = tuple[int, Blob] | None
"""Index of the camera's panel and a marker's blob in it; None: not found."""


@spec
class Blobs(DetectorBase):
    """Markers by colour: chroma mask, contours, moments; identified by the hue at the centroid.

    Tracking: a marker is searched in a window around its predicted position (constant velocity); when one is not found there, the
    whole image of the same exposure is searched. In a camera with panels it is handed over to the next panel before it reaches a
    border; where panels overlap it counts once. Of several blobs of one hue, those are taken that one pose of the target explains
    (`assign_blobs`).

    Measurement: the image of the marker's centre is the centroid less the perspective bias under the pose that the markers
    themselves give. A blob is rejected if it touches the image's border, if its shape is no ellipse, if its area differs from
    what the pose predicts (occlusion), or if it lies far from where the pose of the others predicts it (another object of that
    colour); the worst is left out and the pose solved again until all fit. Of three markers without an earlier pose, the
    solution whose areas fit best is taken. With fewer than three, border and shape alone decide, and the bias is that of the
    last pose.

    Noise: its level is estimated from the image (`noise_level`: 0 for a rendered one without noise). From a standard deviation
    of about 1 grey level, blobs are segmented in the smoothed image, and with `grey` moments edge pixels are weighted by their
    measured chroma, so that centroids scatter in proportion to the noise: 2 cm discs at 1 m by .01, .02 and .05 px for 2, 8 and
    20 grey levels. Above 20, markers begin to be missed; the dark sides of shaded balls a little before. From about 30 on,
    noise itself may be taken for a marker.

    Args:
        chroma: max - min of r, g, b (0..255) above which a pixel belongs to a marker [grey levels]; scenes keep everything else below it.
        hue_tolerance_deg: largest difference to the marker's hue; never more than half the step between two markers' hues.
        least_area_px: least area of a blob; smaller ones are noise [px^2].
        moments: `binary` weights each pixel 0 or 1; `grey` by coverage, which is finer in images with multisampling and the
            same in images with neither multisampling nor noise, whose markers are of one colour up to the edge.
        correct_centre: subtract the perspective bias from the centroid.
        area_tolerance: largest relative difference between a blob's area and the predicted one [1].
        window_margin_px: margin of a window around the predicted blob, besides half of its last move [px].

    Reference: Corke 2017, Robotics, Vision & Control, sections 13.1 and 15.2 (blobs, moments, visual servoing with them).
    """

    kind: Literal["blobs"] = "blobs"
    chroma: Annotated[int, Ge(1), Lt(255)] = 60
    hue_tolerance_deg: Annotated[PositiveAngle, Narrower(le=180)] = 15.0
    least_area_px: Annotated[Pixels, Narrower(ge=1)] = 9.0
    moments: Literal["binary", "grey"] = "grey"
    correct_centre: bool = True
    area_tolerance: Annotated[float, Gt(0), Lt(1)] = 0.06
    window_margin_px: Annotated[int, Ge(2), Le(8192)] = 8
    needs_image: ClassVar[bool] = True
    needs_truth: ClassVar[bool] = False
    markers: ClassVar[tuple[str, ...]] = ("disc", "sphere")

    def init(self) -> BlobsMemory:
        """Nothing seen yet."""
        return BlobsMemory()

    def look(self, memory: BlobsMemory, camera: Camera, target: Target) -> Look | None:
        """Windows around the predicted markers, in a camera with panels also across the seams; None where a marker is lost."""
        return look_of(memory, camera, self.window_margin_px) if memory.blobs else None

    def detect(
        self, memory: BlobsMemory, picture: Picture | None, view: TruthView | None, camera: Camera, target: Target, rng: np.random.Generator
    ) -> tuple[BlobsMemory, Detection]:
        """Marker centres (N, 2) [px] in one picture, NaN where not seen, and the pose (4, 4) where it can be solved.

        Raises:
            ParameterError: there is no picture.
        """
        if picture is None or picture.empty:
            raise ParameterError("picture", "is missing: detector blobs needs one; use detector oracle where there is none")
        noise = _noise_levels(picture)
        found = self._track(picture, noise, memory, camera, target)
        if found is None:
            picture = picture.completed()
            noise = _noise_levels(picture)
            found = self._search(picture, noise, memory, camera, target)
        blobs, panels = _split(found, memory)
        level = max((noise[f[0]] for f in found if f), default=0.0)
        markers = MarkerFit(camera, target, panels, self.area_tolerance, _edge_px(level, camera.panels[0].lens))
        uv, T, bias = markers.centres(blobs, memory, self.correct_centre)
        for i in np.flatnonzero(markers.outliers):
            blobs[i] = None  # not tracked: its window would follow the wrong object
        kept = T if T is not None else memory.T_camera_target
        after = BlobsMemory(tuple(blobs), moves_of(memory, blobs, panels, camera), kept, bias, tuple(panels))
        if len(camera.panels) > 1:
            after = hand_over(after, camera, self.window_margin_px)
        return after, Detection(uv=uv, T_camera_target=T)

    def _blobs_in(self, places: list[Place], picture: Picture, noise: list[float], camera: Camera) -> list[list[Blob]]:
        """All blobs in each of some places of a picture, in directions that the lens there sees."""
        regions: list[Region] = []
        for panel, window in places:
            image, lens, level = picture.images[panel], camera.panels[panel].lens, noise[panel]
            assert image is not None
            rim: Rim = self.moments if _smooth(lens) or (level > 0 and self.moments == "binary") else "sharp"
            regions.append(Region(image, window, rim, level))
        found = find_blobs(regions, self.chroma, self.least_area_px)
        return [_seen_by(camera.panels[panel].lens, blobs) for (panel, _), blobs in zip(places, found, strict=True)]

    def _track(self, picture: Picture, noise: list[float], memory: BlobsMemory, camera: Camera, target: Target) -> list[Found] | None:
        """Each marker's blob from a window of its own; None where one is lost and the whole image must be searched."""
        own = windows(memory, camera, self.window_margin_px)
        if own is None or any(picture.images[panel] is None for panel in memory.panels):
            return None
        places = list(zip(memory.panels, own, strict=True))
        found: list[Found] = []
        by_marker = self._blobs_in(places, picture, noise, camera)
        for hue, last, move, (panel, window), blobs in zip(target.hues_deg, memory.blobs, memory.moves, places, by_marker, strict=True):
            lens = camera.panels[panel].lens
            if last is None:
                return None
            blob = _nearest(self._of_hue(blobs, hue, len(own)), last.u + move[0], last.v + move[1])
            if blob is None or blob.cut_by(window, lens.width, lens.height):
                return None
            if len(camera.panels) > 1 and at_border(blob, lens):
                return None  # another panel may have the whole of it
            found.append((panel, blob))
        return found

    def _search(self, picture: Picture, noise: list[float], memory: BlobsMemory, camera: Camera, target: Target) -> list[Found]:
        """Each marker's blob in the whole image: of those with its hue the one that the target's geometry explains.

        In a camera with panels instead the largest, blobs that are not cut first.
        """
        hues, everywhere = target.hues_deg, self._all_blobs(picture, noise, camera)
        by_marker = [[f for f in everywhere if self._has_hue(f[1], hue, len(hues))] for hue in hues]
        if len(camera.panels) == 1 and max(map(len, by_marker)) > 1:
            return list(assign_blobs(by_marker, camera, target, memory.T_camera_target))
        return [largest(some, camera) for some in by_marker]

    def _all_blobs(self, picture: Picture, noise: list[float], camera: Camera) -> list[tuple[int, Blob]]:
        """All blobs of all panels, each with the index of its panel."""
        drawn = [i for i, image in enumerate(picture.images) if image is not None]
        whole = [(i, (0, 0, camera.panels[i].lens.width, camera.panels[i].lens.height)) for i in drawn]
        # One by one: a panel is too large for the time of a call to count.
        return [(place[0], blob) for place in whole for blob in self._blobs_in([place], picture, noise, camera)[0]]

    def _of_hue(self, blobs: list[Blob], hue_deg: float, n_hues: int) -> list[Blob]:
        return [b for b in blobs if self._has_hue(b, hue_deg, n_hues)]

    def _has_hue(self, blob: Blob, hue_deg: float, n_hues: int) -> bool:
        """Whether a blob has a marker's hue, of `n_hues` that must be told apart."""
        tolerance = min(self.hue_tolerance_deg, 180 / n_hues)
        return abs((blob.hue_deg - hue_deg + 180) % 360 - 180) <= tolerance


def _noise_levels(picture: Picture) -> list[float]:
    """The noise of each panel's image [grey levels]; 0 for one that was not drawn."""
    return [0.0 if image is None else noise_level(image) for image in picture.images]


def _seen_by(lens: Camera, blobs: list[Blob]) -> list[Blob]:
    """The blobs in directions that a lens sees: noise makes blobs outside of a wide lens's image circle, too, where a pixel has no ray."""
    if not blobs or lens.sees_all:
        return blobs
    seen = np.isfinite(lens.ray(np.array([(blob.u, blob.v) for blob in blobs]))[:, 0])
    return [blob for blob, is_seen in zip(blobs, seen.tolist(), strict=True) if is_seen]


def _split(found: list[Found], memory: BlobsMemory) -> tuple[list[Blob | None], list[int]]:
    """The blobs and their panels; for a marker not found the panel in which it was seen last, at first 0."""
    panels = memory.panels or (0,) * len(found)
    return [f[1] if f else None for f in found], [f[0] if f else last for f, last in zip(found, panels, strict=True)]


def _nearest(blobs: list[Blob], u: float, v: float) -> Blob | None:
    """The blob whose centroid is nearest to (u, v) [px]."""
    return min(blobs, key=lambda b: math.hypot(b.u - u, b.v - v), default=None)


def _edge_px(noise: float, lens: Camera) -> float:
    """Error of a blob's border [px]: none in a clean image of one sample a pixel, whose colours are exact."""
    return EDGE_PX if noise > 0 or _smooth(lens) else 0.0


def _smooth(lens: Camera) -> bool:
    """Whether pixels at a marker's edge mix colours: several samples a pixel, or an image interpolated for a lens."""
    return lens.multisampling > 0 or lens.resampled
