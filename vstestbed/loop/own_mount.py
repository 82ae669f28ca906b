"""The camera's mount as the controller believes it."""

from __future__ import annotations

from vstestbed.core.geometry import Array, inverse
from vstestbed.robots import Mount
from vstestbed.scenario.scenario import Scenario


def mount_at(scenario: Scenario, mount: Mount, q: Array) -> Mount:
    """The camera's mount; eye to hand, the camera's pose relative to the flange at the joints q (n,)."""
    if not scenario.target.on_gripper:
        return mount
    return Mount.facing(inverse(scenario.robot.flange_pose(q)) @ mount.T_flange_camera)
