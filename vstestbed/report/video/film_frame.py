"""The state of one frame as a film shows it, from a running loop or from a log."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vstestbed.core.geometry import Array, pose_from
from vstestbed.loop.columns import POSE
from vstestbed.report.video.writer import Image
from vstestbed.scenario.scenario import Scenario
from vstestbed.tasks.frame import Frame


@dataclass(frozen=True, slots=True)
class FilmFrame:
    """State of one frame as a film shows it.

    `own`: values of the robot's and the task's own columns; `image`: the servo camera's image, if it was rendered already;
    `goal_image`: the picture taken at the goal, if law or detector compare with one.
    """

    t: float
    T_world_target: Array
    T_world_camera: Array
    q: Array
    uv: Array
    error_px: float
    lost: bool
    goal_uv: Array
    own: Array
    image: Image | None = None
    goal_image: Image | None = None

    @classmethod
    def of_frame(cls, frame: Frame) -> FilmFrame:
        """A frame of a running loop."""
        truth, error = frame.truth, frame.error
        shown = None if frame.goal.image is None else frame.goal.image.image
        scene = (truth.T_world_target, truth.T_world_camera, truth.q)
        return cls(frame.t, *scene, frame.observation.uv, error.rms_px, error.lost, frame.goal.uv, frame.row, frame.image, shown)

    @classmethod
    def of_row(cls, row: dict[str, float], scenario: Scenario) -> FilmFrame:
        """The frame of one row of a log."""
        joints, markers = scenario.robot.joints, scenario.rows
        camera, target = (np.array([row[f"{who}_{name}"] for name in POSE]) for who in ("cam", "tgt"))
        return cls(
            t=row["t"],
            T_world_target=pose_from(target[:3], target[3:]),
            T_world_camera=pose_from(camera[:3], camera[3:]),
            q=np.array([row[f"q_{name}"] for name in joints]),
            uv=np.array([[row[f"u_{i}"], row[f"v_{i}"]] for i in range(markers)]).reshape(markers, 2),
            error_px=row["error_px"],
            lost=bool(row["lost"]),
            goal_uv=np.array([[row[f"u_goal_{i}"], row[f"v_goal_{i}"]] for i in range(markers)]).reshape(markers, 2),
            own=np.array([row[name] for name in scenario.own_columns]),
        )
