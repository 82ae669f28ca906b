"""A printed picture tracked whole: the homography of its plane by ESM, found again by keypoints."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Annotated, ClassVar, Literal, NamedTuple

import numpy as np
from annotated_types import Ge, Gt, Le, Lt
from numpy.typing import NDArray

from vstestbed.camera import Camera, Image, Panel, Perspective, Picture, Regions, Window
from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array, homogeneous
from vstestbed.core.lazy import cv2
from vstestbed.core.quantity import PositiveTime
from vstestbed.core.spec import spec
from vstestbed.features.observation import Goal
from vstestbed.targets.base import Target
from vstestbed.targets.picture import decoded
from vstestbed.vision.base import Detection, DetectorBase, TruthView, windows_round
from vstestbed.vision.local_features import Descriptors, Sift, brightness, mutual_matches
from vstestbed.vision.pnp import looking_along

# A picture on a plane as a template to track: its grey levels in several sizes, each with all that
# its alignment needs of it.
GreyImage = NDArray[np.float32]

LEAST_SIDE = 20  # shortest side of the smallest copy of a template [texel]
# blocks along a template's longer side, each of which is compared with the picture by itself
BLOCKS = 6
# standard deviation of a block's grey levels below which its correlation would be one of noise
# alone
FLAT = 6.0
# sigma of the filter over template and picture [texel, px], without which sampling between pixels
# shifts fine detail
BLUR = 0.8
# outermost texels that are left out: what the picture shows there mixes with what is behind the
# template
EDGE = 2


@dataclass(frozen=True, slots=True, eq=False)
class TemplateSize:
    """A template in one size, (h, w) texels; n = h w.

    Attributes:
        grey: grey levels (h, w). slopes: derivatives of the grey levels by x and y, (2, n).
        x, y: texel centres in units of half the template's longer side, from its middle, right and
            down, (n,).
        to_plane: (3, 3), from (column, row, 1) to (x, y, 1). texel: width and height of a texel, in
            the same units.
        inner: which texels count, (n,); those at the border do not. spread: by which a residual is
            measured, (n,) [grey levels].
        block: number of each texel's block, (n,). textured: which blocks are not flat, (B,).
            blocks: how many along x and y.
    """

    grey: GreyImage
    x: GreyImage
    y: GreyImage
    to_plane: Array
    slopes: GreyImage
    texel: tuple[float, float]
    inner: NDArray[np.bool_]
    spread: GreyImage
    block: NDArray[np.intp]
    textured: NDArray[np.bool_]
    blocks: tuple[int, int]

    def by_block(self, values: GreyImage) -> GreyImage:
        """Means of values (n,) over each block, (B,)."""
        values = values.reshape(self.grey.shape)
        return cv2.resize(values, self.blocks, interpolation=cv2.INTER_AREA).ravel()


@dataclass(frozen=True, slots=True, eq=False)
class Template:
    """A picture file as a template: from its largest copy to its smallest, each about half as large
    as the one before.

    Attributes:
        unit_m: half the longer side of the picture [m]. half: half its sides in that unit.
        features: its keypoints' places in that unit (K, 2) and their SIFT descriptors (K, 128).
    """

    levels: tuple[TemplateSize, ...]
    unit_m: float
    half: tuple[float, float]
    features: tuple[Array, Descriptors]

    @property
    def corners(self) -> Array:
        """(-, -), (+, -), (+, +), (-, +), homogeneous, shape (4, 3)."""
        a, b = self.half
        return np.array([[-a, -b, 1], [a, -b, 1], [a, b, 1], [-a, b, 1]])


@lru_cache(maxsize=8)
def template_of(path: Path, written_ns: int, width_m: float, most_texels: int) -> Template:
    """The template of a picture file, last written at a time [ns], printed `width_m` wide; the
    largest copy has about `most_texels`.
    """
    image = decoded(path)
    grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY).astype(np.float32)
    height, width = grey.shape
    longer = max(height, width)
    half = width / longer, height / longer
    share = min(1.0, (most_texels / grey.size) ** 0.5)
    levels: list[TemplateSize] = []
    while min(height, width) * share >= LEAST_SIDE or not levels:
        size = max(4, round(width * share)), max(4, round(height * share))
        levels.append(_level(grey, size, half))
        share /= 2
    return Template(tuple(levels), width_m / 2 / half[0], half, _features(image, half))


def _level(grey: GreyImage, size: tuple[int, int], half: tuple[float, float]) -> TemplateSize:
    """The template reduced to a size (w, h) by averaging, so that its texels' places stay where
    they are.
    """
    small = grey
    if size != grey.shape[::-1]:
        small = cv2.resize(grey, size, interpolation=cv2.INTER_AREA)
    small = cv2.GaussianBlur(small, (0, 0), BLUR)
    w, h = size
    texel = 2 * half[0] / w, 2 * half[1] / h
    u, v = np.meshgrid(np.arange(w), np.arange(h))
    x = ((u - (w - 1) / 2) * texel[0]).ravel()
    y = ((v - (h - 1) / 2) * texel[1]).ravel()
    inner = ((np.minimum(u, w - 1 - u) >= EDGE) & (np.minimum(v, h - 1 - v) >= EDGE)).ravel()
    across, down = (max(1, round(BLOCKS * side)) for side in half)  # the same blocks in every size
    block = (v * down // h * across + u * across // w).ravel()
    n = np.bincount(block)
    mean = np.bincount(block, small.ravel()) / n
    spread = np.sqrt(np.maximum(np.bincount(block, small.ravel() ** 2) / n - mean**2, 0))
    to_plane = np.array([[texel[0], 0, x[0]], [0, texel[1], y[0]], [0, 0, 1]])
    slope = slopes(small, texel)
    # A flat texel may differ by four grey levels from the picture, and an edge may seem to be
    # shifted by .3 texels in it.
    steepness = np.hypot(slope[0] * texel[0], slope[1] * texel[1])
    return TemplateSize(
        small,
        x.astype(np.float32),
        y.astype(np.float32),
        to_plane,
        slope,
        texel,
        inner,
        np.hypot(4.0, 0.3 * steepness).astype(np.float32),
        block,
        spread > FLAT,
        (across, down),
    )


def slopes(grey: GreyImage, texel: tuple[float, float]) -> GreyImage:
    """Derivatives of grey levels (h, w) by the template's x and y,
    by central differences, (2, n).
    """
    out = np.empty((2, *grey.shape), np.float32)
    cv2.Sobel(grey, cv2.CV_32F, 1, 0, dst=out[0], ksize=1, scale=0.5 / texel[0])
    cv2.Sobel(grey, cv2.CV_32F, 0, 1, dst=out[1], ksize=1, scale=0.5 / texel[1])
    return out.reshape(2, -1)


@functools.cache
def _sift() -> Sift:
    """Its contrast is a quarter of what is usual: a picture may be in shadow, and wrong matches are
    found out.
    """
    return Sift(most=800, contrast=0.01)


def _features(image: Image, half: tuple[float, float]) -> tuple[Array, Descriptors]:
    """Places (K, 2) in the template's unit and SIFT descriptors (K, 128) of a picture (H, W, 3),
    blue first.
    """
    height, width = image.shape[:2]
    share = min(1.0, 640 / max(height, width))  # a picture shows no finer ones
    w = round(width * share)
    h = round(height * share)
    small = cv2.cvtColor(cv2.resize(image, (w, h), interpolation=cv2.INTER_AREA), cv2.COLOR_BGR2RGB)
    px, descriptors = _sift().extract(small)
    return ((px + 0.5) / [w, h] * 2 - 1) * half, descriptors


# Grey pictures in several sizes, sampled where a plane is projected by any lens.
OUTSIDE = -1e4  # a pixel far outside of every picture
# places along a template's sides at which its size in the picture is measured
GRID = np.linspace(-1, 1, 9)


class GreyPicture:
    """An exposure's grey levels, in the camera's panels, or in one window of its image alone."""

    def __init__(self, picture: Picture, camera: Camera, window: Window | None = None):
        self.camera = camera
        # Of each panel with an image: its grey levels, and those halved again and again
        # (`cv2.pyrDown`); where they begin [px].
        self._sizes: dict[int, list[GreyImage]] = {}
        self._begin: dict[int, Array] = {}
        self._smooth: dict[tuple[int, int], GreyImage] = {}
        for k, image in enumerate(picture.images):
            if image is None:
                continue
            left, top, right, bottom = window or (0, 0, image.shape[1], image.shape[0])
            self._sizes[k] = [brightness(image[top:bottom, left:right]).astype(np.float32)]
            self._begin[k] = np.array([left, top], float)

    def sampled(self, rays: Array, shape: tuple[int, int], halvings: int) -> GreyImage:
        """Grey levels (h, w) of a grid in a plane, from the picture halved so many times; NaN where
        it shows nothing.

        rays: (3, 3), from a grid's place (column, row, 1) to its direction in the camera's frame.
            shape: h and w of the grid.
        """
        parts = [self._sampled(k, rays, shape, halvings) for k in self._sizes]
        out = parts[0]
        for more in parts[1:]:
            np.copyto(out, more, where=np.isnan(out))
        return out

    def _sampled(self, k: int, rays: Array, shape: tuple[int, int], halvings: int) -> GreyImage:
        if (k, halvings) not in self._smooth:
            sizes = self._sizes[k]
            while len(sizes) <= halvings:
                sizes.append(cv2.pyrDown(sizes[-1]))
            self._smooth[k, halvings] = cv2.GaussianBlur(sizes[halvings], (0, 0), BLUR)
        image = self._smooth[k, halvings]
        begin = self._begin[k]
        lens = self.camera.panels[k].lens
        turned = self.camera.panels[k].R_camera_panel.T @ rays
        h, w = shape
        ahead = turned[2] @ [[0, w - 1, 0, w - 1], [0, 0, h - 1, h - 1], [1, 1, 1, 1]]
        if isinstance(lens, Perspective) and not lens.resampled and ahead.min() > 0:
            to_part = np.array([[1, 0, -begin[0]], [0, 1, -begin[1]], [0, 0, 2**halvings]])
            return cv2.warpPerspective(
                image,
                to_part @ lens.K @ turned,
                (w, h),
                flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
                borderMode=cv2.BORDER_CONSTANT,
                borderValue=np.nan,
            )
        at = (lens.project(_grid(shape) @ turned.T) - begin) / 2**halvings
        at = np.nan_to_num(at.astype(np.float32), nan=OUTSIDE)
        u, v = np.moveaxis(at, -1, 0)
        return cv2.remap(
            image, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=np.nan
        )


@lru_cache(maxsize=16)
def _grid(shape: tuple[int, int]) -> Array:
    v, u = np.mgrid[: shape[0], : shape[1]].astype(float)
    grid = np.stack([u, v, np.ones(shape)], axis=-1)
    grid.setflags(write=False)  # kept
    return grid


def pixels_per_unit(camera: Camera, G: Array, half: tuple[float, float]) -> float:
    """Pixels of a camera's image (of its panels) along the unit of a template: the root of the
    ratio of areas; NaN where it is not seen.
    """
    x, y = np.meshgrid(GRID * half[0], GRID * half[1])
    rays = np.stack([x, y, np.ones_like(x)], axis=-1).reshape(-1, 3) @ G.T
    areas: list[float] = []
    for panel in camera.panels:
        uv = panel.project(rays).reshape(len(GRID), len(GRID), 2)
        a = uv[1:, 1:] - uv[:-1, :-1]
        b = uv[1:, :-1] - uv[:-1, 1:]
        area = np.abs(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]) / 2
        area = area[np.isfinite(area) & panel.lens.inside(uv[1:, 1:])]
        areas.extend(area.tolist())
    cell = (GRID[1] - GRID[0]) ** 2 * half[0] * half[1]
    return float(np.sqrt(np.median(areas) / cell)) if areas else float("nan")


# Alignment of a plane's template with a picture by efficient second-order minimisation (ESM), under
# any lens.
#
# The plane's homography G (3, 3), det G > 0, maps a template's point (x, y, 1) to the direction of
# its image in the camera's frame.

# residuals beyond this many standard deviations have no weight (95 % efficiency on Gaussian noise)
TUKEY = 4.685
# least standard deviation that residuals are taken to have, in units of `TemplateSize.spread`
LEAST_SIGMA = 0.5
# grey levels that count as one in the normal equations, so that their columns are of similar size
LIGHT = 64.0
PART = 2000  # texels in one product of matrices
INSIDE = 0.5  # share of a block that must be in the picture for it to count
# share of the textured blocks that must be alike before the others are left out; fewer may be alike
# by chance
ENOUGH = 0.15
# least standard deviation of a block that correlates, in grey levels: that of a plain surface is
# noise
FAINT = 1.0
BlockFits = tuple[NDArray[np.bool_], float, float]
"""Which blocks (B,) of a template count; zero-mean normalised cross-correlation of the picture with
those that are alike, and their share of the textured ones.
"""


def normalised(G: Array) -> Array:
    """The same homography with determinant 1, whatever its factor; zero where it is singular."""
    det = np.linalg.det(G)
    return G / np.cbrt(det) if abs(det) > 1e-12 * np.abs(G).max() ** 3 else np.zeros((3, 3))


def align(
    template: Template,
    picture: GreyPicture,
    G: Array,
    least_correlation: float,
    least_visible: float,
) -> Array | None:
    """The homography near G that aligns a template with a picture; None where the plane leaves the
    picture.

    It is None, too, where less than `least_visible` of the textured blocks are inside the picture
    and alike.

    From the template's small copies to a large one, each against the picture in a similar size, the
    residuals
    r = (a . l) I(w(G exp(A(z)) q)) + b . l - T(q), l = (1, x, y), over its texels q are minimised
    over z in sl(3) and the light's gain and offset, which change linearly over the plane. ESM takes
    the mean of the derivatives in the picture and in the template, which makes the
    convergence quadratic. Weights of Tukey, and zero for blocks that do not correlate, leave out
    what hides the plane.
    References: Benhimane & Malis 2007, doi:10.1177/0278364907080252; Malis & Marchand 2006,
    doi:10.1109/IROS.2006.281831 (weights).
    """
    sizes = _sizes(template, picture, G)
    if not sizes:
        return None
    visible = 0.0
    # most iterations, on the smallest copy first
    for size, rounds in zip(sizes, (12, 8, 8)[-len(sizes) :], strict=True):
        # They end when no corner moves by more than this in the picture [px]; in the smaller copies
        # earlier.
        still = 0.03 if size is sizes[-1] else 0.24
        found = size.aligned(G, rounds, still, least_correlation, template.corners)
        if found is None:
            return None
        G, (_, _, visible) = found
    return G if visible >= least_visible else None


def similarity(
    template: Template, picture: GreyPicture, G: Array, least_correlation: float
) -> tuple[float, float]:
    """How well a template fits a picture at G as it is, in its smallest copy that `align` would
    use: share visible, correlation.
    """
    sizes = _sizes(template, picture, G)
    if not sizes:
        return 0.0, 0.0
    _, correlation, share = sizes[0].compared(G, least_correlation)
    return share, correlation


class _Size(NamedTuple):
    """One size of a template, and a picture with how often it is halved to be of similar size."""

    level: TemplateSize
    picture: GreyPicture
    halvings: int

    def sampled(self, G: Array) -> GreyImage:
        """The picture's grey levels (n,) at the texels."""
        rays = G @ self.level.to_plane
        return self.picture.sampled(rays, self.level.grey.shape, self.halvings).ravel()

    def compared(self, G: Array, least: float) -> BlockFits:
        """How well each block fits."""
        return _compared(self.level, self.sampled(G), least)

    def aligned(
        self, G: Array, rounds: int, still: float, least: float, corners: Array
    ) -> tuple[Array, BlockFits] | None:
        """G aligned, and how well each block fits there; None where too little of the plane is in
        the picture.
        """
        level = self.level
        before = self.picture.camera.project(corners @ G.T)
        counted = light = None
        for _ in range(rounds):
            grey = self.sampled(G)
            if counted is None:
                counted = _compared(level, grey, least)[0]
            seen = counted[level.block] & level.inner & np.isfinite(grey)
            if np.count_nonzero(seen) < 100:  # texels
                return None
            warp, light = _step(level, grey, seen, light)
            G = normalised(G @ warp)
            if not np.isfinite(G).all() or np.linalg.det(G) <= 0:
                return None
            now = self.picture.camera.project(corners @ G.T)
            moved = np.abs(now - before)
            before = now
            if not (moved > still).any():
                blocks = self.compared(G, least)
                if (blocks[0] == counted).all():
                    return G, blocks
                counted = blocks[0]
        return G, self.compared(G, least)


