"""Policies of one's own, for `law: {kind: policy, file: "policy.py:act"}`: here image-based
servoing from pixels, by hand.

From this folder: `vstestbed run ibvs_book --set "law={kind: policy, file: policy.py:act}"`.
"""

import numpy as np

from vstestbed.features import Point

FOCAL_PX, CENTRE, DEPTH_M, GAIN = 800.0, 499.5, 1.0, 0.5
"""What it knows of its camera and its goal: those of `ibvs_book`."""


def act(observation):
    """The action (6,), within [-1, 1]: u = -gain pinv(L) (xy - xy*), with L at the goal."""
    if not observation["seen"].all():
        return None
    here, goal = ((observation[name] - CENTRE) / FOCAL_PX for name in ("markers", "goal"))
    L = Point().interaction(goal, np.full(len(goal), DEPTH_M))
    return -GAIN * np.linalg.pinv(L) @ (here - goal).ravel()


class Smooth:
    """The same through a first-order filter: a policy with a memory, of which every run has an
    instance of its own.
    """

    def __init__(self):
        self.action, self.frames = np.zeros(6), 0

    def act(self, observation):
        """The filtered action (6,)."""
        now = act(observation)
        if now is None:
            return None
        self.frames += 1
        self.action = self.action + 0.3 * (now - self.action)
        return self.action.copy()
