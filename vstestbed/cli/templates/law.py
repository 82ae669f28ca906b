"""The control law my_law: an error and its Jacobian, from what the camera saw.

    pytest my_law.py
    vstestbed run ibvs_book --plugin my_law.py --set law=my_law

The equation is u = -gain pinv(J B) e, with B the robot's motions, and e = s - s* of the marker
coordinates (x, y) = (X/Z, Y/Z) one after the other. The base class adds the rest: gain, inversion,
feedforward, limits, the field at the picture's border, rest without markers.
"""

from typing import Literal

import vstestbed as vs
import vstestbed.testing
from vstestbed.features.depth import Depth, PnP

POINT = vs.features.Point()


@vs.LAWS.add
@vs.spec
class MyLaw(vs.ErrorLaw):
    """u = -gain pinv(J B) (s - s*).

    Args:
        depth: source of the markers' depth.
    """

    kind: Literal["my_law"] = "my_law"  # its word in a scenario
    # what is annotated is a field in YAML: --set law.depth=goal, estimate, oracle; gain, limits,
    # ... are the base's
    depth: Depth = PnP()
    # what `equations` reads of a view: costly fields are computed only where they are named
    inputs = ("xy", "depth")

    def equations(self, view, goal):
        """The error e (..., 2N) and its Jacobian J (..., 2N, 6): e_dot = J v, v the camera twist,
        for N markers that are all seen.

        view: xy (..., N, 2) and depth (..., N) [m], with leading axes where many runs are simulated
            at once (`vstestbed basin`).
        goal: the same fields at the goal view, without leading axes.
        """
        e = POINT.measure(view.xy) - POINT.measure(goal.xy)
        return e, POINT.interaction(view.xy, view.depth)


def test_my_law():
    """It reaches a goal, passes its state on, and rests where it sees nothing."""
    vstestbed.testing.check_law(MyLaw(gain=1.0))  # type: ignore[arg-type] - a number stands for a gain, as in a scenario
