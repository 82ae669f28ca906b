"""A craft's imperfections as blocks and as presets; what a run of them logs."""

from __future__ import annotations

import numpy as np
import pytest

import vstestbed as vs
from vstestbed.effects.airframe import FIELD, LAB, Airframe, FlightEffects
from vstestbed.robots.quadrotor import Quadrotor

ORACLE = {"detector": {"kind": "oracle", "field_of_view": "limited"}, "stop.duration_s": 0.6}


def test_without_blocks_nothing_acts():
    robot = Quadrotor()
    assert robot.acting == ()
    assert robot.log(robot.supervisor(False, 1.0, 1.0)).columns[-1] == "supervisor"


@pytest.mark.parametrize(("level", "blocks"), [("lab", LAB), ("field", FIELD)])
def test_a_preset_fills_all_blocks(level, blocks):
    robot = Quadrotor(realism=level)
    assert {name: getattr(robot, name) for name in LAB} == blocks
    assert [type(effect) for effect in robot.acting] == [FlightEffects]


def test_one_block_leaves_the_draws_of_the_others():
    """Each block draws from a stream of its own."""
    both, one = Quadrotor(realism="lab"), Quadrotor(vibration={})  # pyright: ignore[reportArgumentType] - a block as YAML has it
    felt = []
    for robot in (both, one):
        airframe = Airframe(robot.parameters, robot, np.random.default_rng(4))
        felt.append(airframe.felt({"accelerometer": [0.0] * 3, "gyro": [0.0] * 3})["accelerometer"])
    assert felt[0] == felt[1]


def test_a_craft_of_the_field_flies_and_logs_its_voltage():
    run = vs.run(vs.load("quadrotor_hover", ORACLE | {"robot.realism": "field"}))
    volts = run["battery_v"]
    assert 13 < volts[-1] < volts[0] < 14.5
    assert run.outcome.name == "timed_out"


@pytest.mark.study
@pytest.mark.parametrize("level", ["lab", "field"])
def test_it_still_lands_on_a_car(level):
    run = vs.run(
        vs.load("quadrotor_land", {"detector": ORACLE["detector"], "robot.realism": level})
    )
    assert run.outcome.name == "landed", run.reason
