"""The figures of one run over time: errors, twist, depth, joints; of vehicles wheels and slip; of
craft velocity, attitude, rotors.

Each function takes the run's tracks and returns a Chart, or None if the run has no such data. True
values are wide pale bands, measured or commanded values are thin lines over them: where they agree,
the line lies in its band.
"""

from __future__ import annotations

from itertools import chain, pairwise

import numpy as np

from vstestbed.core.geometry import Array, adjoint, inverse
from vstestbed.core.planar import wrapped
from vstestbed.loop.columns import TWIST
from vstestbed.report.chart import Chart, ChartPanel, Words
from vstestbed.report.marks import (
    AXIS_COLORS,
    BAND,
    GOAL,
    INK,
    LINE,
    LINE_COLORS,
    LOST,
    THRESHOLD,
    TIME,
    Look,
    line_color,
    marker_colors,
)
from vstestbed.report.run.tracks import LogArrays, MeasuredError

LEAST_TWIST, LEAST_DEPTH = 2e-3, 0.02
"""Least span of the axis of twists [distances at the goal/s, rad/s] and of depths (relative to the
depth): below it there is only noise.
"""
JOINT_PANELS = {
    "q": "position [rad, m]",
    "qd": "velocity [rad/s, m/s]",
    "ctrl": "input [own unit]",
    "tau": "torque [Nm, N]",
}
MOST_OWN = 8  # panels of columns of one's own
ESTIMATES = (("est", "as estimated", LINE_COLORS[1]), ("odo", "by odometry alone", LINE_COLORS[3]))
"""Where a vehicle believes to be: columns, words, colour."""


def over_time(tracks: LogArrays, height_in: float, *labels: str) -> Chart:
    """A chart with a panel for each label over the time of the log; the intervals in which the
    target was lost are shaded.
    """
    chart = Chart(height_in, len(labels))
    t = tracks.t[np.isfinite(tracks.t)]
    for panel, label in zip(chart.panels, labels, strict=True):
        panel.labels = TIME, label
        if len(t) and t[-1] > t[0]:
            panel.xlim = float(t[0]), float(t[-1])
        for start, end in tracks.lost_intervals():
            panel.area((start, end), (-np.inf, np.inf), LOST, 0.16, "target lost")
    return chart


def error(tracks: LogArrays) -> Chart:
    """RMS image error over time, logarithmic, with threshold and intervals without target; a panel
    for each unit in the log.

    Of a tilted craft also the error of the image rotated into its level frame, which decides
    convergence. Below, the law's mode.
    """
    both = tracks.setting.image_errors
    shown = [one for one in both if (tracks.column(one.column) > 0).any()] or both[:1]
    labels = [one.label for one in shown]
    height_in = 1.5 + 1.6 * len(shown)
    modes = tracks.setting.modes and np.isfinite(tracks.column("law_mode")).any()
    if modes:
        labels.append("mode")
        height_in += 0.5
    chart = over_time(tracks, height_in, *labels)
    for panel, one in zip(chart.panels, shown, strict=False):
        _draw_error(panel, tracks, one)
    if modes:
        _draw_modes(chart.panels[-1], tracks)
    return chart


def _draw_modes(panel: ChartPanel, tracks: LogArrays) -> None:
    """A strip with the law's mode over time, a colour for each."""
    mode = tracks.column("law_mode")
    words = tracks.setting.modes
    panel.share = 0.22
    panel.ylim = (0.0, 1.0)
    panel.in_words = (None, lambda _: "")
    starts = np.flatnonzero(np.diff(mode, prepend=np.nan) != 0).tolist()
    for a, b in pairwise([*starts, len(mode) - 1]):
        number = int(np.nan_to_num(mode[a]))
        word = words[number] if number < len(words) else f"mode {number}"
        span = tracks.t[a], tracks.t[b]
        panel.area(span, (0.0, 1.0), line_color(number + 1), 0.75, word)


def _draw_error(panel: ChartPanel, tracks: LogArrays, error: MeasuredError) -> None:
    """One error in the image over time, with its threshold, and where the goal view changed to the
    next.
    """
    t = tracks.t
    value = tracks.column(error.column)
    level = tracks.column("level_error_px")
    look: Look = {"color": LINE_COLORS[0]}
    panel.log = True
    if error.unit == "px" and (level > 0).any():
        if (value > 0).any():
            panel.plot(t, value, label="in the picture", alpha=0.4, **look)
        panel.plot(t, level, label="turned level, which counts", **look)
    elif (value > 0).any():
        panel.plot(t, value, **look)
    else:
        panel.title = "no frame with a measured error"
    if error.threshold:
        words = f"threshold {error.threshold:g} {error.unit}"
        panel.rule(error.threshold, **THRESHOLD, label=words)
    view = tracks.column("view")
    for i in np.flatnonzero(np.diff(view) > 0) + 1:
        panel.plot([t[i], t[i]], [-np.inf, np.inf], color=INK, linewidth=0.8, alpha=0.6)
        panel.words.append(Words(t[i], np.inf, f" view {view[i] + 1:.0f}"))


