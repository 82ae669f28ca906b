"""Alignment of a plane's template with a picture by efficient second-order minimisation (ESM), under any lens.

The plane's homography G (3, 3), det G > 0, maps a template's point (x, y, 1) to the direction of its image in the camera's frame.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from vstestbed.core.geometry import Array
from vstestbed.vision.detect.sampling import GreyPicture, Grey, pixels_per_unit
from vstestbed.vision.detect.template import Level, Template, slopes

TUKEY = 4.685
"""Residuals beyond this many standard deviations have no weight (95 % efficiency on Gaussian noise)."""
LEAST_SIGMA = 2.0
"""Least standard deviation that residuals are taken to have, in grey levels."""
LIGHT = 64.0
"""Grey levels that count as one in the normal equations, so that their columns are of similar size."""
RIDGE = 1e-6
"""Added to the normal equations' diagonal, as a share of its mean: what a template leaves open stays where it is."""
MOST_ROUNDS = (12, 8, 8)
"""Most iterations on the smallest copy, the next one and the largest."""
STILL_PX = 0.01
"""The iterations end when no corner moves by more than this in the picture [px]."""
EARLIER = 8.0
"""In the smaller copies they end so many times earlier."""
PART = 2000
"""Texels in one product of matrices."""
LEAST_TEXELS = 100
"""Fewest texels within the picture from which an alignment is attempted."""
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


def normalised(G: Array) -> Array:
    """The same homography with determinant 1, whatever its factor; zero where it is singular."""
    det = np.linalg.det(G)
    return G / np.cbrt(det) if abs(det) > 1e-12 * np.abs(G).max() ** 3 else np.zeros((3, 3))


def align(template: Template, picture: GreyPicture, G: Array, least_correlation: float) -> Fit | None:
    """The homography near G that aligns a template with a picture; None where the plane leaves the picture.

    From the template's small copies to a large one, each against the picture in a similar size, the residuals
    r = a I(w(G exp(A(z)) q)) + b - T(q) over its texels q are minimised over z in sl(3) and the light's gain a and offset b. ESM takes
    the mean of the derivatives in the picture and in the template, which makes the convergence quadratic. Weights of Tukey, and zero for
    blocks that did not correlate in the size before, leave out what hides the plane.

    References: Benhimane & Malis 2007, doi:10.1177/0278364907080252; Malis & Marchand 2006, doi:10.1109/IROS.2006.281831 (weights).
    """
    fit: Fit | None = None
    sizes = _sizes(template, picture, G)
    blocks: NDArray[np.bool_] | None = None
    for (level, halvings), rounds in zip(sizes, MOST_ROUNDS[-len(sizes) :], strict=True):
        still = STILL_PX * (1 if level is sizes[-1][0] else EARLIER)
        G, residual = _aligned(level, picture, halvings, G, rounds, still, blocks, template.corners)
        if residual is None:
            return None
        alike, correlation = _compared(level, residual, least_correlation)
        blocks = alike if alike.any() else None
        fit = Fit(G, correlation, np.count_nonzero(alike) / max(1, np.count_nonzero(level.textured)))
    return fit


def compared(template: Template, picture: GreyPicture, G: Array, least_correlation: float) -> Fit | None:
    """How a template fits a picture at G as it is, by its smallest copy that `align` would use."""
    sizes = _sizes(template, picture, G)
    if not sizes:
        return None
    level, halvings = sizes[0]
    alike, correlation = _compared(level, _sampled(level, picture, halvings, G), least_correlation)
    return Fit(G, correlation, np.count_nonzero(alike) / max(1, np.count_nonzero(level.textured)))


def _sizes(template: Template, picture: GreyPicture, G: Array) -> list[tuple[Level, int]]:
    """The template's copies to align with, smallest first, each with how often the picture is halved for it; empty where not seen."""
    scale = pixels_per_unit(picture.camera, G, template.half)
    if not scale > 0:
        return []
    px = [scale * np.sqrt(level.texel[0] * level.texel[1]) for level in template.levels]
    first = next((k for k, size in enumerate(px) if size >= SHARP), len(px) - 1)
    used = [k for k in range(first, len(px)) if px[k] <= COARSEST * 1.2 * px[first]]
    return [(template.levels[k], max(0, round(float(np.log2(px[k]))))) for k in reversed(used)]


def _sampled(level: Level, picture: GreyPicture, halvings: int, G: Array) -> Grey:
    return picture.sampled(level.homogeneous @ G.T, halvings)


