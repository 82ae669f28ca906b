"""Alignment of a plane's template with a picture by efficient second-order minimisation (ESM), under any lens.

The plane's homography G (3, 3), det G > 0, maps a template's point (x, y, 1) to the direction of its image in the camera's frame.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vstestbed.core.geometry import Array
from vstestbed.vision.detect.sampling import Grey, GreyPicture, pixels_per_unit
from vstestbed.vision.detect.template import Template, TemplateSize, slopes

TUKEY = 4.685
"""Residuals beyond this many standard deviations have no weight (95 % efficiency on Gaussian noise)."""
LEAST_SIGMA = 0.5
"""Least standard deviation that residuals are taken to have, in units of `TemplateSize.spread`."""
LIGHT = 64.0
"""Grey levels that count as one in the normal equations, so that their columns are of similar size."""
RIDGE = 1e-6
"""Added to the normal equations' diagonal, as a share of its mean: what a template leaves open stays where it is."""
MOST_ROUNDS = (12, 8, 8)
"""Most iterations on the smallest copy, the next one and the largest."""
STILL_PX = 0.03
"""The iterations end when no corner moves by more than this in the picture [px]."""
EARLIER = 8.0
"""In the smaller copies they end so many times earlier."""
PART = 2000
"""Texels in one product of matrices."""
LEAST_TEXELS = 100
"""Fewest texels within the picture from which an alignment is attempted."""
INSIDE = 0.5
"""Share of a block that must be in the picture for it to count."""
ENOUGH = 0.15
"""Share of the textured blocks that must be alike before the others are left out; fewer may be alike by chance."""
FAINT = 1.0
"""Least standard deviation of a block that correlates, in grey levels: that of a plain surface is noise."""
PARTLY = 0.8
"""Share of the alike blocks' median correlation below which a block is taken to be hidden in part."""
COARSEST = 4.0
"""The smallest copy is that whose texels are up to so many times those of the largest."""
SHARP = 0.7
"""Pixels along a texel of the largest copy that is used, at least: finer ones show nothing that the picture holds."""


@dataclass(frozen=True, slots=True)
class Fit:
    """How a template fits a picture.

    Attributes:
        G: the homography (3, 3). correlation: zero-mean normalised cross-correlation over the visible blocks.
        visible: share of the textured blocks that the picture shows: inside it, and alike.
    """

    G: Array
    correlation: float
    visible: float


@dataclass(frozen=True, slots=True)
class BlockFits:
    """Which blocks (B,) of a template count; the correlation of those that are alike, and their share of the textured ones."""

    counted: NDArray[np.bool_]
    correlation: float
    share: float


def normalised(G: Array) -> Array:
    """The same homography with determinant 1, whatever its factor; zero where it is singular."""
    det = np.linalg.det(G)
    return G / np.cbrt(det) if abs(det) > 1e-12 * np.abs(G).max() ** 3 else np.zeros((3, 3))


def align(template: Template, picture: GreyPicture, G: Array, least_correlation: float) -> Fit | None:
    """The homography near G that aligns a template with a picture; None where the plane leaves the picture.

    From the template's small copies to a large one, each against the picture in a similar size, the residuals
    r = (a . l) I(w(G exp(A(z)) q)) + b . l - T(q), l = (1, x, y), over its texels q are minimised over z in sl(3) and the light's gain and
    offset, which change linearly over the plane. ESM takes the mean of the derivatives in the picture and in the template, which makes the
    convergence quadratic. Weights of Tukey, and zero for blocks that do not correlate, leave out what hides the plane.

    References: Benhimane & Malis 2007, doi:10.1177/0278364907080252; Malis & Marchand 2006, doi:10.1109/IROS.2006.281831 (weights).
    """
    blocks = None
    sizes = _sizes(template, picture, G)
    for (level, halvings), rounds in zip(sizes, MOST_ROUNDS[-len(sizes) :], strict=True):
        still = STILL_PX * (1 if level is sizes[-1][0] else EARLIER)
        found = _aligned(level, picture, halvings, G, rounds, still, least_correlation, template.corners)
        if found is None:
            return None
        G, blocks = found
    return None if blocks is None else Fit(G, blocks.correlation, blocks.share)


def similarity(template: Template, picture: GreyPicture, G: Array, least_correlation: float) -> tuple[float, float]:
    """How well a template fits a picture at G as it is, in its smallest copy that `align` would use: share visible, correlation."""
    sizes = _sizes(template, picture, G)
    if not sizes:
        return 0.0, 0.0
    level, halvings = sizes[0]
    blocks = _compared(level, _sampled(level, picture, halvings, G), least_correlation)
    return blocks.share, blocks.correlation


def _sizes(template: Template, picture: GreyPicture, G: Array) -> list[tuple[TemplateSize, int]]:
    """The template's copies to align with, smallest first, each with how often the picture is halved for it; empty where not seen."""
    scale = pixels_per_unit(picture.camera, G, template.half)
    if not scale > 0:
        return []
    px = [scale * np.sqrt(level.texel[0] * level.texel[1]) for level in template.levels]
    first = next((k for k, size in enumerate(px) if size >= SHARP), len(px) - 1)
    used = [k for k in range(first, len(px)) if px[k] <= COARSEST * 1.2 * px[first]]
    return [(template.levels[k], max(0, round(float(np.log2(px[k]))))) for k in reversed(used)]


def _sampled(level: TemplateSize, picture: GreyPicture, halvings: int, G: Array) -> Grey:
    return picture.sampled(G @ level.to_plane, level.grey.shape, halvings).ravel()


