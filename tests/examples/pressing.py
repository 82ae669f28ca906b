r"""A hybrid law, as a plugin: pictures across the axis of a hole, the force at the wrist along it.

From this folder:

    vstestbed run arm_insert --plugin pressing --set law=pressing \
        --set goal.press_n=null --set goal.seat_s=2

Reference: Raibert & Craig 1981, doi:10.1115/1.3139652.
"""

from typing import Annotated, Literal

from annotated_types import Gt

import vstestbed as vs
from vstestbed.laws.pbvs import PBVS

TOUCH_N = 3.0
"""Pressure from which on the plug touches: well over the noise of the sensor."""


@vs.LAWS.add
@vs.spec
class Pressing(PBVS):
    """As `pbvs`, but for the way along the hole's axis while the plug touches: there the speed is
    gain (force_n - f) / stiffness_npm.

    f is the pressure along the axis [N]. The weight of a tool is part of it, unless the axis is
    horizontal.
    """

    kind: Literal["pressing"] = "pressing"
    force_n: Annotated[float, Gt(0)] = 30.0
    stiffness_npm: Annotated[float, Gt(0)] = 2500.0
    inputs = ("T_camera_target", "wrench")

    def equations(self, view, goal):
        """The error (6,) and L (6, 6): the camera's pose in the goal's frame."""
        e, L = super().equations(view, goal)
        if getattr(view, "wrench", None) is None:  # of a goal view, and where no robot is
            return e, L
        f = -view.wrench[:3] @ view.T_camera_target[:3, 2]
        if f > TOUCH_N:
            axis = goal.T_camera_target[:3, 2]
            e[:3] += ((f - self.force_n) / self.stiffness_npm - axis @ e[:3]) * axis
        return e, L