def task_error(tracks: LogArrays) -> Chart | None:
    """True error of a continuing task, with its tolerance after the settling time."""
    value = tracks.column("task_error_m")
    band = tracks.setting.band_m
    settle = tracks.setting.settle_s
    if not np.isfinite(value).any():
        return None
    chart = over_time(tracks, 3.1, "off [m]")
    (panel,) = chart.panels
    if band is not None:
        last = max(float(np.nanmax(tracks.t)), settle)
        panel.area((settle, last), (-band, band), GOAL, 0.14, f"band, {band:g} m to each side")
        later = np.abs(value[(tracks.t >= settle) & np.isfinite(value)])
        if len(later):
            panel.title = f"at most {later.max():.3f} m off once settled"
    panel.rule(0)
    panel.plot(tracks.t, value, color=LINE_COLORS[0])
    return chart


def pose_error(tracks: LogArrays) -> Chart | None:
    """Distance and angle of the true camera (or vehicle) pose from the goal, logarithmic; None for
    a vehicle's continuing task.
    """
    setting = tracks.setting
    errors = tracks.column("position_error_m"), np.degrees(tracks.column("rotation_error_rad"))
    if setting.planar and setting.band_m is not None:
        return None
    if not np.isfinite(errors).any():
        return None
    chart = over_time(tracks, 3.9, "position [m]", "rotation [deg]")
    for i, (panel, value) in enumerate(zip(chart.panels, errors, strict=True)):
        panel.plot(tracks.t, value, color=line_color(i))
        panel.log = True
    return chart


def twist(tracks: LogArrays) -> Chart:
    """The camera's twist in its own frame: commanded (line) and true (band), translation above,
    rotation below.
    """
    chart = over_time(tracks, 4.3, "translation [m/s]", "rotation [rad/s]")
    t_command = tracks.column("t_cmd")  # a command takes effect when its image has arrived
    goal = tracks.setting.T_camera_target
    reach = 1.0 if goal is None else float(np.linalg.norm(goal[:3, 3]))
    for panel, part, colors in zip(
        chart.panels, "vw", (AXIS_COLORS, LINE_COLORS[3:6]), strict=True
    ):
        panel.rule(0)
        panel.least = LEAST_TWIST * (reach if part == "v" else 1)
        for axis, color in zip("xyz", colors, strict=True):
            panel.plot(tracks.t, tracks.column(f"act_{part}{axis}"), color=color, **BAND)
            commanded = tracks.column(f"cmd_{part}{axis}")
            panel.plot(t_command, commanded, color=color, linewidth=1.1, label=f"{part}{axis}")
    return chart


def depth(tracks: LogArrays) -> Chart | None:
    """Depth of each marker as used by the law (line), and the true depth (band) if it can be
    computed.
    """
    used = tracks.numbered("depth")
    true = tracks.true_depth
    names = tracks.names or [""] * tracks.markers
    if not np.isfinite(used).any():
        return None
    chart = over_time(tracks, 3.1, "depth [m]")
    (panel,) = chart.panels
    panel.least = LEAST_DEPTH * float(np.nanmedian(np.abs(used)))
    for i, color in enumerate(marker_colors(tracks.markers)):
        if true is not None:
            panel.plot(tracks.t, true[:, i], color=color, **BAND)
        panel.plot(tracks.t, used[:, i], color=color, label=names[i], **LINE)
    return chart


def joints(tracks: LogArrays) -> Chart | None:
    """Joint positions, velocities and actuator inputs, as far as the log has them; None for a
    ground vehicle (see `wheels`).
    """
    with_values = {stem: _moving(tracks, stem) for stem in JOINT_PANELS}
    found = {stem: names for stem, names in with_values.items() if names}
    if tracks.setting.planar or not found:
        return None
    every = list(dict.fromkeys(chain.from_iterable(found.values())))
    labels = every if len(every) <= 16 else [""] * len(every)
    chart = over_time(tracks, 0.6 + 1.45 * len(found), *(JOINT_PANELS[stem] for stem in found))
    for panel, (stem, names) in zip(chart.panels, found.items(), strict=True):
        for name in names:
            i = every.index(name)
            look: Look = {"color": line_color(i), "linewidth": 1.2, "label": labels[i]}
            panel.plot(tracks.t, tracks.column(f"{stem}_{name}"), **look)
    return chart


