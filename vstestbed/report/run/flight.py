"""Figures over time of a quadrotor: velocity, attitude and body rates with their references; rotors, wind."""

from __future__ import annotations

import numpy as np

from vstestbed.core.geometry import Array, adjoint, inverse
from vstestbed.report.html.canvas import LINE_COLORS
from vstestbed.report.html.chart import Chart
from vstestbed.report.run.figures import BAND, over_time
from vstestbed.report.run.tracks import Tracks

AXES = ("ahead", "left", "up")
LIMIT_RADPS = 1000.0
"""Speed limit of a rotor [rad/s], from models/quadrotor.xml."""


def velocity(tracks: Tracks) -> Chart | None:
    """Velocity in the level frame: commanded (thin line) and estimated by the craft (pale band)."""
    flown, camera = tracks.columns("est_vx", "est_vy", "est_vz"), tracks.setting.camera
    if camera is None or not np.isfinite(flown).any():
        return None
    # applied_*: the camera twist in the camera frame after the robot's limits; the mount's adjoint takes it to the craft
    applied = tracks.columns(*(f"applied_{name}" for name in ("vx", "vy", "vz", "wx", "wy", "wz")))
    commanded = applied @ adjoint(camera.mount.T).T
    chart = Chart(4.4, 3)
    for i, panel in enumerate(chart.panels):
        panel.rule(0)
        panel.plot(tracks.t, flown[:, i], color=LINE_COLORS[i], **BAND)
        panel.plot(tracks.t, commanded[:, i], color=LINE_COLORS[i], linewidth=1.0)
        panel.labels = "", f"{AXES[i]} [m/s]"
    over_time(chart, tracks)
    return chart


def tilt(tracks: Tracks) -> Chart | None:
    """Roll and pitch: true (pale band), estimated by the craft (thin line), and the reference of its velocity loop (dotted)."""
    estimated, reference, camera = tracks.columns("est_roll", "est_pitch"), tracks.columns("ref_roll", "ref_pitch"), tracks.setting.camera
    if camera is None or not np.isfinite(estimated).any():
        return None
    true = _tilt_of(tracks.poses("cam") @ inverse(camera.mount.T))
    chart = Chart(3.0)
    (panel,) = chart.panels
    panel.rule(0)
    for i, name in enumerate(("roll", "pitch")):
        panel.plot(tracks.t, np.degrees(true[:, i]), color=LINE_COLORS[i], **BAND)
        panel.plot(tracks.t, np.degrees(estimated[:, i]), color=LINE_COLORS[i], linewidth=1.0, label=name)
        panel.plot(tracks.t, np.degrees(reference[:, i]), color=LINE_COLORS[i], linewidth=1.0, linestyle=":")
    panel.labels = "", "tilt [deg]"
    over_time(chart, tracks)
    return chart


def rates(tracks: Tracks) -> Chart | None:
    """Body rates: reference of the attitude loop (thin line) and gyro less its bias (pale band)."""
    flown, reference = (tracks.columns(*(f"{what}_{name}" for name in ("wx", "wy", "wz"))) for what in ("est", "ref"))
    if not np.isfinite(flown).any():
        return None
    chart = Chart(4.4, 3)
    for i, panel in enumerate(chart.panels):
        panel.rule(0)
        panel.plot(tracks.t, np.degrees(flown[:, i]), color=LINE_COLORS[i], **BAND)
        panel.plot(tracks.t, np.degrees(reference[:, i]), color=LINE_COLORS[i], linewidth=1.0)
        panel.labels = "", f"{('roll', 'pitch', 'yaw')[i]} [deg/s]"
    over_time(chart, tracks)
    return chart


def _tilt_of(T_world_base: Array) -> Array:
    """Roll and pitch (n, 2) [rad] of poses (n, 4, 4)."""
    up = T_world_base[:, 2, :3]  # the world's z axis in the base frame: independent of yaw
    return np.column_stack([np.arctan2(up[:, 1], up[:, 2]), -np.arcsin(np.clip(up[:, 0], -1, 1))])


def rotors(tracks: Tracks) -> Chart | None:
    """Rotor speeds with their limit (dotted); below them the wind, if there was any."""
    names = tracks.named("speed")
    if not names:
        return None
    wind = tracks.columns("wind_x", "wind_y", "wind_z")
    windy = bool(np.nanmax(np.abs(wind), initial=0.0) > 0)  # without wind its columns are zero
    chart = Chart(4.2 if windy else 2.8, 2 if windy else 1)
    for i, name in enumerate(names):
        speed, label = tracks.column(f"speed_{name}"), name.removeprefix("rotor_")
        chart.panels[0].plot(tracks.t, speed, color=LINE_COLORS[i], linewidth=1.0, label=label)
    chart.panels[0].rule(LIMIT_RADPS, linewidth=1.4, linestyle=":")
    chart.panels[0].labels = "", "rotors [rad/s]"
    for i in range(3) if windy else ():
        chart.panels[1].plot(tracks.t, wind[:, i], color=LINE_COLORS[i], linewidth=1.0, label=f"wind {'xyz'[i]}")
        chart.panels[1].labels = "", "wind [m/s]"
    over_time(chart, tracks)
    return chart
