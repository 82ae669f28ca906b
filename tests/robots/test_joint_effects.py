"""Imperfect joints in plain numbers: what encoders read, the highest eigenfrequency of elastic gears, sentences for what does not fit."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import vstestbed as vs
from tests.sim.two_mass import ROTOR, arm, inertia
from vstestbed.core.errors import ParameterError, ScenarioError
from vstestbed.robots import Puma560
from vstestbed.robots.joint_effects import CurrentLoops, Encoders, Gears
from vstestbed.robots.link_errors import GeometryError
from vstestbed.robots.mechanics import quickest

TURNING = np.zeros(1, dtype=bool)
SOFT = {"stiffness_nmprad": [25000, 25000, 10000, 0, 0, 0]}


class TestEncoders:
    def test_angles_come_in_whole_counts(self) -> None:
        q = np.linspace(0, 0.01, 2001)
        read = np.array([Encoders(counts=(4096,)).read(np.array([a]), np.zeros(1), TURNING)[0][0] for a in q])
        step = 2 * math.pi / 4096
        np.testing.assert_allclose(read / step, np.round(read / step), atol=1e-9)
        assert np.abs(read - q).max() <= step / 2 + 1e-12
        assert np.diff(np.unique(np.round(read / step))) == pytest.approx(1.0)

    def test_its_error_over_a_turn_is_uniform(self) -> None:
        """Variance c^2 / 12 of a quantisation by c."""
        q, encoders = np.random.default_rng(0).uniform(-3, 3, 4000), Encoders(counts=(1000,))
        error = np.array([encoders.read(np.array([a]), np.zeros(1), TURNING)[0][0] for a in q]) - q
        assert np.var(error) == pytest.approx((2 * math.pi / 1000) ** 2 / 12, rel=0.05)

    def test_speeds_are_counts_of_a_window(self) -> None:
        quantum = 2 * math.pi / 1000 / 0.01
        speeds = [Encoders(counts=(1000,)).read(np.zeros(1), np.array([v]), TURNING)[1][0] for v in (0.4 * quantum, 0.6 * quantum)]
        assert speeds == pytest.approx([0.0, quantum])

    def test_eccentricity_is_an_error_of_once_a_turn(self) -> None:
        encoders = Encoders(eccentricity_deg=(0.1,), turns=(3.0,))
        q = np.linspace(0, 2 * math.pi, 360, endpoint=False)
        error = np.array([encoders.read(np.array([a]), np.zeros(1), TURNING)[0][0] for a in q]) - q
        waves = np.abs(np.fft.rfft(error)) / 180
        assert np.argmax(waves) == 3 and math.degrees(waves[3]) == pytest.approx(0.1)
        assert np.delete(waves, 3).max() == pytest.approx(0.0, abs=1e-12)

    def test_its_speed_is_the_rate_of_its_angle(self) -> None:
        encoders, q, h = Encoders(eccentricity_deg=(0.5,), turns=(7.0,)), 0.3, 1e-6
        (after,), (before,) = (encoders.read(np.array([q + s * 2.0 * h]), np.zeros(1), TURNING)[0] for s in (1, -1))
        assert encoders.read(np.array([q]), np.array([2.0]), TURNING)[1][0] == pytest.approx((after - before) / (2 * h), rel=1e-7)

    def test_joints_that_slide_are_read_exactly(self) -> None:
        q, qd = Encoders(counts=(100,)).read(np.array([0.123, 0.123]), np.array([0.1, 0.1]), np.array([False, True]))
        assert q[0] != 0.123 and (q[1], qd[1]) == (0.123, 0.1)

    def test_the_controller_reads_them_and_the_log_has_the_truth(self) -> None:
        robot = Puma560(encoders=Encoders(counts=(1000,)))
        q = np.full(6, 0.1)
        assert robot.measured(q, q, {}, None).q == pytest.approx(2 * math.pi / 1000 * 16)


class TestEigenfrequency:
    def test_of_one_joint(self) -> None:
        w, joint = quickest(np.array([[2.0]]), np.array([0.5]), np.array([1000.0]))
        assert w == pytest.approx(math.sqrt(1000 * (1 / 2.0 + 1 / 0.5))) and joint == 0

    def test_of_a_rigid_arm_there_is_none(self) -> None:
        assert quickest(np.eye(2), np.ones(2), np.zeros(2)) == (0.0, 0)

    def test_a_rigid_joint_has_its_rotor_on_its_link(self) -> None:
        """Masses 1 + 3 behind the coupling of a link: det(K - w^2 M) by hand for M = [[2, 1], [1, 1]], J = (1, 3), k = (100, 0)."""
        w, joint = quickest(np.array([[2.0, 1.0], [1.0, 1.0]]), np.array([1.0, 3.0]), np.array([100.0, 0.0]))
        effective = 2.0 - 1.0 / 4.0
        assert w == pytest.approx(math.sqrt(100 * (1 / effective + 1.0))) and joint == 0

    def test_the_physics_step_resolves_it(self, tmp_path: Path) -> None:
        w = math.sqrt(20000 * (1 / inertia() + 1 / ROTOR))
        assert arm(tmp_path, gears=Gears(stiffness_nmprad=(20000, 0))).needed_step_s == pytest.approx(0.5 / w, rel=1e-3)

    def test_without_gears_any_step_will_do(self) -> None:
        assert Puma560().needed_step_s == np.inf and Puma560(drives=CurrentLoops()).needed_step_s == 0.001


class TestPresets:
    @pytest.mark.parametrize("level", ["lab", "field"])
    def test_they_pass_the_suite_of_robots(self, level: str) -> None:
        vs.testing.check_robot(vs.load("arm_ibvs", {"robot.realism": level}).robot)

    def test_the_geometry_is_drawn_from_the_seed_and_written_down(self) -> None:
        one, same, other = (vs.load("arm_ibvs", {"robot.realism": "lab", "seed": seed}).robot.geometry_error for seed in (1, 1, 2))
        assert one == same and len(one.offsets) == 6 and one.offsets != other.offsets

    def test_its_spread_is_sigma(self) -> None:
        drawn = GeometryError(sigma_m=1e-3, sigma_deg=0.1)
        all_of = np.array([[p.xyz, p.rpy_deg] for s in range(200) for p in drawn.drawn(6, np.random.default_rng(s)).offsets])
        assert all_of.std(axis=(0, 2)) == pytest.approx([1e-3, 0.1], rel=0.05)

    def test_listed_displacements_stay(self) -> None:
        listed = [{"xyz": [0.001, 0, 0]}] + 5 * [{}]
        robot = vs.load("arm_ibvs", {"robot.geometry_error": {"offsets": listed}}).robot
        assert robot.geometry_error.offsets[0].xyz == (0.001, 0, 0)

    def test_an_idealised_arm_keeps_its_body_alone(self) -> None:
        ideal = vs.load("arm_ibvs", {"robot.realism": "field", "robot.payload": {"mass_kg": 1}}).robot.idealised()
        assert ideal.gears is ideal.drives is ideal.encoders is None
        assert ideal.payload.mass_kg == 1 and len(ideal.geometry_error.offsets) == 6


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"gears": {"stiffness_nmprad": [1e4, 1e4]}}, "must be one value for all joints, or 6"),
        ({"gears": {**SOFT, "backlash_deg": [0, 0, 0, 0.1, 0, 0]}}, "must be 0 for a rigid joint"),
        ({"gears": {"stiffness_nmprad": [0, 0, 0, 0, 0, 30000]}}, r"at most \d+ for joint_6: it vibrates at \d+ Hz"),
        ({"realism": "lab", "actuation": "ideal"}, "must be none with `actuation: ideal`"),
        ({"drives": {}, "actuation": "ideal"}, "is for actuators with limits"),
        ({"geometry_error": {"offsets": [{}]}}, "must be 6, one for each link"),
        ({"encoders": {"counts": [10, 10]}}, "must be one value for all joints"),
    ],
)
def test_what_does_not_fit_is_refused(given: dict[str, Any], words: str) -> None:
    with pytest.raises(ScenarioError, match=words):
        vs.load("arm_ibvs", {f"robot.{name}": value for name, value in given.items()})


def test_a_physics_step_that_is_too_long_is_refused() -> None:
    with pytest.raises(ScenarioError, match=r"step_s: must be at most 0\.001 s"):
        vs.load("arm_ibvs", {"robot.drives": {}, "physics.step_s": 0.002})


def test_a_joint_without_rotor_has_no_gears(tmp_path: Path) -> None:
    robot = arm(tmp_path, rotor=0.0, gears=Gears(stiffness_nmprad=(2000, 0)))
    with pytest.raises(ParameterError, match="has no rotor that could move by itself"):
        robot.needed_step_s  # noqa: B018 - it refuses
