"""Metrics of a run for `summary.json`, computed from its log."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from vstestbed.core.geometry import Array, rotation_angle, rotation_from_quaternion
from vstestbed.core.outcome import Outcome
from vstestbed.loop.columns import TWIST
from vstestbed.loop.stability import Swinging
from vstestbed.scenario.scenario import Scenario
from vstestbed.tasks.base import Log as Columns
from vstestbed.tasks.metrics import FIGURES, SOME_FIGURES, Figures, OwnFigures, Part

# The parts of a run's metrics, each computed block by block: a log of a day needs no more memory than one of an hour.


SATURATED = 0.999  # a command scaled under this counts as saturated


def side_by_side(log: Columns, prefix: str, names: tuple[str, ...]) -> Array:
    """Columns `prefix_name` as (rows, names)."""
    return np.column_stack([log[f"{prefix}_{name}"] for name in names])


class _Counts:
    """Frames, and the values in the last one."""

    def __init__(self) -> None:
        self._frames = self._lost = self._saturated = 0
        self._last = {"t": 0.0, "error_px": math.nan, "position_error_m": math.nan, "rotation_error_rad": math.nan}

    def add(self, log: Columns) -> None:
        self._frames += len(log["t"])
        self._lost += int(log["lost"].sum())
        self._saturated += int((log["scale"] < SATURATED).sum())
        names = (*self._last, "error_grey") if "error_grey" in log else tuple(self._last)
        self._last |= {name: float(log[name][-1]) for name in names}

    def figures(self) -> Figures:
        found: Figures = {
            "sim_time_s": self._last["t"],
            "frames": self._frames,
            "frames_lost": self._lost,
            "final_error_px": self._last["error_px"],
            "final_position_error_m": self._last["position_error_m"],
            "final_rotation_error_deg": math.degrees(self._last["rotation_error_rad"]),
            "saturated_fraction": self._saturated / self._frames if self._frames else None,
        }
        return found | ({"final_error_grey": self._last["error_grey"]} if "error_grey" in self._last else {})


class _Convergence:
    """Start of the last unbroken stretch in which the goal's conditions held, of a run that converged [s]."""

    def __init__(self, scenario: Scenario, outcome: Outcome):
        self._scenario, self._asked = scenario, outcome is Outcome.converged
        self._since: float | None = None

    def add(self, log: Columns) -> None:
        if not self._asked:
            return
        over = np.flatnonzero(~_converged_frames(self._scenario, log))
        if not len(over):
            self._since = float(log["t"][0]) if self._since is None else self._since
        else:  # an error that dips under its threshold on the way there has not converged
            after = log["t"][int(over[-1]) + 1 :]
            self._since = float(after[0]) if len(after) else None

    def figures(self) -> Figures:
        return {"time_to_converge_s": self._since}


def _converged_frames(scenario: Scenario, log: Columns) -> NDArray[np.bool_]:
    """Frames in which the conditions of `stop.converged` hold at the last goal view, shape (frames,) bool."""
    counted = scenario.goal_view.counted
    markers = range(scenario.rows) if counted is None else np.flatnonzero(counted)
    # A detector of other points leaves rows empty, in the goal's columns, too.
    whole = np.all([np.isfinite(log[f"u_{i}"]) | np.isnan(log[f"u_goal_{i}"]) for i in markers], axis=0)
    reached, none = scenario.stop.converged, np.full(len(log["t"]), np.nan)
    estimate = [log[name] if reached.by_estimate else none for name in ("est_position_m", "est_rotation_rad")]
    error = log.get("level_error_px", log["error_px"])  # of a craft that tilts, the error by which the judge decides
    rows = zip(np.broadcast_to(whole, len(none)), error, *estimate, log.get("error_grey", none), strict=True)
    last_view = log["view"] == len(scenario.goal_views) - 1 if len(scenario.goal_views) > 1 else np.ones(len(none), dtype=bool)
    return np.array([reached.near(*row) for row in rows]) & last_view & ~log["lost"].astype(bool)


