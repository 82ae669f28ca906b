"""Metrics of a run for `summary.json`, computed from its log."""

from __future__ import annotations

import math

import numpy as np

from vstestbed.core.geometry import Array, rotation_angle, rotation_from_quaternion
from vstestbed.core.outcome import Outcome
from vstestbed.loop.columns import TWIST
from vstestbed.loop.stability import swing
from vstestbed.scenario.scenario import Scenario
from vstestbed.tasks.base import Log
from vstestbed.tasks.metrics import FIGURES, SOME_FIGURES, Figures, own_figures

SATURATED = 0.999  # a command scaled under this counts as saturated
XYZ, WXYZ = ("x", "y", "z"), ("qw", "qx", "qy", "qz")


def side_by_side(log: Log, prefix: str, names: tuple[str, ...]) -> Array:
    """Columns `prefix_name` as (rows, names)."""
    return np.column_stack([log[f"{prefix}_{name}"] for name in names])


def _counts(log: Log) -> Figures:
    """Frames, the values in the last one, and the largest true speed and rate of the camera."""
    found: Figures = {
        "sim_time_s": float(log["t"][-1]),
        "frames": len(log["t"]),
        "frames_lost": int(log["lost"].sum()),
        "final_error_px": float(log["error_px"][-1]),
        "final_position_error_m": float(log["position_error_m"][-1]),
        "final_rotation_error_deg": math.degrees(log["rotation_error_rad"][-1]),
        "saturated_fraction": int((log["scale"] < SATURATED).sum()) / len(log["t"]),
        "peak_speed_mps": _largest_norm(log, TWIST[:3]),
        "peak_rate_radps": _largest_norm(log, TWIST[3:]),
    }
    if "error_grey" in log:
        found["final_error_grey"] = float(log["error_grey"][-1])
    return found


def _largest_norm(log: Log, names: tuple[str, ...]) -> float:
    return float(np.linalg.norm(side_by_side(log, "act", names), axis=1).max())


def _time_to_converge(scenario: Scenario, log: Log) -> float | None:
    """Start of the last unbroken stretch in which the conditions of `stop.converged` held at the
    last goal view [s].
    """
    counted = scenario.goal_view.counted
    markers = range(scenario.rows) if counted is None else np.flatnonzero(counted)
    whole = np.ones(len(log["t"]), dtype=bool)
    for i in markers:  # a detector of other points leaves rows empty, in the goal's columns, too
        whole &= np.isfinite(log[f"u_{i}"]) | np.isnan(log[f"u_goal_{i}"])
    reached = scenario.stop.converged
    none = np.full(len(whole), np.nan)
    estimate = (none, none)
    if reached.by_estimate:
        estimate = (log["est_position_m"], log["est_rotation_rad"])
    # of a craft that tilts, the error that decides its task
    error = log.get("level_error_px", log["error_px"])
    rows = zip(whole, error, *estimate, log.get("error_grey", none), strict=True)
    converged = np.array([reached.near(*row) for row in rows]) & ~log["lost"].astype(bool)
    if len(scenario.goal_views) > 1:
        converged &= log["view"] == len(scenario.goal_views) - 1
    over = np.flatnonzero(~converged)
    # an error that dips under its threshold on the way there has not converged
    after = log["t"][int(over[-1]) + 1 if len(over) else 0 :]
    return float(after[0]) if len(after) else None


def _camera_path(s: Scenario, log: Log) -> Figures:
    """Length of the camera's path, its retreat and its turn; of a target in the gripper, of the
    camera relative to it.
    """
    camera = side_by_side(log, "cam", XYZ)
    target = side_by_side(log, "tgt", XYZ)
    distance = np.linalg.norm(camera - target, axis=1)
    R = rotation_from_quaternion(side_by_side(log, "cam", WXYZ))
    if s.target.on_gripper:
        R_target = rotation_from_quaternion(side_by_side(log, "tgt", WXYZ))
        R = R_target.mT @ R
        camera = np.einsum("nji,nj->ni", R_target, camera - target)
    length = float(np.linalg.norm(np.diff(camera, axis=0), axis=1).sum())
    straight = s.goal.distance_to_go_m(log, s.goal_poses)
    at_goal = float(np.linalg.norm(s.goal_poses[-1][:3, 3]))
    # Under a thousandth of the goal's distance the ratio says nothing: a run that starts at its
    # goal has no straight way to compare with. Nor has one whose goal is no single pose.
    comparable = straight > 1e-3 * at_goal and not s.free_motions
    return {
        "path_length_m": length,
        "path_ratio": length / straight if comparable else None,
        "max_retreat_m": max(0.0, float(distance.max()) - max(float(distance[0]), at_goal)),
        "max_rotation_deg": math.degrees(max(0.0, float(rotation_angle(R[0].T @ R).max()))),
    }


