"""Subpixel corners of tags: the four edges measured in the grey image and intersected, good to hundredths of a pixel."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from vstestbed.core.geometry import Array

Image = NDArray[np.uint8]

ALONG = np.linspace(0.1, 0.9, 16)
"""Positions along an edge at which it is measured, as shares of its length; the blurred corners are left out."""
ACROSS = np.linspace(-1, 1, 25)
"""Samples of one profile across an edge, in units of its reach."""
ENDS = 3
"""Samples at each end of a profile whose mean is its black or white level."""
REACH = 0.65
"""Half length of a profile in modules: it ends within the black border and within the white quiet zone ..."""
MOST_REACH_PX = 4.0
"""... and its limit [px], beyond any blur of the order of a pixel."""
ROUNDS = 4
"""Most iterations; each starts from the corners of the last one ..."""
STEADY_PX = 0.02
"""... and they end when no corner moves by more than this [px], since the next would move them by a fraction of that."""


@dataclass(frozen=True, slots=True)
class Edges:
    """The measured edges of N tags.

    Attributes:
        corners: shape (N, 4, 2) [px].
        astray: largest distance of a measured point from its line, shape (N,) [px].
        contrast: least step from black to white as a share of the tag's median step, shape (N,).
        border: least distance of a profile's ends from the picture's border, shape (N,) [px]; negative outside.
    """

    corners: Array
    astray: Array
    contrast: Array
    border: Array


def measure_edges(grey: Image, corners: Array, modules: int) -> Edges:
    """The edges of tags whose corners are known within half a module.

    Profiles of intensity I are sampled across an edge along the tag's own rows and columns, mapped into the image by the
    corners' homography, so that they end within one module also on a tilted tag. Along a profile of length 2 r from black b to
    white w the edge lies at r (1 - 2 mean(I - b)/(w - b)), which no symmetrical blur shifts. Lines are fitted to these points
    by total least squares; their intersections are the corners.

    Args:
        grey: the image (H, W).
        corners: shape (N, 4, 2) [px], clockwise from the tag's own upper left.
        modules: number of modules along a tag's edge.
    """
    with np.errstate(divide="ignore", invalid="ignore"):  # parallel lines give NaN, which fails every check of a tag
        edges = _measured_once(grey, corners, modules)
        for _ in range(ROUNDS - 1):
            if np.abs(edges.corners - corners).max() < STEADY_PX:
                break
            corners, edges = edges.corners, _measured_once(grey, edges.corners, modules)
    return edges


def _measured_once(grey: Image, corners: Array, modules: int) -> Edges:
    """One iteration of `measure_edges`."""
    size = np.array([grey.shape[1], grey.shape[0]]) - 1
    middle, reach = _profiles(corners, modules)
    where = (middle[..., None, :] + ACROSS[:, None] * reach[..., None, :]).astype(np.float32)
    u, v = where.reshape(1, -1, 2)[..., 0], where.reshape(1, -1, 2)[..., 1]
    profile = cv2.remap(grey, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    share, step = _crossing(np.asarray(profile, float).reshape(where.shape[:-1]))
    measured, misfit = _cross(middle + share[..., None] * reach)
    contrast = step.min(axis=(1, 2)) / np.maximum(np.median(step, axis=(1, 2)), 1.0)
    # Samples outside of the image repeat its border pixels; a negative distance rejects the tag.
    border = np.minimum(where, size - where).min(axis=(1, 2, 3, 4))
    return Edges(measured, np.abs(misfit).max(axis=(1, 2)), contrast, border)


def _profiles(corners: Array, modules: int) -> tuple[Array, Array]:
    """Midpoints of the profiles and the vectors from there to their outer ends, both (N, 4, S, 2) [px].

    Homography of the unit square from its four corners: Heckbert 1989, Fundamentals of Texture Mapping and Image Warping, section 2.2.3.
    """
    a, b, c, d = (corners[:, k] for k in range(4))
    e, f, s = b - c, d - c, a - b + c - d
    det = np.cross(_flat(e), _flat(f))[:, 2]
    g, h = np.cross(_flat(s), _flat(f))[:, 2] / det, np.cross(_flat(e), _flat(s))[:, 2] / det
    H = np.zeros((len(corners), 3, 3))
    H[:, :2, 0], H[:, :2, 1], H[:, :2, 2] = b - a + g[:, None] * b, d - a + h[:, None] * d, a
    H[:, 2] = np.stack([g, h, np.ones_like(g)], axis=-1)
    out = REACH / modules
    s, zero = ALONG, np.zeros_like(ALONG)
    on = np.stack([np.stack([s, zero]), np.stack([zero + 1, s]), np.stack([1 - s, zero + 1]), np.stack([zero, 1 - s])])
    normal = np.array([[0, -1], [1, 0], [0, 1], [-1, 0]])[:, :, None]
    inner, outer = (_mapped(H, on + sign * out * normal) for sign in (-1, 1))
    reach = (outer - inner) / 2
    long = np.linalg.norm(reach, axis=-1, keepdims=True)
    return _mapped(H, on), reach * np.minimum(1, MOST_REACH_PX / np.maximum(long, 1e-9))


def _mapped(H: Array, p: Array) -> Array:
    """Points (4, 2, S) of the unit square mapped into the image by homographies (N, 3, 3), shape (N, 4, S, 2)."""
    q = np.einsum("nij,ejs->nesi", H[:, :, :2], p) + H[:, None, None, :, 2]
    return q[..., :2] / q[..., 2:]


def _crossing(profile: Array) -> tuple[Array, Array]:
    """Position of the edge in profiles (..., K), from -1 at their inner to 1 at their outer end, and the step's height."""
    black, white = profile[..., :ENDS].mean(axis=-1), profile[..., -ENDS:].mean(axis=-1)
    step = white - black
    mean = np.trapezoid(profile, axis=-1) / (profile.shape[-1] - 1)
    return np.clip(1 - 2 * (mean - black) / np.maximum(step, 1.0), -1, 1), step


def _cross(points: Array) -> tuple[Array, Array]:
    """Intersections (N, 4, 2) of the lines through points (N, 4, S, 2), and the points' distances from their lines (N, 4, S)."""
    mean = points.mean(axis=2)
    d = points - mean[:, :, None]
    xx, yy, xy = (d[..., 0] ** 2).sum(-1), (d[..., 1] ** 2).sum(-1), (d[..., 0] * d[..., 1]).sum(-1)
    angle = np.arctan2(2 * xy, xx - yy) / 2 + np.pi / 2  # the scatter matrix's minor axis, in closed form
    normal = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    lines = np.concatenate([normal, -(normal * mean).sum(-1, keepdims=True)], axis=-1)
    # Homogeneous lines: their cross product is the point of intersection.
    crossed = np.cross(np.roll(lines, 1, axis=1), lines)
    return crossed[..., :2] / crossed[..., 2:], (d * normal[:, :, None]).sum(-1)


def _flat(v: Array) -> Array:
    """Vectors (N, 2) with a third component 0, for np.cross."""
    return np.concatenate([v, np.zeros((len(v), 1))], axis=-1)
