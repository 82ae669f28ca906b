"""Figures over time of a flight: how velocity, attitude and rates follow what is asked of them; rotors, wind."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from vstestbed.core.geometry import Array, adjoint, inverse
from vstestbed.report.html.canvas import LINE_COLORS, RULE, new_figure
from vstestbed.report.run.figures import BAND, line_keys, shade_lost, time_axis
from vstestbed.report.run.tracks import Tracks

if TYPE_CHECKING:
    from matplotlib.figure import Figure

AXES = ("ahead", "left", "up")
LIMIT_RADPS = 1000.0
"""Of a rotor [rad/s]: models/quadrotor.xml."""


def velocity(tracks: Tracks) -> Figure | None:
    """Velocity in the level frame: ordered (thin line) and flown, by the craft's own estimate (pale band)."""
    flown, camera = tracks.columns("est_vx", "est_vy", "est_vz"), tracks.setting.camera
    if camera is None or not np.isfinite(flown).any():
        return None
    made = tracks.columns(*(f"applied_{name}" for name in ("vx", "vy", "vz", "wx", "wy", "wz")))
    ordered = made @ adjoint(camera.mount.T).T
    figure = new_figure(4.4)
    grid = figure.subplots(3, 1, sharex=True)
    for i, axes in enumerate(grid):
        axes.axhline(0, color=RULE, linewidth=0.8)
        axes.plot(tracks.t, flown[:, i], color=LINE_COLORS[i], **BAND)
        axes.plot(tracks.t, ordered[:, i], color=LINE_COLORS[i], linewidth=1.0)
        axes.set_ylabel(f"{AXES[i]} [m/s]")
        shade_lost(axes, tracks)
    time_axis(grid[-1], tracks)
    return figure


def tilt(tracks: Tracks) -> Figure | None:
    """Roll and pitch: true (pale band), as the craft estimates them (thin line) and as its velocity loop asks for them (dotted)."""
    told, asked, camera = tracks.columns("est_roll", "est_pitch"), tracks.columns("ref_roll", "ref_pitch"), tracks.setting.camera
    if camera is None or not np.isfinite(told).any():
        return None
    true = _tilt_of(tracks.poses("cam") @ inverse(camera.mount.T))
    figure = new_figure(3.0)
    axes = figure.add_subplot()
    axes.axhline(0, color=RULE, linewidth=0.8)
    for i in range(2):
        axes.plot(tracks.t, np.degrees(true[:, i]), color=LINE_COLORS[i], **BAND)
        axes.plot(tracks.t, np.degrees(told[:, i]), color=LINE_COLORS[i], linewidth=1.0)
        axes.plot(tracks.t, np.degrees(asked[:, i]), color=LINE_COLORS[i], linewidth=1.0, linestyle=":")
    axes.set_ylabel("tilt [deg]")
    shade_lost(axes, tracks)
    time_axis(axes, tracks)
    figure.legend(handles=line_keys(["roll", "pitch"]), loc="outside lower center", ncols=2)
    return figure


def rates(tracks: Tracks) -> Figure | None:
    """Body rates: asked for by the attitude loop (thin line) and flown, by the gyro less its bias (pale band)."""
    flown, asked = (tracks.columns(*(f"{what}_{name}" for name in ("wx", "wy", "wz"))) for what in ("est", "ref"))
    if not np.isfinite(flown).any():
        return None
    figure = new_figure(4.4)
    grid = figure.subplots(3, 1, sharex=True)
    for i, axes in enumerate(grid):
        axes.axhline(0, color=RULE, linewidth=0.8)
        axes.plot(tracks.t, np.degrees(flown[:, i]), color=LINE_COLORS[i], **BAND)
        axes.plot(tracks.t, np.degrees(asked[:, i]), color=LINE_COLORS[i], linewidth=1.0)
        axes.set_ylabel(f"{('roll', 'pitch', 'yaw')[i]} [deg/s]")
        shade_lost(axes, tracks)
    time_axis(grid[-1], tracks)
    return figure


def _tilt_of(T_world_base: Array) -> Array:
    """Roll and pitch (n, 2) [rad] of poses (n, 4, 4)."""
    up = T_world_base[:, 2, :3]
    return np.column_stack([np.arctan2(up[:, 1], up[:, 2]), -np.arcsin(np.clip(up[:, 0], -1, 1))])


def rotors(tracks: Tracks) -> Figure | None:
    """Speeds of the rotors, their limit dotted; below, the wind where it blew."""
    names = tracks.named("speed")
    if not names:
        return None
    wind = tracks.columns("wind_x", "wind_y", "wind_z")
    windy = bool(np.nanmax(np.abs(wind), initial=0.0) > 0)
    figure = new_figure(4.2 if windy else 2.8)
    grid = np.ravel(figure.subplots(2 if windy else 1, 1, sharex=True, squeeze=False))
    for i, name in enumerate(names):
        grid[0].plot(tracks.t, tracks.column(f"speed_{name}"), color=LINE_COLORS[i], linewidth=1.0)
    grid[0].axhline(LIMIT_RADPS, color=RULE, linestyle=":")
    grid[0].set_ylabel("rotors [rad/s]")
    for i in range(3) if windy else ():
        grid[1].plot(tracks.t, wind[:, i], color=LINE_COLORS[i], linewidth=1.0, label="xyz"[i])
    if windy:
        grid[1].set_ylabel("wind [m/s]")
        grid[1].legend(loc="upper right", ncols=3)
    time_axis(grid[-1], tracks)
    figure.legend(handles=line_keys([name.removeprefix("rotor_") for name in names]), loc="outside lower center", ncols=4)
    return figure
