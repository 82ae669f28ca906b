"""The figures of one run over time: errors, twist, depth, joints; of vehicles wheels and slip; of
craft velocity, attitude, rotors.

Each function takes the run's tracks and returns a Chart, or None if the run has no such data. True
values are wide pale bands, measured or commanded values are thin lines over them: where they agree,
the line lies in its band.
"""

from __future__ import annotations

import numpy as np

from vstestbed.core.geometry import Array, adjoint, inverse
from vstestbed.core.planar import wrapped
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
    chart, t = Chart(height_in, len(labels)), tracks.t[np.isfinite(tracks.t)]
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
    modes = bool(tracks.setting.modes) and bool(np.isfinite(tracks.column("law_mode")).any())
    both, view = tracks.setting.image_errors, tracks.column("view")
    shown = [one for one in both if (tracks.column(one.column) > 0).any()] or both[:1]
    labels = [*(one.label for one in shown), *["mode"] * modes]
    chart = over_time(tracks, 3.1 + 1.6 * (len(shown) - 1) + 0.5 * modes, *labels)
    for panel, one in zip(chart.panels, shown, strict=False):
        _draw_error(panel, tracks, one)
        for i in np.flatnonzero(np.diff(view) > 0) + 1:  # the goal view changed to the next
            panel.plot([tracks.t[i]] * 2, [-np.inf, np.inf], color=INK, linewidth=0.8, alpha=0.6)
            panel.words.append(Words(tracks.t[i], np.inf, f" view {view[i] + 1:.0f}"))
    if modes:  # a strip with the mode over time, a colour for each
        panel, mode, t = chart.panels[-1], tracks.column("law_mode"), tracks.t
        panel.share, panel.ylim, panel.in_words = 0.22, (0.0, 1.0), (None, lambda _: "")
        starts = np.flatnonzero(np.diff(mode, prepend=np.nan) != 0)
        for a, b in zip(starts, [*starts[1:], len(t) - 1], strict=True):
            number = int(np.nan_to_num(mode[a]))
            word = (
                tracks.setting.modes[number]
                if number < len(tracks.setting.modes)
                else f"mode {number}"
            )
            panel.area((t[a], t[b]), (0.0, 1.0), line_color(number + 1), 0.75, word)
    return chart


def _draw_error(panel: ChartPanel, tracks: LogArrays, error: MeasuredError) -> None:
    """One error in the image over time, with its threshold."""
    value, level = tracks.column(error.column), tracks.column("level_error_px")
    tilted = error.unit == "px" and bool((level > 0).any())
    panel.log = True
    if (value > 0).any():
        panel.plot(
            tracks.t,
            value,
            color=LINE_COLORS[0],
            **({"label": "in the picture", "alpha": 0.4} if tilted else {}),
        )
    elif not tilted:
        panel.title = "no frame with a measured error"
    if tilted:
        panel.plot(tracks.t, level, color=LINE_COLORS[0], label="turned level, which counts")
    if error.threshold:
        panel.rule(
            error.threshold, **THRESHOLD, label=f"threshold {error.threshold:g} {error.unit}"
        )


def task_error(tracks: LogArrays) -> Chart | None:
    """True error of a continuing task, with its tolerance after the settling time."""
    value, band, settle = (
        tracks.column("task_error_m"),
        tracks.setting.band_m,
        tracks.setting.settle_s,
    )
    if not np.isfinite(value).any():
        return None
    chart = over_time(tracks, 3.1, "off [m]")
    (panel,) = chart.panels
    if band is not None:
        last = max(float(np.nanmax(tracks.t)), settle)
        panel.area((settle, last), (-band, band), GOAL, 0.14, f"band, {band:g} m to each side")
        later = np.abs(value[(tracks.t >= settle) & np.isfinite(value)])
        panel.title = f"at most {later.max():.3f} m off once settled" if len(later) else ""
    panel.rule(0)
    panel.plot(tracks.t, value, color=LINE_COLORS[0])
    return chart


def pose_error(tracks: LogArrays) -> Chart | None:
    """Distance and angle of the true camera (or vehicle) pose from the goal, logarithmic; None for
    a vehicle's continuing task.
    """
    errors = tracks.column("position_error_m"), np.degrees(tracks.column("rotation_error_rad"))
    if (tracks.setting.planar and tracks.setting.band_m is not None) or not np.isfinite(
        errors
    ).any():
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
            panel.plot(
                t_command,
                tracks.column(f"cmd_{part}{axis}"),
                color=color,
                linewidth=1.1,
                label=f"{part}{axis}",
            )
    return chart


def depth(tracks: LogArrays) -> Chart | None:
    """Depth of each marker as used by the law (line), and the true depth (band) if it can be
    computed.
    """
    used, true = tracks.numbered("depth"), tracks.true_depth
    if not np.isfinite(used).any():
        return None
    chart = over_time(tracks, 3.1, "depth [m]")
    (panel,) = chart.panels
    panel.least = LEAST_DEPTH * float(np.nanmedian(np.abs(used)))
    for i, color in enumerate(marker_colors(tracks.markers)):
        if true is not None:
            panel.plot(tracks.t, true[:, i], color=color, **BAND)
        panel.plot(
            tracks.t, used[:, i], color=color, label=tracks.names[i] if tracks.names else "", **LINE
        )
    return chart


