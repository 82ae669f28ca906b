"""Why the law has no measurement, in words, for the reason of a run that ends as `target_lost`."""

from __future__ import annotations

import numpy as np

from vstestbed.features.observation import Goal, Observation
from vstestbed.scenario.scenario import Scenario
from vstestbed.tasks.frame import ImageError

NONE_SEEN, FEW_SEEN, NO_PICTURE = "no marker was in sight", "too few markers were in sight", "no picture arrived"
"""Why there is no measurement, where the law itself gives no reason."""
GUESS = ": at the start they may be outside of it, hidden or too small"
"""What a robot may think of markers that it has never found; a judge that sees the truth says which it was (`lost_markers`)."""


def unseen(seen: Observation, goal: Goal, error: ImageError, needed: int) -> str:
    """Why a law that gives no reason has no measurement; "" where it has as many markers as it needs."""
    n = len(seen.uv) if error.all_seen and goal.counted is None else np.count_nonzero(seen.seen)
    return "" if n >= needed else FEW_SEEN if n else NONE_SEEN


def detail(scenario: Scenario, seen: Observation, found: bool, why: str = "") -> str:
    """What the detector says (`why`), or which markers are not seen, by their names, in brackets; "" where they have none, or all are seen.

    Where the detector has not found a single marker in any picture of the run (`found`), what may be wrong instead.
    """
    if why:
        return f" ({why})"
    if not found and scenario.detector.needs_image:
        return f" ({never_found(scenario)})"
    if scenario.detector.changing:
        return ""
    names = [name for name, there in zip(scenario.target.names, seen.seen, strict=False) if not there]
    return f" (not seen: {', '.join(names)})" if names else ""


def never_found(scenario: Scenario) -> str:
    """That a detector of pictures has found nothing from the start on, and the likely causes."""
    if scenario.detector.changing:
        words = f"detector {scenario.detector.kind} has found nothing of the goal's picture in any picture"
        return f"{words}: the start may show too little of it, or from too far aside, or too few points of it are looked for"
    target, n = scenario.target, len(scenario.target.points)
    words = f"detector {scenario.detector.kind} has not found one of {n} marker{'s' * (n != 1)} in any picture"
    if scenario.detector.needs_sheet:
        return f"{words}: at the start the picture may be outside of it, too small, too oblique or without structure"
    if target.shows_markers:
        return words + GUESS
    return f"{words}: the file {target.source.name if target.source else ''} may not show {target.marker.looks(n)} there"
