"""The columns of a log, each beside the function that fills it."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array, angles, inverse, quaternion_wxyz, rotation_angle
from vstestbed.core.planar import place_of, relative
from vstestbed.scenario.scenario import Scenario
from vstestbed.tasks.frame import Frame
from vstestbed.tasks.metrics import TWIST

POSE = ("x", "y", "z", "qw", "qx", "qy", "qz")
Kept = Mapping[str, Any]  # the numbers and arrays of a frame that enter the log, by name; no picture
Stacked = Mapping[str, Array]  # the same for n frames, stacked along the first axis
Block = tuple[tuple[str, ...], Callable[[Stacked], Array]]


def kept(frame: Frame) -> Kept:
    """The numbers and arrays of a frame from which `Layout.rows` makes a row."""
    seen, truth, goal = frame.observation, frame.truth, frame.goal
    numbers = {
        "t": frame.timing.t,
        "frame": frame.timing.number,
        "lost": frame.error.lost,
        "error_px": frame.error.rms_px,
        "t_cmd": frame.timing.t_cmd,
        "scale": frame.allocation.scale * frame.command.scale,
        "uv": seen.uv,
        "depth": seen.depth,
        "p_camera": truth.p_camera,
        "T_camera": truth.T_world_camera,
        "T_target": truth.T_world_target,
        "cmd": frame.command.twist,
        "act": truth.twist,
        "applied": frame.allocation.twist,
        "goal_uv": goal.uv,
        "T_goal": goal.T_camera_target,
        "view": goal.view,
        "own": frame.row,
        "q": truth.q,
        "qd": truth.qd,
        "ctrl": truth.ctrl,
        "mode": frame.command.mode,
        "tau": truth.tau,
    }
    if frame.command.row:
        numbers["law"] = frame.command.row
    return numbers if frame.timing.own is None else numbers | dict(frame.timing.own)


class Layout:
    """The columns of a scenario's log, and how frames become rows of numbers.

    Measurements and truth (act_, q_, ctrl_, ...) are those of the exposure at t. The command cmd_ was computed from that picture and is in
    force from t_cmd on. applied_ is the twist after the robot's joint limits and singularity damping; scale is the product of the law's
    scale factor and the robot's. Of a camera without an image plane, theta and phi [rad] are the measured ray's angles from the axis and
    about it. The robot's and the task's columns follow, the number of the law's mode, time stamps and losses, and those of the exposure.
    """

    def __init__(self, scenario: Scenario):
        robot, goal = scenario.robot, scenario.goal
        self._camera, self._believed, self._rays = scenario.camera, scenario.believed_camera, len(scenario.camera.panels) > 1
        self._T_camera_base, self._planar = inverse(scenario.camera.mount.T), robot.base == "planar"
        exact = scenario.calibration.camera_exact and scenario.calibration.depth_exact
        # With a wrong calibration the law's goal is not the true one, from which errors count; along a path it is the one of its time.
        self._goal_poses = None if exact or goal.by_clock else np.array(scenario.goal_poses)
        self._of_law: tuple[str, ...] = tuple(scenario.law.columns)
        self._blocks = self._laid_out(scenario)
        self.columns: tuple[str, ...] = tuple(name for names, _ in self._blocks for name in names)
        if twice := sorted({name for name in self.columns if self.columns.count(name) > 1}):
            words = f"must have columns of their own: the log has {', '.join(twice)} twice; works: one effect of a kind, or other names"
            raise ParameterError("law.columns" if set(twice) & set(self._of_law) else "robot.effects", words)

    def _laid_out(self, scenario: Scenario) -> tuple[Block, ...]:
        """All columns in their order, which existing logs fix."""
        robot, columns = scenario.robot, scenario.timing.columns + scenario.camera.columns
        per_marker = ("u", "v", "u_true", "v_true", "u_goal", "v_goal", "depth") + (("theta", "phi") if self._rays else ())
        markers = tuple(f"{name}_{i}" for i in range(scenario.rows) for name in per_marker)
        return (
            (("t", "frame", "lost"), lambda k: np.column_stack([k["t"], k["frame"], k["lost"]])),
            (markers, self._markers),
            (("error_px",), lambda k: k["error_px"][:, None]),
            (_named("cam", POSE) + _named("tgt", POSE), lambda k: _poses(k["T_camera"], k["T_target"])),
            (("position_error_m", "rotation_error_rad"), self._pose_errors),
            (("t_cmd",), lambda k: k["t_cmd"][:, None]),
            (_named("cmd", TWIST), lambda k: k["cmd"]),
            (_named("act", TWIST), lambda k: k["act"]),
            (_named("applied", TWIST), lambda k: k["applied"]),
            (("scale",), lambda k: k["scale"][:, None]),
            (scenario.own_columns, lambda k: k["own"]),
            (_named("q", robot.joints), lambda k: k["q"]),
            (_named("qd", robot.joints), lambda k: k["qd"]),
            (_named("ctrl", robot.body.actuators if robot.body else ()), lambda k: k["ctrl"]),
            (_named("tau", robot.joints if robot.body else ()), lambda k: k["tau"]),
            *(((("law_mode",), lambda k: k["mode"][:, None]),) if scenario.law.modes else ()),
            *(((self._of_law, lambda k: k["law"]),) if self._of_law else ()),
            *(((columns, lambda k: np.column_stack([k[name] for name in columns])),) if columns else ()),
        )

    def rows(self, frames: Sequence[Kept]) -> Array:
        """Frames as numbers, shape (len(frames), columns); the same numbers for one at a time and for many at once."""
        unknown = {"law": (np.nan,) * len(self._of_law)}
        names = {**frames[0], **(unknown if self._of_law else {})}
        stacked = {name: np.array([frame[name] if name in frame else unknown[name] for frame in frames]) for name in names}
        return np.concatenate([values(stacked) for _, values in self._blocks], axis=1)

    def _markers(self, k: Stacked) -> Array:
        markers = [k["uv"], self._camera.project(k["p_camera"]), k["goal_uv"], k["depth"][..., None]]
        if self._rays:
            markers.append(angles(self._believed.ray(k["uv"])))
        return np.concatenate(markers, axis=-1).reshape(len(k["t"]), -1)

    def _pose_errors(self, k: Stacked) -> Array:
        """Distance [m] and angle [rad] of the camera, or of a vehicle on the floor, from the goal pose, (n, 2)."""
        T_camera_target = k["T_goal"] if self._goal_poses is None else self._goal_poses[k["view"].astype(int)]
        T_camera, T_goal = k["T_camera"], k["T_target"] @ inverse(T_camera_target)
        if self._planar:
            step = relative(place_of(T_goal @ self._T_camera_base), place_of(T_camera @ self._T_camera_base))
            return np.column_stack([np.hypot(step[:, 0], step[:, 1]), np.abs(step[:, 2])])
        angle = rotation_angle(T_camera[:, :3, :3].mT @ T_goal[:, :3, :3])
        return np.column_stack([np.linalg.norm(T_camera[:, :3, 3] - T_goal[:, :3, 3], axis=1), angle])


@dataclass(frozen=True)
class ColumnText:
    """What a column of the log is. name: a regular expression for the names of such columns; shown: how a page writes them."""

    name: str
    unit: str
    words: str
    shown: str = ""


_N = r"\d+"
_AXIS = r"v[xyz]|w[xyz]"
TEXTS: tuple[ColumnText, ...] = (
    ColumnText("t", "s", "time of the exposure (of its middle) since the start; measurements and truth of a row are those of this time"),
    ColumnText("frame", "", "number of the picture; numbers that are missing are pictures that were lost or refused"),
    ColumnText("lost", "", "1 where too few markers were seen"),
    ColumnText(f"[uv]_{_N}", "px", "measured image coordinates of marker N; NaN where it was not seen", "u_N, v_N"),
    ColumnText(f"[uv]_true_{_N}", "px", "true image coordinates of marker N, by the true camera and its true pose", "u_true_N, v_true_N"),
    ColumnText(f"[uv]_goal_{_N}", "px", "image coordinates of marker N in the goal view", "u_goal_N, v_goal_N"),
    ColumnText(f"depth_{_N}", "m", "depth of marker N that the law used (`law.depth`)", "depth_N"),
    ColumnText(f"(theta|phi)_{_N}", "rad", "angles of the measured ray from the optical axis, and about it", "theta_N, phi_N"),
    ColumnText("error_px", "px", "RMS of the measured image error over the coordinates seen; NaN where none are"),
    ColumnText("(cam|tgt)_[xyz]", "m", "true position of the camera, and of the target, in the world", "cam_x, ..., tgt_z"),
    ColumnText("(cam|tgt)_q[wxyz]", "", "true orientation of the camera, and of the target, as a quaternion wxyz", "cam_qw, ..., tgt_qz"),
    ColumnText("position_error_m", "m", "true distance of the camera (of a vehicle, on the floor) from its goal pose"),
    ColumnText("rotation_error_rad", "rad", "true angle between the camera (a vehicle's heading) and its goal pose"),
    ColumnText("t_cmd", "s", "from when the command of this row is in force: its picture's arrival and the latency of commands"),
    ColumnText(f"cmd_({_AXIS})", "m/s, rad/s", "twist that the law commands, in the camera frame", "cmd_vx, ..., cmd_wz"),
    ColumnText(f"act_({_AXIS})", "m/s, rad/s", "true twist of the camera, in the camera frame", "act_vx, ..., act_wz"),
    ColumnText(
        f"applied_({_AXIS})",
        "m/s, rad/s",
        "twist ordered after the robot's limits and damping",
        "applied_vx, ..., applied_wz",
    ),
    ColumnText("scale", "", "product of the factors by which the law's limits and the robot's shortened the command; 1: not at all"),
    ColumnText("supervisor", "", "0 follows the law, 1 holds, 2 stops (a craft: sinks), 3 rotors off"),
    ColumnText("view", "", "number of the current goal view, of a goal with several"),
    ColumnText("error_grey", "grey levels", "RMS difference between picture and goal picture, with the law's weights"),
    ColumnText("level_error_px", "px", "as `error_px`, after derotation, of a craft that tilts: the error that decides its task"),
    ColumnText("est_position_m", "m", "distance from the goal pose as the robot estimates it"),
    ColumnText("est_rotation_rad", "rad", "angle from the goal pose as the robot estimates it"),
    ColumnText("task_error_m", "m", "true error of the task: of a continuing one its distance, of a landing that from the pad's centre"),
    ColumnText("touch_mps", "m/s", "speed downwards at the first contact of a landing; NaN before"),
    ColumnText("(base|est|odo)_[xy]", "m", "place of a vehicle: true, estimated, and by its encoders alone", "base_x, est_y, odo_x, ..."),
    ColumnText("(base|est|odo)_heading", "rad", "heading of a vehicle: true, estimated, and by its encoders alone", "base_heading, ..."),
    ColumnText("slip_mps", "m/s", "rate at which a vehicle's odometry and its true motion diverge"),
    ColumnText("slip_radps", "rad/s", "rate at which a vehicle's odometry and its true turn diverge"),
    ColumnText(
        "(est|ref)_(roll|pitch)",
        "rad",
        "attitude of a craft: estimate, and reference of the velocity loop",
        "est_roll, ref_roll, ...",
    ),
    ColumnText("est_v[xyz]", "m/s", "velocity of a craft in the level frame, its estimate", "est_vx, ..., est_vz"),
    ColumnText(
        "(est|ref)_w[xyz]",
        "rad/s",
        "rates of a craft's body: estimate, and reference of the attitude loop",
        "est_wx, ref_wx, ...",
    ),
    ColumnText("wind_[xyz]", "m/s", "true velocity of the air in the world", "wind_x, ..., wind_z"),
    ColumnText("speed_rotor_.*", "rad/s", "true speed of a rotor", "speed_rotor_NAME"),
    ColumnText("battery_v", "V", "voltage of the battery as measured"),
    ColumnText("q_.*", "rad, m", "true position of a joint", "q_NAME"),
    ColumnText("qd_.*", "rad/s, m/s", "true velocity of a joint", "qd_NAME"),
    ColumnText("ctrl_.*", "of the actuator", "control of an actuator, as the robot's model has it", "ctrl_NAME"),
    ColumnText("tau_.*", "Nm, N", "torque (force) of the actuators at a joint, true", "tau_NAME"),
    ColumnText("law_mode", "", "number of the word in the law's `modes` for what it did"),
    ColumnText("t_stamp", "s", "time of the exposure by the picture's stamp, which the controller believes"),
    ColumnText("refused", "", "how many pictures have been refused so far, because a later one had arrived"),
    ColumnText("command_lost", "", "1 where this frame's command was lost on its way to the robot"),
    ColumnText("exposure_s", "s", "exposure time of the picture, as the camera's automatic set it"),
    ColumnText("gain", "", "gain of the picture, as the camera's automatic set it"),
)
"""What the columns of the log are; a column of an effect or a law of one's own is described there."""


def text_of(name: str) -> ColumnText | None:
    """What a column of the log is; None of one that an effect or a law has added."""
    return next((text for text in TEXTS if re.fullmatch(text.name, name)), None)


def _named(prefix: str, names: Sequence[str]) -> tuple[str, ...]:
    return tuple(f"{prefix}_{name}" for name in names)


def _poses(*T: Array) -> Array:
    """Position and quaternion of poses (n, 4, 4) side by side, from one call for all: of few frames it is the call that takes the time."""
    together = np.concatenate(T)
    rows = np.concatenate([together[:, :3, 3], quaternion_wxyz(together[:, :3, :3])], axis=1)
    return np.concatenate(np.split(rows, len(T)), axis=1)
