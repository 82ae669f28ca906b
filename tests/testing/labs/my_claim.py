"""What has full marks in lab 3: by the pose the camera goes to its goal on a straight line."""

from typing import Literal

import vstestbed as vs

POSE = vs.laws.PBVS()


@vs.LAWS.add
@vs.spec
class MyClaim(vs.ErrorLaw):
    """u = -gain pinv(J B) e with e = (t, theta u) of the camera in the goal's frame."""

    kind: Literal["my_claim"] = "my_claim"
    inputs = ("T_camera_target",)

    def equations(self, view, goal):
        """The error and its Jacobian."""
        return POSE.equations(view, goal)
