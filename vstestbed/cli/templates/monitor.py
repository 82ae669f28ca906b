"""The monitor my_monitor: a rule of when a run ends, and with which outcome.

    pytest my_monitor.py
    vstestbed run ibvs_book --plugin my_monitor.py --set "monitors=[my_monitor]"

The run ends as `diverged` once the camera is farther from the target than it was at the start, by a
margin.
"""

from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge

import vstestbed as vs
import vstestbed.testing


@vs.MONITORS.add
@vs.spec
class MyMonitor:
    """It ends a run whose camera retreats.

    Args:
        margin_m: how much farther than at the start it may be [m].
    """

    kind: Literal["my_monitor"] = "my_monitor"  # its word in a scenario
    margin_m: Annotated[float, Ge(0)] = 0.5

    def monitor(self, setup):
        """What tests each frame of one run; setup: its robot, camera, target, law, detector."""
        return MyMonitorOfARun(self.margin_m)


class MyMonitorOfARun:
    """What one run remembers."""

    def __init__(self, margin_m):
        self.margin_m = margin_m
        self.limit_m = None

    def update(self, frame):
        """None to go on, or the outcome and its reason. It is the referee: `frame.truth` is the
        simulator's.
        """
        distance = np.linalg.norm(
            frame.truth.T_world_camera[:3, 3] - frame.truth.T_world_target[:3, 3]
        )
        if self.limit_m is None:
            self.limit_m = distance + self.margin_m
        if distance <= self.limit_m:
            return None
        return (
            vs.Outcome.diverged,
            f"the camera is {distance:.2f} m from the target, over {self.limit_m:.2f} m",
        )


def test_my_monitor():
    """It leaves a good run alone, and ends one that retreats."""
    vstestbed.testing.check_monitor(MyMonitor())
    retreats = vs.load("ibvs_retreat", {"detector": "oracle", "law.gain": 1.0})
    vstestbed.testing.check_monitor(MyMonitor(margin_m=0.1), ends=retreats)
