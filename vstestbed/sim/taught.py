"""An arm put where it is shown its goal: by its true geometry, which is not the one that it computes with."""

from __future__ import annotations

from vstestbed.core.geometry import Array, inverse
from vstestbed.sim.scene.stage import Stage

ROUNDS = 3
"""Corrections of the joints: each leaves the product of the geometry's error and the correction before, under a micrometre at the third."""


def shown_at(stage: Stage, T_world_flange: Array, q: Array) -> Array:
    """Joints (n,) at which the true flange, which carries the camera, is at a pose (4, 4); those of the arm's own model are q (n,).

    q <- f^-1(T E^-1) with the error E = f(q)^-1 T_true(q) of the arm's own kinematics f. The stage is left at the joints before the last.

    Raises:
        UnreachableError: the arm does not get there.
    """
    robot = stage.parts.robot
    if robot.mechanics is None or robot.mechanics.links is None or stage.parts.target.on_gripper:
        return q
    for _ in range(ROUNDS):
        stage.place(stage.data.time, stage.target_pose(), q)
        own = robot.flange_pose(q)
        true = stage.camera_pose() @ stage.mount_inverse
        q = robot.configuration_at(T_world_flange @ inverse(true) @ own, q)
    return q
