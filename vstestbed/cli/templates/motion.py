"""The motion of a target my_motion, as a displacement in time.

    pytest my_motion.py
    vstestbed run arm_track_circle --plugin my_motion.py --set target.motion=my_motion

The target goes along a figure of eight in its own plane: D(t) = (a sin wt, a sin wt cos wt, 0), w =
2 pi f.
"""

import math
from typing import Annotated, Literal

import numpy as np
from annotated_types import Gt

import vstestbed as vs
import vstestbed.testing


@vs.MOTIONS.add
@vs.spec
class MyMotion(vs.MotionBase):
    """D(t) = (a sin wt, a sin wt cos wt, 0).

    Args:
        amplitude_m: a [m].
        frequency_hz: f [Hz].
    """

    kind: Literal["my_motion"] = "my_motion"  # its word in a scenario
    amplitude_m: Annotated[float, Gt(0)] = 0.08
    frequency_hz: Annotated[float, Gt(0)] = 0.1

    def path(self, rng):
        """The displacement (4, 4) from the pose at rest, along the target's own axes, as a function
        of time [s].

        What is random is drawn from `rng`, the run's own, and must be the same whenever a time is
        asked for again; a motion that draws has the line `draws = True`.
        """
        a, w = self.amplitude_m, 2 * math.pi * self.frequency_hz

        def at(t):
            D = np.eye(4)
            D[:2, 3] = a * math.sin(w * t), a * math.sin(w * t) * math.cos(w * t)
            return D

        return at


def test_my_motion():
    """It is continuous, rigid, and the same for the same seed."""
    vstestbed.testing.check_motion(MyMotion())
