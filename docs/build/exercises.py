"""Figures of the exercises' page, each of the runs that its entry names:
`python -m docs.build.pictures exercise_1a`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

import vstestbed as vs
from docs.build.kept import Kept
from vstestbed.core.geometry import Array
from vstestbed.loop.stability import closed_form
from vstestbed.report.canvas import DPI, new_figure, panels, save, style
from vstestbed.report.comparison.page import COLUMN_IN
from vstestbed.report.marks import FAILED, LINE_COLORS, LOST, THRESHOLD, line_color
from vstestbed.report.run.tracks import LogArrays, Setting

WIDE = COLUMN_IN[2]


def starts(path: Path) -> None:
    """Path and retreat over the start's translation and rotation, a row of panels for each law;
    crosses where the goal was not reached.
    """
    rows = Kept(may_run=False)("compare starts")
    laws, tasks, amounts = (
        list(dict.fromkeys(row[name] for row in rows)) for name in ("law", "task", "amount")
    )
    figure = new_figure(4.0, WIDE)
    grid = panels(figure, 2 * len(laws), len(laws), sharex=True, sharey=True)
    for k, (metric, title, most) in enumerate(
        (("path_ratio", "path over the straight line", 5.0), ("max_retreat_m", "retreat [m]", 2.0))
    ):
        for axes, law in zip(grid[k * len(laws) :], laws, strict=False):
            found = {(row["task"], row["amount"]): row for row in rows if row["law"] == law}
            values = np.array(
                [
                    [found[t, a][metric] if found[t, a]["success"] else np.nan for a in amounts]
                    for t in tasks
                ],
                dtype=float,
            )
            image = axes.imshow(
                values, cmap="viridis_r", vmin=1.0 - k, vmax=most, origin="lower", aspect="auto"
            )
            for i, j in np.argwhere(np.isnan(values)):
                axes.plot(j, i, **(FAILED | {"markersize": 6}))
            for i, j in np.argwhere(np.isfinite(values)):
                share, places = (
                    (values[i, j] - 1 + k) / (most - 1 + k),
                    0 if values[i, j] >= 9.95 else 1,
                )
                look = {
                    "color": "white" if share > 0.5 else "black",
                    "ha": "center",
                    "va": "center",
                    "fontsize": 6,
                }
                axes.text(j, i, f"{values[i, j]:.{places}f}", **look)
            axes.set_title(f"{law}: {title}" if k else law)
            axes.grid(visible=False)
        figure.colorbar(
            image,
            ax=grid[k * len(laws) : (k + 1) * len(laws)],
            label=title,
            extend="max",
            shrink=0.9,
        )
    for axes in grid[len(laws) :]:
        axes.set_xticks(
            range(len(amounts)), [amount.removesuffix(" deg") for amount in amounts], fontsize=6
        )
        axes.set_title("")
        axes.set_xlabel("turned by [deg]")
    for axes in grid[:: len(laws)]:
        axes.set_yticks(range(len(tasks)), [task.partition(" ")[0] for task in tasks])
        axes.set_ylabel("off the axis [m]")
    save(figure, path, DPI)


def borders(path: Path) -> None:
    """Exercises 1b and 1c: the markers' discs in the picture, and how far their rims stay from its
    border.
    """
    figure = new_figure(2.6, WIDE)
    left, middle, right = panels(figure, 3, 3)
    for axes, name, color in (
        (left, "partitioned_leaves", LOST),
        (middle, "partitioned_repelled", LINE_COLORS[0]),
    ):
        tracks, scenario = _tracks(name, {})
        uv, depth = _markers(tracks), tracks.true_depth
        assert depth is not None
        rims = scenario.camera.f * scenario.target.marker.radius / depth
        size = np.array([scenario.camera.width, scenario.camera.height])
        margin = np.minimum(uv, size - 1 - uv).min(axis=2) - rims
        seen, last = int(np.flatnonzero(np.isfinite(tracks.column("error_px")))[-1]), len(uv) - 1
        for i in range(uv.shape[1]):
            axes.plot(*uv[: last + 1, i].T, color=line_color(i), lw=0.9)
            for at in (0, last):
                angle = np.linspace(0, 2 * np.pi, 60)
                axes.fill(
                    *(uv[at, i, :, None] + rims[at, i] * np.array([np.cos(angle), np.sin(angle)])),
                    color=line_color(i),
                    alpha=0.35,
                )
        axes.set(
            xlim=(-60, size[0] + 60),
            ylim=(size[1] + 60, -60),
            aspect="equal",
            xlabel="u [px]",
            title=name,
        )
        axes.plot([0, size[0], size[0], 0, 0], [0, 0, size[1], size[1], 0], color="black", lw=0.8)
        right.plot(tracks.t, margin.min(axis=1), color=color, label=name)
        if seen < last:
            right.plot(tracks.t[seen], margin[seen].min(), label="lost", **FAILED)
    right.axhline(0, color="black", lw=0.8)
    right.set(xlabel="time [s]", ylabel="least margin of a rim [px]", ylim=(-20, 300))
    right.legend(loc="center right")
    save(figure, path, DPI)


def sizes(path: Path) -> None:
    """Exercise 1d: three forms of the size error, with exact and with measured pixels, and the
    chatter of one of them.
    """
    figure = new_figure(2.6, WIDE)
    left, middle, right = panels(figure, 3, 3)
    long: dict[str, Any] = {"stop.duration_s": 200}
    for color, sigma in zip(LINE_COLORS, ("ratio", "log", "difference"), strict=False):
        for axes, changes in ((left, {"detector": "oracle", "camera.rate_hz": 25}), (right, {})):
            recording = vs.run(vs.load("partitioned_book", long | changes | {"law.sigma": sigma}))
            axes.semilogy(recording["t"], recording["error_px"], color=color, label=sigma, lw=1.0)
    for color, rate in ((LINE_COLORS[3], 10), (LINE_COLORS[4], 100)):
        changes = long | {"detector": "oracle", "camera.rate_hz": rate, "law.sigma": "difference"}
        recording = vs.run(vs.load("partitioned_book", changes))
        middle.plot(recording["t"], recording["cmd_vx"], color=color, label=f"{rate} Hz", lw=0.9)
    left.set(title="exact pixels, 25 Hz", ylabel="error [px]", xlabel="time [s]")
    middle.set(title="difference, exact pixels", ylabel="$v_x$ [m/s]", xlabel="time [s]")
    right.set(title="measured pixels, 10 Hz", ylabel="error [px]", xlabel="time [s]")
    for axes in (left, middle, right):
        axes.legend()
    save(figure, path, DPI)


DELAYED = {
    "detector": "oracle",
    "law.gain": 4,
    "stop": {"duration_s": 4, "converged": {"error_px": 0.01, "hold_s": 4}},
}


def delays(path: Path) -> None:
    """Exercise 3b: how a marker of the arm's picture comes to its goal with 0 to 5 frames of delay,
    and the gain's limit over the delay.
    """
    figure = new_figure(2.6, WIDE)
    left, right = panels(figure, 2, 2)
    for d in range(6):
        recording = vs.run(vs.load("arm_ibvs", DELAYED | {"camera.latency_s": 0.04 * d}))
        off = recording["u_true_2"] - recording["u_goal_2"]
        left.plot(recording["t"], off / off[0], color=line_color(d), label=f"{d}", lw=1.1)
    left.set(
        xlabel="time [s]",
        ylabel="error of a marker, over that at the start [1]",
        title="the arm, gain 4 1/s",
        ylim=(-0.4, 1.1),
    )
    left.legend(title="frames of 40 ms", ncols=2)
    at = np.linspace(0, 5, 60)
    right.plot(
        at, [closed_form(d) for d in at], color="black", lw=0.9, label="2 sin(π / (2 (2 d + 1)))"
    )
    for command, mark, color in (
        ("gain-limit ibvs_book", "o", LINE_COLORS[0]),
        ("gain-limit arm_ibvs", "D", LINE_COLORS[1]),
    ):
        rows = Kept(may_run=False)(command)
        shown = [
            (row["delay_frames"], row["g_measured"])
            for row in rows
            if row["delay_frames"] == int(row["delay_frames"])
        ]
        right.plot(*zip(*shown, strict=True), mark, color=color, ms=4, mfc="none", label=command)
    right.set(xlabel="delay [frames]", ylabel="largest stable gain a frame [1]", ylim=(0, 2.1))
    right.legend()
    save(figure, path, DPI)


HORIZONS_S = np.arange(0, 0.221, 0.02)
MODELS = ("alpha_beta", "kalman_cv", "kalman_ca")
RADIUS_M, TURNS_HZ, GAIN, DELAY_S = 0.1, 0.2, 1.0, 0.09
"""Of `arm_track_circle`; the delay is that of the pictures (40 ms), half of the 40 ms of a command,
and of the servos (30 ms, `gain-limit arm_ibvs`).
"""
CORNERS_HZ = {"kalman_cv": 5.0, "kalman_ca": 2.0}


def horizons(path: Path) -> None:
    """Exercise 3d: the error behind a target on a circle over the prediction horizon, by model,
    with the formula's curves.
    """
    figure = new_figure(2.8, 0.72 * WIDE)
    axes = figure.add_subplot()
    for color, kind in zip(LINE_COLORS, MODELS, strict=False):
        changes = [{"kind": kind, "predict_s": float(p)} for p in HORIZONS_S]
        runs = [
            vs.run(vs.load("arm_track_circle", {"law.feedforward": change, "detector": "oracle"}))
            for change in changes
        ]
        behind = [1e3 * float(str(run.summary()["tracking_rms_m"])) for run in runs]
        axes.plot(HORIZONS_S, behind, "o-", color=color, ms=3, lw=0.8, label=kind)
    fine = np.linspace(0, HORIZONS_S[-1], 100)
    for kind, look in (("kalman_cv", "--"), ("kalman_ca", ":")):
        axes.plot(
            fine,
            1e3 * left_behind_m(fine, kind),
            look,
            color="black",
            lw=0.9,
            label=f"formula, {kind}",
        )
    axes.set(
        xlabel="prediction horizon [s]", ylabel="camera from its goal, RMS [mm]", ylim=(0, None)
    )
    axes.legend()
    save(figure, path, DPI)


def left_behind_m(horizon_s: Array, kind: str) -> Array:
    """The error of the exercise's formula: of estimates that are D seconds old, with the filters'
    own response at the circle's frequency w.

    With the target at r exp(jwt), E = r (lambda (P - 1) + jw (V - 1)) / (lambda + jw): P is the
    target's predicted place over its true one, and V its speed. Of constant velocity P = d (1 + jwp
    F), V = d F with d = exp(-jwD); of constant acceleration P = d (1 + jwp F + (jwp)^2 G / 2), V =
    d (F + jwp G). F and G are the responses of rate and acceleration of Butterworth filters with
    the corner c.
    """
    s, corner = 2j * np.pi * TURNS_HZ, 2 * np.pi * CORNERS_HZ[kind]
    late, p = np.exp(-s * DELAY_S), horizon_s
    if kind == "kalman_cv":
        F = corner**2 / (s**2 + np.sqrt(2) * corner * s + corner**2)
        place, speed = late * (1 + s * p * F), late * F + 0 * p
    else:
        below = s**3 + 2 * corner * s**2 + 2 * corner**2 * s + corner**3
        F, G = (2 * corner**2 * s + corner**3) / below, corner**3 / below
        place, speed = late * (1 + s * p * F + (s * p) ** 2 * G / 2), late * (F + s * p * G)
    return np.asarray(RADIUS_M * np.abs((GAIN * (place - 1) + s * (speed - 1)) / (GAIN + s)))


DEROTATIONS = ("exact", "first_order", "none", "as_printed")


def rates(path: Path) -> None:
    """Exercises 6c and 6d: the craft's body rates and tilt with each derotation of the picture."""
    figure = new_figure(2.6, WIDE)
    left, right = panels(figure, 2, 2)
    for color, option in zip(LINE_COLORS, DEROTATIONS, strict=False):
        recording = vs.run(vs.load("quadrotor_aggressive", {"derotation": option}))
        left.plot(
            recording["t"], np.degrees(recording["est_wy"]), color=color, lw=0.9, label=option
        )
        right.plot(recording["t"], np.degrees(recording["est_pitch"]), color=color, lw=0.9)
    left.set(xlabel="time [s]", ylabel="pitch rate [deg/s]", xlim=(0, 10))
    right.set(xlabel="time [s]", ylabel="pitch [deg]", xlim=(0, 10))
    right.axhline(0, **(THRESHOLD | {"color": "black", "linewidth": 0.6}))
    left.legend(title="derotation")
    save(figure, path, DPI)


