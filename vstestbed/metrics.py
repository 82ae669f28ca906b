"""A run in numbers: what `summary.json` holds, computed from the log."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from vstestbed.geometry import Array, rotation_angle, rotation_from_quaternion

if TYPE_CHECKING:
    from vstestbed.recording import Recording

SATURATED = 0.999
"""A command scaled under this counts as saturated."""


def summarise(recording: Recording) -> dict[str, object]:
    """All figures of a run; None where a figure has no meaning (no frames, never seen, no distance to go).

    path_ratio: length of the camera's path over the straight distance between its start and its goal.
    max_retreat_m: how much farther from the target's origin the camera came than both its start and its goal.
    max_rotation_deg: largest turn away from the starting orientation.
    max_feature_excursion_px: largest distance of a true marker image from the straight line between its start and goal.
    min_border_margin_px: smallest distance of a true marker image to the picture's border, negative outside.
    time_ms: wall time by part, mean per frame [ms].
    """
    r = recording
    frames = len(r.table)
    sim_time = float(r["t"][-1]) if frames else 0.0
    figures: dict[str, object] = {
        "scenario": r.scenario.name,
        "outcome": r.outcome.name,
        "success": r.outcome.success,
        "reason": r.reason,
        "seed": r.scenario.seed,
        "sim_time_s": sim_time,
        "frames": frames,
        "frames_lost": int(r["lost"].sum()),
        "time_to_converge_s": _time_to_converge(r),
        **_final(r),
        **_path(r),
        **_image(r),
        "peak_speed_mps": _peak(r, ("vx", "vy", "vz")),
        "peak_rate_radps": _peak(r, ("wx", "wy", "wz")),
        "saturated_fraction": float(np.mean(r["scale"] < SATURATED)) if frames else None,
        "wall_time_s": r.wall_time_s,
        "real_time_factor": sim_time / r.wall_time_s if r.wall_time_s > 0 else None,
        "time_ms": {k: v / max(frames, 1) for k, v in r.time_ms.items()},
        "versions": r.versions,
    }
    return {k: _clean(v) for k, v in figures.items()}


def _clean(value: object) -> object:
    """NaN and infinity as None, which JSON has a word for."""
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _time_to_converge(r: Recording) -> float | None:
    """Start of the last unbroken stretch under the threshold, when the run converged [s]."""
    if r.outcome.name != "converged" or not len(r.table):
        return None
    over = np.flatnonzero(~(r["error_px"] < r.scenario.stop.converged.error_px))
    return float(r["t"][over[-1] + 1]) if len(over) else float(r["t"][0])


def _final(r: Recording) -> dict[str, object]:
    names = {"final_error_px": "error_px", "final_position_error_m": "position_error_m", "final_rotation_error_deg": "rotation_error_rad"}
    last = {name: float(r[column][-1]) if len(r.table) else math.nan for name, column in names.items()}
    last["final_rotation_error_deg"] = math.degrees(last["final_rotation_error_deg"])
    return {k: _clean(v) for k, v in last.items()}


def _columns(r: Recording, prefix: str, names: tuple[str, ...]) -> Array:
    return np.column_stack([r[f"{prefix}_{name}"] for name in names])


def _path(r: Recording) -> dict[str, object]:
    if not len(r.table):
        return dict.fromkeys(("path_length_m", "path_ratio", "max_retreat_m", "max_rotation_deg"))
    camera, target = _columns(r, "cam", ("x", "y", "z")), _columns(r, "tgt", ("x", "y", "z"))
    length = float(np.linalg.norm(np.diff(camera, axis=0), axis=1).sum())
    straight = float(r["position_error_m"][0])
    distance = np.linalg.norm(camera - target, axis=1)
    at_goal = float(np.linalg.norm(r.scenario.goal_view.T_camera_target[:3, 3]))
    R = rotation_from_quaternion(_columns(r, "cam", ("qw", "qx", "qy", "qz")))
    return {
        "path_length_m": length,
        "path_ratio": length / straight if straight > 1e-3 else None,
        "max_retreat_m": max(0.0, float(distance.max()) - max(float(distance[0]), at_goal)),
        "max_rotation_deg": math.degrees(float(rotation_angle(R[0].T @ R).max())),
    }


def _image(r: Recording) -> dict[str, object]:
    camera, n = r.scenario.camera, len(r.scenario.target.points)
    if not len(r.table):
        return {"max_feature_excursion_px": None, "min_border_margin_px": None}
    uv = np.stack([_columns(r, "u_true", tuple(str(i) for i in range(n))), _columns(r, "v_true", tuple(str(i) for i in range(n)))], axis=-1)
    start, goal = uv[0], r.scenario.goal_view.uv
    along = goal - start
    length2 = np.maximum((along**2).sum(axis=-1), 1e-12)
    share = np.clip(((uv - start) * along).sum(axis=-1) / length2, 0, 1)
    excursion = np.linalg.norm(uv - start - share[..., None] * along, axis=-1)
    margin = np.minimum(uv + 0.5, np.array([camera.width, camera.height]) - 0.5 - uv)
    known = np.isfinite(excursion)
    return {
        "max_feature_excursion_px": float(excursion[known].max()) if known.any() else None,
        "min_border_margin_px": float(margin[known].min()) if known.any() else None,
    }


def _peak(r: Recording, names: tuple[str, ...]) -> float | None:
    """Largest true speed or rate of the camera."""
    return float(np.linalg.norm(_columns(r, "act", names), axis=1).max()) if len(r.table) else None
