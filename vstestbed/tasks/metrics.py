"""The table of metrics that every reader uses, and the metrics that a scenario adds
(`metrics: [...]`), computed from the log.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from numbers import Real
from typing import Annotated, Any, ClassVar, Literal, Protocol

import numpy as np

from vstestbed.core.errors import ParameterError
from vstestbed.core.quantity import Bounded, PositiveShare
from vstestbed.core.registry import Contract, Registry
from vstestbed.core.spec import spec
from vstestbed.tasks.base import Log
from vstestbed.tasks.monitor import Setup

__all__ = [
    "EVERY_RUN",
    "FIGURES",
    "KNOWN",
    "METRICS",
    "OF_A_RUN",
    "RUN_COLUMNS",
    "SOME_FIGURES",
    "SOME_RUNS",
    "TWIST",
    "Figures",
    "Metric",
    "MetricContract",
    "check_metrics",
    "comparable",
    "own_figures",
    "own_metrics",
]

ERRORS = ("position_error_m", "rotation_error_rad")
Figures = dict[str, object]
Titles = Mapping[str, tuple[str, str]]  # title and unit of each figure, by its name
QUATERNION = ("cam_qw", "cam_qx", "cam_qy", "cam_qz")
LEAST = 1e-9  # a start nearer to its goal than this has no share [m, rad]: rounding


@spec
class StartShares:
    """Distance and angle from the goal at the end as shares of those at the start, by the truth,
    and the pictures that it took.

    `pictures_to_share` counts the pictures until both are under `share` for the rest of the run;
    `rotation_path_ratio` is the angle that the camera turned through over the angle at the start
    (of the path in space, `path_ratio` is the same).

    Args:
        share: of the start's distance and angle [1].
    """

    kind: Literal["start_shares"] = "start_shares"
    share: PositiveShare = 0.1
    titles: ClassVar[Titles] = {
        "position_share": ("Distance at the end over that at the start", ""),
        "rotation_share": ("Angle at the end over that at the start", ""),
        "pictures_to_share": ("Pictures until both are small for good", ""),
        "rotation_path_ratio": ("Angle turned through over that at the start", ""),
    }

    def figures(self, log: Log, setup: Setup) -> Figures:
        """See `MetricContract`; undefined also where the goal is no single pose."""
        errors = np.column_stack([log[name] for name in ERRORS])
        start = errors[0]
        last = errors[-1]
        if not (start > LEAST).all():
            return {**dict.fromkeys(self.titles)}
        over = np.flatnonzero((errors >= self.share * start).any(axis=1))
        pictures = int(over[-1]) + 2 if len(over) else 1
        q = np.column_stack([log[name] for name in QUATERNION])
        cosine = np.abs(np.einsum("ij,ij->i", q[1:], q[:-1]))
        sine = np.sqrt(np.maximum(0, 1 - np.minimum(cosine, 1) ** 2))
        turned = float(2 * np.arctan2(sine, cosine).sum())
        within = pictures if pictures <= len(errors) else None
        found = (*(last / start).tolist(), within, turned / float(start[1]))
        return dict(zip(self.titles, found, strict=True))


ANY = -math.inf, math.inf
Runs = Literal["reached", "ended", "any"]
"""Of which runs a metric tells something: of those that reached their goal (times, paths); of each
run at its end (final errors); of any run on its way, so that also failed runs can be compared by
it.
"""


@dataclass(frozen=True)
class Metric:
    """A number of `summary.json` as every reader shows it: pages, tables, figures, terminal."""

    name: str  # key in `summary.json`
    title: str  # title, unit: as shown
    unit: str = ""  # "" for counts and ratios
    scale: float = 1.0  # factor from the number in `summary.json` to the one that is shown
    better: int = -1  # 1: more is better, -1: less is, 0: it describes a run and does not judge it
    of: Runs = "reached"
    where: str = ""  # which runs have it; "" for all
    tile: bool = False  # stands large at the top of a run's page
    compared: bool = False  # is shown of a comparison that names no metrics
    # least and largest that it can be, as in `summary.json`
    within: tuple[float, float] = (0.0, math.inf)

    @classmethod
    def named(cls, name: str) -> Metric:
        """The metric of a key of `summary.json`;
        one that is in no table has its key as its title.
        """
        return KNOWN.get(name) or own_metrics().get(name) or cls(name, name, within=ANY)

    @property
    def label(self) -> str:
        """Title and unit: `Final error [px]`."""
        return f"{self.title} [{self.unit}]" if self.unit else self.title

    @property
    def of_flight(self) -> bool:
        """Whether it is a time within the run [s], which the run's own limit bounds."""
        return self.unit == "s" and self in EVERY_RUN + SOME_RUNS

    @property
    def every_run(self) -> bool:
        """Whether a median is over all runs that have the number, not only over those that reached
        the goal.
        """
        return self.of != "reached"

    @property
    def over(self) -> str:
        """Which runs a median is over, in words."""
        return "all runs" if self.every_run else "the runs that reached the goal"

    @property
    def every_pair(self) -> bool:
        """Whether differences are over all common seeds, too: the number means the same for a run
        that failed.
        """
        return self.of == "any"


