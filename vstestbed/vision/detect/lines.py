"""Lines on the floor: a strip of floor round each look distance, seen from straight above, in which stripes are found by hue."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal

import cv2
import numpy as np
from annotated_types import Ge, Gt, Le, Lt
from numpy.typing import NDArray

from vstestbed.camera import Camera, Image, Look, Picture, Window
from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array
from vstestbed.core.spec import spec
from vstestbed.targets.base import Target
from vstestbed.targets.ground_lines import GroundLines, on_foot
from vstestbed.vision.base import Detection, TruthView
from vstestbed.vision.detect.colour_blobs import chroma

ROWS = 9
"""Rows of a strip, one about every pixel: a stripe's direction shows, and a bend of 2 m is straight over them."""
LEAST_ROWS = 5
"""A line is not told from fewer."""
FINEST_M, COARSEST_M = 5e-4, 0.02
"""Between these lies the raster of a strip [m]; else a raster unit is a pixel."""
OUTSIDE = np.float32(-9)
"""Where a picture has no pixel [px]: far enough out for interpolation to find nothing there."""
BACKDROP = (128, 128, 128)
"""What is outside of the picture: of no colour."""


@dataclass(frozen=True, slots=True)
class Strip:
    """A strip of floor as a raster of ROWS rows, and the pixels that it is made of.

    Attributes:
        ahead: of its middle row [m]. row_m, column_m: the raster [m]. lefts: of the columns' middles, shape (K,) [m].
        maps: for each of the camera's panels the pixels u and v, each (ROWS, K), or OUTSIDE where it does not see the place.
    """

    ahead: float
    row_m: float
    column_m: float
    lefts: Array
    maps: tuple[tuple[NDArray[np.float32], NDArray[np.float32]], ...]

    def window(self, panel: int, lens: Camera) -> Window | None:
        """The piece of a panel's picture that it is made of; None where there is none."""
        uv = np.stack(self.maps[panel], axis=-1).reshape(-1, 2)
        uv = uv[uv[:, 0] != OUTSIDE]
        if not len(uv):
            return None
        (left, top), (right, bottom) = (np.floor(uv.min(axis=0)) - 1).astype(int), (np.ceil(uv.max(axis=0)) + 2).astype(int)
        return max(0, int(left)), max(0, int(top)), min(lens.width, int(right)), min(lens.height, int(bottom))


@dataclass(frozen=True, slots=True)
class LinesMemory:
    """The strips (made with the first picture), and how far to the left each point was last, shape (N,) [m], NaN where not seen."""

    strips: tuple[Strip, ...] = ()
    lefts: Array | None = None


