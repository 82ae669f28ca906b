"""Why the law has no measurement, in words, for the reason of a run that ends as `target_lost`."""

from __future__ import annotations

from vstestbed.features.observation import Observation
from vstestbed.scenario.scenario import Scenario

NONE_SEEN, FEW_SEEN, NO_PICTURE = "no marker was in sight", "too few markers were in sight", "no picture arrived"
"""Why there is no measurement, where the law itself gives no reason."""


def detail(scenario: Scenario, seen: Observation, found: bool) -> str:
    """Which markers are not seen, by their names, in brackets; "" where they have none, or all are seen.

    Where the detector has not found a single marker in any picture of the run (`found`), what may be wrong instead.
    """
    if not found and scenario.detector.needs_image:
        return f" ({never_found(scenario)})"
    names = [name for name, there in zip(scenario.target.names, seen.seen, strict=False) if not there]
    return f" (not seen: {', '.join(names)})" if names else ""


def never_found(scenario: Scenario) -> str:
    """That a detector of pictures has found nothing from the start on, and the likely causes."""
    target, n = scenario.target, len(scenario.target.points)
    words = f"detector {scenario.detector.kind} has not found one of {n} marker{'s' * (n != 1)} in any picture"
    if scenario.detector.needs_sheet:
        return f"{words}: at the start the picture may be outside of it, too small, too oblique or without structure"
    if target.shows_markers:
        return f"{words}: at the start they may be outside of it, hidden or too small"
    return f"{words}: the file {target.source.name if target.source else ''} may not show {target.marker.looks(n)} there"
