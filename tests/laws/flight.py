"""Flights of the ideal camera with the oracle: the book's camera (f = 800 px on 1000 x 1000), no
border of the picture.
"""

from __future__ import annotations

import numpy as np

import vstestbed as vs
from vstestbed.camera import Camera, Perspective
from vstestbed.core.geometry import Array, Pose
from vstestbed.laws import Law
from vstestbed.robots import Free
from vstestbed.robots.free import FreeStart
from vstestbed.scenario.scenario import Scenario
from vstestbed.targets.base import Points, Square
from vstestbed.tasks import GoalView
from vstestbed.tasks.stop import Converged, Stop
from vstestbed.vision import Oracle


def book_camera(rate_hz: float = 25.0) -> Camera:
    """The book's default camera."""
    return Perspective(
        width=1000, height=1000, focal_length_m=0.008, pixel_size_m=1e-5, rate_hz=rate_hz
    )


def fly(
    law: Law,
    xyz: tuple[float, float, float] = (0, 0, -1),
    yaw: float = 0.0,
    *,
    goal_z: float = 1.0,
    side: float = 0.5,
    target_z: float = 0.0,
    rate_hz: float = 25.0,
    norm_px: float = 0.01,
    duration_s: float = 120.0,
    unlimited: bool = True,
    rpy_deg: tuple[float, float, float] | None = None,
    at: tuple[tuple[float, float, float], ...] | None = None,
) -> vs.Recording:
    """A flight to the view from goal_z straight in front of a square, until the 2-norm of the 8
    pixel errors is under norm_px.

    With `at` the target has its markers there in place of a square's corners.
    """
    angles = (0.0, 0.0, float(np.degrees(yaw))) if rpy_deg is None else rpy_deg
    pose = Pose(xyz=(0, 0, target_z))
    return vs.run(
        Scenario(
            robot=Free(start=FreeStart(nominal=Pose(xyz=xyz, rpy_deg=angles))),
            camera=book_camera(rate_hz),  # pyright: ignore[reportArgumentType]
            target=Square(side=side, pose=pose) if at is None else Points(at=at, pose=pose),
            detector=Oracle(field_of_view="unlimited" if unlimited else "limited"),
            law=law,  # pyright: ignore[reportArgumentType]
            goal=GoalView(T_camera_target=Pose(xyz=(0, 0, goal_z))),
            stop=Stop(
                duration_s=duration_s, converged=Converged(error_px=norm_px / np.sqrt(8), hold_s=0)
            ),
        )
    )


def rays(r: vs.Recording) -> Array:
    """Unit rays (frames, 4, 3) of the measured markers."""
    return r.scenario.camera.ray(pixels(r))


def pixels(r: vs.Recording) -> Array:
    """Measured pixels (frames, 4, 2)."""
    return np.stack([np.column_stack([r[f"u_{i}"], r[f"v_{i}"]]) for i in range(4)], axis=1)
