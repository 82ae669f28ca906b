"""What every lens must do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vstestbed.camera import Camera
from vstestbed.core.geometry import Array, Pose, exp
from vstestbed.robots import Free
from vstestbed.robots.free import FreeStart
from vstestbed.scenario.load import load
from vstestbed.targets import Square
from vstestbed.targets.markers import Disc
from vstestbed.testing.detectors import check_detector
from vstestbed.vision import Blobs

GRID = 25
"""Pixels that are tried along each side of the picture."""
LEAST_SEEN = 0.2
"""Least share of the picture in which each pixel must have a ray."""
WITHIN_PX = 1e-4
"""Largest error of the way to a ray and back [px]: a thousandth of the best measurement."""
AT_M = 0.6
"""Distance of the target that is rendered [m]."""


def check_camera(camera: Camera, seed: int = 0) -> None:
    """`ray` is the inverse of `project`, both take leading axes, and markers are rendered and detected where `project` says.

    Args:
        camera: with the parameters to test. seed: of the directions tried.

    Raises:
        AssertionError: it says what was expected and what was found.
    """
    kind = getattr(camera, "kind", type(camera).__name__)
    assert isinstance(camera, Camera), f"{kind}: a lens must derive from vstestbed.camera.Camera, or Radial"
    uv = _check_pixels(camera, kind)
    _check_directions(camera, kind, np.random.default_rng(seed))
    _check_picture(camera, uv)


def _check_pixels(camera: Camera, kind: str) -> Array:
    """From pixels to rays and back, whatever the distance; returns the pixels that have a ray."""
    across, down = np.linspace(0, camera.width - 1, GRID), np.linspace(0, camera.height - 1, GRID)
    uv = np.stack(np.meshgrid(across, down), axis=-1).reshape(-1, 2)
    rays = camera.ray(uv)
    assert rays.shape == (len(uv), 3), f"{kind}: ray must have shape (N, 3) for uv (N, 2), got {rays.shape}"
    seen = np.isfinite(rays).all(axis=1)
    assert seen.mean() >= LEAST_SEEN, f"{kind}: {seen.mean():.0%} of the picture have a ray, at least {LEAST_SEEN:.0%} must"
    uv, rays = uv[seen], rays[seen]
    length = np.abs(np.linalg.norm(rays, axis=1) - 1).max()
    assert length < 1e-9, f"{kind}: rays must be unit vectors, one is {length:.2g} off"
    for distance in (0.01, 1.0, 100.0):
        back = camera.project(distance * rays)
        error = np.linalg.norm(back - uv, axis=1)
        assert (error < WITHIN_PX).all(), f"{kind}: project(ray(uv)) must be uv at {distance:g} m, it is {np.max(error):.3g} px off"
    both = camera.project(np.stack([rays, 2 * rays]))
    assert both.shape == (2, len(uv), 2), f"{kind}: project must take leading axes: (2, N, 3) to (2, N, 2), got {both.shape}"
    return uv


def _check_directions(camera: Camera, kind: str, rng: np.random.Generator) -> None:
    """From directions all round to pixels and back: what is seen in the picture is seen where it is, not behind."""
    directions = rng.normal(size=(2000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    uv = camera.project(directions)
    shown = camera.inside(uv)
    error = np.linalg.norm(camera.ray(uv[shown]) - directions[shown], axis=1)
    wrong = directions[shown][~(error < 1e-6)]
    words = f"project must be NaN where the lens sees nothing; {len(wrong)} directions, one of them"
    assert not len(wrong), f"{kind}: ray(project(p)) must point to p; {words} {wrong[0].round(3)}, come back elsewhere"


def _check_picture(camera: Camera, uv: Array) -> None:
    """Four discs, rendered through the lens, are detected where it projects them."""
    # Off the middle, which a mirror does not see, and away from the border.
    wanted = np.array([0.7 * camera.width, 0.6 * camera.height])
    ray = camera.ray(uv[np.linalg.norm(uv - wanted, axis=1).argmin()][None])[0]
    axis = np.cross([0.0, 0.0, 1.0], ray)  # the target faces the lens: its z axis along the ray
    turn = axis / max(float(np.linalg.norm(axis)), 1e-12) * np.arccos(np.clip(ray[2], -1, 1))
    T = exp(np.concatenate([np.zeros(3), turn]))
    T[:3, 3] = AT_M * ray
    s = load("ibvs_book", {"detector": "oracle"})
    target = Square(side=0.16, marker=Disc(radius=0.025, lit=False), pose=Pose.of(T))
    robot = Free(start=FreeStart(nominal=Pose()))
    check_detector(Blobs(), replace(s, name="a square before the lens", robot=robot, camera=replace(camera, latency_s=0.0), target=target))