def _image_paths(s: Scenario, log: Log) -> Figures:
    """The paths of the true markers in the image: excursion, overshoot, margin to the border."""
    if s.detector.rows is not None or not s.rows:
        return {}  # of points that are others in every picture there are no paths
    names = tuple(map(str, range(s.rows)))
    uv = np.stack([side_by_side(log, "u_true", names), side_by_side(log, "v_true", names)], axis=-1)
    start = uv[0]
    goal = s.goal_view.uv
    along = goal - start
    # Clipped to the segment: beyond its ends the distance counts from the end, so that an overshoot
    # is an excursion, too.
    length2 = np.maximum((along**2).sum(axis=-1), 1e-12)
    share = np.clip(((uv - start) * along).sum(axis=-1) / length2, 0, 1)
    excursion = np.linalg.norm(uv - start - share[..., None] * along, axis=-1)
    error = (uv - goal).reshape(len(uv), -1)
    first = (start - goal).ravel()
    beyond = -(error @ first) / max(float(first @ first), 1e-12)
    whole = np.isfinite(beyond)
    # Pixel centres are at whole numbers: the picture reaches from -.5 to width - .5.
    margin = np.minimum(uv + 0.5, np.array([s.camera.width, s.camera.height]) - 0.5 - uv)
    known = np.isfinite(excursion)
    return {
        "max_feature_excursion_px": float(excursion[known].max(initial=-math.inf)),
        "feature_overshoot": max(0.0, float(beyond[whole].max())) if whole.any() else None,
        "min_border_margin_px": float(margin[known].min(initial=math.inf)),
    }


def _tracking(s: Scenario, log: Log) -> Figures:
    """True errors of a moving target once settled; a target that the robot itself moves is not
    tracked, but in a continuing task.
    """
    found: Figures = {}
    settled = log["t"] >= s.goal.settle_s
    if not (s.target.moves and (s.goal.continuing or not s.target.on_gripper) and settled.any()):
        return found
    names = [f"{axis}_{{}}_{i}" for i in range(s.rows) for axis in "uv"]
    uv = np.stack([log[name.format("true")] - log[name.format("goal")] for name in names], axis=1)
    rms_px = np.sqrt(np.nanmean(uv[settled] ** 2, axis=1))
    for unit, error in (("px", rms_px), ("m", log["position_error_m"][settled])):
        found[f"tracking_rms_{unit}"] = float(np.sqrt((error**2).sum() / len(error)))
        found[f"tracking_max_{unit}"] = float(error.max())
    return found


def _modes(s: Scenario, log: Log) -> Figures:
    """How a law with `modes` was switched: each change of the mode from one frame to the next is a
    switch.
    """
    words = s.law.modes
    if not words:
        return {}
    mode = log["law_mode"].astype(int)
    switched_s = log["t"][1:][np.diff(mode) != 0]
    share = np.bincount(mode, minlength=len(words)) / len(mode)
    return {
        "law_switches": len(switched_s),
        "law_shortest_stay_s": float(np.diff(switched_s).min()) if len(switched_s) > 1 else None,
        "law_mode_share": dict(zip(words, share.tolist(), strict=True)),
    }


def _link(s: Scenario, log: Log) -> Figures:
    """Pictures that never arrived, pictures that were refused, commands that never arrived; none of
    a run without such effects.
    """
    columns = s.timing.columns
    found: Figures = {}
    refused = int(log["refused"][-1]) if "refused" in columns else 0
    if s.timing.link is not None:
        found["pictures_lost"] = max(0, int(log["frame"].max()) + 1 - len(log["t"]) - refused)
    if "refused" in columns:
        found["pictures_refused"] = refused
    if "command_lost" in columns:
        found["commands_lost"] = int(log["command_lost"].sum())
    return found