class _CameraPath:
    """Length of the camera's path, its retreat and its turn; of a target in the gripper, of the camera relative to it."""

    def __init__(self, scenario: Scenario):
        self._scenario = scenario
        self._length = self._farthest = self._turn = 0.0
        self._straight = self._distance = math.nan
        self._last: Array | None = None
        self._R = np.eye(3)

    def add(self, log: Columns) -> None:
        s = self._scenario
        camera, target = side_by_side(log, "cam", ("x", "y", "z")), side_by_side(log, "tgt", ("x", "y", "z"))
        distance = np.linalg.norm(camera - target, axis=1)
        R = rotation_from_quaternion(side_by_side(log, "cam", ("qw", "qx", "qy", "qz")))
        if s.target.on_gripper:
            R_target = rotation_from_quaternion(side_by_side(log, "tgt", ("qw", "qx", "qy", "qz")))
            R, camera = R_target.mT @ R, np.einsum("nji,nj->ni", R_target, camera - target)
        if self._last is None:
            self._R, self._distance, self._straight = R[0], float(distance[0]), s.goal.distance_to_go_m(log, s.goal_poses)
        way = camera if self._last is None else np.vstack([self._last, camera])
        self._last = camera[-1]
        self._length += float(np.linalg.norm(np.diff(way, axis=0), axis=1).sum())
        self._farthest = max(self._farthest, float(distance.max()))
        self._turn = float(np.maximum(self._turn, rotation_angle(self._R.T @ R).max()))

    def figures(self) -> Figures:
        if self._last is None:
            nothing: Figures = {}
            return nothing | dict.fromkeys(("path_length_m", "path_ratio", "max_retreat_m", "max_rotation_deg"))
        at_goal = float(np.linalg.norm(self._scenario.goal_poses[-1][:3, 3]))
        return {
            "path_length_m": self._length,
            # Under 1 mm the ratio says nothing: a run that starts at its goal has no straight way to compare with. Nor has one whose goal
            # is no single pose.
            "path_ratio": self._length / self._straight if self._straight > 1e-3 and not self._scenario.free_motions else None,
            "max_retreat_m": max(0.0, self._farthest - max(self._distance, at_goal)),
            "max_rotation_deg": math.degrees(self._turn),
        }


class _ImagePaths:
    """The paths of the true markers in the image: excursion, overshoot, margin to the border."""

    def __init__(self, scenario: Scenario):
        self._camera, self._goal = scenario.camera, scenario.goal_view.uv
        # Of points that are others in every picture there are no paths.
        self._names = tuple(str(i) for i in range(scenario.rows)) if scenario.detector.rows is None else ()
        self._start: Array | None = None
        self._excursion = self._beyond = -math.inf
        self._margin = math.inf

    def add(self, log: Columns) -> None:
        if not self._names:
            return
        uv = np.stack([side_by_side(log, "u_true", self._names), side_by_side(log, "v_true", self._names)], axis=-1)
        self._start = start = uv[0] if self._start is None else self._start
        along = self._goal - start
        # Clipped to the segment: beyond its ends the distance counts from the end, so that an overshoot is an excursion, too.
        length2 = np.maximum((along**2).sum(axis=-1), 1e-12)
        share = np.clip(((uv - start) * along).sum(axis=-1) / length2, 0, 1)
        excursion = np.linalg.norm(uv - start - share[..., None] * along, axis=-1)
        error, first = (uv - self._goal).reshape(len(uv), -1), (start - self._goal).ravel()
        beyond = -(error @ first) / max(float(first @ first), 1e-12)
        # Pixel centres are at whole numbers: the picture reaches from -.5 to width - .5.
        margin = np.minimum(uv + 0.5, np.array([self._camera.width, self._camera.height]) - 0.5 - uv)
        known = np.isfinite(excursion)
        self._excursion = max(self._excursion, float(excursion[known].max(initial=-math.inf)))
        self._beyond = max(self._beyond, float(beyond[np.isfinite(beyond)].max(initial=-math.inf)))
        self._margin = min(self._margin, float(margin[known].min(initial=math.inf)))

    def figures(self) -> Figures:
        """See `Part`; an infinity stands for a figure that is undefined."""
        return {
            "max_feature_excursion_px": self._excursion,
            "feature_overshoot": max(0.0, self._beyond) if math.isfinite(self._beyond) else None,
            "min_border_margin_px": self._margin,
        }


