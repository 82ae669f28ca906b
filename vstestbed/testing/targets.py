"""What every target must do."""

from __future__ import annotations

import numpy as np

from vstestbed.camera import Perspective
from vstestbed.core.contract import Contract
from vstestbed.core.geometry import Pose, inverse, transform
from vstestbed.robots import Free
from vstestbed.robots.free import FreeStart
from vstestbed.sim.scene.compose import Parts
from vstestbed.sim.scene.stage import Stage
from vstestbed.sim.scene.world import World
from vstestbed.targets import Target, TargetContract


def check_target(target: Target) -> None:
    """A target has its markers where it says, is seen where it is, and stands so in the compiled scene.

    Raises:
        AssertionError: it says what was expected and what was found.
    """
    Contract(TargetContract, base=Target).check(type(target))
    points, places = target.points, target.places
    assert points.ndim == 2 and points.shape[1] == 3, f"points must have shape (N, 3), got {points.shape}"
    assert np.isfinite(points).all(), "points must be finite"
    assert len(places) in (0, len(points)), f"places must be all {len(points)} points or none, got {len(places)}"
    assert len(target.hues_deg) == len(points), f"each of {len(points)} markers needs a hue, got {len(target.hues_deg)}"
    if len(places) > 1:  # a kind may forget to refuse markers that overlap
        gaps = np.linalg.norm(places[:, None] - places[None], axis=-1) + np.eye(len(places)) * 1e9
        target.marker.check_spacing(float(gaps.min()), len(places))
    T_target_camera = inverse(Pose(xyz=(0.1, -0.2, 2.0), rpy_deg=(5, -10, 20)).T)
    if len(places):
        error = np.abs(target.seen_from(T_target_camera) - transform(inverse(T_target_camera), points)).max()
        assert error < 1e-12, f"seen_from must be points in the camera's frame, it is {error:.2g} m off"
    _check_scene(target)


def _check_scene(target: Target) -> None:
    """The compiled scene has a site for each marker that has a place, there."""
    robot = Free(start=FreeStart(nominal=Pose(xyz=(0, 0, -2))))
    floor_z = -50.0 if len(target.places) else 0.0  # out of the way of markers; lines lie on it
    stage = Stage(Parts(robot, Perspective(), target, World(floor_z=floor_z), step=0.002))
    try:
        for i, place in enumerate(target.places):
            found = stage.model.site(f"target/marker_{i}").pos
            assert np.allclose(found, place, atol=1e-6), f"marker {i} stands at {found} in the scene and at {place} in the target"
    finally:
        stage.close()