def own_columns(tracks: LogArrays) -> Chart | None:
    """The first columns of the law's own and of the effects', by their names,
    which tell the unit.
    """
    known = [name for name in tracks.setting.own if np.isfinite(tracks.column(name)).any()]
    names = known[:MOST_OWN]
    if not names:
        return None
    chart = over_time(tracks, 0.9 + 1.5 * len(names), *names)
    for i, (panel, name) in enumerate(zip(chart.panels, names, strict=True)):
        panel.plot(tracks.t, tracks.column(name), color=line_color(i), **LINE)
    return chart


def _moving(tracks: LogArrays, stem: str) -> list[str]:
    """The names of a stem whose columns hold values."""
    return [n for n in tracks.named(stem) if np.isfinite(tracks.column(f"{stem}_{n}")).any()]


# Of a quadrotor: velocity, attitude and body rates with their references; rotors, wind.
def velocity(tracks: LogArrays) -> Chart | None:
    """Velocity in the level frame: commanded (thin line) and estimated by the craft (pale band)."""
    flown = tracks.columns("est_vx", "est_vy", "est_vz")
    camera = tracks.setting.camera
    if camera is None:
        return None
    # applied_*: the camera twist in the camera frame after the robot's limits; the mount's adjoint
    # takes it to the craft
    applied = tracks.columns(*(f"applied_{name}" for name in TWIST))
    reference = applied @ adjoint(camera.mount.T).T
    return _three(tracks, flown, reference, "ahead [m/s]", "left [m/s]", "up [m/s]")


def rates(tracks: LogArrays) -> Chart | None:
    """Body rates: reference of the attitude loop (thin line) and gyro less its bias (pale band)."""
    flown = np.degrees(tracks.columns("est_wx", "est_wy", "est_wz"))
    reference = np.degrees(tracks.columns("ref_wx", "ref_wy", "ref_wz"))
    return _three(tracks, flown, reference, "roll [deg/s]", "pitch [deg/s]", "yaw [deg/s]")


def _three(tracks: LogArrays, measured: Array, reference: Array, *labels: str) -> Chart | None:
    """Three panels with a column each of what was measured (pale band) and its reference (thin
    line), both (T, 3).
    """
    if not np.isfinite(measured).any():
        return None
    chart = over_time(tracks, 4.4, *labels)
    for i, panel in enumerate(chart.panels):
        panel.rule(0)
        panel.plot(tracks.t, measured[:, i], color=line_color(i), **BAND)
        panel.plot(tracks.t, reference[:, i], color=line_color(i), **LINE)
    return chart


def tilt(tracks: LogArrays) -> Chart | None:
    """Roll and pitch: true (pale band), estimated by the craft (thin line), and the reference of
    its velocity loop (dotted).
    """
    estimated = tracks.columns("est_roll", "est_pitch")
    reference = tracks.columns("ref_roll", "ref_pitch")
    camera = tracks.setting.camera
    if camera is None or not np.isfinite(estimated).any():
        return None
    # the world's z axis in the base frame: independent of yaw
    up = (tracks.poses("cam") @ inverse(camera.mount.T))[:, 2, :3]
    true = np.column_stack([np.arctan2(up[:, 1], up[:, 2]), -np.arcsin(np.clip(up[:, 0], -1, 1))])
    chart = over_time(tracks, 3.0, "tilt [deg]")
    (panel,) = chart.panels
    panel.rule(0)
    t = tracks.t
    for i, name in enumerate(("roll", "pitch")):
        color = line_color(i)
        panel.plot(t, np.degrees(true[:, i]), color=color, **BAND)
        panel.plot(t, np.degrees(estimated[:, i]), color=color, label=name, **LINE)
        panel.plot(t, np.degrees(reference[:, i]), color=color, linestyle=":", **LINE)
    return chart


