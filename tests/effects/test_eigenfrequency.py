"""The highest eigenfrequency of elastic gears against closed forms, and the physics step that it
asks for.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from tests.sim.two_mass import ROTOR, arm, inertia
from vstestbed.effects.joints import CurrentLoops, Gears, quickest
from vstestbed.robots import Puma560
from vstestbed.robots.base import needed_step


class TestEigenfrequency:
    def test_of_one_joint(self) -> None:
        w, joint = quickest(np.array([[2.0]]), np.array([0.5]), np.array([1000.0]))
        assert w == pytest.approx(math.sqrt(1000 * (1 / 2.0 + 1 / 0.5))) and joint == 0

    def test_of_a_rigid_arm_there_is_none(self) -> None:
        assert quickest(np.eye(2), np.ones(2), np.zeros(2)) == (0.0, 0)

    def test_a_rigid_joint_has_its_rotor_on_its_link(self) -> None:
        """Masses 1 + 3 behind the coupling of a link: det(K - w^2 M) by hand for M = [[2, 1], [1,
        1]], J = (1, 3), k = (100, 0).
        """
        w, joint = quickest(
            np.array([[2.0, 1.0], [1.0, 1.0]]), np.array([1.0, 3.0]), np.array([100.0, 0.0])
        )
        effective = 2.0 - 1.0 / 4.0
        assert w == pytest.approx(math.sqrt(100 * (1 / effective + 1.0))) and joint == 0

    def test_the_physics_step_resolves_it(self, tmp_path: Path) -> None:
        w = math.sqrt(20000 * (1 / inertia() + 1 / ROTOR))
        assert needed_step(
            arm(tmp_path, gears=Gears(stiffness_nmprad=(20000, 0)))
        ) == pytest.approx(0.5 / w, rel=1e-3)

    def test_without_gears_any_step_will_do(self) -> None:
        assert (
            needed_step(Puma560()) == np.inf
            and needed_step(Puma560(drives=CurrentLoops())) == 0.001
        )
