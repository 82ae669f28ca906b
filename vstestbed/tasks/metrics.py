"""Metrics that a scenario adds to those of every run (`metrics: [...]`), each computed from the log."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from numbers import Real
from typing import Annotated, ClassVar, Literal, Protocol

import numpy as np
from annotated_types import Gt, Le

from vstestbed.core.errors import ParameterError
from vstestbed.core.quantity import Within
from vstestbed.core.registry import Contract
from vstestbed.core.spec import OneOf, spec
from vstestbed.tasks.base import Log
from vstestbed.tasks.monitor import Setup

ERRORS = ("position_error_m", "rotation_error_rad")
Figures = dict[str, object]
QUATERNION = ("cam_qw", "cam_qx", "cam_qy", "cam_qz")
LEAST = 1e-6
"""A start nearer to its goal than this has no share [m, rad]."""


@spec
class StartShares:
    """Distance and angle from the goal at the end as shares of those at the start, by the truth, and the pictures that it took.

    `pictures_to_share` counts the pictures until both are under `share` for the rest of the run; `rotation_path_ratio` is the angle
    that the camera turned through over the angle at the start (of the path in space, `path_ratio` is the same).

    Args:
        share: of the start's distance and angle [1].
    """

    kind: Literal["start_shares"] = "start_shares"
    share: Annotated[float, Gt(0), Le(1)] = 0.1
    titles: ClassVar[Mapping[str, tuple[str, str]]] = {
        "position_share": ("Distance at the end over that at the start", ""),
        "rotation_share": ("Angle at the end over that at the start", ""),
        "pictures_to_share": ("Pictures until both are small for good", ""),
        "rotation_path_ratio": ("Angle turned through over that at the start", ""),
    }

    def figures(self, log: Log, setup: Setup) -> Figures:
        """See `MetricContract`; undefined also where the goal is no single pose."""
        errors = np.column_stack([log[name] for name in ERRORS])
        start, last = errors[0], errors[-1]
        if not (start > LEAST).all():
            return {**dict.fromkeys(self.titles)}
        over = np.flatnonzero((errors >= self.share * start).any(axis=1))
        pictures = int(over[-1]) + 2 if len(over) else 1
        q = np.column_stack([log[name] for name in QUATERNION])
        cosine = np.abs(np.einsum("ij,ij->i", q[1:], q[:-1]))
        sine = np.sqrt(np.maximum(0, 1 - np.minimum(cosine, 1) ** 2))
        turned = float(2 * np.arctan2(sine, cosine).sum())
        found = (*(last / start).tolist(), pictures if pictures <= len(errors) else None, turned / float(start[1]))
        return dict(zip(self.titles, found, strict=True))


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
"""The names of every run's figures."""
SOME_FIGURES = (
    *("law_switches", "law_shortest_stay_s"),  # of a law with modes
    *("pictures_lost", "pictures_refused", "commands_lost"),  # of wrong time stamps, pictures out of order or a link that loses
    "final_error_grey",  # of a law that works on grey levels
    *("swung_s", "swing_frames"),  # of a run whose command swung
)
_COLUMNS = ("scenario", "outcome", "success", "reason", "seed", "folder", "task", "amount", "attempts", "versions", "time_ms")
_OTHERS = ("wall_time_s", "real_time_factor", "worst_task_error_m", "judged_unit", "judged_limit", "judged_by", "law_mode_share")
TAKEN = frozenset((*FIGURES, *SOME_FIGURES, *_COLUMNS, *_OTHERS))
"""Names that a summary or a comparison's table has already."""
TWIST = ("vx", "vy", "vz", "wx", "wy", "wz")


class MetricContract(Protocol):
    """A metric.

    Attributes:
        titles: the figures that it adds to `summary.json`, by name, each with the title and the unit of the reports.
    """

    titles: ClassVar[Mapping[str, tuple[str, str]]]

    @property
    def kind(self) -> str:
        """The word in a scenario."""
        ...

    def figures(self, log: Log, setup: Setup) -> Figures:
        """The figures of one run: a number for each name of `titles`, or None where it is undefined.

        log: its columns by name, each with one row a frame, of one frame at least. setup: the experiment.
        """
        ...


@spec
class ErrorIntegrals:
    """Integrals of the measured image error e (RMS of the coordinates seen [px]) over the run, by the trapezoidal rule.

    iae_px_s = int e dt,  ise_px2_s = int e^2 dt,  itae_px_s2 = int t e dt.  Frames without a measurement are bridged.
    Runs are comparable where they last equally long, or converge.

    Reference: Graham & Lathrop 1953, The synthesis of "optimum" transient response, Trans. AIEE 72(5).
    """

    kind: Literal["error_integrals"] = "error_integrals"
    titles: ClassVar[Mapping[str, tuple[str, str]]] = {
        "iae_px_s": ("Integral of the error", "px s"),
        "ise_px2_s": ("Integral of the squared error", "px² s"),
        "itae_px_s2": ("Integral of time times error", "px s²"),
    }

    def figures(self, log: Log, setup: Setup) -> Figures:
        """See `MetricContract`; undefined for a target that was never seen."""
        t, e = np.asarray(log["t"], dtype=float), np.asarray(log["error_px"], dtype=float)
        t, e = t[np.isfinite(e)], e[np.isfinite(e)]
        found = [float(np.trapezoid(y, t)) for y in (e, e * e, t * e)] if len(e) else [None] * 3
        return dict(zip(self.titles, found, strict=True))


