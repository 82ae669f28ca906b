"""Tracking: keep a view of a moving target."""

from __future__ import annotations

from typing import Literal

from vstestbed.core.geometry import Array, Pose, inverse, rigid_error
from vstestbed.core.spec import spec
from vstestbed.targets import Target
from vstestbed.tasks.continuing import Continuing, Settle, Tolerance
from vstestbed.tasks.setup import Setup


@spec
class GoalTrack(Continuing):
    """Continuing task: keep a view of a moving target.

    Args:
        T_camera_target: the pose from which the target is to be seen at all times.
        band_m: tolerance of the camera's distance from that pose once settled [m].
        settle_s: settling time [s].
    """

    kind: Literal["track"] = "track"
    T_camera_target: Pose
    band_m: Tolerance = 0.05
    settle_s: Settle = 5.0

    def goal_poses(self, target: Target, mount: Array) -> tuple[Array, ...]:
        """The pose, whatever the mount."""
        return (self.T_camera_target.T,)

    @property
    def view_fields(self) -> tuple[str, ...]:
        """The pose."""
        return ("goal.T_camera_target",)

    def error_m(self, setup: Setup, T_world_base: Array, T_world_target: Array, t: float) -> float:
        """Distance of the camera from its goal pose."""
        T_camera = T_world_base @ setup.camera.mount.T
        return rigid_error(T_camera, T_world_target @ inverse(self.T_camera_target.T))[0]