def summarise(scenario: Scenario, outcome: Outcome, log: Log) -> dict[str, object]:
    """The metrics of a run; None where one is undefined (no frames, target never seen, no distance
    to the goal).

    time_to_goal_s: time_to_converge_s, or the time of another end with success; of a run that
    failed its limit, `stop.duration_s`.
    limit_s: that limit, which is the price of a failure where runs are compared.
    path_ratio: length of the camera's path over the straight distance between its start and its
        goal; None where `law.redundant` leaves motions free, so that no single pose is the goal.
    max_retreat_m: largest distance of the camera from the target's origin, beyond both its start
    and its goal.
    max_rotation_deg: largest turn away from the starting orientation.
    max_feature_excursion_px: largest distance of a true marker image from the straight line between
    its start and goal.
    feature_overshoot: how far the true marker images went beyond their goals, as a share of the
        way: the largest -(e . e0)/|e0|^2 of the image error e and its start e0, 0 where they never
        did.
    min_border_margin_px: smallest distance of a true marker image to the picture's border, negative
    outside.
    worst_task_error_m: largest true error of a continuing task after its settling time; only for
    such tasks.
    judged_error, judged_unit, judged_limit, judged_by: the error that decides the task at the end
        of the run (of a continuing task the largest one once settled, of a landing the one at the
        first contact), its unit, its limit, and who measured it: `pixels` (the detector),
        `level pixels` (after derotation, of a craft that tilts), `estimate` (the robot's own) or
        `truth`.
    saturated_fraction: share of frames in which the law's limits, the robot's limits or its damping
        near a singularity reduced the command.
    tracking_*: for a moving target (in the gripper, only in continuing tasks), the true error once
    settled
        (`goal.settle_s`): RMS over all coordinates of the markers and the largest of one frame
        [px], RMS and largest distance of the camera from its goal pose [m].
    law_switches, law_shortest_stay_s, law_mode_share: only of a law with `modes`: how often its
        mode changed from one frame to the next, the shortest time between two such changes (None
        with fewer than two), and the share of the frames in each mode.
    pictures_lost, pictures_refused, commands_lost: only with `timing.link`, `out_of_order` or
        `camera_clock`: pictures up to the last one used that never arrived, or arrived after a
        later one (by its stamp); commands that the link lost.
    swung_s, swing_frames: only of a run whose command swung: for how long without a break [s], and
    the period [frames].
    final_error_grey: only of a law that works on grey levels: its RMS difference of picture and
    goal picture at the end. The figures of the scenario's own metrics (`tasks.metrics`) follow.

    outcome: how it ended. log: its columns.
    """
    if not len(log["t"]):
        return _without_frames(scenario)
    limit_s = scenario.stop.duration_s
    converged = _time_to_converge(scenario, log) if outcome is Outcome.converged else None
    figures = _counts(log)
    taken = figures["sim_time_s"] if converged is None else converged
    figures |= {
        "time_to_converge_s": converged,
        "time_to_goal_s": taken if outcome.success else limit_s,
        "limit_s": limit_s,
    }
    for part in (_camera_path, _image_paths, _tracking, _modes, _link, swing):
        figures |= part(scenario, log)
    task = scenario.goal.metrics(log) | scenario.goal.judged(log, scenario.stop).summary()
    ordered = _in_order(figures, task)
    ordered |= own_figures(scenario.metrics, log, scenario.setup)
    return {name: _finite(value) for name, value in ordered.items()}


def _in_order(figures: Figures, task: Figures) -> Figures:
    """Figures as a summary has them; None for those of every run that are unknown."""
    before = FIGURES.index("saturated_fraction")  # the task's own figures stand before it
    ordered = {name: figures.get(name) for name in FIGURES[:before]} | task
    ordered |= {name: figures.get(name) for name in FIGURES[before:] if name not in ordered}
    some = (*SOME_FIGURES, "law_mode_share")
    return ordered | {name: figures[name] for name in some if name in figures}


def _without_frames(scenario: Scenario) -> Figures:
    """The metrics of a run in which no picture arrived."""
    limit_s = scenario.stop.duration_s
    found: Figures = {**dict.fromkeys(FIGURES)}
    found |= {"sim_time_s": 0.0, "frames": 0, "frames_lost": 0, "limit_s": limit_s}
    for metric in scenario.metrics:
        found |= dict.fromkeys(metric.titles)
    return found


def _finite(value: object) -> object:
    """A figure; None for NaN and infinity, which JSON does not have."""
    return None if isinstance(value, float) and not math.isfinite(value) else value
