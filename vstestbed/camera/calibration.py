"""Calibration errors: the camera as robot, detector and law know it, where that differs from the true one."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge, Gt, Le, Lt

from vstestbed.camera.base import Camera
from vstestbed.core.geometry import Array, Pose
from vstestbed.core.quantity import Narrower, Pixel, PositiveGain
from vstestbed.core.spec import spec


@spec
class Calibration:
    """Errors of the calibration that robot, detector, observer and law work with; the simulator's camera is the true one.

    believed mount = true mount * mount_error,  believed f = true f * (1 + focal_error),
    believed principal point = true one + principal_error_px.

    Args:
        mount_error: pose of the believed camera in the true one's frame [m, deg].
        focal_error: relative error of the focal length [1]; e.g. `0.02`.
        principal_error_px: error of the principal point (u, v) [px]; e.g. `[3, -2]`.
        ignores_distortion: the distortion is not modelled: a perspective lens is taken for a pinhole, a fisheye for equidistant.
        depth_factor, depth_spread: error of every depth Z_i (and range) given to the law, whatever its source, and of the
            distance in an estimated pose: Z_i * factor * exp(spread n_i), with one normal number n_i for each marker and run [1].
        goal: how the goal view was given. `told`: as a pose in numbers; the law converges where the true camera sees the reference pixels
            of the believed one, off by the calibration's error. `shown`: the true camera took the picture at the goal; pose and depth there
            are estimated from it with the believed calibration, so that the errors at the goal cancel.

    Reference: Chaumette & Hutchinson 2006, doi:10.1109/MRA.2006.250573, and Malis & Rives 2003, doi:10.1109/ROBOT.2003.1241749.
    """

    mount_error: Pose = Pose()
    focal_error: Annotated[float, Gt(-0.9), Lt(9)] = 0.0
    principal_error_px: Pixel = (0.0, 0.0)
    ignores_distortion: bool = False
    depth_factor: Annotated[PositiveGain, Narrower(le=100)] = 1.0
    depth_spread: Annotated[float, Ge(0), Le(3)] = 0.0
    goal: Literal["told", "shown"] = "told"

    @cached_property
    def lens_exact(self) -> bool:
        """Whether the believed intrinsics are the true ones."""
        return not (self.focal_error or any(self.principal_error_px) or self.ignores_distortion)

    @cached_property
    def camera_exact(self) -> bool:
        """Whether the believed intrinsics and mount are the true ones."""
        return self.lens_exact and self.mount_error == Pose()

    @cached_property
    def depth_exact(self) -> bool:
        """Whether depths have no error."""
        return self.depth_factor == 1 and self.depth_spread == 0

    @property
    def draws(self) -> bool:
        """Whether a seed makes a difference: errors of the depths are drawn."""
        return self.depth_spread > 0

    def depth_scale(self, markers: int, rng: np.random.Generator) -> Array | None:
        """Factor on each marker's depth in one run, shape (markers,); None where depths have no error."""
        if self.depth_exact:
            return None
        return self.depth_factor * np.exp(self.depth_spread * rng.standard_normal(markers))

    def believed(self, camera: Camera) -> Camera:
        """The camera as robot, detector, observer and law know it; ParameterError where the lens is impossible with this error."""
        if self.camera_exact:
            return camera
        mount = Pose.of(camera.mount.T @ self.mount_error.T)
        if self.lens_exact:
            return replace(camera, mount=mount)
        cx, cy = (camera.centre + self.principal_error_px).tolist()
        return replace(camera.miscalibrated(self.focal_error, (cx, cy), self.ignores_distortion), mount=mount)
