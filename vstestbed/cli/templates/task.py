"""The task my_task, by its goal views.

    pytest my_task.py
    vstestbed run ibvs_book --plugin my_task.py --set "goal={kind: my_task}"

The camera is to see the target straight from the front, at a distance, turned about the optical
axis.
"""

import math
from typing import Annotated, Literal

import numpy as np
from annotated_types import Gt

import vstestbed as vs
import vstestbed.testing


@vs.GOALS.add
@vs.spec
class MyTask(vs.TaskBase):
    """One view; `vs.TaskBase` ends the run when `stop.converged` holds there. Several poses are
    taken in turn by `kind: views`.

    Args:
        distance_m: distance from the camera to the target [m].
        turn_deg: angle about the optical axis [deg].
    """

    kind: Literal["my_task"] = "my_task"  # its word in a scenario
    distance_m: Annotated[float, Gt(0)] = 1.0
    turn_deg: float = 20.0

    def goal_poses(self, target, mount):
        """T_camera_target (4, 4) of each goal view:
        the target's pose in the camera's frame there.
        """
        c, s = math.cos(math.radians(self.turn_deg)), math.sin(math.radians(self.turn_deg))
        T = np.eye(4)
        T[:2, :2], T[2, 3] = [[c, -s], [s, c]], self.distance_m
        return (T,)


def test_my_task():
    """It is reached, and not in three frames."""
    goal = {"kind": "my_task", "distance_m": 1.5}
    vstestbed.testing.check_task(vs.load("ibvs_book", {"detector": "oracle", "goal": goal}))
