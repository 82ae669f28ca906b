"""Lines on the floor: bird's-eye strips of the floor around the look-ahead distances, in which
stripes are found by hue.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

import numpy as np
from annotated_types import Ge, Gt, Lt
from numpy.typing import NDArray

from vstestbed.camera import Camera, Image, Picture, Regions, Window
from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array
from vstestbed.core.lazy import cv2
from vstestbed.core.quantity import PositiveAngle, PositiveLength, TighterBounds
from vstestbed.core.spec import spec
from vstestbed.targets.base import Target
from vstestbed.targets.ground_lines import GroundLines, on_foot
from vstestbed.vision.base import Detection, DetectorBase, TruthView, window_round
from vstestbed.vision.colour import chroma

# rows of a strip, about one pixel apart: enough for a stripe's direction, few enough for a bend of
# 2 m radius to be straight
ROWS = 9
# coordinate for a cell that the camera does not see [px]: too far outside for interpolation to
# reach the image
OUTSIDE = np.float32(-9)
BACKDROP = (128, 128, 128)  # grey for cells outside of the image: without hue


@dataclass(frozen=True, slots=True)
class Strip:
    """A strip of floor as a raster of ROWS x K cells, in the vehicle's frame (x ahead, y left), and
    its pixels.

    Attributes:
        row_m, column_m: size of a cell [m].
        lefts: y of the columns, shape (K,) [m], from left to right.
        maps: for each panel the pixels u and v of the cells, each (ROWS, K), or OUTSIDE where it is
            not seen.
    """

    row_m: float
    column_m: float
    lefts: Array
    maps: tuple[tuple[NDArray[np.float32], NDArray[np.float32]], ...]

    def window(self, panel: int, lens: Camera) -> Window | None:
        """The window of a panel's image that holds the strip;
        None where the panel does not see it.
        """
        uv = np.stack(self.maps[panel], axis=-1).reshape(-1, 2)
        uv = uv[uv[:, 0] != OUTSIDE]
        if not len(uv):
            return None
        left, top = (np.floor(uv.min(axis=0)) - 1).astype(int).tolist()
        right, bottom = (np.ceil(uv.max(axis=0)) + 2).astype(int).tolist()
        return window_round((left, top, right, bottom), (0.0, 0.0), lens, 0)


LinesState = tuple[tuple[Strip, ...], Array | None]
"""The strips, built with the first picture, and the last y of each point, shape (N,) [m], NaN where
never seen.
"""


@spec
class Lines(DetectorBase):
    """Lines on the floor by colour, where they cross the target's look distances.

    The camera's mount and lens are calibrated and the vehicle is upright on a level floor, so each
    pixel is a point of the floor (inverse perspective mapping). A strip of floor across each
    look-ahead distance is resampled from the image, at about one pixel a cell. Of the connected
    regions of a line's hue the largest is taken or, where two are of one size, as at a crossing,
    the one nearest to the last picture's. The centroids by chroma of the nine rows are fitted by a
    straight line (robustly, Huber), and its intersection with the look-ahead distance is the point.
    It is rejected where the region is cut by the strip's end or is not as wide as a stripe
    (occlusion). The pitch of a vehicle on its suspension displaces the floor, as on a real one.

    Args:
        chroma: max - min of r, g, b (0..255) above which a pixel belongs to a line [grey levels].
        hue_tolerance_deg: largest difference to the line's hue; never more than half the step
            between two lines' hues.
        reach_m: half width of the strips, to each side of the vehicle [m].
        width_tolerance: largest relative difference between the measured width and the stripe's
            [1].

    Reference: view of a plane from above: Corke 2017, Robotics, Vision & Control, section 14.2
    (planar homography); robust fit: Huber 1981, Robust Statistics.
    """

    kind: Literal["lines"] = "lines"
    chroma: Annotated[int, Ge(1), Lt(255)] = 60
    hue_tolerance_deg: Annotated[PositiveAngle, TighterBounds(le=180)] = 30.0
    reach_m: Annotated[PositiveLength, TighterBounds(le=10)] = 0.7
    width_tolerance: Annotated[float, Gt(0), Lt(1)] = 0.4
    needs_image: ClassVar[bool] = True
    markers: ClassVar[tuple[str, ...]] = ("stripe",)

    def init(self) -> LinesState:
        """Nothing seen yet."""
        return (), None

    def regions_of_interest(
        self, state: LinesState, camera: Camera, target: Target
    ) -> Regions | None:
        """The windows that hold the strips; None before the first picture."""
        if not state[0]:
            return None
        regions: list[tuple[Window, ...]] = []
        for i, panel in enumerate(camera.panels):
            windows = [strip.window(i, panel.lens) for strip in state[0]]
            regions.append(tuple(filter(None, windows)))
        return tuple(regions)

    def detect(
        self,
        state: LinesState,
        picture: Picture | None,
        view: TruthView | None,
        camera: Camera,
        target: Target,
        rng: np.random.Generator,
    ) -> tuple[LinesState, Detection]:
        """Crossings (N, 2) [px] in one picture, in the target's order, NaN where not seen."""
        picture = self._given(picture)
        strips, last = state
        n = len(target.points)
        assert isinstance(target, GroundLines)  # a scenario refuses others
        strips = strips or tuple(_strip(camera, ahead, self.reach_m) for ahead in target.look_m)
        last = np.full(n, np.nan) if last is None else last
        hues = target.hues_deg
        lefts = np.full(n, np.nan)
        for k, strip in enumerate(strips):
            floor = _from_above(picture, strip)
            colour = chroma(floor)
            hue = cv2.cvtColor(floor, cv2.COLOR_RGB2HSV)[..., 0]
            # Points are commanded line by line, each at all look-ahead distances: every
            # len(strips)-th is in this strip.
            for i in range(k, n, len(strips)):
                # One comparison for each of OpenCV's 256 hues (of 2 degrees), then a lookup for
                # each cell.
                apart = np.abs((2.0 * np.arange(256) - hues[i] + 180) % 360 - 180)
                near = (apart <= min(self.hue_tolerance_deg, 180 / (n // len(strips))))[hue]
                mask = ((colour > self.chroma) & near).astype(np.uint8)
                lefts[i] = self._cross(strip, colour, mask, target.marker.width_m, last[i])
        aheads = np.tile(target.look_m, n // len(strips))
        uv = camera.project(on_foot(camera.mount.T, np.column_stack([aheads, lefts])))
        return (strips, np.where(np.isfinite(lefts), lefts, last)), Detection(uv=uv)

    def _cross(
        self, strip: Strip, colour: Image, mask: Image, width_m: float, last: float
    ) -> float:
        """Y at which a line crosses the middle row of its strip [m]; NaN where it is not seen well
        enough.

        colour: chroma (ROWS, K); mask: 1 in the line's cells (ROWS, K); width_m: of the stripe;
            last: y in the last picture [m], or NaN.
        """
        count, labels, stats, centres = cv2.connectedComponentsWithStats(mask, connectivity=8)
        if count < 2:
            return math.nan
        areas = stats[1:, cv2.CC_STAT_AREA]
        able = 1 + np.flatnonzero(2 * areas >= areas.max())
        far = -areas[able - 1]
        if math.isfinite(last):
            far = np.abs(strip.lefts[np.rint(centres[able, 0]).astype(int)] - last)
        mine = labels == able[np.argmin(far)]
        around = cv2.dilate(mine.astype(np.uint8), np.ones((1, 3), np.uint8)) > 0
        weight = np.where(around, colour, 0).astype(float)
        rows = np.flatnonzero((weight[:, 0] == 0) & (weight[:, -1] == 0) & mine.any(axis=1))
        if len(rows) < 5:
            return math.nan
        mass = weight[rows].sum(axis=1)
        columns = weight[rows] @ np.arange(weight.shape[1]) / mass
        ahead = (rows - ROWS // 2) * strip.row_m / strip.column_m
        points = np.column_stack([ahead, columns]).astype(np.float32)
        # With Huber's loss, outliers beyond a unit or so weigh little.
        vx, vy, x0, y0 = cv2.fitLine(points, cv2.DIST_HUBER, 0, 1e-3, 1e-3).ravel().tolist()
        slope = vy / vx if abs(vx) > 1e-6 else math.copysign(1e6, vy)
        crossing = y0 - slope * x0
        columns_wide = float(np.median(mass)) / float(weight.max())
        width = columns_wide * strip.column_m / math.hypot(1.0, slope)
        if abs(width - width_m) > self.width_tolerance * width_m:
            return math.nan
        return float(strip.lefts[0] + crossing * (strip.lefts[1] - strip.lefts[0]))


def _strip(camera: Camera, ahead: float, reach: float) -> Strip:
    """The strip of floor at a look-ahead distance [m], `reach` [m] to each side; ParameterError
    where the camera does not see the floor.
    """
    # Pixels per metre by finite differences of 2 mm, which hold for any lens.
    mount = camera.mount.T
    step = 0.002
    probes = np.array([[ahead, 0.0], [ahead + step, 0.0], [ahead, step]])
    here, on, left = camera.project(on_foot(mount, probes))
    # a cell is a pixel, if neither
    row_m, column_m = (
        float(np.clip(step / np.linalg.norm(uv - here), 5e-4, 0.02)) for uv in (on, left)
    )
    if not math.isfinite(row_m + column_m):
        raise ParameterError.bound(
            "target.look_m", "within", "the floor that the camera sees", ahead
        )
    half = math.ceil(reach / column_m)
    # left is left, as in the image
    lefts: Array = np.arange(half, -half - 1, -1, dtype=np.float64) * column_m
    aheads: Array = ahead + (np.arange(ROWS, dtype=np.float64) - ROWS // 2) * row_m
    floor = np.stack(np.meshgrid(aheads, lefts, indexing="ij"), axis=-1)
    p = on_foot(mount, floor.astype(np.float64))
    maps = []
    for panel in camera.panels:
        uv = panel.project(p)
        u, v = np.moveaxis(np.where(panel.lens.inside(uv)[..., None], uv, OUTSIDE), -1, 0)
        maps.append((np.ascontiguousarray(u, np.float32), np.ascontiguousarray(v, np.float32)))
    return Strip(row_m, column_m, lefts, tuple(maps))


def _from_above(picture: Picture, strip: Strip) -> Image:
    """The strip's image (ROWS, K, 3); where several panels see a cell, from the first of them."""
    out: Image | None = None
    for image, maps in zip(picture.images, strip.maps, strict=True):
        if image is None or (maps[0] == OUTSIDE).all():
            continue
        seen = cv2.remap(image, *maps, cv2.INTER_LINEAR, None, cv2.BORDER_CONSTANT, BACKDROP)
        if out is not None:
            seen = np.where((out == BACKDROP).all(axis=-1, keepdims=True), seen, out)
        out = seen
    return np.full((*strip.maps[0][0].shape, 3), BACKDROP[0], np.uint8) if out is None else out