MOVING = "a target that moves"
MODES = "a law with modes"
LINK = "a link or a camera clock"
PLUG = "a task of insertion"
EVERY_RUN = (
    Metric("sim_time_s", "Simulated time", "s", better=0),
    Metric("frames", "Frames", better=0),
    Metric("frames_lost", "Frames without target"),
    Metric("time_to_converge_s", "Time to converge", "s", tile=True),
    Metric(
        "time_to_goal_s", "Time to the goal, a failure at its limit", "s", of="any", compared=True
    ),
    Metric("final_error_px", "Measured image error", "px", of="ended", tile=True, compared=True),
    Metric(
        "final_position_error_m",
        "True position error",
        "mm",
        1e3,
        of="ended",
        tile=True,
        compared=True,
    ),
    Metric(
        "final_rotation_error_deg",
        "True rotation error",
        "deg",
        of="ended",
        tile=True,
        compared=True,
    ),
    Metric("path_length_m", "Path length", "m", tile=True),
    Metric("path_ratio", "Path over straight line", "×", compared=True),
    Metric("max_retreat_m", "Largest retreat", "m", compared=True),
    Metric("max_rotation_deg", "Largest rotation", "deg", better=0),
    Metric("max_feature_excursion_px", "Largest feature excursion", "px", compared=True),
    Metric("feature_overshoot", "Overshoot of features", "×", of="any"),
    Metric(
        "min_border_margin_px",
        "Smallest margin to the border",
        "px",
        better=1,
        compared=True,
        within=ANY,
    ),
    Metric("peak_speed_mps", "Peak speed", "m/s", better=0, compared=True),
    Metric("peak_rate_radps", "Peak rate of turn", "rad/s", better=0),
    Metric(
        "saturated_fraction",
        "Frames with a limited command",
        "%",
        1e2,
        compared=True,
        within=(0.0, 1.0),
    ),
    Metric("tracking_rms_px", "Tracking error, RMS", "px", of="any", where=MOVING),
    Metric("tracking_max_px", "Tracking error, largest", "px", of="any", where=MOVING),
    Metric("tracking_rms_m", "Camera from its goal, RMS", "m", of="any", where=MOVING),
    Metric("tracking_max_m", "Camera from its goal, largest", "m", of="any", where=MOVING),
    Metric("judged_error", "Error that decides", within=ANY),
    Metric("limit_s", "Limit of time", "s", better=0, of="any"),
)
"""The metrics that each summary has, in its order; null where one is undefined."""
SOME_RUNS = (
    Metric("law_switches", "Switches of the law", of="any", where=MODES),
    Metric("law_shortest_stay_s", "Shortest time between two switches", "s", of="any", where=MODES),
    Metric("pictures_lost", "Pictures lost", of="any", where=LINK),
    Metric("pictures_refused", "Pictures refused, out of order", of="any", where=LINK),
    Metric("commands_lost", "Commands lost", of="any", where=LINK),
    Metric(
        "final_error_grey",
        "Measured image error",
        "grey levels",
        of="ended",
        where="a law that works on grey levels",
        tile=True,
    ),
    Metric(
        "swung_s",
        "Longest time for which the command swung",
        "s",
        of="any",
        where="a command that swung",
    ),
    Metric(
        "swing_frames",
        "Period of that swing, in frames",
        better=0,
        of="any",
        where="a command that swung",
    ),
    Metric(
        "insertion_m",
        "Depth of the plug in its socket",
        "mm",
        1e3,
        better=1,
        of="any",
        where=PLUG,
        tile=True,
        within=ANY,
    ),
    Metric("largest_force_n", "Largest force on the plug", "N", of="any", where=PLUG, tile=True),
    Metric(
        "final_force_n",
        "Force on the plug over the last second",
        "N",
        better=0,
        of="any",
        where=PLUG,
    ),
)
"""The metrics that a summary has where the run has what they tell of."""
OF_A_RUN = (
    Metric("seed", "Seed", better=0),
    Metric("wall_time_s", "Wall time", "s"),
    Metric(
        "worst_task_error_m",
        "Largest error once settled",
        "m",
        of="any",
        where="a continuing task",
        tile=True,
    ),
    Metric("real_time_factor", "Real-time factor, films included", "×", better=1, tile=True),
)
"""Other numbers of a summary that a run's page shows, and by which no runs are compared unless they
are named.
"""
KNOWN = {metric.name: metric for metric in (*EVERY_RUN, *SOME_RUNS, *OF_A_RUN)}
FIGURES = tuple(m.name for m in EVERY_RUN)
SOME_FIGURES = tuple(m.name for m in SOME_RUNS)
RUN_COLUMNS = {
    "scenario": "name of the scenario",
    "outcome": "how the run ended: `converged`, `timed_out`, `target_lost`, ...",
    "success": "whether that is a success",
    "reason": "why it ended, in a sentence",
    "folder": "of the run, in the comparison's folder",
    "task": "the task, of a comparison with tasks",
    "amount": "what varies in the task: `20 deg`",
    "attempts": "how often it was begun; more than 1: a worker died",
    "versions": "of the packages and the renderer, `versions.NAME`",
    "time_ms": "wall time by part, `time_ms.PART` [ms]",
    "judged_unit": "unit of `judged_error`",
    "judged_limit": "limit of `judged_error`",
    "judged_by": "who measured it: pixels, level pixels, estimate, truth",
    "law_mode_share": "share of the frames in each mode of the law",
}
"""What else a summary, or the row of a run in a comparison's table, has; the varied fields have
columns of their own.
"""
# Names that a summary or a comparison's table has already
TAKEN = frozenset((*KNOWN, *RUN_COLUMNS))
TWIST = ("vx", "vy", "vz", "wx", "wy", "wz")