def _sizes(template: Template, picture: GreyPicture, G: Array) -> list[_Size]:
    """The template's copies to align with, smallest first; empty where not seen."""
    scale = pixels_per_unit(picture.camera, G, template.half)
    if not scale > 0:
        return []
    px = [scale * np.sqrt(level.texel[0] * level.texel[1]) for level in template.levels]
    # Texels from .7 px on, since finer ones show nothing that the picture holds, to about four
    # times those.
    first = next((k for k, size in enumerate(px) if size >= 0.7), len(px) - 1)
    used = [k for k in range(first, len(px)) if px[k] <= 4.0 * 1.2 * px[first]]
    return [
        _Size(template.levels[k], picture, max(0, round(float(np.log2(px[k])))))
        for k in reversed(used)
    ]


def _step(
    level: TemplateSize, grey: GreyImage, seen: NDArray[np.bool_], light: Array | None
) -> tuple[Array, Array]:
    """The warp exp(A(z)) (3, 3) of the template's plane in one iteration, and the light (6,) after
    it: gain and offset, each (1, x, y).
    """
    template = level.grey.ravel()
    x = level.x
    y = level.y
    known = np.where(seen, grey, 0)
    if light is None:  # that by which the grey levels have the template's mean and spread
        i = grey[seen]
        t = template[seen]
        ratio = t.std() / max(float(i.std()), 1e-3)
        light = np.array([ratio, 0, 0, t.mean() - ratio * i.mean(), 0, 0])
    a = light
    gain = (a[0] + a[1] * x + a[2] * y).astype(np.float32)
    residual = gain * known + (a[3] + a[4] * x + a[5] * y).astype(np.float32) - template
    image = np.where(np.isfinite(grey), grey, 0).reshape(level.grey.shape)
    gx, gy = 0.5 * (gain * slopes(image, level.texel) + level.slopes)
    along = gx * x + gy * y
    of_warp = gx, gy, gx * y, gy * x, gx * x - gy * y, -along - gy * y, -x * along, -y * along
    scaled = known / LIGHT
    of_light = scaled, scaled * x, scaled * y, np.ones_like(x), x, y
    rows = np.stack([*of_warp, *of_light, residual])
    rows = np.asarray(rows * np.sqrt(_weights(residual, level, seen)), np.float32)
    # rows rows^T in parts so small that a linear algebra library does not share them out among
    # threads
    parts = [rows[:, k : k + PART] for k in range(0, rows.shape[1], PART)]
    N = np.add.reduce([part @ part.T for part in parts]).astype(float)
    n = len(N) - 1
    # The ridge leaves where it is what the template leaves open.
    z = -np.linalg.solve(N[:n, :n] + 1e-6 * np.trace(N[:n, :n]) / n * np.eye(n), N[:n, n])
    return _exponential(z[:8]), a + z[8:] / [LIGHT, LIGHT, LIGHT, 1, 1, 1]


