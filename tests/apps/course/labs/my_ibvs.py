"""What has full marks in lab 1: points with the Jacobian of either view or their mean, and the pose
where it must not retreat.
"""

from typing import Literal

import numpy as np

import vstestbed as vs

POSE = vs.laws.PBVS()


def rows(xy, depth):
    """The image Jacobian of points (..., 2N, 6) for normalised coordinates xy (..., N, 2) and
    depths (..., N) [m].
    """
    x, y = xy[..., 0], xy[..., 1]
    z = np.broadcast_to(depth, x.shape)
    zero = np.zeros_like(x)
    of_x = np.stack([-1 / z, zero, x / z, x * y, -(1 + x * x), y], axis=-1)
    of_y = np.stack([zero, -1 / z, y / z, 1 + y * y, -x * y, -x], axis=-1)
    return np.stack([of_x, of_y], axis=-2).reshape(*x.shape[:-1], -1, 6)


@vs.LAWS.add
@vs.spec
class MyIbvs(vs.ErrorLaw):
    """u = -gain pinv(J B) (s - s*).

    Args:
        jacobian: of which view it is.
        retreat: whether the camera may go back where it has to turn; otherwise the pose is the
            error.
    """

    kind: Literal["my_ibvs"] = "my_ibvs"
    jacobian: Literal["present", "goal", "mean"] = "present"
    retreat: bool = True
    inputs = ("xy", "depth", "T_camera_target")

    def equations(self, view, goal):
        """The error and its Jacobian."""
        if not self.retreat:
            return POSE.equations(view, goal)
        e = (view.xy - goal.xy).reshape(*view.xy.shape[:-2], -1)
        now, then = rows(view.xy, view.depth), rows(goal.xy, goal.depth)
        J = {"present": now, "goal": np.broadcast_to(then, now.shape), "mean": (now + then) / 2}[
            self.jacobian
        ]
        return e, J