def _aligned(
    level: TemplateSize, picture: GreyPicture, halvings: int, G: Array, rounds: int, still: float, least: float, corners: Array
) -> tuple[Array, BlockFits] | None:
    """G aligned in one size, and how well each block fits there; None where too little of the plane is in the picture."""
    before = picture.camera.project(corners @ G.T)
    counted = light = None
    for _ in range(rounds):
        grey = _sampled(level, picture, halvings, G)
        if counted is None:
            counted = _compared(level, grey, least).counted
        seen = counted[level.block] & level.inner & np.isfinite(grey)
        if np.count_nonzero(seen) < LEAST_TEXELS:
            return None
        warp, light = _step(level, grey, seen, light)
        G = normalised(G @ warp)
        if not np.isfinite(G).all() or np.linalg.det(G) <= 0:
            return None
        now = picture.camera.project(corners @ G.T)
        moved, before = np.abs(now - before), now
        if not (moved > still).any():
            blocks = _compared(level, _sampled(level, picture, halvings, G), least)
            if (blocks.counted == counted).all():
                return G, blocks
            counted = blocks.counted
    return G, _compared(level, _sampled(level, picture, halvings, G), least)


def _step(level: TemplateSize, grey: Grey, seen: NDArray[np.bool_], light: Array | None) -> tuple[Array, Array]:
    """The warp exp(A(z)) (3, 3) of the template's plane by which its homography changes in one iteration, and the light (6,) after it.

    light: gain and offset, each (1, x, y); None at first.
    """
    template, x, y = level.grey.ravel(), level.x, level.y
    known = np.where(seen, grey, 0)
    a = _first_light(grey[seen], template[seen]) if light is None else light
    gain = (a[0] + a[1] * x + a[2] * y).astype(np.float32)
    residual = gain * known + (a[3] + a[4] * x + a[5] * y).astype(np.float32) - template
    shape = level.grey.shape
    gx, gy = 0.5 * (gain * slopes(np.where(np.isfinite(grey), grey, 0).reshape(shape), level.texel) + level.slopes)
    along = gx * x + gy * y
    scaled = known / LIGHT
    lit = (scaled, scaled * x, scaled * y, np.ones_like(x), x, y)
    rows = np.stack([gx, gy, gx * y, gy * x, gx * x - gy * y, -along - gy * y, -x * along, -y * along, *lit, residual])
    N = _products(np.asarray(rows * np.sqrt(_weights(residual, level, seen)), np.float32))
    n = len(N) - 1
    z = -np.linalg.solve(N[:n, :n] + RIDGE * np.trace(N[:n, :n]) / n * np.eye(n), N[:n, n])
    return _exponential(z[:8]), a + z[8:] / [LIGHT, LIGHT, LIGHT, 1, 1, 1]


def _first_light(grey: Grey, template: Grey) -> Array:
    """Gain and offset (6,), the same everywhere, by which the grey levels have the template's mean and spread."""
    gain = template.std() / max(float(grey.std()), 1e-3)
    return np.array([gain, 0, 0, template.mean() - gain * grey.mean(), 0, 0])


def _products(rows: Grey) -> Array:
    """The product rows rows^T of (m, n), in parts so small that a linear algebra library does not share them out among threads."""
    return np.add.reduce([(part := rows[:, k : k + PART]) @ part.T for k in range(0, rows.shape[1], PART)]).astype(float)


def _weights(residual: Grey, level: TemplateSize, seen: NDArray[np.bool_]) -> Grey:
    """Tukey's weights of residuals (n,), zero where not seen; their scale by the median of their sizes."""
    size = np.abs(residual) / level.spread
    sigma = max(1.4826 * float(np.median(size[seen])), LEAST_SIGMA)
    part = np.minimum(size / (TUKEY * sigma), 1.0)
    return np.where(seen, (1 - part * part) ** 2, 0).astype(np.float32)


def _exponential(z: Array) -> Array:
    """The exponential of the matrix of sl(3) with coordinates z (8,), by its series: it is small."""
    A = np.array([[z[4], z[2], z[0]], [z[3], -z[4] - z[5], z[1]], [z[6], z[7], z[5]]])
    A *= min(1.0, 1.0 / max(np.abs(A).max(), 1e-12))
    out, term = np.eye(3), np.eye(3)
    for k in range(1, 8):
        term = term @ A / k
        out = out + term
    return out


def _compared(level: TemplateSize, grey: Grey, least: float) -> BlockFits:
    """How well each textured block of a template fits the grey levels (n,): by its zero-mean normalised correlation with them."""
    seen = level.inner & np.isfinite(grey)
    # About their means, which single precision would otherwise keep too few digits beside.
    i, t = (np.where(seen, of - of[seen].mean(), 0) if seen.any() else np.zeros_like(of) for of in (grey, level.grey.ravel()))
    s, si, st, sii, stt, sit = (level.by_block(values) for values in (seen.astype(np.float32), i, t, i * i, t * t, i * t))
    some = np.maximum(s, 1e-3)
    cov, vi, vt = sit - si * st / some, np.maximum(sii - si * si / some, 0), np.maximum(stt - st * st / some, 0)
    inside = level.textured & (s >= INSIDE * level.by_block(level.inner.astype(np.float32)))
    each = cov / np.sqrt(np.maximum(vi, FAINT**2) * np.maximum(vt, FAINT**2))
    alike = inside & (each >= least)
    total = float(cov[alike].sum() / max(np.sqrt(vi[alike].sum() * vt[alike].sum()), 1e-6))
    share = np.count_nonzero(alike) / max(1, np.count_nonzero(level.textured))
    # A block that is hidden in part lets its alignment slip, and has less correlation than the others.
    counted = alike & (each >= PARTLY * np.median(each[alike])) if share >= ENOUGH else inside
    return BlockFits(counted, total, share)