def _aligned(
    level: Level,
    picture: GreyPicture,
    halvings: int,
    G: Array,
    rounds: int,
    still: float,
    blocks: NDArray[np.bool_] | None,
    corners: Array,
) -> tuple[Array, Grey | None]:
    """G aligned in one size, and the grey levels (n,) sampled there; None where too little of the plane is in the picture."""
    counts = level.inner if blocks is None else level.inner & blocks[level.block]
    before = picture.camera.project(corners @ G.T)
    for _ in range(rounds):
        grey = _sampled(level, picture, halvings, G)
        seen = counts & np.isfinite(grey)
        if np.count_nonzero(seen) < LEAST_TEXELS:
            return G, None
        G = normalised(G @ _step(level, grey, seen))
        if not np.isfinite(G).all() or np.linalg.det(G) <= 0:
            return G, None
        now = picture.camera.project(corners @ G.T)
        moved = np.abs(now - before)
        before = now
        if not (moved > still).any():
            break
    return G, _sampled(level, picture, halvings, G)


def _step(level: Level, grey: Grey, seen: NDArray[np.bool_]) -> Array:
    """exp(A(z)), the warp in the template's plane by which its homography changes in one iteration, (3, 3)."""
    h, w = level.grey.shape
    template = level.grey.ravel()
    known = np.where(np.isfinite(grey), grey, 0)
    i, t = known[seen], template[seen]
    gain = t.std() / max(float(i.std()), 1e-3)
    offset = t.mean() - gain * i.mean()
    residual = gain * known + offset - template
    weights = _weights(residual, seen)
    gx, gy = 0.5 * (gain * slopes(known.reshape(h, w), level.texel) + level.slopes)
    x, y = level.x, level.y
    along = gx * x + gy * y
    columns = (gx, gy, gx * y, gy * x, gx * x - gy * y, -along - gy * y, -x * along, -y * along, known / LIGHT, np.ones_like(x), residual)
    N = _products(np.stack(columns) * np.sqrt(weights))
    normal = N[:10, :10] + RIDGE * np.trace(N[:10, :10]) / 10 * np.eye(10)
    z = -np.linalg.solve(normal, N[:10, 10])
    return _exponential(z[:8])


def _products(rows: Grey) -> Array:
    """rows rows^T of (m, n), in parts so small that a linear algebra library does not share them out among threads."""
    return np.add.reduce([(part := rows[:, k : k + PART]) @ part.T for k in range(0, rows.shape[1], PART)]).astype(float)


def _weights(residual: Grey, seen: NDArray[np.bool_]) -> Grey:
    """Tukey's weights of residuals (n,), zero where not seen; their scale by the median of their sizes."""
    size = np.abs(residual)
    sigma = max(1.4826 * float(np.median(size[seen])), LEAST_SIGMA)
    part = np.minimum(size / (TUKEY * sigma), 1.0)
    return np.where(seen, (1 - part * part) ** 2, 0).astype(np.float32)


def _exponential(z: Array) -> Array:
    """exp of the matrix of sl(3) with coordinates z (8,), by its series: it is small."""
    A = np.array([[z[4], z[2], z[0]], [z[3], -z[4] - z[5], z[1]], [z[6], z[7], z[5]]])
    A *= min(1.0, 1.0 / max(np.abs(A).max(), 1e-12))
    out, term = np.eye(3), np.eye(3)
    for k in range(1, 8):
        term = term @ A / k
        out = out + term
    return out


def _compared(level: Level, grey: Grey, least: float) -> tuple[NDArray[np.bool_], float]:
    """Which textured blocks (B,) correlate with the template by at least `least`, and the correlation over all of those."""
    seen = level.inner & np.isfinite(grey)
    block, template = level.block, level.grey.ravel()
    i, t = np.where(seen, grey, 0).astype(float), np.where(seen, template, 0).astype(float)
    n = len(level.textured)
    s, si, st, sii, stt, sit = (np.bincount(block, values, n) for values in (seen.astype(float), i, t, i * i, t * t, i * t))
    many = np.maximum(s, 1)
    cov, vi, vt = sit - si * st / many, np.maximum(sii - si * si / many, 0), np.maximum(stt - st * st / many, 0)
    each = cov / np.maximum(np.sqrt(vi * vt), 1e-6)
    inside = s >= 0.5 * np.bincount(block, level.inner.astype(float), n)
    alike = level.textured & inside & (each >= least) & (s > 3)
    total = float(cov[alike].sum() / max(np.sqrt(vi[alike].sum() * vt[alike].sum()), 1e-6)) if alike.any() else 0.0
    return alike, total