def _weights(residual: GreyImage, level: TemplateSize, seen: NDArray[np.bool_]) -> GreyImage:
    """Tukey's weights of residuals (n,), zero where not seen; their scale by the median of their
    sizes.
    """
    size = np.abs(residual) / level.spread
    sigma = max(1.4826 * float(np.median(size[seen])), LEAST_SIGMA)
    part = np.minimum(size / (TUKEY * sigma), 1.0)
    return np.where(seen, (1 - part * part) ** 2, 0).astype(np.float32)


def _exponential(z: Array) -> Array:
    """The exponential of the matrix of sl(3) with coordinates z (8,), by its series:
    it is small.
    """
    A = np.array([[z[4], z[2], z[0]], [z[3], -z[4] - z[5], z[1]], [z[6], z[7], z[5]]])
    A *= min(1.0, 1.0 / max(np.abs(A).max(), 1e-12))
    out = np.eye(3)
    term = out
    for k in range(1, 8):
        term = term @ A / k
        out = out + term
    return out


def _compared(level: TemplateSize, grey: GreyImage, least: float) -> BlockFits:
    """How well each textured block of a template fits the grey levels (n,): by its zero-mean
    normalised correlation with them.
    """
    seen = level.inner & np.isfinite(grey)
    i = _centred(grey, seen)
    t = _centred(level.grey.ravel(), seen)
    s = level.by_block(seen.astype(np.float32))
    si = level.by_block(i)
    st = level.by_block(t)
    some = np.maximum(s, 1e-3)
    cov = level.by_block(i * t) - si * st / some
    vi = np.maximum(level.by_block(i * i) - si * si / some, 0)
    vt = np.maximum(level.by_block(t * t) - st * st / some, 0)
    inside = level.textured & (s >= INSIDE * level.by_block(level.inner.astype(np.float32)))
    each = cov / np.sqrt(np.maximum(vi, FAINT**2) * np.maximum(vt, FAINT**2))
    alike = inside & (each >= least)
    total = float(cov[alike].sum() / max(np.sqrt(vi[alike].sum() * vt[alike].sum()), 1e-6))
    share = np.count_nonzero(alike) / max(1, np.count_nonzero(level.textured))
    # A block that is hidden in part lets its alignment slip, and has less correlation than the
    # others.
    counted = alike & (each >= 0.8 * np.median(each[alike])) if share >= ENOUGH else inside
    return counted, total, share


