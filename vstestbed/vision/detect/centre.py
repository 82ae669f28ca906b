"""Perspective bias: the centroid of a marker's image is not the image of its centre (discs and spheres)."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from vstestbed.camera import Camera
from vstestbed.core.geometry import Array, transform
from vstestbed.targets.base import Target

BALL_ROUNDS = 5
"""Iterations after which distance and bias have converged to 1e-4 (balls of 2 to 60 px, to 65 degrees off axis)."""
CORNERS = 32
"""Corners of the polygon that approximates an outline: its bias and area are then right to 1e-4."""


def _circle() -> tuple[Array, Array]:
    """Closed polygon with the area of the unit circle: cosines and sines, shape (CORNERS + 1,) each."""
    angle = np.arange(CORNERS + 1) * (2 * math.pi / CORNERS)
    swell = math.sqrt(2 * math.pi / (CORNERS * math.sin(2 * math.pi / CORNERS)))
    return swell * np.cos(angle), swell * np.sin(angle)


_COS, _SIN = _circle()


class Outlines(NamedTuple):
    """Images of N markers.

    Attributes:
        bias: their centroids less the images of their centres, shape (N, 2) [px].
        area: shape (N,) [px^2].
        centre: the images of their centres, shape (N, 2) [px].
    """

    bias: Array
    area: Array
    centre: Array


def centre_bias(camera: Camera, target: Target, T_camera_target: Array) -> Outlines:
    """Centroid of each marker's image relative to the image of its centre, the image's area, and that of the centre.

    The rim (of a disc: across its normal; of a sphere: the circle where the rays touch it, centre p (d^2 - r^2)/d^2,
    radius r sqrt(1 - r^2/d^2), d = |p|) is projected as a polygon; with its corners q_i relative to the image of the centre,
    a_i = q_i x q_i+1,  area = |sum a_i|/2,  bias = sum (q_i + q_i+1) a_i / (3 sum a_i).
    This holds for any lens. Where the lens does not see a whole rim the result is NaN.

    Args:
        camera: the camera.
        target: marker points, normals, kind and radius.
        T_camera_target: the target's pose, shape (4, 4).

    Reference: Heikkila & Silven 1997, doi:10.1109/CVPR.1997.609468 (the bias in closed form for a pinhole and a disc).
    """
    points, radius = target.points, target.marker.radius
    with np.errstate(invalid="ignore", divide="ignore"):
        if not target.marker.height_m:  # flat
            p = transform(T_camera_target, _disc_rims(points.tobytes(), target.normals.tobytes(), radius)).reshape(len(points), -1, 3)
        else:
            p = _sphere_rims(transform(T_camera_target, points), radius)
        return _of_rims(camera, p)


def _of_rims(camera: Camera, p: Array) -> Outlines:
    """The images of centres and rims p (N, 1 + corners, 3) in the camera's frame."""
    uv = camera.project(p)
    q = uv[:, 1:] - uv[:, :1]
    here, there = q[:, :-1], q[:, 1:]
    a = here[..., 0] * there[..., 1] - here[..., 1] * there[..., 0]
    twice_area = np.add.reduce(a, axis=1)
    bias = np.einsum("nik,ni->nk", here + there, a) / (3 * twice_area[:, None])
    return Outlines(bias, 0.5 * np.abs(twice_area), uv[:, 0])


def ball_bias(camera: Camera, radius: float, centroid: Array, area: Array) -> Array:
    """The bias (N, 2) [px] of balls from centroids (N, 2) [px] and areas (N,) [px^2], without a pose.

    The area gives a ball's distance; an error of 5 % in the area makes one of 5 % in the bias. NaN stays NaN.
    """
    bias, reach = np.zeros_like(centroid), np.full(len(area), 10 * radius)
    with np.errstate(invalid="ignore", divide="ignore"):
        for _ in range(BALL_ROUNDS):
            p = camera.ray(centroid - bias) * reach[:, None]
            bias, expected, _ = _of_rims(camera, _sphere_rims(p, radius))
            # The area falls with the square of the distance; never closer than the ball's own surface.
            reach = np.maximum(reach * np.sqrt(expected / area), 1.01 * radius)
    return bias


@lru_cache(maxsize=256)
def _disc_rims(points: bytes, normals: bytes, radius: float) -> Array:
    """Each disc's centre and rim in the target's frame, shape (N (CORNERS + 2), 3).

    points, normals: of the discs, (N, 3) each, as bytes, which can be hashed.
    """
    centre = np.frombuffer(points).reshape(-1, 1, 3)
    across = np.array([_across(*normal) for normal in np.frombuffer(normals).reshape(-1, 3).tolist()])
    rim = centre + radius * (_COS[:, None] * across[:, :1] - _SIN[:, None] * across[:, 1:])
    return np.concatenate([centre, rim], axis=1).reshape(-1, 3)


def _sphere_rims(p: Array, radius: float) -> Array:
    """Centres of spheres, and the circles of tangency of the camera's rays, shape (N, CORNERS + 2, 3); NaN from inside.

    Reference for the basis across a ray: Duff et al. 2017, Building an orthonormal basis, revisited, JCGT 6(1).
    """
    d2 = np.einsum("ni,ni->n", p, p)
    shrink = 1 - radius**2 / d2
    rho = radius * np.sqrt(shrink)
    across = np.array([_across(*ray) for ray in (p / np.sqrt(d2)[:, None]).tolist()])
    out = np.empty((len(p), CORNERS + 2, 3))
    out[:, 0] = p
    rim = _COS[:, None] * across[:, :1]
    rim += _SIN[:, None] * across[:, 1:]
    rim *= rho[:, None, None]
    np.add((p * shrink[:, None])[:, None], rim, out=out[:, 1:])
    return out


def _across(x: float, y: float, z: float) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """Two unit vectors across a ray (x, y, z); in plain floats, a quarter of the time of numpy's for some five markers."""
    sign = math.copysign(1.0, z)  # the branch without a singularity at z = -1
    a = -1 / (sign + z)
    b = x * y * a
    return (1 + sign * x * x * a, sign * b, -sign * x), (b, sign + y * y * a, -y)
