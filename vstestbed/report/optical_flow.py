"""Optical flow: velocity of a feature in its own coordinates for each of the six camera velocities.

The arrows are columns of the feature's interaction matrix, for fixed points at the same depth (at
the same distance for `spherical`). With angles on the axes an arrow is a velocity in that plane,
not in the image.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from vstestbed.core.errors import ParameterError
from vstestbed.core.files import make_parents
from vstestbed.core.geometry import Array
from vstestbed.features import Feature, Point, Polar, Spherical
from vstestbed.report.canvas import new_figure, save, style
from vstestbed.report.marks import INK, LINE_COLORS
from vstestbed.report.run import space

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MOTIONS = ("$v_x$", "$v_y$", "$v_z$", r"$\omega_x$", r"$\omega_y$", r"$\omega_z$")
FORMATS = (".png", ".svg", ".pdf")
PI = math.pi

# The planes in which the flow of a feature is drawn: the feature; coordinates of the arrows' tails
# along the horizontal and the vertical axis; the row of L, of the two per point, that belongs to
# each axis; labels of the axes; and a function that gives the input (N, k) of the feature's
# interaction matrix for tails (N, 2).
ROUND = np.linspace(-PI, PI, 13)
PLANES: dict[
    str, tuple[Feature, Array, Array, tuple[int, int], tuple[str, str], Callable[[Array], Array]]
] = {
    "point": (
        Point(),
        np.linspace(-1, 1, 9),
        np.linspace(-1, 1, 9),
        (0, 1),
        ("x", "y"),
        lambda tails: tails,
    ),
    "polar": (
        Polar(),
        ROUND,
        np.linspace(0.2, 1, 9),
        (1, 0),
        (r"$\phi$ [rad]", "r"),
        lambda tails: tails[:, 1:] * np.stack([np.cos(tails[:, 0]), np.sin(tails[:, 0])], axis=-1),
    ),
    "spherical": (
        Spherical(),
        ROUND,
        np.linspace(0.1, 0.9, 9) * PI,
        (1, 0),
        (r"$\phi$ [rad]", r"$\theta$ [rad]"),
        lambda tails: space.ray_at(tails[:, 1], tails[:, 0]),
    ),
}


def sphere_flow(depth: float = 1.0) -> tuple[Array, Array]:
    """Rays (N, 3) over the sphere, and their velocity (6, N, 3), tangential to it, for each camera
    motion at 1 m/s or 1 rad/s.

    ray_dot = theta_dot e_theta + phi_dot sin theta e_phi
    """
    # points on 12 parallels, their number in proportion to the circumference: about evenly spread
    rings = [(theta, round(24 * math.sin(theta))) for theta in (np.arange(12) + 0.5) * PI / 12]
    theta = np.concatenate([np.full(n, t) for t, n in rings])
    phi = np.concatenate([2 * PI * np.arange(n) / n for _, n in rings])
    ray = space.ray_at(theta, phi)
    rates = np.moveaxis(
        Spherical().interaction(ray, np.full(len(ray), depth)).reshape(-1, 2, 6), -1, 0
    )
    e_theta = space.ray_at(theta + PI / 2, phi)
    e_phi = np.stack([-np.sin(phi), np.cos(phi), 0 * phi], axis=-1)
    return ray, rates[..., :1] * e_theta + rates[..., 1:] * np.sin(theta)[:, None] * e_phi


def draw_plane(name: str, depth: float = 1.0) -> Figure:
    """The six flow fields in the feature's plane at 1 m/s or 1 rad/s; in each, the longest arrow is
    as long as the spacing of the tails.

    `name`: point, in (x, y); polar, in (phi, r); spherical, in (phi, theta). depth: of every point,
    for `spherical` its distance [m].
    """
    feature, across, up, rows, labels, seen_at = PLANES[name]
    tails = np.stack(np.meshgrid(across, up), axis=-1).reshape(-1, 2)
    L = feature.interaction(seen_at(tails), np.full(len(tails), depth)).reshape(len(tails), 2, 6)
    figure = new_figure(6.4, 9.0)
    spacing = np.array([across[1] - across[0], up[1] - up[0]])
    grid = figure.subplots(2, 3, sharex=True, sharey=True)
    head: dict[str, Any] = {
        "width": 0.0045,
        "headwidth": 4,
        "headlength": 5,
        "headaxislength": 4.5,
        "minlength": 0.4,
    }
    for axes, rate, motion in zip(
        np.ravel(grid), np.moveaxis(L[:, list(rows)], -1, 0), MOTIONS, strict=True
    ):
        arrow = 0.95 * rate / np.linalg.norm(rate / spacing, axis=-1).max()
        axes.quiver(
            *tails.T, *arrow.T, angles="xy", scale_units="xy", scale=1, color=LINE_COLORS[0], **head
        )
        axes.plot(*tails.T, ".", color=INK, markersize=1.5)
        axes.set_title(motion)
    first: Axes = grid[0, 0]
    first.set_xlim(across[0] - spacing[0], across[-1] + spacing[0])
    first.set_ylim(up[0] - spacing[1], up[-1] + spacing[1])
    if name == "point":
        first.invert_yaxis()  # y points down, as in the image
        for axes in np.ravel(grid):
            axes.set_aspect("equal")
    else:
        first.set_xticks(
            [-PI, -PI / 2, 0, PI / 2, PI], [r"$-\pi$", r"$-\pi/2$", "0", r"$\pi/2$", r"$\pi$"]
        )
    if name == "spherical":
        first.set_yticks(
            [0, PI / 4, PI / 2, 3 * PI / 4, PI],
            ["0", r"$\pi/4$", r"$\pi/2$", r"$3\pi/4$", r"$\pi$"],
        )
    for axes in grid[-1]:
        axes.set_xlabel(labels[0])
    for axes in grid[:, 0]:
        axes.set_ylabel(labels[1])
    figure.suptitle(
        f"{name}, {'distance' if name == 'spherical' else 'depth'} {depth:g} m;"
        " arrows to scale within each field"
    )
    return figure


def draw_sphere(depth: float = 1.0) -> Figure:
    """The six flow fields on the unit sphere around the camera, seen from outside and ahead; the
    far side is hidden.
    """
    ray, rates = sphere_flow(depth)
    figure = new_figure(6.7, 9.0)
    figure.set_layout_engine("none")
    for i, (rate, motion) in enumerate(zip(rates, MOTIONS, strict=True)):
        place = (i % 3 / 3, (0.1 if i >= 3 else 3.1) / 6.7, 1 / 3, 3.0 / 6.7)  # 3 in by 3 in each
        # Any: matplotlib's stubs have only 2-D axes
        axes: Any = figure.add_axes(place, projection="3d")
        axes.set(xlim=(-1, 1), ylim=(-1, 1), zlim=(-1, 1))
        axes.set_box_aspect((1, 1, 1), zoom=1.36)
        axes.view_init(elev=24, azim=52)
        axes.set_axis_off()
        space.draw_net(axes, PI, PI / 6, hide_back=True)
        space.draw_curve(
            axes,
            space.ray_at(PI / 2, np.linspace(0, 2 * PI, 121)),
            hide_back=True,
            color=INK,
            linewidth=1.1,
        )
        # cosine of the angle to the viewer: without the rays next to the outline
        near = ray @ space.towards_viewer(axes) > 0.08
        arrow = 0.24 * rate[near] / np.linalg.norm(rate, axis=-1).max()
        axes.quiver(
            *space.drawn(ray[near]),
            *space.drawn(arrow),
            color=LINE_COLORS[0],
            linewidth=1.1,
            arrow_length_ratio=0.4,
        )
        space.draw_axes(axes, 0.4, start=1.0)
        space.draw_cross_axes(axes, np.zeros(3), 0.2, start=1.05)
        for artist in (*axes.lines, *axes.collections):
            artist.set_clip_on(False)
        axes.set_title(motion, x=0.1, y=0.87)
    title = f"spherical, distance {depth:g} m: the unit sphere around the camera, seen from outside"
    figure.text(0.02, 0.985, title, va="top", fontsize=11)
    legend = (
        "Dashed: the optical axis z."
        " The dark circle, 90 deg from it, divides what is ahead of the camera from what is behind."
    )
    figure.text(0.02, 0.95, legend, va="top")
    return figure


def write_flow(name: str, depth: float = 1.0, out: Path | None = None) -> list[Path]:
    """Draw a feature's flow into a file (`runs/optical_flow/NAME.png`), for `spherical` also on the
    sphere (`NAME_sphere`).

    Returns the paths. ParameterError: no such plane, depth or format. OutputError: the file cannot
    be written.
    """
    if name not in PLANES:
        raise ParameterError.choice(
            "feature",
            PLANES,
            name,
            why="only these have two coordinates per point, which span a plane",
        )
    if not (math.isfinite(depth) and depth > 0):
        raise ParameterError.bound("depth", ">", "0 m, and finite", depth)
    out = out or Path("runs", "optical_flow", f"{name}.png")
    if out.suffix.lower() not in FORMATS:
        raise ParameterError.choice("ending of --out", FORMATS, str(out))
    make_parents(out)
    with style():
        paths = [save(draw_plane(name, depth), out)]
        if name == "spherical":
            paths.append(save(draw_sphere(depth), out.with_name(f"{out.stem}_sphere{out.suffix}")))
    return paths