class MetricContract(Protocol):
    """A metric.

    Attributes:
        titles: the figures that it adds to `summary.json`, by name, each with its title and unit in
            reports and, where they are not 1 and -1, `Metric.scale` and `Metric.better`: ("Charge
            left", "%", 100, 1) is a share that is shown as per cent, and more is better.
    """

    titles: ClassVar[Mapping[str, Any]]

    @property
    def kind(self) -> str:
        """The word in a scenario."""
        ...

    def figures(self, log: Log, setup: Setup) -> Figures:
        """The figures of one run: a number for each name of `titles`, or None where it is
        undefined.

        log: its columns by name, each with one row a frame, of one frame at least. setup: the
            experiment.
        """
        ...


@spec
class ErrorIntegrals:
    """Integrals of the measured image error e (RMS of the coordinates seen [px]) over the run, by
    the trapezoidal rule.

    iae_px_s = int e dt,  ise_px2_s = int e^2 dt,  itae_px_s2 = int t e dt.

    Frames without a measurement are bridged. Runs are comparable where they last equally long, or
    converge.

    Reference: Graham & Lathrop 1953, The synthesis of "optimum" transient response, Trans. AIEE
    72(5).
    """

    kind: Literal["error_integrals"] = "error_integrals"
    titles: ClassVar[Titles] = {
        "iae_px_s": ("Integral of the error", "px s"),
        "ise_px2_s": ("Integral of the squared error", "px² s"),
        "itae_px_s2": ("Integral of time times error", "px s²"),
    }

    def figures(self, log: Log, setup: Setup) -> Figures:
        """See `MetricContract`; undefined for a target that was never seen."""
        known = np.isfinite(log["error_px"])
        t = log["t"][known]
        e = log["error_px"][known]
        found = [float(np.trapezoid(y, t)) for y in (e, e * e, t * e)] if len(e) else [None] * 3
        return dict(zip(self.titles, found, strict=True))


