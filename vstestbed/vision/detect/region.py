"""One region of colour: segmented by chroma and hue, its border measured to a fraction of a pixel, the target's outline fitted to it."""

from __future__ import annotations

import colorsys
import math
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal, NamedTuple

import cv2
import numpy as np
from annotated_types import Ge, Gt, Le, Lt
from numpy.typing import NDArray

from vstestbed.camera import Camera, Image, Look, Picture, Window
from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array
from vstestbed.core.quantity import Narrower, Pixels, PositiveAngle, PositivePixels
from vstestbed.core.spec import spec
from vstestbed.features.observation import Goal
from vstestbed.targets.base import Target
from vstestbed.vision.base import Detection, DetectorBase, TruthView
from vstestbed.vision.detect.colour_blobs import Region, chroma_mask, noise_level
from vstestbed.vision.detect.edges import bare_share, coverage, edge_points
from vstestbed.vision.detect.outline_fit import Border, OutlineFit, fit_outline, turn_at
from vstestbed.vision.detect.windows import Move, windows_round

MOST_EDGES = 400
"""Points of a border that are fitted at most, evenly spread: with more the outline hardly becomes better."""
LEAST_EDGES = 24
"""Fewest points from which an outline is fitted."""
MOST_TRIED = 3
"""Regions of the target's hue that are tried, the largest first."""
NOISE_PX = 0.05
"""Added to the tolerance by noise [px per grey level of its standard deviation]."""
PIXEL_PX = 1.0
"""Added to the tolerance where the outline is compared with whole pixels [px]: outlines that were right, sharp, blurred over up to 8 px or
under noise, then had under 0.015 of their length farther from the region's pixels."""
BESIDE_PX = 3
"""A region is measured so far beyond its box [px], which may touch the window in which it was searched."""


class Found(NamedTuple):
    """A region: its box [px], its centroid (2,) [px], and the outline fitted to it."""

    box: Window
    middle: Array
    fit: OutlineFit


@dataclass(frozen=True, slots=True)
class RegionMemory:
    """State of the region detector.

    Attributes:
        expected: how a shape is turned in the goal view [rad]: the first guess, which decides for a shape with symmetry.
        box, middle: of the region in the last picture [px]; None where it was not found.
        move: its displacement since the picture before [px].
        turn: how the shape was turned in the last picture [rad].
    """

    expected: float = 0.0
    box: Window | None = None
    middle: Array | None = None
    move: Move = (0.0, 0.0)
    turn: float = 0.0


