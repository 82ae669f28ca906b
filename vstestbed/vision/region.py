"""One region of colour: segmented by chroma and hue, its border measured to a fraction of a pixel,
the target's outline fitted to it.
"""

from __future__ import annotations

import colorsys
import math
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

import numpy as np
from annotated_types import Ge, Gt, Le, Lt
from numpy.typing import NDArray

from vstestbed.camera import Camera, Image, Panel, Picture, Regions, Window
from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array, homogeneous
from vstestbed.core.lazy import cv2
from vstestbed.core.quantity import Pixels, PositiveAngle, PositivePixels, TighterBounds
from vstestbed.core.spec import spec
from vstestbed.features.observation import Goal
from vstestbed.targets import Target
from vstestbed.targets.regions import LEAST_AHEAD, centroid, covariance, evenly_along
from vstestbed.vision.base import Detection, DetectorBase, Move, TruthView, windows_round
from vstestbed.vision.colour import (
    Region,
    chroma_mask,
    mixes_colours,
    noise_level,
    with_surroundings,
)

REACH = 2  # pixels to each side of the border that are added up
NEIGHBOURS = np.ones((3, 3), np.uint8)
# a pixel's neighbours whose mean colours, of those wholly covered and of those not covered at all,
# meet at a border
NEAR = 7, 7


def coverage(part: Image, alone: NDArray[np.uint8]) -> NDArray[np.float32]:
    """How much of each pixel a region covers, (H, W), 0 to 1 but for noise, in the RGB of its box
    and a few pixels round it (H, W, 3).

    A pixel at the border has the colour c = f F + (1 - f) B of what meets there, so that f = (c -
    B) . (F - B) / |F - B|^2. F and B are the mean colours of the pixels near it that are wholly
    inside (`alone` 255) and wholly outside, which follow shading and background.
    Reference: Smith & Blinn 1996, Blue screen matting, doi:10.1145/237170.237263 (the mixture at a
    border).
    """
    near = cv2.dilate(alone, NEIGHBOURS)
    inner = cv2.erode(alone, NEIGHBOURS)
    out = (inner > 0).astype(np.float32)
    # the colours are worked out there alone: most of a region is its inside
    border = (near > 0) & (inner == 0)
    F = _mean_near(part, inner, border)
    B = _mean_near(part, cv2.bitwise_not(near), border)
    span = F - B
    size2 = (span * span).sum(axis=1)
    out[border] = ((part[border] - B) * span).sum(axis=1) / np.maximum(size2, 1.0)
    return out