def joints(tracks: LogArrays) -> Chart | None:
    """Joint positions, velocities and actuator inputs, as far as the log has them; None for a
    ground vehicle (see `wheels`).
    """
    found = {stem: names for stem in JOINT_PANELS if (names := _moving(tracks, stem))}
    if tracks.setting.planar or not found:
        return None
    every = list(dict.fromkeys(name for names in found.values() for name in names))
    chart = over_time(tracks, 0.6 + 1.45 * len(found), *(JOINT_PANELS[stem] for stem in found))
    for panel, (stem, names) in zip(chart.panels, found.items(), strict=True):
        for name in names:
            label = name if len(every) <= 16 else ""
            panel.plot(
                tracks.t,
                tracks.column(f"{stem}_{name}"),
                color=line_color(every.index(name)),
                linewidth=1.2,
                label=label,
            )
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
    flown, camera = tracks.columns("est_vx", "est_vy", "est_vz"), tracks.setting.camera
    if camera is None:
        return None
    # applied_*: the camera twist in the camera frame after the robot's limits; the mount's adjoint
    # takes it to the craft
    applied = tracks.columns(*(f"applied_{name}" for name in ("vx", "vy", "vz", "wx", "wy", "wz")))
    return _three(
        tracks, flown, applied @ adjoint(camera.mount.T).T, "ahead [m/s]", "left [m/s]", "up [m/s]"
    )


def rates(tracks: LogArrays) -> Chart | None:
    """Body rates: reference of the attitude loop (thin line) and gyro less its bias (pale band)."""
    flown, reference = (
        np.degrees(tracks.columns(*(f"{what}_{name}" for name in ("wx", "wy", "wz"))))
        for what in ("est", "ref")
    )
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
    estimated, reference, camera = (
        tracks.columns("est_roll", "est_pitch"),
        tracks.columns("ref_roll", "ref_pitch"),
        tracks.setting.camera,
    )
    if camera is None or not np.isfinite(estimated).any():
        return None
    # the world's z axis in the base frame: independent of yaw
    up = (tracks.poses("cam") @ inverse(camera.mount.T))[:, 2, :3]
    true = np.column_stack([np.arctan2(up[:, 1], up[:, 2]), -np.arcsin(np.clip(up[:, 0], -1, 1))])
    chart = over_time(tracks, 3.0, "tilt [deg]")
    (panel,) = chart.panels
    panel.rule(0)
    for i, name in enumerate(("roll", "pitch")):
        panel.plot(tracks.t, np.degrees(true[:, i]), color=line_color(i), **BAND)
        panel.plot(tracks.t, np.degrees(estimated[:, i]), color=line_color(i), label=name, **LINE)
        panel.plot(
            tracks.t, np.degrees(reference[:, i]), color=line_color(i), linestyle=":", **LINE
        )
    return chart


def rotors(tracks: LogArrays) -> Chart | None:
    """Rotor speeds with their limit (dotted); below them the wind, if there was any."""
    names, wind = tracks.named("speed"), tracks.columns("wind_x", "wind_y", "wind_z")
    if not names:
        return None
    windy = bool(np.nanmax(np.abs(wind), initial=0.0) > 0)  # without wind its columns are zero
    chart = over_time(tracks, 4.2 if windy else 2.8, "rotors [rad/s]", *["wind [m/s]"] * windy)
    # [rad/s], the limit of a rotor in models/quadrotor.xml
    chart.panels[0].rule(1000.0, linewidth=1.4, linestyle=":")
    for i, name in enumerate(names):
        chart.panels[0].plot(
            tracks.t,
            tracks.column(f"speed_{name}"),
            color=line_color(i),
            label=name.removeprefix("rotor_"),
            **LINE,
        )
    for i in range(3 * windy):
        chart.panels[1].plot(
            tracks.t, wind[:, i], color=line_color(i), label=f"wind {'xyz'[i]}", **LINE
        )
    return chart


# Of a ground vehicle: wheels, slip, localisation error.
def wheels(tracks: LogArrays) -> Chart | None:
    """Wheel speeds, measured (band) and commanded (line), and below them the steering angles."""
    # column of the measurement, label, measured and commanded: the wheels' speed, and the angle of
    # steering joints
    panels = [
        (stem, label, _joints(tracks, stem, steering), _joints(tracks, "ctrl", steering))
        for stem, steering, label in (("qd", False, "speed [rad/s]"), ("q", True, "angle [rad]"))
    ]
    panels = [panel for panel in panels if panel[2] or panel[3]]
    if not tracks.setting.planar or not panels:
        return None
    names = dict.fromkeys(
        name for _, _, measured, commanded in panels for name in (*measured, *commanded)
    )
    color = {name: line_color(i) for i, name in enumerate(names)}
    chart = over_time(tracks, 0.6 + 1.9 * len(panels), *(label for _, label, _, _ in panels))
    for name in names:  # an entry of full colour, where the first curve may be a pale band
        chart.panels[0].plot([], [], color=color[name], label=name)
    for panel, (stem, _, measured, commanded) in zip(chart.panels, panels, strict=True):
        for name in measured:
            panel.plot(tracks.t, tracks.column(f"{stem}_{name}"), color=color[name], **BAND)
        for name in commanded:
            panel.plot(tracks.t, tracks.column(f"ctrl_{name}"), color=color[name], **LINE)
    return chart


def _joints(tracks: LogArrays, stem: str, steering: bool) -> list[str]:
    """Names of the steering joints or of the wheels with values in the columns of a stem; the
    floating base (`root_`) is neither.
    """
    return [
        n for n in _moving(tracks, stem) if not n.startswith("root_") and ("steer" in n) == steering
    ]


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