@spec
class CommandVariation:
    """Total variation of the commanded camera twist, TV = sum_k |v_(k+1) - v_k|, of translation and of rotation: less is smoother.

    Reference: Skogestad 2003, J. Process Control 13(4), doi:10.1016/S0959-1524(02)00062-8 (total variation of the input).
    """

    kind: Literal["command_variation"] = "command_variation"
    titles: ClassVar[Mapping[str, tuple[str, str]]] = {
        "command_variation_mps": ("Total variation of the commanded velocity", "m/s"),
        "command_variation_radps": ("Total variation of the commanded rate", "rad/s"),
    }

    def figures(self, log: Log, setup: Setup) -> Figures:
        """See `MetricContract`."""
        steps = np.diff(np.column_stack([log[f"cmd_{name}"] for name in TWIST]), axis=0).reshape(-1, 2, 3)
        return dict(zip(self.titles, np.linalg.norm(steps, axis=2).sum(axis=0).tolist(), strict=True))


@spec
class ErrorGrowth:
    """Frames in which an error is larger than in the frame before: of the image (RMS [px], measured), and of the true position and angle.

    The error of a law's own features falls in every frame under ideal conditions: its square is a Lyapunov function of the law. Errors
    that grow by less than `least` of the largest one of the run count as noise.

    Args:
        least: share of the largest error until then under which a growth is not counted [1].
    """

    kind: Literal["error_growth"] = "error_growth"
    least: Annotated[float, Within(0.0, 1.0, "", "a share of the largest error")] = 1e-4
    titles: ClassVar[Mapping[str, tuple[str, str]]] = {
        "image_error_growth_frames": ("Frames in which the image error grew", ""),
        "position_error_growth_frames": ("Frames in which the position error grew", ""),
        "rotation_error_growth_frames": ("Frames in which the rotation error grew", ""),
    }

    def figures(self, log: Log, setup: Setup) -> Figures:
        """See `MetricContract`."""
        errors = np.column_stack([log[name] for name in ("error_px", "position_error_m", "rotation_error_rad")])
        largest = np.fmax.accumulate(np.nan_to_num(errors, nan=-np.inf), axis=0)
        grew = (np.diff(errors, axis=0) > self.least * largest[1:]).sum(axis=0)
        return dict(zip(self.titles, grew.tolist(), strict=True))


METRICS = OneOf("metric", ErrorIntegrals, CommandVariation, ErrorGrowth, StartShares, contract=Contract(MetricContract))


def own_titles() -> dict[str, tuple[str, str]]:
    """Title and unit of the figures of all registered metrics, by name."""
    return {name: title for metric in METRICS.members.values() for name, title in metric.titles.items()}  # pyright: ignore[reportAttributeAccessIssue] - of the contract


def check_metrics(metrics: Sequence[MetricContract]) -> None:
    """Refuse metrics two of which have a figure of one name, or one that every run has."""
    owner: dict[str, str] = dict.fromkeys(TAKEN, "every run")
    for i, metric in enumerate(metrics):
        for name in metric.titles:
            if name in owner:
                words = f"has a figure {name!r}, which {owner[name]} has already; give it another name in `titles`"
                raise ParameterError(f"metrics.{i}", f"of kind {metric.kind} {words}")
            owner[name] = f"metrics.{i}"


def own_figures(metrics: Sequence[MetricContract], log: Log, setup: Setup) -> Figures:
    """The figures of a scenario's own metrics of one run. Raises ParameterError: they are not those of the titles, or not numbers."""
    return {name: value for metric in metrics for name, value in _figures_of(metric, log, setup).items()}


def _figures_of(metric: MetricContract, log: Log, setup: Setup) -> Figures:
    found, names = metric.figures(log, setup), list(metric.titles)
    if not isinstance(found, dict) or set(found) != set(names):
        raise ParameterError(f"metrics: {metric.kind}", f"figures() must give {', '.join(names)}, as its `titles` say", str(found))
    for name, value in found.items():
        if isinstance(value, bool) or not isinstance(value, Real | None):
            raise ParameterError(f"metrics: {metric.kind}", f"{name} must be a number or None", str(value))
    return {name: float(value) if isinstance(value := found[name], Real) else None for name in names}