@spec
class CommandVariation:
    """Total variation of the commanded camera twist, TV = sum_k |v_(k+1) - v_k|, of translation and
    of rotation: less is smoother.

    Reference: Skogestad 2003, J. Process Control 13(4), doi:10.1016/S0959-1524(02)00062-8 (total
    variation of the input).
    """

    kind: Literal["command_variation"] = "command_variation"
    titles: ClassVar[Titles] = {
        "command_variation_mps": ("Total variation of the commanded velocity", "m/s"),
        "command_variation_radps": ("Total variation of the commanded rate", "rad/s"),
    }

    def figures(self, log: Log, setup: Setup) -> Figures:
        """See `MetricContract`."""
        twists = np.column_stack([log[f"cmd_{name}"] for name in TWIST])
        steps = np.diff(twists, axis=0).reshape(-1, 2, 3)
        found = np.linalg.norm(steps, axis=2).sum(axis=0).tolist()
        return dict(zip(self.titles, found, strict=True))


@spec
class ErrorGrowth:
    """Frames in which an error is larger than in the frame before: of the image (RMS [px],
    measured), and of the true position and angle.

    The error of a law's own features falls in every frame under ideal conditions: its square is a
    Lyapunov function of the law. Errors that grow by less than `least` of the largest one of the
    run count as noise.

    Args:
        least: share of the largest error until then under which a growth is not counted [1].
    """

    kind: Literal["error_growth"] = "error_growth"
    least: Annotated[float, Bounded(0.0, 1.0, "", "a share of the largest error")] = 1e-4
    titles: ClassVar[Titles] = {
        "image_error_growth_frames": ("Frames in which the image error grew", ""),
        "position_error_growth_frames": ("Frames in which the position error grew", ""),
        "rotation_error_growth_frames": ("Frames in which the rotation error grew", ""),
    }

    def figures(self, log: Log, setup: Setup) -> Figures:
        """See `MetricContract`."""
        errors = np.column_stack(
            [log[name] for name in ("error_px", "position_error_m", "rotation_error_rad")]
        )
        largest = np.fmax.accumulate(np.nan_to_num(errors, nan=-np.inf), axis=0)
        grew = (np.diff(errors, axis=0) > self.least * largest[1:]).sum(axis=0)
        return dict(zip(self.titles, grew.tolist(), strict=True))


METRICS = Registry(
    "metric",
    ErrorIntegrals,
    CommandVariation,
    ErrorGrowth,
    StartShares,
    contract=Contract(MetricContract),
)


def own_metrics() -> dict[str, Metric]:
    """The metrics of all registered kinds, by name."""
    kinds: Any = METRICS.members.values()  # of the contract
    found = {}
    for kind in kinds:
        for name, title in kind.titles.items():
            found[name] = Metric(name, *title, of="any", within=ANY)
    return found


def comparable() -> tuple[str, ...]:
    """Names of all metrics by which runs can be compared."""
    return (*FIGURES, *SOME_FIGURES, *own_metrics())


def check_metrics(metrics: Sequence[MetricContract]) -> None:
    """Refuse metrics two of which have a figure of one name, or one that every run has."""
    owner: dict[str, str] = dict.fromkeys(TAKEN, "every run")
    for i, metric in enumerate(metrics):
        for name in metric.titles:
            if name in owner:
                words = (
                    f"has a figure {name!r}, which {owner[name]} has already;"
                    " give it another name in `titles`"
                )
                raise ParameterError(f"metrics.{i}", f"of kind {metric.kind} {words}")
            owner[name] = f"metrics.{i}"


def own_figures(metrics: Sequence[MetricContract], log: Log, setup: Setup) -> Figures:
    """The figures of a scenario's own metrics of one run. Raises ParameterError: they are not those
    of the titles, or not numbers.
    """
    figures: Figures = {}
    for metric in metrics:
        found = metric.figures(log, setup)
        if not isinstance(found, dict) or set(found) != set(metric.titles):
            words = f"figures() must give {', '.join(metric.titles)}, as its `titles` say"
            raise ParameterError(f"metrics: {metric.kind}", words, str(found))
        for name in metric.titles:
            value = found[name]
            if isinstance(value, bool) or not isinstance(value, Real | None):
                wanted = f"{name} as a number or None"
                field = f"metrics: {metric.kind}"
                raise ParameterError.returned(field, "figures", wanted, str(value))
            figures[name] = None if value is None else float(value)
    return figures