def _centred(grey: GreyImage, seen: NDArray[np.bool_]) -> GreyImage:
    """Grey levels (n,) about the mean of those seen, beside which single precision would keep too
    few of their digits; 0 where not seen.
    """
    return np.where(seen, grey - grey[seen].mean(), 0) if seen.any() else np.zeros_like(grey)


# A plane's template found anywhere in a picture: keypoints matched, and the homography on which
# most of them agree.
LEAST_MATCHES = 10  # fewest matches that must agree
STEP = 1e-3  # tangent by which the picture's scale in its middle is measured


def found(template: Template, picture: Picture, camera: Camera) -> Array | None:
    """The homography (3, 3) from a template's plane to the directions of its image, as `align`
    takes it; None where it is not found.

    SIFT keypoints of all panels are matched with the template's. Their directions are turned to a
    virtual pinhole camera which looks at their middle, so that any lens will do.
    """
    places, _ = template.features
    pairs = [
        _matched(image, panel, template)
        for image, panel in zip(picture.images, camera.panels, strict=True)
        if image is not None
    ]
    rays, index = (np.concatenate(parts) for parts in zip(*pairs, strict=True))
    if len(rays) < LEAST_MATCHES:
        return None
    R = looking_along(np.median(rays, axis=0))
    turned = rays @ R
    ahead = turned[:, 2] > 0.1
    xy = turned[ahead, :2] / turned[ahead, 2:]
    if len(xy) < LEAST_MATCHES:
        return None
    # Pixels per unit of tangent in the middle of the camera's (first) image.
    middle = camera.panels[0].lens.project(np.array([[0.0, 0.0, 1.0], [STEP, 0.0, 1.0]]))
    f = float(np.linalg.norm(middle[1] - middle[0])) / STEP
    # within 3 px
    H, inliers = cv2.findHomography(
        places[index[ahead]], f * xy, cv2.RANSAC, 3.0, maxIters=2000, confidence=0.999
    )
    if H is None or np.count_nonzero(inliers) < LEAST_MATCHES:
        return None
    G = normalised(R @ np.diag([1 / f, 1 / f, 1]) @ H)
    # A plane seen from behind, or points on both sides of the camera, come of wrong matches.
    return G if G.any() and (template.corners @ (R.T @ G)[2] > 0).all() else None