@spec
class Lines:
    """Lines on the floor by colour, where they cross the target's look distances.

    The camera's mount and lens are calibrated, the vehicle stands upright on a level floor: so each pixel is a place on the
    floor. A strip of floor across each look distance is put together from the picture, seen from straight above, about a
    pixel to a raster unit, whatever the lens. In it a line's pixels are those of its hue; of their connected regions the
    largest counts, or where two are of one size, as where a way crosses itself, the one nearest to the last picture's. In
    each of nine rows the centroid by chroma is taken, a straight line fitted to them robustly (Huber), and
    where that crosses the look distance is the point. It is not reported where the region is cut by the strip's end, or is not
    as wide as a stripe (something stands before it). A vehicle that pitches sees the floor displaced, as a real one does.

    Args:
        chroma: max - min of r, g, b (0..255) above which a pixel belongs to a line.
        hue_tolerance_deg: largest difference to the line's hue; never more than half the step between two lines' hues.
        reach_m: how far to each side a line is looked for [m].
        width_tolerance: largest relative difference between the width seen and the stripe's.

    Reference: view of a plane from above: Corke 2017, Robotics, Vision & Control, section 14.2 (planar homography); robust fit:
    Huber 1981, Robust Statistics.
    """

    kind: Literal["lines"] = "lines"
    chroma: Annotated[int, Ge(1), Lt(255)] = 60
    hue_tolerance_deg: Annotated[float, Gt(0), Le(180)] = 30.0
    reach_m: Annotated[float, Gt(0), Le(10)] = 0.7
    width_tolerance: Annotated[float, Gt(0), Lt(1)] = 0.4
    needs_image: ClassVar[bool] = True
    needs_truth: ClassVar[bool] = False
    markers: ClassVar[tuple[str, ...]] = ("stripe",)

    def init(self) -> LinesMemory:
        """Nothing seen yet."""
        return LinesMemory()

    def look(self, memory: LinesMemory, camera: Camera, target: Target) -> Look | None:
        """The pieces of the picture that the strips are made of; None before the first."""
        if not memory.strips:
            return None
        panels = enumerate(camera.panels)
        return tuple(tuple(w for s in memory.strips if (w := s.window(i, panel.lens)) is not None) for i, panel in panels)

    def detect(
        self, memory: LinesMemory, frame: Picture | None, view: TruthView | None, camera: Camera, target: Target, rng: np.random.Generator
    ) -> tuple[LinesMemory, Detection]:
        """Crossings (N, 2) [px] in one picture, in the target's order, NaN where not seen.

        Raises:
            ParameterError: there is no picture, or the target is no lines.
        """
        if frame is None or all(image is None for image in frame.images):
            raise ParameterError("frame", "is missing: detector lines needs a picture; use detector oracle where there is none")
        if not isinstance(target, GroundLines):
            raise ParameterError("target", "must be of kind lines for detector lines")
        strips = memory.strips or tuple(_strip(camera, ahead, self.reach_m) for ahead in target.look_m)
        n = len(target.points)
        last = np.full(n, np.nan) if memory.lefts is None else memory.lefts
        hues, lefts = target.hues_deg, np.full(n, np.nan)
        for k, strip in enumerate(strips):
            floor = _from_above(frame, strip)
            colour, hue = chroma(floor), np.asarray(cv2.cvtColor(floor, cv2.COLOR_RGB2HSV)[..., 0], np.uint8)
            for i in range(k, n, len(strips)):
                mask = self._mask(colour, hue, hues[i], n // len(strips))
                lefts[i] = self._cross(strip, colour, mask, target.marker.width_m, last[i])
        aheads = np.tile(np.array([s.ahead for s in strips]), n // len(strips))
        uv = camera.project(on_foot(camera.mount.T, np.column_stack([aheads, lefts])))
        return LinesMemory(strips, np.where(np.isfinite(lefts), lefts, last)), Detection(uv=uv)

    def _mask(self, colour: Image, hue: Image, hue_deg: float, lines: int) -> Image:
        """1 where a raster unit is of a line's hue. OpenCV's hue is in steps of 2 degrees."""
        tolerance = min(self.hue_tolerance_deg, 180 / lines)
        apart = np.abs((2.0 * np.arange(256) - hue_deg + 180) % 360 - 180)
        return ((colour > self.chroma) & (apart <= tolerance)[hue]).astype(np.uint8)

    def _cross(self, strip: Strip, colour: Image, mask: Image, width_m: float, last: float) -> float:
        """How far to the left a line crosses the middle of its strip [m]; NaN where it cannot be told."""
        count, labels, stats, centres = cv2.connectedComponentsWithStats(mask, connectivity=8)
        if count < 2:
            return math.nan
        areas = stats[1:, cv2.CC_STAT_AREA]
        able = 1 + np.flatnonzero(2 * areas >= areas.max())
        far = np.abs(strip.lefts[np.rint(centres[able, 0]).astype(int)] - last) if math.isfinite(last) else -areas[able - 1]
        one = int(able[np.argmin(far)])
        weight = np.where(cv2.dilate((labels == one).astype(np.uint8), np.ones((1, 3), np.uint8)) > 0, colour, 0).astype(float)
        rows = np.flatnonzero((weight[:, 0] == 0) & (weight[:, -1] == 0) & ((labels == one).any(axis=1)))
        if len(rows) < LEAST_ROWS:
            return math.nan
        mass = weight[rows].sum(axis=1)
        columns = weight[rows] @ np.arange(weight.shape[1]) / mass
        slope, crossing = _fit(np.column_stack([(rows - ROWS // 2) * strip.row_m / strip.column_m, columns]))
        width = float(np.median(mass)) / float(weight.max()) * strip.column_m / math.hypot(1.0, slope)
        if abs(width - width_m) > self.width_tolerance * width_m:
            return math.nan
        return float(strip.lefts[0] + crossing * (strip.lefts[1] - strip.lefts[0]))


def _fit(points: NDArray[np.floating[Any]]) -> tuple[float, float]:
    """Slope and value at 0 of the line through points (K, 2), robustly: outliers over a unit or so count little."""
    vx, vy, x0, y0 = cv2.fitLine(points.astype(np.float32), cv2.DIST_HUBER, 0, 1e-3, 1e-3).ravel().tolist()
    slope = vy / vx if abs(vx) > 1e-6 else math.copysign(1e6, vy)
    return slope, y0 - slope * x0


def _strip(camera: Camera, ahead: float, reach: float) -> Strip:
    """The strip of floor at a look distance [m], `reach` [m] to each side, and the pixels that it is made of in each panel.

    Raises:
        ParameterError: the camera does not see the floor there.
    """
    mount, step = camera.mount.T, 0.002
    here, on, left = camera.project(on_foot(mount, np.array([[ahead, 0.0], [ahead + step, 0.0], [ahead, step]])))
    row_m, column_m = (float(np.clip(step / np.linalg.norm(uv - here), FINEST_M, COARSEST_M)) for uv in (on, left))
    if not math.isfinite(row_m + column_m):
        raise ParameterError("target.look_m", "must be where the camera sees the floor", ahead)
    half = math.ceil(reach / column_m)
    lefts: Array = np.arange(half, -half - 1, -1, dtype=np.float64) * column_m  # as in the picture, left at the left
    aheads: Array = ahead + (np.arange(ROWS, dtype=np.float64) - ROWS // 2) * row_m
    floor = np.stack(np.meshgrid(aheads, lefts, indexing="ij"), axis=-1)
    p = on_foot(mount, floor.astype(np.float64))
    maps = []
    for panel in camera.panels:
        uv = panel.lens.project(p @ panel.R_camera_panel)
        u, v = np.moveaxis(np.where(panel.lens.inside(uv)[..., None], uv, OUTSIDE), -1, 0)
        maps.append((np.ascontiguousarray(u, np.float32), np.ascontiguousarray(v, np.float32)))
    return Strip(ahead, row_m, column_m, lefts, tuple(maps))


def _from_above(frame: Picture, strip: Strip) -> Image:
    """The strip's picture (ROWS, K, 3); of several panels that see a place, the first that was drawn."""
    out: Image | None = None
    for image, maps in zip(frame.images, strip.maps, strict=True):
        if image is None or (maps[0] == OUTSIDE).all():
            continue
        seen = np.asarray(cv2.remap(image, *maps, cv2.INTER_LINEAR, None, cv2.BORDER_CONSTANT, BACKDROP), np.uint8)
        out = seen if out is None else np.where((out == BACKDROP).all(axis=-1, keepdims=True), seen, out)
    return np.full((*strip.maps[0][0].shape, 3), BACKDROP[0], np.uint8) if out is None else out
