"""What ends a run: terms that are asked in one order, by a run of the loop frame by frame, and by
many ideal runs as arrays.
"""

from vstestbed.endings.base import Ending, FrameLimits, IdealRuns
from vstestbed.endings.monitors import MONITORS, Monitor, MonitorContract
from vstestbed.endings.plane import PlaneCrossed
from vstestbed.endings.termination import (
    GOES_ON,
    ORDER,
    OUTCOMES,
    OVER_ARRAYS,
    Termination,
    codes,
)

__all__ = [
    "GOES_ON",
    "MONITORS",
    "ORDER",
    "OUTCOMES",
    "OVER_ARRAYS",
    "Ending",
    "FrameLimits",
    "IdealRuns",
    "Monitor",
    "MonitorContract",
    "PlaneCrossed",
    "Termination",
    "codes",
]
