"""Metrics of a run for `summary.json`, computed from its log."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Protocol

import numpy as np

from vstestbed.core.geometry import Array
from vstestbed.core.outcome import Outcome
from vstestbed.loop.link_figures import LinkFigures
from vstestbed.loop.metric_parts import CameraPath, Convergence, Counts, ImagePaths, Modes, Peaks, Tracking
from vstestbed.loop.stability import Swinging
from vstestbed.scenario.scenario import Scenario
from vstestbed.tasks.metrics import FIGURES, SOME_FIGURES, Figures, OwnFigures, Part


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

    Args:
        scenario: the experiment. outcome: how it ended. log: its rows, which are read a block at a time.
    """
    parts: list[Part] = [
        Counts(),
        Convergence(scenario, outcome),
        CameraPath(scenario),
        ImagePaths(scenario),
        Peaks(),
        Tracking(scenario),
        Modes(scenario),
        LinkFigures(scenario),
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
    return {name: _clean(value) for name, value in (ordered | own.figures()).items()}


def _clean(value: object) -> object:
    """NaN and infinity as None: JSON has neither."""
    return None if isinstance(value, float) and not math.isfinite(value) else value
