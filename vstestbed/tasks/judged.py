"""The error by which a task is judged: its value at the end of a run, its limit, and who measured it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from typing import Literal, NamedTuple

import numpy as np

from vstestbed.core.geometry import Array
from vstestbed.tasks.stop import Converged, Stop

By = Literal["pixels", "level pixels", "grey levels", "estimate", "truth"]
MEASURED_BY: dict[By, str] = {
    "pixels": "measured pixels",
    "level pixels": "measured pixels after derotation",
    "grey levels": "the difference of the pictures",
    "estimate": "the robot's own estimate",
    "truth": "the simulator's truth",
}
"""The same in words; level pixels are those of a craft that tilts."""


def in_words_unit(value: float, unit: str) -> tuple[float, str]:
    """A value and its unit as people read it: angles in degrees, as in scenarios."""
    return (math.degrees(value), "deg") if unit == "rad" else (value, unit)


class JudgedError(NamedTuple):
    """The error that decides a task.

    Attributes:
        value: at the end of the run, in `unit`; NaN where it is unknown.
        unit: px, grey levels, m, rad, or m/s (the speed of a touch-down). limit: the task is reached under it. by: who measured it.
    """

    value: float
    unit: Literal["px", "grey levels", "m", "rad", "m/s"]
    limit: float
    by: By

    def summary(self) -> dict[str, object]:
        """Its entries in `summary.json`."""
        value = self.value if math.isfinite(self.value) else None
        return {"judged_error": value, "judged_unit": self.unit, "judged_limit": self.limit, "judged_by": self.by}


def by_convergence(log: Mapping[str, Array], converged: Converged) -> JudgedError:
    """The error that `stop.converged` tests at the end of a run; of several, the one that is largest compared with its limit."""
    found: list[JudgedError] = []
    if converged.error_px is not None:
        column, by = ("level_error_px", "level pixels") if "level_error_px" in log else ("error_px", "pixels")
        found.append(JudgedError(_last(log, column), "px", converged.error_px, by))
    if converged.error_grey is not None:
        found.append(JudgedError(_last(log, "error_grey"), "grey levels", converged.error_grey, "grey levels"))
    if converged.position_m is not None:
        found.append(JudgedError(_last(log, "est_position_m"), "m", converged.position_m, "estimate"))
    if converged.rotation_deg is not None:
        found.append(JudgedError(_last(log, "est_rotation_rad"), "rad", math.radians(converged.rotation_deg), "estimate"))
    return largest(found)


def largest(errors: Iterable[JudgedError]) -> JudgedError:
    """The error that is largest compared with its limit; an unknown one comes first: no task is done with it."""
    return max(errors, key=lambda error: math.inf if math.isnan(error.value) else error.value / error.limit)


def at_worst(log: Mapping[str, Array], column: str, limit: float, settle_s: float) -> JudgedError:
    """The largest magnitude of a true error [m] from settle_s [s] on."""
    settled = np.abs(log[column][log["t"] >= settle_s])
    return JudgedError(float(settled.max()) if len(settled) else math.nan, "m", limit, "truth")


def at_the_end(log: Mapping[str, Array], column: str, limit: float, unit: Literal["m", "m/s"] = "m") -> JudgedError:
    """A true error in the last frame."""
    return JudgedError(_last(log, column), unit, limit, "truth")


def in_a_frame(judged: Callable[[Mapping[str, Array], Stop], JudgedError], stop: Stop, values: Mapping[str, float]) -> JudgedError:
    """The error by which a task is judged, in one frame; judged: `Task.judged`. values: `error_px` and the task's own columns."""
    # A continuing task is judged by its error once settled: at t = inf it is that of this frame.
    return judged({name: np.array([value]) for name, value in values.items()} | {"t": np.array([np.inf])}, stop)


def _last(log: Mapping[str, Array], column: str) -> float:
    return float(log[column][-1]) if len(log["t"]) else math.nan
