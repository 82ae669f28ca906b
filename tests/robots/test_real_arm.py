"""Presets of imperfect arms, what is drawn from the seed, sentences for what does not fit."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import vstestbed as vs
from tests.sim.two_mass import arm
from vstestbed.core.errors import ParameterError, ScenarioError
from vstestbed.effects.joints import Gears
from vstestbed.effects.links import GeometryError
from vstestbed.robots.base import needed_step

SOFT = {"stiffness_nmprad": [25000, 25000, 10000, 0, 0, 0]}


class TestPresets:
    @pytest.mark.parametrize("level", ["lab", "field"])
    def test_they_pass_the_suite_of_robots(self, level: str) -> None:
        vs.testing.check_robot(vs.load("arm_ibvs", {"robot.realism": level}).robot)

    def test_the_geometry_is_drawn_from_the_seed_and_written_down(self) -> None:
        one, same, other = (
            vs.load(
                "arm_ibvs", {"robot.realism": "lab", "seed": seed}
            ).resolved.robot.geometry_error
            for seed in (1, 1, 2)
        )
        assert one == same and len(one.offsets) == 6 and one.offsets != other.offsets

    def test_its_spread_is_sigma(self) -> None:
        drawn = GeometryError(sigma_m=1e-3, sigma_deg=0.1)
        all_of = np.array(
            [
                [p.xyz, p.rpy_deg]
                for s in range(200)
                for p in drawn.drawn(6, np.random.default_rng(s)).offsets
            ]
        )
        assert all_of.std(axis=(0, 2)) == pytest.approx([1e-3, 0.1], rel=0.05)

    def test_listed_displacements_stay(self) -> None:
        listed = [{"xyz": [0.001, 0, 0]}] + 5 * [{}]
        robot = vs.load("arm_ibvs", {"robot.geometry_error": {"offsets": listed}}).robot
        assert robot.geometry_error.offsets[0].xyz == (0.001, 0, 0)

    def test_an_idealised_arm_keeps_its_body_alone(self) -> None:
        ideal = vs.load(
            "arm_ibvs", {"robot.realism": "field", "robot.payload": {"mass_kg": 1}}
        ).resolved.robot.idealised()
        assert ideal.gears is ideal.drives is ideal.encoders is None
        assert ideal.payload.mass_kg == 1 and len(ideal.geometry_error.offsets) == 6


def test_what_does_not_fit_is_refused() -> None:
    for given, words in (
        ({"gears": {"stiffness_nmprad": [1e4, 1e4]}}, "must be one value for all joints, or 6"),
        ({"gears": {**SOFT, "backlash_deg": [0, 0, 0, 0.1, 0, 0]}}, "must be 0 for a rigid joint"),
        (
            {"gears": {"stiffness_nmprad": [0, 0, 0, 0, 0, 30000]}},
            r"at most \d+ for joint_6: it vibrates at \d+ Hz",
        ),
        ({"realism": "lab", "actuation": "ideal"}, "must be none with actuation: ideal"),
        ({"drives": {}, "actuation": "ideal"}, "is for actuators with limits"),
        ({"geometry_error": {"offsets": [{}]}}, "must be 6 items, one for each link"),
        ({"encoders": {"counts": [10, 10]}}, "must be one value for all joints"),
    ):
        with pytest.raises(ScenarioError, match=words):
            vs.load("arm_ibvs", {f"robot.{name}": value for name, value in given.items()})


def test_a_physics_step_that_is_too_long_is_refused() -> None:
    with pytest.raises(ScenarioError, match=r"step_s: must be at most 0\.001 s"):
        vs.load("arm_ibvs", {"robot.drives": {}, "physics.step_s": 0.002})


def test_a_joint_without_rotor_has_no_gears(tmp_path: Path) -> None:
    robot = arm(tmp_path, rotor=0.0, gears=Gears(stiffness_nmprad=(2000, 0)))
    with pytest.raises(ParameterError, match="has no rotor that could move by itself"):
        needed_step(robot)
