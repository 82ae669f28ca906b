"""Metrics of a run for `summary.json`, computed from its log."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from vstestbed.core.geometry import Array, rotation_angle, rotation_from_quaternion
from vstestbed.core.outcome import Outcome
from vstestbed.scenario.scenario import Scenario

Columns = Mapping[str, Array]

FIGURES = (
    "sim_time_s",
    "frames",
    "frames_lost",
    "time_to_converge_s",
    "final_error_px",
    "final_position_error_m",
    "final_rotation_error_deg",
    "path_length_m",
    "path_ratio",
    "max_retreat_m",
    "max_rotation_deg",
    "max_feature_excursion_px",
    "feature_overshoot",
    "min_border_margin_px",
    "peak_speed_mps",
    "peak_rate_radps",
    "saturated_fraction",
    "tracking_rms_px",
    "tracking_max_px",
    "tracking_rms_m",
    "tracking_max_m",
    "judged_error",
)
"""The names of a run's figures."""
SATURATED = 0.999
"""A command scaled under this counts as saturated."""


def summarise(scenario: Scenario, outcome: Outcome, log: Columns) -> dict[str, object]:
    """The metrics of a run; None where one is undefined (no frames, target never seen, no distance to the goal).

    path_ratio: length of the camera's path over the straight distance between its start and its goal.
    max_retreat_m: largest distance of the camera from the target's origin, beyond both its start and its goal.
    max_rotation_deg: largest turn away from the starting orientation.
    max_feature_excursion_px: largest distance of a true marker image from the straight line between its start and goal.
    feature_overshoot: how far the true marker images went beyond their goals, as a share of the way: the largest -(e . e0)/|e0|^2 of
        the image error e and its start e0, 0 where they never did.
    min_border_margin_px: smallest distance of a true marker image to the picture's border, negative outside.
    worst_task_error_m: largest true error of a continuing task after its settling time; only for such tasks.
    judged_error, judged_unit, judged_limit, judged_by: the error that decides the task at the end of the run (of a continuing task the
        largest one once settled, of a landing the one at the first contact), its unit, its limit, and who measured it: `pixels`
        (the detector), `level pixels` (after derotation, of a craft that tilts), `estimate` (the robot's own) or `truth`.
    saturated_fraction: share of frames in which the law's limits, the robot's limits or its damping near a
        singularity reduced the command.
    tracking_*: for a moving target (in the gripper, only in continuing tasks), the true error once settled
        (`goal.settle_s`): RMS over all coordinates of the markers and the largest of one frame [px], RMS and largest distance
        of the camera from its goal pose [m].

    Args:
        scenario: the experiment. outcome: how it ended. log: the columns of the log by name, shape (frames,) each.
    """
    frames = len(log["t"])
    figures: dict[str, object] = {
        "sim_time_s": float(log["t"][-1]) if frames else 0.0,
        "frames": frames,
        "frames_lost": int(log["lost"].sum()),
        "time_to_converge_s": _time_to_converge(scenario, outcome, log),
        **_final(log),
        **_path(scenario, log),
        **_image(scenario, log),
        "peak_speed_mps": _peak(log, ("vx", "vy", "vz")),
        "peak_rate_radps": _peak(log, ("wx", "wy", "wz")),
        **scenario.goal.metrics(log),
        **scenario.goal.judged(log, scenario.stop).summary(),
        "saturated_fraction": float(np.mean(log["scale"] < SATURATED)) if frames else None,
        **_tracking(scenario, log),
    }
    return {k: _clean(v) for k, v in figures.items()}


def _clean(value: object) -> object:
    """NaN and infinity as None: JSON has neither."""
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _time_to_converge(scenario: Scenario, outcome: Outcome, log: Columns) -> float | None:
    """Start of the last unbroken stretch in which the goal's conditions held, of a run that converged [s]."""
    if outcome is not Outcome.converged or not len(log["t"]):
        return None
    # From the end backwards: an error that dips under its threshold on the way there has not converged.
    over = np.flatnonzero(~_converged_frames(scenario, log))
    first = int(over[-1]) + 1 if len(over) else 0
    return float(log["t"][first]) if first < len(log["t"]) else None


def _converged_frames(scenario: Scenario, log: Columns) -> NDArray[np.bool_]:
    """Frames in which the conditions of `stop.converged` hold at the last goal view, shape (frames,) bool."""
    counted = scenario.goal_view.counted
    markers = range(len(scenario.target.points)) if counted is None else np.flatnonzero(counted)
    whole = np.all([np.isfinite(log[f"u_{i}"]) for i in markers], axis=0)
    reached, none = scenario.stop.converged, np.full(len(log["t"]), np.nan)
    estimate = [log[name] if reached.by_estimate else none for name in ("est_position_m", "est_rotation_rad")]
    error = log.get("level_error_px", log["error_px"])  # of a craft that tilts, the error by which the judge decides
    rows = zip(whole, error, *estimate, strict=True)
    last_view = log["view"] == len(scenario.goal_views) - 1 if len(scenario.goal_views) > 1 else np.ones(len(whole), dtype=bool)
    return np.array([reached.near(*row) for row in rows]) & last_view & ~log["lost"].astype(bool)


