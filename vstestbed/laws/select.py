"""Which markers a law may work with, and the words for why it orders rest."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import all_finite
from vstestbed.features.observation import Goal, Observation
from vstestbed.features.polygon import segments, size, spans_area

Rows = slice | NDArray[np.bool_]
"""Which markers' rows are taken."""
TOO_FEW, NO_DEPTH, NO_POSE = "too few markers in sight", "the depth of the markers in sight cannot be told", "the pose cannot be told"
NO_AREA = "the markers in sight span no area"
"""Why a law orders rest."""
ALL = slice(None)


def usable_rows(observation: Observation, inputs: tuple[str, ...], needed: int) -> Rows | str:
    """The markers for which all of the inputs are known, or why there are fewer than needed.

    Args:
        observation: what was seen.
        inputs: names of fields of the observation, the first of image coordinates (N, 2) or rays (N, 3), the others (N,).
        needed: how many markers it takes.
    """
    if len(observation.uv) >= needed and all(all_finite(getattr(observation, name)) for name in inputs):
        return ALL  # a view is cheaper than a selection
    usable = np.isfinite(getattr(observation, inputs[0])[:, 0])
    seen = usable
    for name in inputs[1:]:
        usable = usable & np.isfinite(getattr(observation, name))
    if np.count_nonzero(usable) >= needed:
        return usable
    return TOO_FEW if np.count_nonzero(seen) < needed else NO_DEPTH


def require_area(goal: Goal) -> None:
    """Refuse a goal view in which the markers' polygon has no size.

    Raises:
        ParameterError: it has none.
    """
    if not spans_area(size(goal.xy), segments(goal.xy)):
        words = "spans no area in the goal view, which is where size is told from; markers may not lie on one line, and they are taken"
        raise ParameterError("target", f"{words} in their order, round the polygon: a bow tie's two loops cancel")
