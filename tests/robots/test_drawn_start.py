"""A seed over a run's own scenario draws round the nominal start of the experiment, not round the one that was drawn."""

from __future__ import annotations

import pytest

import vstestbed as vs
from tests.examples.two_link import TwoLink
from vstestbed.robots.base import stated, undrawn
from vstestbed.scenario.dump import changes
from vstestbed.scenario.load import parse

NAMES = ("arm_ibvs", "arm_panda", "car_pbvs", "omni_ibvs", "quadrotor_hover", "ibvs_book")
"""One scenario of each kind of robot."""


@pytest.mark.parametrize("name", NAMES)
def test_a_further_seed_draws_what_it_draws_of_the_experiment_itself(name: str) -> None:
    run, wanted = vs.load(name, seed=3), vs.load(name, seed=5)
    assert run.robot.start.nominal != wanted.robot.start.nominal
    assert parse(vs.dump(run, defaults=True), "scenario.yaml", seed=5) == wanted
    assert run.randomised(5) == wanted
    assert run.randomised(4).randomised(5) == wanted


def test_another_nominal_start_is_the_one_to_draw_round() -> None:
    start = {"robot.start.nominal": {"x": 2.5, "y": 1.5, "heading_deg": 30}}
    text = vs.dump(vs.load("car_pbvs", seed=3), defaults=True)
    assert parse(text, "scenario.yaml", start, seed=5) == vs.load("car_pbvs", start, seed=5)
    one = {"robot.start.nominal.x": 2.5}
    assert parse(text, "scenario.yaml", one, seed=5).robot.start.drawn_about.x == 2.5
    assert parse(text, "scenario.yaml", one).robot.start.drawn_about is None


def test_the_box_of_a_craft_keeps_a_middle_of_its_own() -> None:
    middle = {"robot.start.random.about": {"xyz": [0.5, 0, 2.5]}}
    run = vs.load("quadrotor_hover", middle, seed=3)
    assert run.randomised(5) == vs.load("quadrotor_hover", middle, seed=5)


def test_a_start_that_is_chosen_was_not_drawn() -> None:
    drawn = vs.load("arm_ibvs", seed=3).robot
    assert drawn.start.drawn_about is not None
    assert drawn.started_at(drawn.configuration()).start.drawn_about is None


def test_a_report_does_not_name_it() -> None:
    (changed,) = changes(vs.load("arm_ibvs", seed=3))
    assert changed.startswith("robot.start.nominal.q_deg=")


def test_a_robot_of_ones_own_may_lack_it() -> None:
    arm = TwoLink()
    assert undrawn(arm) is arm
    assert stated(arm, arm) is arm