class _Peaks:
    """Largest true speed and rate of the camera."""

    def __init__(self) -> None:
        self._peaks = np.full(2, -math.inf)

    def add(self, log: Columns) -> None:
        peaks = [np.linalg.norm(side_by_side(log, "act", names), axis=1).max() for names in (TWIST[:3], TWIST[3:])]
        self._peaks = np.maximum(self._peaks, peaks)

    def figures(self) -> Figures:
        return {"peak_speed_mps": float(self._peaks[0]), "peak_rate_radps": float(self._peaks[1])}


class _Tracking:
    """True errors of a moving target once settled."""

    def __init__(self, scenario: Scenario):
        # A target that the robot itself moves is not tracked.
        self._asked = scenario.target.moves and (scenario.goal.continuing or not scenario.target.on_gripper)
        self._settle_s, self._names = scenario.goal.settle_s, tuple(str(i) for i in range(scenario.rows))
        self._frames, self._squares, self._largest = 0, np.zeros(2), np.zeros(2)

    def add(self, log: Columns) -> None:
        settled = log["t"] >= self._settle_s
        if not (self._asked and settled.any()):
            return
        uv = np.stack([log[f"{c}_true_{i}"] - log[f"{c}_goal_{i}"] for i in self._names for c in "uv"], axis=1)[settled]
        errors = np.sqrt(np.nanmean(uv**2, axis=1)), log["position_error_m"][settled]
        self._frames += len(uv)
        self._squares = self._squares + [(error**2).sum() for error in errors]
        self._largest = np.maximum(self._largest, [error.max() for error in errors])

    def figures(self) -> Figures:
        names = ("tracking_rms_px", "tracking_max_px", "tracking_rms_m", "tracking_max_m")
        if not self._frames:
            nothing: Figures = {}
            return nothing | dict.fromkeys(names)
        rms = np.sqrt(self._squares / self._frames)
        return dict(zip(names, map(float, (rms[0], self._largest[0], rms[1], self._largest[1])), strict=True))


class _Modes:
    """How a law with `modes` was switched: each change of the mode from one frame to the next is a switch."""

    def __init__(self, scenario: Scenario):
        self._words = scenario.law.modes
        self._frames = np.zeros(len(self._words), dtype=int)
        self._last: Array = np.empty((0, 2))  # time and mode of the last frame: a switch may lie between two blocks
        self._switched_s: list[float] = []

    def add(self, log: Columns) -> None:
        if not self._words:
            return
        rows = np.vstack([self._last, np.column_stack([log["t"], log["law_mode"]])])
        self._switched_s += rows[1:, 0][np.diff(rows[:, 1]) != 0].tolist()
        self._frames += np.bincount(log["law_mode"].astype(int), minlength=len(self._words))
        self._last = rows[-1:]

    def figures(self) -> Figures:
        """See `Part`; none for a law without modes."""
        if not self._words:
            return {}
        frames = max(int(self._frames.sum()), 1)
        return {
            "law_switches": len(self._switched_s),
            "law_shortest_stay_s": float(np.diff(self._switched_s).min()) if len(self._switched_s) > 1 else None,
            "law_mode_share": {word: int(n) / frames for word, n in zip(self._words, self._frames, strict=True)},
        }


