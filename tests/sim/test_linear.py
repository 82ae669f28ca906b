"""The matrices of an arm about its start, against those of a joint that is known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.sim.two_mass import ROTOR, arm, inertia
from vstestbed.effects.joints import Gears
from vstestbed.sim.plant import linear_arm


def test_its_matrices_are_those_of_the_joint(tmp_path: Path) -> None:
    found = linear_arm(arm(tmp_path, gears=Gears(stiffness_nmprad=(2000, 0), damping_s=0.001)))
    np.testing.assert_allclose(np.diag(found.mass), [inertia(), 0.01 + 0.001, ROTOR], rtol=1e-6)
    np.testing.assert_allclose(found.spring, 2000 * np.array([[1, 0, -1], [0, 0, 0], [-1, 0, 1]]))
    np.testing.assert_allclose(found.damper, 0.001 * found.spring)
    np.testing.assert_allclose(found.motors, [[0, 0], [0, 1], [1, 0]])
    assert (
        found.kp == pytest.approx([2000, 50])
        and found.kv == pytest.approx([50, 1.25])
        and found.integrates.all()
    )