def _mean_near(part: Image, which: Image, at: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Mean colours (K, 3) of the pixels of `which` (255 there) near each of K pixels `at`; where
    there are none, of all of them.
    """
    colours = cv2.bitwise_and(part, part, mask=which)
    total, counted = (
        cv2.boxFilter(image, cv2.CV_32F, NEAR, normalize=False, borderType=cv2.BORDER_CONSTANT)
        for image in (colours, which)
    )
    count = counted[at][:, None] / 255
    overall = np.array(cv2.mean(part, which)[:3], np.float32)
    return np.where(count > 0, total[at] / np.maximum(count, 1), overall).astype(np.float32)


def edge_points(cover: NDArray[np.floating]) -> Array:
    """Points (K, 2) [px] on the border of a region, from the coverage (H, W) of each pixel, 0 to 1.

    Along a row, between two pixels of which one is covered by more than half and the other is not,
    the coverages of four pixels, from inside to outside, add up to the way from the beginning of
    the first to the border. That is exact for straight borders that are steeper than 45 degrees,
    since a pixel's coverage is the mean over its height; flatter ones are measured along columns.
    """
    c = np.pad(cover.astype(np.float32), REACH)
    du = np.abs(cv2.Sobel(c, cv2.CV_32F, 1, 0, ksize=3))
    dv = np.abs(cv2.Sobel(c, cv2.CV_32F, 0, 1, ksize=3))
    along_rows = _crossings(c, du >= dv)
    along_columns = _crossings(np.ascontiguousarray(c.T), np.ascontiguousarray((dv > du).T))
    return np.concatenate([along_rows, along_columns[:, ::-1]]) - REACH


def bare_share(uv: Array, alone: NDArray[np.uint8], reach_px: float) -> float:
    """Share of points uv (S, 2) [px] that no pixel at a region's border is within `reach_px` of;
    NaN counts as such a point.

    Pixels are at the border whether or not it is sharp enough there to be measured (`edge_points`).
    `alone` (H, W) is 255 in the region.
    """
    pad = math.ceil(reach_px) + 1  # beyond it nothing is within reach
    region = cv2.copyMakeBorder(alone, pad, pad, pad, pad, cv2.BORDER_CONSTANT, value=0)
    inner = cv2.erode(region, NEIGHBOURS)
    away = cv2.distanceTransform(
        cv2.bitwise_not(region - inner), cv2.DIST_L2, cv2.DIST_MASK_PRECISE
    )
    height, width = away.shape
    with np.errstate(invalid="ignore"):
        at = np.rint(uv + pad)
        u, v = at[((at >= 0) & (at < [width, height])).all(axis=1)].astype(int).T
    return 1 - np.count_nonzero(away[v, u] <= reach_px) / len(uv)


def _crossings(c: NDArray[np.float32], steep: NDArray[np.bool_]) -> Array:
    """Borders (K, 2) [px] (u, v) along the rows of a coverage (H, W), where `steep` (H, W) says
    that the border runs across them.
    """
    inside = c > 0.5
    v, u = np.nonzero((inside[:, 1:-2] != inside[:, 2:-1]) & (steep[:, 1:-2] | steep[:, 2:-1]))
    # pixels u .. u + 3; the border is between the middle two
    four = np.stack([c[v, u + k] for k in range(4)], axis=1)
    leaves = inside[v, u + 1]
    four = np.where(leaves[:, None], four, four[:, ::-1])
    # no border is measured at corners and in slots
    clear = (four[:, 0] > 0.85) & (four[:, 3] < 0.15)
    way = four.sum(axis=1)
    at = np.where(leaves, u - 0.5 + way, u + 3.5 - way)
    return np.column_stack([at, v])[clear].astype(float)


# Fit of a polygon in a plane to the points of a region's border in a picture: the homography
# between them.
TURNS = 36  # rotations that are tried where none is known: every 10 degrees
ROUNDS = 12  # most Gauss-Newton steps: from the affine guess three to six are enough
# a step that moves no point by more than this share of the region's size ends the fit
SETTLED = 1e-5
# points farther than so many times the usual distance from the polygon (but at least FAINT) have no
# weight
OUTLIER = 4.0
FAINT = 2e-3  # share of the region's size under which no distance is unusual
# of fits that differ by less than this factor, as of a square's four, the one that is turned least
# is taken
PREFERRED = 1.02


PolygonFit = tuple[Array, float, Array]
"""How an image of a polygon's plane fits points of a border: the homography (3, 3) from the plane
to the picture, the rotation in it after both were made round [rad], and the distance of each point
(K,) from the polygon, in standard deviations of the region.
"""


def fit_polygon(
    edge: Array,
    middle: Array,
    spread: Array,
    corners: Array,
    turns: tuple[float, ...],
    expected: float,
) -> PolygonFit | None:
    """The fit of a polygon with `corners` (E, 2) to points `edge` (K, 2) on the border of a region;
    None where none is found.

    Region and polygon are made round by their second moments, after which an affine image of the
    polygon differs by a rotation alone. From there Gauss-Newton steps change the homography G from
    picture to plane so that sum n_k . (G e_k - q_k)^2 is least, with q_k the point of the polygon
    next to G e_k and n_k the normal of its side.

    Args:
        middle, spread: centroid (2,) and covariance (2, 2) of the region's area.
        turns: rotations to begin with [rad]; empty: all round. expected: the rotation that is taken
            where several fit alike.
    """
    middle_of_polygon = centroid(corners)
    whiten = roundness(spread)
    colour = _root(covariance(corners))
    e = (edge - middle) @ whiten
    q = (corners - middle_of_polygon) @ inverted(colour)
    best: PolygonFit | None = None
    for turn in turns or _likely(e, q, expected):
        found = _refined(e, q, turn)
        if found is None:
            continue
        G, off, left = found
        if best is not None and not _better(off, turn, best, expected):
            continue
        to_plane = _affine(colour, middle_of_polygon) @ G
        to_plane = to_plane @ inverted(_affine(inverted(whiten), middle))
        best = inverted(to_plane), left, off
    return best


def _better(off: Array, turn: float, best: PolygonFit, expected: float) -> bool:
    _, turn_before, off_before = best
    size = float(np.sqrt(np.mean(np.minimum(off, 0.5) ** 2)))
    before = float(np.sqrt(np.mean(np.minimum(off_before, 0.5) ** 2)))
    if max(size, before) > PREFERRED * min(size, before) + FAINT:
        return size < before
    away = abs(math.remainder(turn - expected, 2 * math.pi))
    return away < abs(math.remainder(turn_before - expected, 2 * math.pi))


def _likely(e: Array, q: Array, expected: float) -> list[float]:
    """The rotations for which round points e (K, 2) are nearest to a round polygon q (E, 2), the
    best first.
    """
    few = e[:: max(1, len(e) // 40)]
    turns = expected + np.arange(TURNS) * (2 * math.pi / TURNS)
    c = np.cos(turns)
    s = np.sin(turns)
    # rotated back by each, (TURNS, K, 2)
    turned = few @ np.stack([np.stack([c, s], -1), np.stack([-s, c], -1)], -1)
    distance = _foot(turned.reshape(-1, 2), q)[2].reshape(TURNS, -1)
    cost = np.minimum(distance, 0.5).mean(axis=1)
    lowest = np.flatnonzero((cost <= np.roll(cost, 1)) & (cost <= np.roll(cost, -1)))
    # A figure with n-fold symmetry has n such minima, and all are to be compared.
    kept = lowest[cost[lowest] <= 1.5 * cost.min() + FAINT]
    return [float(turns[k]) for k in sorted(kept, key=lambda k: cost[k])]


def _refined(e: Array, q: Array, turn: float) -> tuple[Array, Array, float] | None:
    """G (3, 3) from round points e (K, 2) to a round polygon q (E, 2), the points' distances (K,),
    and the rotation in it.
    """
    c = math.cos(turn)
    s = math.sin(turn)
    G = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])  # back by the rotation
    m = homogeneous(e)
    off = np.zeros(len(e))
    for _ in range(ROUNDS):
        x = m @ G.T
        if not (x[:, 2] > 0.1).all():
            return None
        p = x[:, :2] / x[:, 2:]
        normal, height, off, within = _foot(p, q)
        usual = 1.4826 * float(np.median(off))
        used = within & (off <= max(OUTLIER * usual, FAINT))
        if np.count_nonzero(used) < 16:
            return None
        rows = m[used] / x[used, 2:]
        n = normal[used]
        along = (n * p[used]).sum(axis=1)[:, None]
        J = np.concatenate([n[:, :1] * rows, n[:, 1:] * rows, -along * rows[:, :2]], axis=1)
        step = np.linalg.lstsq(J, -height[used], rcond=None)[0]
        G = G + np.append(step, 0.0).reshape(3, 3)
        if np.abs(step).max() < SETTLED:
            break
    if not np.linalg.cond(G) < 1e3:  # folded onto a line: between round figures it is under ten
        return None
    return G, off, math.atan2(G[0, 1] - G[1, 0], G[0, 0] + G[1, 1])


def _foot(p: Array, q: Array) -> tuple[Array, Array, Array, NDArray[np.bool_]]:
    """The side of a polygon q (E, 2) that is next to each point p (K, 2).

    Its normal (K, 2), the point's height over its line (K,), its distance (K,), and whether its
    foot lies within the side.
    """
    way = np.roll(q, -1, axis=0) - q
    length = np.hypot(way[:, 0], way[:, 1])
    along = way / length[:, None]
    t = p @ along.T - (q * along).sum(axis=1)
    h = p[:, :1] * along[:, 1] - p[:, 1:] * along[:, 0]
    h -= q[:, 0] * along[:, 1] - q[:, 1] * along[:, 0]
    beyond = np.maximum(np.maximum(-t, t - length), 0.0)
    distance = h * h + beyond * beyond
    side = distance.argmin(axis=1)
    k = np.arange(len(p))
    normal = np.column_stack([along[:, 1], -along[:, 0]])[side]
    return normal, h[k, side], np.sqrt(distance[k, side]), beyond[k, side] == 0


def inverted(A: Array) -> Array:
    """The inverse (n, n) of a matrix."""
    return np.linalg.inv(A).astype(float)


def roundness(S: Array) -> Array:
    """The matrix (2, 2) that makes a region with covariance S (2, 2) round, of unit variance:
    S^-1/2.
    """
    return _root(inverted(S))


def _root(S: Array) -> Array:
    root = math.sqrt(max(float(S[0, 0] * S[1, 1] - S[0, 1] * S[1, 0]), 0.0))
    return (S + root * np.eye(2)) / math.sqrt(float(np.trace(S)) + 2 * root)


def _affine(A: Array, shift: Array) -> Array:
    out = np.eye(3)
    out[:2, :2] = A
    out[:2, 2] = shift
    return out


@dataclass(frozen=True, slots=True)
class Border:
    """The border of a region in one panel of a camera: points (K, 2) [px], the region's centroid
    (2,) [px] and covariance (2, 2) [px^2].
    """

    edge: Array
    middle: Array
    spread: Array
    panel: Panel

    @property
    def size_px(self) -> float:
        """Standard deviation of the region's pixels, the geometric mean of both axes [px]."""
        return math.sqrt(math.sqrt(max(float(np.linalg.det(self.spread)), 0.0)))


@dataclass(frozen=True, slots=True)
class OutlineFit:
    """The outline that fits a border best.

    Attributes:
        p: its points as directions in the camera's frame (M, 3), in the target's order. off_px:
            distance of each border point (K,) [px].
        close: directions along it (S, 3), evenly: of a polygon closer together than its points, of
            what is round the points.
        turn: how the target is turned in the picture (`PolygonFit`) [rad]; 0 for what is round.
    """

    p: Array
    off_px: Array
    close: Array
    turn: float = 0.0


def fit_outline(
    border: Border, target: Target, turn: float | None, expected: float
) -> OutlineFit | None:
    """The fit of the target's outline to the border; None where there is none.

    Args:
        turn: the rotation in the last picture [rad]; None where it is to be sought all round.
        expected: the rotation that is taken where several fit alike [rad].
    """
    rays = border.panel.ray(border.edge)
    corners = target.figure_corners
    if corners is None:
        found = target.round_outline(rays)
        if found is None:
            return None
        p, off = found
        # A round region of pixels with standard deviation s has the radius 2 s.
        return OutlineFit(p, off * 2 * border.size_px, p)
    if not (rays[:, 2] > LEAST_AHEAD).all():
        return None
    xy = rays[:, :2] / rays[:, 2:]
    # normalised coordinates of the region's centroid, and their derivative by pixels
    near = border.panel.ray(border.middle + np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]))
    m = near[:, :2] / near[:, 2:]
    J = (m[1:] - m[0]).T
    turns = () if turn is None else (turn,)
    fit = fit_polygon(xy, m[0], J @ border.spread @ J.T, corners, turns, expected)
    if fit is None:
        return None
    H, turned, off = fit
    p = _mapped(H, target.points[:, :2])
    # of the outline 200 points, by which it is compared with the border in the picture
    close = _mapped(H, evenly_along(corners, 200))
    return OutlineFit(p, off * border.size_px, close, turned)