class _LinkFigures:
    """Pictures that never arrived, pictures that were refused, commands that never arrived; none of a run without such effects."""

    def __init__(self, scenario: Scenario):
        self._counts_pictures, self._columns = scenario.timing.link is not None, scenario.timing.columns
        self._used = self._refused = self._commands = 0
        self._sent = 0

    def add(self, log: Columns) -> None:
        self._used += len(log["t"])
        self._sent = max(self._sent, int(log["frame"].max()) + 1)
        if "refused" in self._columns:
            self._refused = int(log["refused"][-1])
        if "command_lost" in self._columns:
            self._commands += int(log["command_lost"].sum())

    def figures(self) -> Figures:
        found: Figures = {"pictures_lost": max(0, self._sent - self._used - self._refused)} if self._counts_pictures else {}
        found |= {"pictures_refused": self._refused} if "refused" in self._columns else {}
        return found | ({"commands_lost": self._commands} if "command_lost" in self._columns else {})


class Blocks(Protocol):
    """The rows of a log (`recording.Rows`), as the metrics need them."""

    columns: tuple[str, ...]

    def blocks(self, names: Sequence[str] | None = None) -> Iterator[dict[str, Array]]:
        """The rows in their order, some thousands at a time; `names`: only these columns."""
        ...


class WholeColumns(Mapping[str, Array]):
    """The columns of a log by name, each read as a whole when it is first asked for."""

    def __init__(self, log: Blocks):
        self._log = log
        self._read: dict[str, Array] = {}

    def __getitem__(self, name: str) -> Array:
        if name not in self._log.columns:
            raise KeyError(name)
        if name not in self._read:
            self._read[name] = np.concatenate([np.zeros(0), *(block[name] for block in self._log.blocks([name]))])
        return self._read[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._log.columns)

    def __len__(self) -> int:
        return len(self._log.columns)


def summarise(scenario: Scenario, outcome: Outcome, log: Blocks) -> dict[str, object]:
    """The metrics of a run; None where one is undefined (no frames, target never seen, no distance to the goal).

    path_ratio: length of the camera's path over the straight distance between its start and its goal; None where
        `law.redundant` leaves motions free, so that no single pose is the goal.
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
    law_switches, law_shortest_stay_s, law_mode_share: only of a law with `modes`: how often its mode changed from one frame to the next,
        the shortest time between two such changes (None with fewer than two), and the share of the frames in each mode.
    pictures_lost, pictures_refused, commands_lost: only with `timing.link`, `out_of_order` or `camera_clock`: pictures up to the last
        one used that never arrived, or arrived after a later one (by its stamp); commands that the link lost.
    swung_s, swing_frames: only of a run whose command swung: for how long without a break [s], and the period [frames].
    final_error_grey: only of a law that works on grey levels: its RMS difference of picture and goal picture at the end.
    The figures of the scenario's own metrics (`tasks.metrics`) follow.

    outcome: how it ended. log: its rows, which are read a block at a time.
    """
    parts: list[Part] = [
        _Counts(),
        _Convergence(scenario, outcome),
        _CameraPath(scenario),
        _ImagePaths(scenario),
        _Peaks(),
        _Tracking(scenario),
        _Modes(scenario),
        _LinkFigures(scenario),
        Swinging(scenario),
    ]
    own = OwnFigures(scenario.metrics, scenario.setup)
    for block in log.blocks():
        for part in (*parts, own):
            part.add(block)
    figures = {name: value for part in parts for name, value in part.figures().items()}
    columns, before = WholeColumns(log), FIGURES.index("saturated_fraction")  # the task's own figures stand before it
    task = scenario.goal.metrics(columns) | scenario.goal.judged(columns, scenario.stop).summary()
    ordered: Figures = {name: figures[name] for name in FIGURES[:before]} | task
    ordered |= {name: figures[name] for name in (*FIGURES[before:], *SOME_FIGURES, "law_mode_share") if name in figures}
    figures = (ordered | own.figures()).items()  # NaN and infinity as None: JSON has neither
    return {name: None if isinstance(value, float) and not math.isfinite(value) else value for name, value in figures}
