"""Selection of the markers that a law can use, and the reasons for which laws order rest."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import all_finite
from vstestbed.features.observation import Goal, Observation
from vstestbed.features.polygon import segments, size, spans_area

Rows = slice | NDArray[np.bool_]
"""Selection of markers along the first axis of an array."""
TOO_FEW, NO_DEPTH, NO_POSE = "too few markers in sight", "the depth of the markers in sight is unknown", "the pose cannot be estimated"
NO_AREA = "the markers in sight span no area"
"""Reasons for rest (`Command.rest_reason`); a run that ends as `target_lost` quotes them."""
ALL = slice(None)


def usable_rows(observation: Observation, inputs: tuple[str, ...], needed: int) -> Rows | str:
    """The markers with all inputs known, or the reason for rest if there are fewer than needed.

    Args:
        observation: of this frame.
        inputs: names of fields of the observation, the first of image coordinates (N, 2) or rays (N, 3), the others (N,).
        needed: the least number of markers.
    """
    if len(observation.uv) >= needed and all(all_finite(getattr(observation, name)) for name in inputs):
        return ALL  # the usual frame: a slice gives views, where a mask would copy
    usable = np.isfinite(getattr(observation, inputs[0])[:, 0])
    seen = usable
    for name in inputs[1:]:
        usable = usable & np.isfinite(getattr(observation, name))
    if np.count_nonzero(usable) >= needed:
        return usable
    return TOO_FEW if np.count_nonzero(seen) < needed else NO_DEPTH


def require_area(goal: Goal) -> None:
    """Refuse a goal view in which the markers' polygon has no area.

    Raises:
        ParameterError: the markers lie on one line, or the polygon crosses itself so that its loops cancel.
    """
    if not spans_area(size(goal.xy), segments(goal.xy)):
        words = "spans no area in the goal view, by which the law measures size; the markers must not lie on one line, and must be in"
        raise ParameterError("target", f"{words} order around the polygon: the areas of a bow tie's two loops cancel")
