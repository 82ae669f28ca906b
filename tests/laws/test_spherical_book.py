"""The textbook's spherical run: square of 1.5 m at z = .5, goal at z = -1.5, steps of .1 s, gain 1
1/s.
"""

from __future__ import annotations

import numpy as np
import pytest

from tests.laws.flight import fly, rays
from vstestbed.features import Spherical
from vstestbed.features.depth import OracleDepth
from vstestbed.laws import IBVS
from vstestbed.laws.base import ConstantGain


# Counted with the start as the first step: 67, 74, 85, from code that is not ours.
@pytest.mark.parametrize(("turn", "steps"), [(0.4, 67), (1.0, 74), (np.pi, 85)])
def test_steps_to_the_goal(turn: float, steps: int):
    law = IBVS(gain=ConstantGain(value=1.0), feature=Spherical(), depth=OracleDepth())
    r = fly(
        law,
        (0.3, 0.3, -2),
        turn,
        goal_z=2.0,
        side=1.5,
        target_z=0.5,
        rate_hz=10,
        norm_px=1e-3,
        duration_s=20,
    )
    s = Spherical()
    e = s.error(s.measure(rays(r)), s.measure(r.scenario.goal_view.ray))
    reached = int(np.argmax(np.linalg.norm(e, axis=1) < 1e-3))
    assert abs(reached - steps) <= 1
