"""Where a craft that flies starts."""

from __future__ import annotations

from vstestbed.core.quantity import Angle, AngleWidth, Position
from vstestbed.core.spec import spec

LOWEST_M = 0.2
"""The lowest start: it hovers there, its feet 3 cm above the ground [m]."""


@spec
class FlightPose:
    """Where the craft hovers at the start: its centre in the world [m], its heading [deg]."""

    xyz: Position = (0.0, 0.0, 2.0)
    yaw_deg: Angle = 0.0


@spec
class FlightBox:
    """Half widths of a box of starts: along world axes [m], in heading [deg]; `about` is its middle, else the nominal start."""

    xyz: Position = (0.0, 0.0, 0.0)
    yaw_deg: AngleWidth = 0.0
    about: FlightPose | None = None


@spec
class FlightStart:
    """Where the craft hovers at the start: `nominal`, and the box from which `random` starts are drawn."""

    nominal: FlightPose = FlightPose()
    random: FlightBox | None = None
