"""The control law my_law, from what the camera saw to a velocity.

    pytest my_law.py
    vstestbed run ibvs_book --plugin my_law.py --set law=my_law

The equation is u = -gain pinv(L B) (s - s*), with s the marker coordinates (x, y) = (X/Z, Y/Z) one after the other.
"""

from typing import Annotated, Literal

import numpy as np
from annotated_types import Gt

import vstestbed as vs
import vstestbed.testing
from vstestbed.features.depth import Depth, PnP


@vs.LAWS.add
@vs.spec
class MyLaw(vs.LawBase):
    """u = -gain pinv(L B) (s - s*).

    Args:
        gain: the error decays as exp(-gain t) [1/s].
        depth: source of the markers' depth.
    """

    kind: Literal["my_law"] = "my_law"  # its word in a scenario
    gain: Annotated[float, Gt(0)] = 0.5  # what is annotated is a field in YAML: --set law.gain=1
    depth: Depth = PnP()  # where the markers' depth comes from: --set law.depth=goal, estimate, oracle
    inputs = ("xy", "depth")  # what `step` reads of the observation: costly fields are computed only where they are named

    def init(self, goal):
        """What `step` gets as its memory in the first frame: a filter's state, say."""
        return

    def step(self, memory, observation, goal, basis):
        """One frame. N markers, n motions of the robot.

        observation: xy (N, 2), NaN where a marker is not seen; depth (N,) [m]; t, the time of exposure [s].
        goal: the same fields at the goal view.
        basis: camera twists (6, n) of the robot's motions, (v, w) in the camera's frame (x right, y down, z forward) [m/s, rad/s].
        """
        if not observation.seen.all():
            return memory, vs.Command.rest(basis, "a marker is out of sight")
        L = vs.features.Point().interaction(observation.xy, observation.depth)  # (2N, 6): s_dot = L v
        error = (observation.xy - goal.xy).ravel()
        u = -self.gain * np.linalg.pinv(L @ basis) @ error
        return memory, self.limits.command(u, basis)


def test_my_law():
    """It reaches a goal, keeps its state in its memory alone, and rests where it sees nothing."""
    vstestbed.testing.check_law(MyLaw(gain=1.0))
