"""Where a craft hovers at the start of a run."""

from __future__ import annotations

from typing import Any

from pydantic import model_validator

from vstestbed.core.quantity import Angle, AngleWidth, Position
from vstestbed.core.spatial import is_matrix, upright
from vstestbed.core.spec import spec

LOWEST_M = 0.2
"""The lowest start: it hovers there, its feet 3 cm above the ground [m]."""


@spec
class FlightPose:
    """Where the craft hovers at the start; in Python also an upright SE3.

    Args:
        xyz: its centre in the world [m].
        yaw_deg: its heading [deg].
    """

    xyz: Position = (0.0, 0.0, 2.0)
    yaw_deg: Angle = 0.0

    @model_validator(mode="before")
    @classmethod
    def _from_matrix(cls, given: Any) -> Any:
        return dict(zip(("xyz", "yaw_deg"), upright(given), strict=True)) if is_matrix(given) else given


@spec
class FlightBox:
    """A box from which random starts are drawn.

    Args:
        xyz: half widths along world axes [m].
        yaw_deg: half width in heading [deg].
        about: the middle of the box; None: the nominal start.
    """

    xyz: Position = (0.0, 0.0, 0.0)
    yaw_deg: AngleWidth = 0.0
    about: FlightPose | None = None


@spec
class FlightStart:
    """Where the craft hovers at the start: `nominal`, and the box from which `random` starts are drawn.

    Args:
        nominal: place and heading at the start of a run without a seed.
        random: the box; None: a seed cannot draw a start.
        drawn_about: the nominal start round which a run with a seed has drawn its own, as its scenario states it; leave it out.
    """

    nominal: FlightPose = FlightPose()
    random: FlightBox | None = None
    drawn_about: FlightPose | None = None