@spec
class RegionDetector(DetectorBase):
    """The outline of the target's region, as points in the target's order: of a shape or a ball.

    Segmentation: connected pixels with more than `chroma` and the target's hue; of several regions the largest to which the outline
    fits. In later pictures it is searched in a window around its predicted place (constant velocity), and where it is not whole there,
    in the whole image.

    Measurement: the border is measured at every pixel along it by coverage (`edge_points`), and the target's outline is fitted to it
    by least squares, in undistorted coordinates: of a polygon the homography of its plane, which needs no calibrated depth and no pose;
    of a disc the ellipse; of a ball the cone of rays that touch it. The outline's points then are those of the target in its order.
    Borders of pixels that are in or out (`camera.multisampling: 0`) are off by up to half a pixel, alike along a border that runs along
    the rows: with 4 samples the points of a shape 200 px long are exact to some hundredths of a pixel.

    Lost: a region that reaches the image's border, since the moments of a part are not those of the region, or of which another thing
    hides a part: more than `hidden_share` of its border is farther than `tolerance_px` from the fitted outline, or of the outline from
    its border. By the second, a remnant is no region that lies along one side of an outline many times its size. A part with the outline
    of the whole as seen from elsewhere, such as half of a square, is not told from it.

    Args:
        chroma: max - min of r, g, b (0..255) above which a pixel belongs to the region [grey levels]; scenes keep everything else below it.
        hue_tolerance_deg: largest difference to the target's hue.
        least_area_px: least area of the region [px^2].
        tolerance_px: largest distance of the border from the fitted outline [px].
        hidden_share: share of the border, and of the fitted outline, that may be farther from the other, above which the region counts as
            partly hidden [1].
        window_margin_px: margin of the window around the predicted region, besides half of its last move [px].

    Reference: coverage as the mean over a pixel: Corke 2017, Robotics, Vision & Control, section 13.1 (regions, moments).
    """

    kind: Literal["region"] = "region"
    chroma: Annotated[int, Ge(1), Lt(255)] = 60
    hue_tolerance_deg: Annotated[PositiveAngle, Narrower(le=180)] = 20.0
    least_area_px: Annotated[Pixels, Narrower(ge=50)] = 100.0
    tolerance_px: PositivePixels = 1.5
    hidden_share: Annotated[float, Gt(0), Lt(1)] = 0.04
    window_margin_px: Annotated[int, Ge(2), Le(8192)] = 12
    needs_image: ClassVar[bool] = True
    markers: ClassVar[tuple[str, ...]] = ("outline",)

    def init(self) -> RegionMemory:
        """Nothing seen yet."""
        return RegionMemory()

    def begin(self, goal: Goal, camera: Camera, target: Target) -> RegionMemory:
        """Nothing seen yet; a shape is expected as the goal view shows it."""
        return RegionMemory(expected=turn_at(goal, target))

    def look(self, memory: RegionMemory, camera: Camera, target: Target) -> Look | None:
        """A window around the predicted region; None where it is lost or large, and in a camera with panels."""
        own = self._window(memory, camera, self.window_margin_px + BESIDE_PX)
        return None if own is None else ((own,),)

    def _window(self, memory: RegionMemory, camera: Camera, margin: int) -> Window | None:
        if len(camera.panels) > 1:
            return None
        own = windows_round([memory.box], [memory.move], [0], camera, margin)
        return own[0] if own else None

    def detect(
        self,
        memory: RegionMemory,
        picture: Picture | None,
        view: TruthView | None,
        camera: Camera,
        target: Target,
        rng: np.random.Generator,
    ) -> tuple[RegionMemory, Detection]:
        """Points of the outline (M, 2) [px] in one picture; all NaN where the region is not found whole.

        Raises:
            ParameterError: there is no picture, or the target is not a region.
        """
        if picture is None or picture.empty:
            raise ParameterError("picture", "is missing: detector region needs one; use detector oracle where there is none")
        if not target.outlined:
            raise ParameterError("target", "must be a shape or a ball for detector region")
        found = self._tracked(picture, memory, camera, target) or self._searched(picture.completed(), memory, camera, target)
        if found is None:
            return RegionMemory(memory.expected), Detection(uv=np.full((len(target.points), 2), np.nan))
        du, dv = (0.0, 0.0) if memory.middle is None else (found.middle - memory.middle).tolist()
        after = RegionMemory(memory.expected, found.box, found.middle, (du, dv), found.fit.turn)
        return after, Detection(uv=camera.project(found.fit.p))

    def _tracked(self, picture: Picture, memory: RegionMemory, camera: Camera, target: Target) -> Found | None:
        """The region in a window round its predicted place; None where it is not whole there."""
        window, image = self._window(memory, camera, self.window_margin_px), picture.images[0]
        return None if window is None or image is None else self._largest(image, 0, window, memory, camera, target)

    def _searched(self, picture: Picture, memory: RegionMemory, camera: Camera, target: Target) -> Found | None:
        """The region in the first panel that has it whole; None where none has."""
        for panel, image in enumerate(picture.images):
            lens = camera.panels[panel].lens
            found = None if image is None else self._largest(image, panel, (0, 0, lens.width, lens.height), memory, camera, target)
            if found is not None:
                return found
        return None

    def _largest(self, image: Image, panel: int, window: Window, memory: RegionMemory, camera: Camera, target: Target) -> Found | None:
        """The largest region of the target's hue in a window that is whole and to which the outline fits; None without one."""
        lens = camera.panels[panel].lens
        region = Region(image, window, "grey" if lens.multisampling > 0 or lens.resampled else "sharp", noise_level(image))
        mask = chroma_mask(region.searched, self.chroma)
        _, labels, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=8)
        order = 1 + np.argsort(-stats[1:, cv2.CC_STAT_AREA], kind="stable")
        for label in order[:MOST_TRIED].tolist():
            x, y, w, h, area = stats[label].tolist()
            if area < self.least_area_px:
                break
            alone = np.asarray(255 * (labels[y : y + h, x : x + w] == label), np.uint8)
            left, top = window[0] + x, window[1] + y
            box = (left, top, left + w, top + h)
            if not self._has_hue(image[top : top + h, left : left + w], alone, target.hues_deg[0]) or not _inside(box, window, lens):
                continue
            if (found := self._fitted(region, alone, box, panel, memory, camera, target)) is not None:
                return found
        return None

    def _has_hue(self, part: Image, alone: Image, wanted_deg: float) -> bool:
        """Whether a region's mean colour has the target's hue."""
        r, g, b, _ = cv2.mean(part, mask=alone)
        return abs(math.remainder(360 * colorsys.rgb_to_hsv(r, g, b)[0] - wanted_deg, 360)) <= self.hue_tolerance_deg

    def _fitted(
        self, region: Region, alone: Image, box: Window, panel: int, memory: RegionMemory, camera: Camera, target: Target
    ) -> Found | None:
        """The outline fitted to a region, by `alone` (255 in its pixels in its box); None where it does not fit."""
        left, top = max(box[0] - BESIDE_PX, 0), max(box[1] - BESIDE_PX, 0)
        part = region.image[top : box[3] + BESIDE_PX, left : box[2] + BESIDE_PX]
        found = np.zeros(part.shape[:2], np.uint8)
        found[box[1] - top : box[3] - top, box[0] - left : box[2] - left] = alone
        cover = coverage(part, found)
        edge = edge_points(cover) + [left, top]
        if len(edge) < LEAST_EDGES:
            return None
        edge = edge[np.linspace(0, len(edge) - 1, min(len(edge), MOST_EDGES)).astype(int)]
        m = cv2.moments(cover)
        mass = m["m00"]
        middle = np.array([left + m["m10"] / mass, top + m["m01"] / mass])
        spread = np.array([[m["mu20"], m["mu11"]], [m["mu11"], m["mu02"]]]) / mass
        border = Border(edge, middle, spread, camera.panels[panel])
        fit = self._fitting(border, found, (left, top), self.tolerance_px + NOISE_PX * region.noise, memory, target)
        return None if fit is None else Found(box, middle, fit)

    def _fitting(
        self, border: Border, found: NDArray[np.uint8], corner: tuple[int, int], tolerance: float, memory: RegionMemory, target: Target
    ) -> OutlineFit | None:
        """The outline that fits a border, turned as in the last picture or else all round; None where neither fits.

        Args:
            found: 255 in the region's pixels, of a part of the image whose first pixel is `corner`.
        """
        for turn in [None] if memory.box is None else [memory.turn, None]:
            fit = fit_outline(border, target, turn, memory.expected)
            if fit is None:
                continue
            bare = bare_share(border.project(fit.close) - corner, found, tolerance + PIXEL_PX)
            if float(np.mean(fit.off_px > tolerance)) <= self.hidden_share and bare <= self.hidden_share:
                return fit
        return None


def _inside(box: Window, window: Window, lens: Camera) -> bool:
    """Whether a box neither reaches the image's border nor an edge of the window that was searched, beyond which it may go on."""
    left, top, right, bottom = box
    in_image = left > 0 and top > 0 and right < lens.width and bottom < lens.height
    return in_image and left > window[0] and top > window[1] and right < window[2] and bottom < window[3]
