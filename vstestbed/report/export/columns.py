"""What the columns of a log are: their units, and who knows them."""

from __future__ import annotations

import re
from typing import Literal, NamedTuple

from vstestbed.scenario.scenario import Scenario

Whose = Literal["clock", "measured", "command", "truth", "own"]
"""`clock`: times and counters; `measured`: what camera and robot know; `command`: what they command; `truth`: the simulator's alone;
`own`: of the robot's kind or the task."""


class Meaning(NamedTuple):
    """Of a column: its unit ("" for numbers without one), who knows it, and in words."""

    unit: str
    whose: Whose
    words: str


_PATTERNS: tuple[tuple[str, Meaning], ...] = (
    ("t", Meaning("s", "clock", "middle of the exposure")),
    ("frame", Meaning("", "clock", "number of the picture; one that never arrived has no row")),
    ("lost", Meaning("", "measured", "too few markers are measured")),
    (r"[uv]_\d+", Meaning("px", "measured", "marker as measured; the middle of the first pixel is 0")),
    (r"[uv]_true_\d+", Meaning("px", "truth", "marker in the true lens")),
    (r"[uv]_goal_\d+", Meaning("px", "command", "marker at the goal")),
    (r"depth_\d+", Meaning("m", "measured", "depth as the law assumes it")),
    (r"(theta|phi)_\d+", Meaning("rad", "measured", "angle of a marker's ray from the axis, about it")),
    ("error_px", Meaning("px", "measured", "RMS distance of the markers from the goal")),
    (r"(cam|tgt)_[xyz]", Meaning("m", "truth", "place of camera or target in the world")),
    (r"(cam|tgt)_q[wxyz]", Meaning("", "truth", "its orientation, as a quaternion")),
    ("position_error_m", Meaning("m", "truth", "distance from the goal pose")),
    ("rotation_error_rad", Meaning("rad", "truth", "angle from the goal pose")),
    ("t_cmd", Meaning("s", "clock", "the command of this row is in force from then on")),
    ("t_stamp", Meaning("s", "measured", "time stamp of the picture, by the camera's clock")),
    ("refused", Meaning("", "clock", "number of pictures refused so far, older than one that was used")),
    ("command_lost", Meaning("", "clock", "1: the link lost the command of this row")),
    ("exposure_s", Meaning("s", "measured", "exposure time of the picture, as the camera reports it")),
    ("gain", Meaning("", "measured", "gain of its sensor's amplifier")),
    (r"cmd_v[xyz]", Meaning("m/s", "command", "commanded camera twist, camera axes")),
    (r"cmd_w[xyz]", Meaning("rad/s", "command", "commanded camera twist, camera axes")),
    (r"applied_v[xyz]", Meaning("m/s", "command", "the same within the robot's limits")),
    (r"applied_w[xyz]", Meaning("rad/s", "command", "the same within the robot's limits")),
    (r"act_v[xyz]", Meaning("m/s", "truth", "camera twist, camera axes")),
    (r"act_w[xyz]", Meaning("rad/s", "truth", "camera twist, camera axes")),
    ("scale", Meaning("", "command", "factor by which limits shorten the command")),
    (r"ctrl_.*", Meaning("", "command", "control of an actuator, in its own unit")),
    ("supervisor", Meaning("", "command", "0 follows the law, 1 holds, 2 and more: see the robot")),
    ("view", Meaning("", "command", "number of the goal view")),
    (r"base_[xy]", Meaning("m", "truth", "place of the vehicle")),
    ("base_heading", Meaning("rad", "truth", "heading of the vehicle")),
    (r"est_[xy]|est_position_m", Meaning("m", "measured", "by the robot's own estimate")),
    (r"est_(heading|roll|pitch|rotation_rad)", Meaning("rad", "measured", "by the robot's own estimate")),
    (r"est_v[xyz]", Meaning("m/s", "measured", "velocity in the level frame, by the robot's own estimate")),
    (r"est_w[xyz]", Meaning("rad/s", "measured", "body rate by the robot's own estimate")),
    (r"odo_[xy]", Meaning("m", "measured", "dead reckoning from the true start")),
    ("odo_heading", Meaning("rad", "measured", "dead reckoning from the true start")),
    ("slip_mps", Meaning("m/s", "truth", "rate at which odometry and truth diverge")),
    ("slip_radps", Meaning("rad/s", "truth", "rate at which odometry and truth diverge")),
    (r"ref_(roll|pitch)", Meaning("rad", "command", "reference of the velocity loop")),
    (r"ref_w[xyz]", Meaning("rad/s", "command", "reference of the attitude loop")),
    (r"wind_[xyz]", Meaning("m/s", "truth", "velocity of the air in the world")),
    (r"speed_.*", Meaning("rad/s", "truth", "speed of a rotor")),
    ("task_error_m", Meaning("m", "truth", "distance from where the task wants the robot now")),
    ("touch_mps", Meaning("m/s", "truth", "speed of the touch-down")),
    ("error_grey", Meaning("grey levels", "measured", "RMS difference of picture and goal picture, with the law's weights")),
    ("level_error_px", Meaning("px", "measured", "error of the markers after derotation")),
)
_SUFFIXES = {"px": "px", "m": "m", "mm": "mm", "rad": "rad", "deg": "deg", "s": "s", "mps": "m/s", "radps": "rad/s", "n": "N", "nm": "Nm"}
"""Unit by the last part of a name, for columns of plugins."""
IN_NAMES = {"m/s": "mps", "rad/s": "radps", "grey levels": "grey"}
"""Units as parts of names."""


def meaning(column: str, scenario: Scenario) -> Meaning:
    """What a column of a scenario's log is."""
    kind, _, joint = column.partition("_")
    if kind in ("q", "qd") and joint in scenario.robot.joints:
        unit = unit_of_joint(joint, scenario) + ("/s" if kind == "qd" else "")
        return Meaning(unit, "truth", "velocity of a joint" if kind == "qd" else "position of a joint")
    for pattern, found in _PATTERNS:
        if re.fullmatch(pattern, column):
            return found
    return Meaning(_SUFFIXES.get(column.rpartition("_")[2], ""), "own", "of the robot's kind, or of the task")


def unit_of_joint(joint: str, scenario: Scenario) -> str:
    """rad, or m for a joint that slides."""
    chain = getattr(scenario.robot, "chain", None)  # of an arm read from a file
    slides = () if chain is None else [name for name, slide in zip(chain.names, chain.slides, strict=True) if slide]
    return "m" if joint in (*slides, "root_x", "root_y") else "rad"


def name_with_unit(name: str, unit: str) -> str:
    """A name that ends with its unit, of letters, digits and underscores alone, and no digit first: `vx_mps`."""
    word = IN_NAMES.get(unit, unit)
    plain = re.sub(r"^(?=\d)|\W", "_", name)
    return plain if not word or plain.endswith(f"_{word}") else f"{plain}_{word}"
