"""Image-based servoing with an estimated Jacobian (Broyden), as a plugin.

The smallest of its kind, whose first Jacobian is still that of a calibrated camera; the law
`uncalibrated` needs none.

From this folder: `vstestbed run arm_ibvs --plugin broyden --set law=broyden`.

Reference: Jagersand, Fuentes & Nelson 1997, doi:10.1109/ROBOT.1997.606723; Broyden 1965,
doi:10.1090/S0025-5718-1965-0198670-6.
"""

from typing import Annotated, Literal, NamedTuple

import numpy as np
from annotated_types import Gt, Le

import vstestbed as vs


class Memory(NamedTuple):
    """The last frame: time [s], Jacobian (2N, n) of the features, features (2N,), velocities
    commanded (n,).
    """

    t: float
    J: vs.Array
    s: vs.Array
    u: vs.Array


@vs.LAWS.add
@vs.spec
class Broyden(vs.LawBase):
    """u = -gain pinv(J) e, with J corrected by what the last motion did: J + update (ds - J dx)
    dx' / (dx' dx).
    """

    kind: Literal["broyden"] = "broyden"
    gain: Annotated[float, Gt(0)] = 1.0
    update: Annotated[float, Gt(0), Le(1)] = 0.1
    inputs = ("xy",)

    def step(self, state, observation, goal, basis):
        """One frame; the first Jacobian is that of points at the depth of the goal view."""
        if not observation.seen.all():
            return None, vs.Command.rest(basis, "a marker is out of sight")
        s, s_goal = observation.xy.ravel(), goal.xy.ravel()
        J = (
            vs.features.Point().interaction(goal.xy, goal.depth) @ basis
            if state is None
            else state.J
        )
        if state is not None:
            dx = state.u * (observation.t - state.t)
            if dx @ dx > 1e-12:  # at rest there is nothing to learn
                J = J + self.update * np.outer(s - state.s - J @ dx, dx) / (dx @ dx)
        u = -self.gain * np.linalg.lstsq(J, s - s_goal, rcond=None)[0]
        command = self.limits.command(u, basis)
        return Memory(observation.t, J, s, command.u), command
