"""The unit sphere around the camera centre in 3-D: graticule, axes, viewpoint.

Camera axes (x right, y down, z forward) are drawn as (x, z, -y), so that down is down.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from vstestbed.core.geometry import Array
from vstestbed.report.html.canvas import AXIS_COLORS, INK, RULE

if TYPE_CHECKING:
    from mpl_toolkits.mplot3d import Axes3D

    from vstestbed.report.html.space import Space

FAR = 0.4
"""Factor of the opacity of lines on the far side."""


def drawn(p: Array) -> Array:
    """Camera coordinates (..., 3) as matplotlib's x, y, z, first axis first: shape (3, ...)."""
    p = np.asarray(p, dtype=float)
    return np.stack([p[..., 0], p[..., 2], -p[..., 1]])


def ray_at(theta: ArrayLike, phi: ArrayLike) -> Array:
    """Unit rays (..., 3) at colatitude theta and longitude phi [rad]."""
    a, b = np.broadcast_arrays(np.asarray(theta, float), np.asarray(phi, float))
    return np.stack([np.sin(a) * np.cos(b), np.sin(a) * np.sin(b), np.cos(a)], axis=-1)


def towards_viewer(axes: Axes3D | Space) -> Array:
    """Unit vector (3,) in camera coordinates from the centre towards the viewer."""
    elevation, azimuth = np.radians(axes.elev), np.radians(axes.azim)
    return np.array([np.cos(elevation) * np.cos(azimuth), -np.sin(elevation), np.cos(elevation) * np.sin(azimuth)])


def draw_curve(axes: Axes3D | Space, p: Array, alpha: float = 1.0, hide_back: bool = False, **look: Any) -> None:
    """A line through points of the sphere (T, 3); the far side is paler, or hidden."""
    near = np.where((p @ towards_viewer(axes) >= 0)[:, None], p, np.nan)
    if not hide_back:
        axes.plot(*drawn(p), alpha=FAR * alpha, **look)
    axes.plot(*drawn(near), alpha=alpha, **look)


def draw_net(axes: Axes3D | Space, reach: float, step: float, hide_back: bool = False) -> None:
    """Circles of equal theta every `step` [rad] up to `reach`, and meridians every 30 degrees; the far side paler or hidden."""
    line = np.linspace(0, 2 * np.pi, 121)
    lines = [ray_at(theta, line) for theta in np.arange(step, min(reach, np.pi - 1e-6) + 1e-6, step)]
    lines += [ray_at(np.linspace(0, reach, 61), phi) for phi in np.arange(12) * np.pi / 6]
    for p in lines:
        draw_curve(axes, p, hide_back=hide_back, color=RULE, linewidth=0.6)


def draw_axes(axes: Axes3D | Space, length: float, start: float = 0.0) -> None:
    """The optical axis as a dashed line of this length from z = `start`, labelled."""
    tip = np.array([0, 0, start + length])
    axes.plot(*drawn(np.stack([[0, 0, start], tip])), color=INK, linewidth=1.3, linestyle=(0, (4, 2)))
    _letter(axes, tip * 1.06, "z", INK)


def draw_cross_axes(axes: Axes3D | Space, at: Array, length: float, start: float = 0.0) -> None:
    """Lines of this length along x and y from `start` away from the point `at` (3,), in the axes' colours, labelled."""
    for direction, name, color in zip(np.eye(3), "xy", AXIS_COLORS, strict=False):
        axes.plot(*drawn(at + np.outer([start, start + length], direction)), color=color, linewidth=1.3)
        _letter(axes, at + (start + 1.3 * length) * direction, name, color)


def _letter(axes: Any, at: Array, letter: str, color: str) -> None:  # Any: matplotlib's stubs have only the 2-D signature of text
    axes.text(*drawn(at).tolist(), letter, color=color, ha="center", va="center")


def frame(axes: Axes3D, low: Array, high: Array, elev: float, azim: float, zoom: float) -> None:
    """Limit the axes to the box from `low` to `high` (3,) in camera coordinates, equal scale, without matplotlib's own axes."""
    corners = np.sort(np.stack([drawn(low), drawn(high)]), axis=0)  # sorted: the sign of y changes when drawn
    limits: dict[str, Any] = {f"{name}lim": tuple(corners[:, i].tolist()) for i, name in enumerate("xyz")}
    axes.set(**limits)
    box: dict[str, Any] = {"zoom": zoom}  # zoom is a float, but the stubs say int
    axes.set_box_aspect(np.ptp(corners, axis=0), **box)
    axes.view_init(elev=elev, azim=azim)
    axes.set_axis_off()