def _final(log: Columns) -> dict[str, object]:
    names = {"final_error_px": "error_px", "final_position_error_m": "position_error_m", "final_rotation_error_deg": "rotation_error_rad"}
    last = {name: float(log[column][-1]) if len(log["t"]) else math.nan for name, column in names.items()}
    last["final_rotation_error_deg"] = math.degrees(last["final_rotation_error_deg"])
    return {k: _clean(v) for k, v in last.items()}


def _columns(log: Columns, prefix: str, names: tuple[str, ...]) -> Array:
    return np.column_stack([log[f"{prefix}_{name}"] for name in names])


def _path(scenario: Scenario, log: Columns) -> dict[str, object]:
    if not len(log["t"]):
        return {"path_length_m": None, "path_ratio": None, "max_retreat_m": None, "max_rotation_deg": None}
    camera, target = _columns(log, "cam", ("x", "y", "z")), _columns(log, "tgt", ("x", "y", "z"))
    length = float(np.linalg.norm(np.diff(camera, axis=0), axis=1).sum())
    # Under 1 mm the ratio says nothing: a run that starts at its goal has no straight way to compare with.
    straight = scenario.goal.distance_to_go_m(log, scenario.goal_poses)
    distance = np.linalg.norm(camera - target, axis=1)
    at_goal = float(np.linalg.norm(scenario.goal_poses[-1][:3, 3]))
    R = rotation_from_quaternion(_columns(log, "cam", ("qw", "qx", "qy", "qz")))
    if scenario.target.on_gripper:  # the path of the gripper, as the camera's path relative to it
        R_target = rotation_from_quaternion(_columns(log, "tgt", ("qw", "qx", "qy", "qz")))
        R, camera = R_target.mT @ R, np.einsum("nji,nj->ni", R_target, camera - target)
        target = np.zeros_like(camera)
        length = float(np.linalg.norm(np.diff(camera, axis=0), axis=1).sum())
    return {
        "path_length_m": length,
        "path_ratio": length / straight if straight > 1e-3 else None,
        "max_retreat_m": max(0.0, float(distance.max()) - max(float(distance[0]), at_goal)),
        "max_rotation_deg": math.degrees(float(rotation_angle(R[0].T @ R).max())),
    }


def _image(scenario: Scenario, log: Columns) -> dict[str, object]:
    camera, n = scenario.camera, len(scenario.target.points)
    if not len(log["t"]):
        return {"max_feature_excursion_px": None, "feature_overshoot": None, "min_border_margin_px": None}
    names = tuple(str(i) for i in range(n))
    uv = np.stack([_columns(log, "u_true", names), _columns(log, "v_true", names)], axis=-1)
    start, goal = uv[0], scenario.goal_view.uv
    along = goal - start
    # Clipped to the segment: beyond its ends the distance counts from the end, so that an overshoot is an excursion, too.
    length2 = np.maximum((along**2).sum(axis=-1), 1e-12)
    share = np.clip(((uv - start) * along).sum(axis=-1) / length2, 0, 1)
    excursion = np.linalg.norm(uv - start - share[..., None] * along, axis=-1)
    error = (uv - goal).reshape(len(uv), -1)
    beyond = -(error @ error[0]) / max(float(error[0] @ error[0]), 1e-12)
    # Pixel centres are at whole numbers: the picture reaches from -.5 to width - .5.
    margin = np.minimum(uv + 0.5, np.array([camera.width, camera.height]) - 0.5 - uv)
    known = np.isfinite(excursion)
    return {
        "max_feature_excursion_px": float(excursion[known].max()) if known.any() else None,
        "feature_overshoot": max(0.0, float(beyond[np.isfinite(beyond)].max())) if np.isfinite(beyond).any() else None,
        "min_border_margin_px": float(margin[known].min()) if known.any() else None,
    }


def _tracking(scenario: Scenario, log: Columns) -> dict[str, object]:
    names = ("tracking_rms_px", "tracking_max_px", "tracking_rms_m", "tracking_max_m")
    settled = log["t"] >= scenario.goal.settle_s
    asked = scenario.goal.continuing or not scenario.target.on_gripper  # a target that the robot itself moves is not tracked
    if not (scenario.target.moves and asked and settled.any()):
        nothing: dict[str, object] = {}
        return nothing | dict.fromkeys(names)
    markers = range(len(scenario.target.points))
    uv = np.stack([log[f"{c}_true_{i}"] - log[f"{c}_goal_{i}"] for i in markers for c in "uv"], axis=1)[settled]
    frames, metres = np.sqrt(np.mean(uv**2, axis=1)), log["position_error_m"][settled]
    values = (np.sqrt(np.mean(frames**2)), frames.max(), np.sqrt(np.mean(metres**2)), metres.max())
    return {name: float(value) for name, value in zip(names, values, strict=True)}


def _peak(log: Columns, names: tuple[str, ...]) -> float | None:
    """Largest true speed or rate of the camera."""
    return float(np.linalg.norm(_columns(log, "act", names), axis=1).max()) if len(log["t"]) else None