def _mapped(H: Array, flat: Array) -> Array:
    """Directions (N, 3) of a plane's points (N, 2) by its homography, turned to lie before the
    camera.
    """
    p = homogeneous(flat) @ H.T
    return p * np.sign(p[:, 2:])


# a region is measured so far beyond its box [px], which may touch the window in which it was
# searched
BESIDE_PX = 3
# a region: its box [px], its centroid (2,) [px], and the outline fitted to it
Found = tuple[Window, Array, OutlineFit]


@dataclass(frozen=True, slots=True)
class RegionState:
    """State of the region detector.

    Attributes:
        expected: how a shape is turned in the goal view [rad]: the first guess, which decides for a
            shape with symmetry; 0 if round.
        box, middle, turn: of the region in the last picture [px, rad]. move: its displacement since
            the picture before [px].
    """

    expected: float = 0.0
    box: Window | None = None
    middle: Array | None = None
    move: Move = (0.0, 0.0)
    turn: float = 0.0


@spec
class RegionDetector(DetectorBase):
    """The outline of the target's region, as points in the target's order: of a shape or a ball.

    Segmentation: connected pixels with more than `chroma` and the target's hue; of several regions
    the largest to which the outline fits. In later pictures it is searched in a window around its
    predicted place, and where it is not whole there, in the whole image.

    Measurement: the border is measured at every pixel along it by coverage (`edge_points`), and the
    target's outline is fitted to it by least squares, in undistorted coordinates: of a polygon the
    homography of its plane, which needs no calibrated depth and no pose; of a disc the ellipse; of
    a ball the cone of rays that touch it. With `camera.multisampling: 0` borders are off by up to
    half a pixel; with 4 samples the points of a shape 200 px long are exact to some hundredths of a
    pixel.

    Lost: a region that reaches the image's border, or of which another thing hides a part: more
    than `hidden_share` of its border is farther than `tolerance_px` from the fitted outline, or of
    the outline from its border. A part with the outline of the whole as seen from elsewhere, such
    as half of a square, is not told from it.

    Args:
        chroma: max - min of r, g, b (0..255) above which a pixel belongs to the region [grey
            levels]; scenes keep everything else below it.
        hue_tolerance_deg: largest difference to the target's hue.
        least_area_px: least area of the region [px^2].
        tolerance_px: largest distance of the border from the fitted outline [px].
        hidden_share: share of the border, and of the fitted outline, that may be farther from the
            other [1].
        window_margin_px: margin of the window around the predicted region, besides half of its last
            move [px].

    Reference: coverage as the mean over a pixel: Corke 2017, Robotics, Vision & Control, section
    13.1 (regions, moments).
    """

    kind: Literal["region"] = "region"
    chroma: Annotated[int, Ge(1), Lt(255)] = 60
    hue_tolerance_deg: Annotated[PositiveAngle, TighterBounds(le=180)] = 20.0
    least_area_px: Annotated[Pixels, TighterBounds(ge=50)] = 100.0
    tolerance_px: PositivePixels = 1.5
    hidden_share: Annotated[float, Gt(0), Lt(1)] = 0.04
    window_margin_px: Annotated[int, Ge(2), Le(8192)] = 12
    needs_image: ClassVar[bool] = True
    markers: ClassVar[tuple[str, ...]] = ("outline",)

    def init(self) -> RegionState:
        """Nothing seen yet."""
        return RegionState()

    def begin(self, goal: Goal, camera: Camera, target: Target) -> RegionState:
        """Nothing seen yet; a shape is expected as the goal view shows it."""
        if target.figure_corners is None or not np.isfinite(goal.xy).all():
            return RegionState()
        seen = goal.xy
        flat = target.points[:, :2]
        # The affine map that fits best, without what makes both shapes round: a rotation.
        to, _, _, _ = np.linalg.lstsq(homogeneous(flat), seen, rcond=None)
        R = roundness(covariance(seen)) @ to[:2].T @ inverted(roundness(covariance(flat)))
        return RegionState(expected=math.atan2(R[1, 0] - R[0, 1], R[0, 0] + R[1, 1]))

    def regions_of_interest(
        self, state: RegionState, camera: Camera, target: Target
    ) -> Regions | None:
        """A window around the predicted region; None where it is lost or large, and in a camera
        with panels.
        """
        own = self._window(state, camera, self.window_margin_px + BESIDE_PX)
        return None if own is None else ((own,),)

    def _window(self, state: RegionState, camera: Camera, margin: int) -> Window | None:
        own = windows_round([state.box], [state.move], camera, margin)
        return own[0] if own else None

    def detect(
        self,
        state: RegionState,
        picture: Picture | None,
        view: TruthView | None,
        camera: Camera,
        target: Target,
        rng: np.random.Generator,
    ) -> tuple[RegionState, Detection]:
        """Points of the outline (M, 2) [px] in one picture; all NaN where the region is not found
        whole.
        """
        picture = self._given(picture)
        if not target.outlined:
            raise ParameterError.fixed("target", "a shape or a ball", where="for detector region")
        found = None
        window = self._window(state, camera, self.window_margin_px)
        image = picture.images[0]
        if window is not None and image is not None:
            found = self._largest(image, window, camera.panels[0], state, target)
        if found is None:
            found = self._searched(picture.completed(), state, camera, target)
        if found is None:
            unseen = np.full((len(target.points), 2), np.nan)
            return RegionState(state.expected), Detection(uv=unseen)
        box, middle, fit = found
        du, dv = (0.0, 0.0) if state.middle is None else (middle - state.middle).tolist()
        after = RegionState(state.expected, box, middle, (du, dv), fit.turn)
        return after, Detection(uv=camera.project(fit.p))

    def _searched(
        self, picture: Picture, state: RegionState, camera: Camera, target: Target
    ) -> Found | None:
        """The region in the first of the whole images that shows one."""
        for image, panel in zip(picture.images, camera.panels, strict=True):
            if image is None:
                continue
            whole = (0, 0, image.shape[1], image.shape[0])
            found = self._largest(image, whole, panel, state, target)
            if found is not None:
                return found
        return None

    def _largest(
        self, image: Image, window: Window, panel: Panel, state: RegionState, target: Target
    ) -> Found | None:
        """The largest region of the target's hue in a window that is whole and to which the outline
        fits; None without one.
        """
        rim = "grey" if mixes_colours(panel.lens) else "sharp"
        region = Region(image, window, rim, noise_level(image))
        mask = chroma_mask(region.searched, self.chroma)
        _, labels, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=8)
        order = 1 + np.argsort(-stats[1:, cv2.CC_STAT_AREA], kind="stable")
        for label in order[:3].tolist():  # the largest ones
            x, y, w, h, area = stats[label].tolist()
            if area < self.least_area_px:
                break
            if x == 0 or y == 0 or x + w == mask.shape[1] or y + h == mask.shape[0]:
                continue  # Beyond an edge of the window, or the image's border, it may go on.
            left = window[0] + x
            top = window[1] + y
            alone = cv2.inRange(labels[y : y + h, x : x + w], label, label)
            part = image[top : top + h, left : left + w]
            if not self._has_hue(part, alone, target.hues_deg[0]):
                continue
            box = (left, top, left + w, top + h)
            found = self._fitted(region, alone, box, panel, state, target)
            if found is not None:
                return found
        return None

    def _has_hue(self, part: Image, alone: Image, wanted_deg: float) -> bool:
        r, g, b, _ = cv2.mean(part, mask=alone)
        hue_deg = 360 * colorsys.rgb_to_hsv(r, g, b)[0]
        return abs(math.remainder(hue_deg - wanted_deg, 360)) <= self.hue_tolerance_deg

    def _fitted(
        self,
        region: Region,
        alone: Image,
        box: Window,
        panel: Panel,
        state: RegionState,
        target: Target,
    ) -> Found | None:
        """The outline fitted to a region, by `alone` (255 in its pixels in its box); None where it
        does not fit.
        """
        part, found, left, top = with_surroundings(region.image, alone, box, BESIDE_PX)
        cover = coverage(part, found)
        edge = edge_points(cover) + [left, top]
        if len(edge) < 24:
            return None
        # Of a long border evenly spread points: with more than 400 the outline hardly becomes
        # better.
        edge = edge[np.linspace(0, len(edge) - 1, min(len(edge), 400)).astype(int)]
        m = cv2.moments(cover)
        mass = m["m00"]
        middle = np.array([left + m["m10"] / mass, top + m["m01"] / mass])
        spread = np.array([[m["mu20"], m["mu11"]], [m["mu11"], m["mu02"]]]) / mass
        border = Border(edge, middle, spread, panel)
        # [px], and [px per grey level of its standard deviation]
        tolerance = self.tolerance_px + 0.05 * region.noise
        # as in the last picture, or else all round
        for turn in [None] if state.box is None else [state.turn, None]:
            fit = fit_outline(border, target, turn, state.expected)
            if fit is None:
                continue
            # One more against whole pixels: outlines that were right, sharp, blurred over up to 8
            # px or under noise, then had under 0.015 of their length farther from the region's
            # pixels.
            bare = bare_share(panel.project(fit.close) - (left, top), found, tolerance + 1.0)
            off = float(np.mean(fit.off_px > tolerance))
            if max(off, bare) <= self.hidden_share:
                return box, middle, fit
        return None