def _tracks(name: str, changes: dict[str, Any]) -> tuple[LogArrays, Any]:
    scenario = vs.load(name, changes)
    return LogArrays.of(vs.run(scenario).frame(), Setting.of(scenario)), scenario


def _markers(tracks: LogArrays) -> Array:
    """True pixels (T, N, 2)."""
    return np.stack([tracks.numbered("u_true"), tracks.numbered("v_true")], axis=-1)


EXERCISES: dict[str, Callable[[Path], None]] = {
    "exercise_1a": starts,
    "exercise_1bc": borders,
    "exercise_1d": sizes,
    "exercise_3b": delays,
    "exercise_3d": horizons,
    "exercise_6cd": rates,
}


EASY: dict[str, Any] = {"detector": "oracle"}
REPORTS: dict[str, tuple[tuple[str, dict[str, Any], str], ...]] = {
    "section_15_1": (("pbvs_book", {}, "features"), ("pbvs_book", {}, "camera_path")),
    "section_15_2": (("ibvs_book", {}, "features"), ("ibvs_book", {}, "camera_path")),
    "section_15_2_depth": (
        ("ibvs_book", {"law.depth": "estimate"}, "depth"),
        ("ibvs_book", {"law.depth": "estimate"}, "error"),
    ),
    "section_15_2_retreat": (("ibvs_retreat", {}, "features"), ("ibvs_retreat", {}, "camera_path")),
    "section_15_2_half_turn": (("retreat_point", {}, "features"), ("retreat_point", {}, "depth")),
    "section_16_1": (
        ("partitioned_book", EASY, "features"),
        ("partitioned_book", {}, "camera_path"),
        ("partitioned_book", EASY, "camera_path"),
    ),
    "section_16_3": (("spherical_book", {}, "spherical"), ("spherical_book", {}, "on_sphere")),
    "section_16_4_1": (
        ("arm_book", {}, "features"),
        ("arm_book", {}, "joints"),
        ("arm_ibvs", {}, "joints"),
    ),
    "section_16_4_2_1": (("omni_ibvs", {}, "features"), ("omni_ibvs", {}, "plane")),
    "section_16_4_2_2": (("car_pbvs", {}, "plane"), ("car_pbvs", {}, "localisation_error")),
    "section_16_4_3": (("quadrotor_hover", {}, "tilt"), ("quadrotor_hover", {}, "velocity")),
    "exercise_3a": (("arm_offset", {}, "features"), ("arm_offset", {}, "camera_path")),
    "exercise_3c": (
        ("arm_track_circle", {"law.feedforward": "none"}, "pose_error"),
        ("arm_track_circle", {}, "pose_error"),
    ),
    "exercise_3e": (
        ("arm_docking", {}, "features"),
        ("arm_docking", {}, "error"),
        ("arm_docking_overflow", {}, "features"),
    ),
    "exercise_4a": (("omni_catadioptric", {}, "plane"), ("car_catadioptric", {}, "plane")),
    "exercise_4b": (
        ("omni_blended", {}, "plane"),
        ("omni_blended", {}, "twist"),
        ("omni_blended", {"goal.speed_mps": None, "goal.threshold_px": 3}, "twist"),
    ),
    "exercise_4c": (
        ("car_pursuit", {}, "task_error"),
        ("car_line", {}, "task_error"),
        ("omni_line", {}, "task_error"),
    ),
    "exercise_6a": (
        ("quadrotor_perspective", {}, "features"),
        ("quadrotor_perspective", {}, "tilt"),
    ),
    "exercise_6b": (("quadrotor_row", {}, "camera_path"), ("quadrotor_row", {}, "error")),
    "exercise_7": (
        ("hybrid_book", {}, "features"),
        ("hybrid_book", {}, "camera_path"),
        ("retreat_hybrid", {}, "camera_path"),
    ),
}
"""Entries whose figure is of the reports of their runs, from left to right: scenario, what is
changed in it, the name of the figure.
"""


def side_by_side(path: Path, shown: Sequence[tuple[str, dict[str, Any], str]]) -> None:
    """Figures of reports beside one another, of one width."""
    runs: dict[str, vs.Recording] = {}
    images = []
    for name, changes, figure in shown:
        key = f"{name} {changes}"
        runs[key] = runs.get(key) or vs.run(vs.load(name, changes))
        drawn = runs[key].plot(figure)
        drawn.axes[0].set_title(" ".join([name, *(f"{k}={v}" for k, v in changes.items())]))
        images.append(cv2.imread(str(save(drawn, path, DPI))))
    height = max(image.shape[0] for image in images)
    white = {"borderType": cv2.BORDER_CONSTANT, "value": (255, 255, 255)}
    even = [
        cv2.copyMakeBorder(image, 0, height - image.shape[0], 0, 12, **white) for image in images
    ]
    cv2.imwrite(str(path), np.hstack(even))


def draw(name: str, folder: Path) -> Path:
    """The figure of an entry in a folder; its path."""
    path = folder / f"{name}.png"
    with style():
        if name in REPORTS:
            side_by_side(path, REPORTS[name])
        else:
            EXERCISES[name](path)
    return path
