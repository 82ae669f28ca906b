"""Selection of the markers that a law can use, and the reasons for which laws order rest."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vstestbed.core.geometry import Array, all_finite
from vstestbed.features.base import Feature
from vstestbed.features.observation import Goal, Observation

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


def at_goal(feature: Feature, goal: Goal) -> tuple[Array, Array] | None:
    """Both inputs of a feature in a goal view, of the markers that count and are in it; None where the feature needs more."""
    x, distance = (getattr(goal, name) for name in feature.inputs)
    known = np.isfinite(x[:, 0]) if goal.counted is None else np.isfinite(x[:, 0]) & goal.counted
    return (x[known], distance[known]) if np.count_nonzero(known) >= feature.least_markers else None


def check_goal(feature: Feature, goal: Goal) -> None:
    """Refuse a goal view at which a feature cannot work, as its own `check_goal` says, where it has one.

    Raises:
        ParameterError: it names a field of the scenario.
    """
    check, inputs = getattr(feature, "check_goal", None), at_goal(feature, goal)
    if check is not None and inputs is not None:
        check(*inputs)
