"""What has full marks in lab 3: by the pose the camera goes to its goal on a straight line, twice
as fast as it turns.
"""

from typing import Literal

import numpy as np

import vstestbed as vs

POSE = vs.laws.PBVS()
FASTER = np.array([2.0, 2.0, 2.0, 1.0, 1.0, 1.0])


@vs.LAWS.add
@vs.spec
class MyClaim(vs.ErrorLaw):
    """u = -gain pinv(J B) e with e = (2 t, theta u) of the camera in the goal's frame, J the
    Jacobian of (t, theta u).
    """

    kind: Literal["my_claim"] = "my_claim"
    inputs = ("T_camera_target",)

    def equations(self, view, goal):
        """The error and its Jacobian."""
        e, J = POSE.equations(view, goal)
        return FASTER * e, J