def rotors(tracks: LogArrays) -> Chart | None:
    """Rotor speeds with their limit (dotted); below them the wind, if there was any."""
    names = tracks.named("speed")
    wind = tracks.columns("wind_x", "wind_y", "wind_z")
    if not names:
        return None
    labels = ["rotors [rad/s]"]
    height_in = 2.8
    if np.nanmax(np.abs(wind), initial=0.0) > 0:  # without wind its columns are zero
        labels.append("wind [m/s]")
        height_in = 4.2
    chart = over_time(tracks, height_in, *labels)
    speeds, *of_wind = chart.panels
    # [rad/s], the limit of a rotor in models/quadrotor.xml
    speeds.rule(1000.0, linewidth=1.4, linestyle=":")
    for i, name in enumerate(names):
        look: Look = {"color": line_color(i), "label": name.removeprefix("rotor_")}
        speeds.plot(tracks.t, tracks.column(f"speed_{name}"), **look, **LINE)
    for panel in of_wind:
        for i, axis in enumerate("xyz"):
            panel.plot(tracks.t, wind[:, i], color=line_color(i), label=f"wind {axis}", **LINE)
    return chart


# Of a ground vehicle: wheels, slip, localisation error.
def wheels(tracks: LogArrays) -> Chart | None:
    """Wheel speeds, measured (band) and commanded (line), and below them the steering angles."""
    panels = _wheel_panels(tracks)
    if not tracks.setting.planar or not panels:
        return None
    names = [*dict.fromkeys(name for _, of_joints in panels for _, name, _ in of_joints)]
    chart = over_time(tracks, 0.6 + 1.9 * len(panels), *(label for label, _ in panels))
    for i, name in enumerate(names):  # of full colour, where the first curve may be a pale band
        chart.panels[0].plot([], [], color=line_color(i), label=name)
    for panel, (_, of_joints) in zip(chart.panels, panels, strict=True):
        for stem, name, look in of_joints:
            color = line_color(names.index(name))
            panel.plot(tracks.t, tracks.column(f"{stem}_{name}"), color=color, **look)
    return chart


def _wheel_panels(tracks: LogArrays) -> list[tuple[str, list[tuple[str, str, Look]]]]:
    """The speed of the wheels, and the angle of the steering joints, as far as the log has them:
    label of a panel, and of its curves stem and joint of the column, and look.
    """
    found = []
    for stem, steering, label in (("qd", False, "speed [rad/s]"), ("q", True, "angle [rad]")):
        measured = [(stem, name, BAND) for name in _joints(tracks, stem, steering)]
        commanded = [("ctrl", name, LINE) for name in _joints(tracks, "ctrl", steering)]
        if measured or commanded:
            found.append((label, measured + commanded))
    return found


def _joints(tracks: LogArrays, stem: str, steering: bool) -> list[str]:
    """Names of the steering joints or of the wheels with values in the columns of a stem; the
    floating base (`root_`) is neither.
    """
    joints = [name for name in _moving(tracks, stem) if not name.startswith("root_")]
    return [name for name in joints if ("steer" in name) == steering]


def localisation_error(tracks: LogArrays) -> Chart | None:
    """Localisation error in position and heading: of the estimate with landmarks, and of odometry
    alone.
    """
    true = tracks.planar_poses("base")
    errors = [(tracks.planar_poses(stem) - true, label, color) for stem, label, color in ESTIMATES]
    errors = [found for found in errors if np.isfinite(found[0]).any()]
    if not tracks.setting.planar or not errors:
        return None
    chart = over_time(tracks, 3.9, "position [m]", "heading [deg]")
    upper, lower = chart.panels
    upper.lowest = 0  # a distance
    for error, label, color in errors:
        upper.plot(tracks.t, np.hypot(error[:, 0], error[:, 1]), color=color, label=label)
        lower.plot(tracks.t, np.degrees(wrapped(error[:, 2])), color=color)
    lower.rule(0)
    return chart


def slip(tracks: LogArrays) -> Chart | None:
    """Slip speed and, below, slip in yaw: motion over the floor that the encoders do not measure;
    older logs lack the latter.
    """
    # column, factor to the unit of the label, least span of the axis in that unit, label
    rows = (
        ("slip_mps", 1e3, 1.0, "slip [mm/s]"),
        ("slip_radps", 180 / np.pi, 0.1, "in yaw [deg/s]"),
    )
    panels = [(tracks.column(name) * factor, least, label) for name, factor, least, label in rows]
    panels = [panel for panel in panels if np.isfinite(panel[0]).any()]
    if not panels:
        return None
    chart = over_time(tracks, 0.9 + 1.7 * len(panels), *(label for _, _, label in panels))
    for panel, (value, least, _) in zip(chart.panels, panels, strict=True):
        panel.plot(tracks.t, value, color=LINE_COLORS[0], **LINE)
        panel.least, panel.lowest = least, 0
    return chart
