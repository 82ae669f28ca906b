"""From what a scenario asks for to the goal that a law is told: where the camera shall be, and what it sees there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vstestbed.camera import Camera
from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array, inverse
from vstestbed.core.planar import pose_on_ground
from vstestbed.features.observation import Goal
from vstestbed.scenario.goal import AnyGoal, GoalGap, GoalLanding, GoalLine, GoalPlace, GoalTrack, GoalView, GoalViewFrom
from vstestbed.targets.base import Target
from vstestbed.targets.ground_lines import GroundLines
from vstestbed.vision.pose.calibration_error import pose_by_depth, shown_goal


def told_goal(goal: AnyGoal, camera: Camera, believed: Camera, target: Target, depth_scale: Array | None, shown: bool) -> Goal:
    """The goal as the law is told it. Tasks that are no view have one all the same: what is seen where all is well.

    Args:
        goal: one of the scenario's. camera, believed: the true one, and the one that the law believes in.
        depth_scale: by how much each marker's depth is told wrong, (N,); None where it is not.
        shown: the goal's picture was taken with the true camera there; else it is reckoned with the believed one.

    Raises:
        ParameterError: lines are nowhere ahead of the camera, or the goal is a line and the target none.
    """
    points = target.points
    if isinstance(goal, GoalLine) and isinstance(target, GroundLines):
        ahead = target.straight_ahead(believed.mount.T, goal.offset_m)
        if not np.isfinite(ahead).all():
            words = "must have the camera look ahead, or down with the top of its picture ahead: lines are met ahead of it"
            raise ParameterError("camera.mount", words, camera.mount.rpy_deg)
        return Goal.of_points(believed, ahead, goal_pose(goal, target, believed.mount.T))
    if shown:
        made = shown_goal(camera, believed, points, goal_pose(goal, target, camera.mount.T))
    else:
        made = Goal.from_view(believed, points, goal_pose(goal, target, believed.mount.T))
    if depth_scale is not None:
        pose = pose_by_depth(made.T_camera_target, points, depth_scale) if shown else made.T_camera_target
        made = replace(made.deepened(depth_scale), T_camera_target=pose)
    match goal:
        case GoalView(markers=markers) if markers is not None:
            return replace(made, counted=np.isin(np.arange(len(points)), markers))
        case GoalViewFrom(view_from=here) | GoalPlace(pose=here):
            return replace(made, place=here.place)
        case GoalGap(gap_m=gap):
            return replace(made, gap_m=gap)
        case _:
            return made


def goal_pose(goal: AnyGoal, target: Target, mount: Array) -> Array:
    """T_camera_target (4, 4) at the goal, for a camera with this mount T_base_camera (4, 4); NaN where any place along a line will do.

    Raises:
        ParameterError: the goal is a line, and the target none.
    """
    match goal:
        case GoalView(T_camera_target=pose) | GoalTrack(T_camera_target=pose) | GoalLanding(above=pose):
            return pose.T
        case GoalViewFrom(view_from=here) | GoalPlace(pose=here):
            return inverse(here.T @ mount) @ target.pose.T
        case GoalGap(gap_m=gap):
            carrier = target.pose.T.copy()
            carrier[:2, 3] = 0.0  # straight ahead, the carrier turned as the vehicle is
            return inverse(mount) @ pose_on_ground(np.array([gap, 0.0, 0.0])) @ carrier
        case GoalLine() if isinstance(target, GroundLines):
            return np.full((4, 4), np.nan)
        case _:
            raise ParameterError("goal", f"of kind {goal.kind} needs a line on the floor as target")