def _matched(image: Image, panel: Panel, template: Template) -> tuple[Array, NDArray[np.intp]]:
    """Unit rays (M, 3) in the camera's frame of a panel's keypoints that match one of the
    template's, and its number (M,).
    """
    px, descriptors = _sift().extract(image)
    mine, number, _ = mutual_matches(descriptors, template.features[1], ratio=0.8)
    rays = panel.ray(px[mine])
    known = np.isfinite(rays).all(axis=1)
    return rays[known], number[known]


@dataclass(frozen=True, slots=True)
class PatchState:
    """The plane's homography (3, 3) when last seen and in the picture before; whether the last one
    showed it; when it was searched [s].
    """

    G: Array | None = None
    before: Array | None = None
    tracked: bool = False
    searched_s: float = -math.inf


@spec
class PatchDetector(DetectorBase):
    """The target's own picture, tracked whole; its corners, or the points `at_px`, are the markers.

    Its homography to the camera's picture is aligned by efficient second-order minimisation (ESM)
    from the last one, predicted at constant velocity, with a gain and an offset of the light and
    the robust weights of an M-estimator. At first, and every `search_s` while it is lost, SIFT
    keypoints find it. The plane is projected by the camera's own model, with any lens.

    All points of the plane are known by the homography: also those that are hidden or beyond the
    border of the picture. When less than `least_visible` of the template is in the picture, and
    alike, all markers are lost.

    Args:
        least_correlation: a block of the template (a sixth of its longer side) is taken to be
            visible if its zero-mean normalised correlation with the picture is at least this [1].
        least_visible: share of the blocks with texture that must be visible [1].
        search_s: time between two searches while it is lost [s].
        texels: largest number of the template's pixels that are compared with the picture; more are
            slower and a little more exact.
        window_margin_px: margin of the window around the predicted picture, besides half of its
            last move [px].

    References: Benhimane & Malis 2007, doi:10.1177/0278364907080252; Lowe 2004,
    doi:10.1023/B:VISI.0000029664.99615.94.
    """

    kind: Literal["patch"] = "patch"
    least_correlation: Annotated[float, Gt(0), Lt(1)] = 0.6
    least_visible: Annotated[float, Gt(0), Le(1)] = 0.3
    search_s: PositiveTime = 0.2
    texels: Annotated[int, Ge(1000), Le(1000000)] = 30000
    window_margin_px: Annotated[int, Ge(2), Le(8192)] = 12
    needs_image: ClassVar[bool] = True
    needs_sheet: ClassVar[bool] = True

    def init(self) -> PatchState:
        """Nothing seen yet."""
        return PatchState()

    def begin(self, goal: Goal, camera: Camera, target: Target) -> PatchState:
        """Nothing seen yet; the target's picture and its keypoints are read now, not while a robot
        waits for the first picture.
        """
        if target.sheet is not None:
            self._template(target)
        return self.init()

    def regions_of_interest(
        self, state: PatchState, camera: Camera, target: Target
    ) -> Regions | None:
        """The window of the next picture; None for everything,
        always so in a camera with panels.
        """
        window = self._window(state, camera, target)
        return None if window is None else ((window,),)

    def detect(
        self,
        state: PatchState,
        picture: Picture | None,
        view: TruthView | None,
        camera: Camera,
        target: Target,
        rng: np.random.Generator,
    ) -> tuple[PatchState, Detection]:
        """Pixels (N, 2) of the target's points in one picture, all NaN where its picture is not
        found.
        """
        picture = self._given(picture)
        template = self._template(target)
        searched_s = state.searched_s
        G = self._tracked(state, picture, template, camera, target)
        if G is None and picture.t - searched_s >= self.search_s:
            searched_s = picture.t
            whole = picture.completed()
            rough = found(template, whole, camera)
            if rough is not None:
                grey = GreyPicture(whole, camera)
                G = align(template, grey, rough, self.least_correlation, self.least_visible)
        if G is None:
            lost = replace(state, before=None, tracked=False, searched_s=searched_s)
            return lost, Detection(uv=np.full((len(target.points), 2), np.nan))
        points = homogeneous(target.points[:, :2] / template.unit_m)
        after = PatchState(G, state.G if state.tracked else None, True, searched_s)
        return after, Detection(uv=camera.project(points @ G.T))

    def _template(self, target: Target) -> Template:
        if target.sheet is None or target.source is None:
            raise ParameterError.fixed(
                "target", "a picture", where="for detector patch, which tracks it"
            )
        return template_of(
            target.source, target.source.stat().st_mtime_ns, target.sheet.width, self.texels
        )

    def _tracked(
        self,
        state: PatchState,
        picture: Picture,
        template: Template,
        camera: Camera,
        target: Target,
    ) -> Array | None:
        if state.G is None:
            return None
        window = self._window(state, camera, target)
        G = self._aligned(state, GreyPicture(picture, camera, window), template)
        if G is None and window is not None:
            G = self._aligned(state, GreyPicture(picture.completed(), camera), template)
        return G

    def _aligned(self, state: PatchState, grey: GreyPicture, template: Template) -> Array | None:
        """Aligned from the last homography and the one predicted at constant velocity, from the
        more similar one first.
        """
        if state.G is None:
            return None
        starts = [state.G]
        if state.before is not None:
            starts.append(normalised(state.G @ np.linalg.inv(state.before) @ state.G))
            starts.sort(key=lambda G: similarity(template, grey, G, self.least_correlation))
        for G in reversed(starts):
            aligned = align(template, grey, G, self.least_correlation, self.least_visible)
            if aligned is not None:
                return aligned
        return None

    def _window(self, state: PatchState, camera: Camera, target: Target) -> Window | None:
        if not state.tracked or state.G is None:
            return None
        # Places along the template's sides, and between, whose images make its bounding box.
        half = self._template(target).half
        along = np.linspace(-1, 1, 5)
        x, y = np.meshgrid(along * half[0], along * half[1])
        plane = np.stack([x, y, np.ones_like(x)], axis=-1).reshape(-1, 3)
        uv = camera.project(plane @ state.G.T)
        before = uv if state.before is None else camera.project(plane @ state.before.T)
        if not (np.isfinite(uv).all() and np.isfinite(before).all()):
            return None
        left, top = uv.min(axis=0).tolist()
        right, bottom = uv.max(axis=0).tolist()
        box = (
            max(-camera.width, int(left)),
            max(-camera.height, int(top)),
            math.ceil(right) + 1,
            math.ceil(bottom) + 1,
        )
        du, dv = (uv - before).mean(axis=0).tolist()
        windows = windows_round([box], [(du, dv)], camera, self.window_margin_px)
        return None if windows is None else windows[0]
