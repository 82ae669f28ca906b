"""Columns of a log: each is explained, torques are those that hold the arm, a law logs numbers of
its own.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any, Literal

import mujoco
import numpy as np
import pytest

import vstestbed as vs
from vstestbed.core.errors import ParameterError
from vstestbed.core.named_files import bundled_scenarios
from vstestbed.loop.columns import Layout, check_own, text_of
from vstestbed.sim.scene.scene import Scene


def test_every_column_of_every_bundled_scenario_is_explained() -> None:
    columns = {name: Layout(vs.load(name)).columns for name in bundled_scenarios()}
    assert {
        (name, column)
        for name, those in columns.items()
        for column in those
        if text_of(column) is None
    } == set()
    units = {
        column: text.unit
        for those in columns.values()
        for column in those
        if (text := text_of(column))
    }
    assert (units["cmd_vx"], units["u_0"], units["tau_joint_1"], units["q_joint_1"]) == (
        "m/s",
        "px",
        "Nm, N",
        "rad, m",
    )


@pytest.mark.parametrize("realism", ["none", "field"])
def test_torques_at_rest_are_those_that_carry_the_arm(realism: str) -> None:
    """At the goal the motors hold what gravity and dry friction pull: each at most its friction
    away from the bias force of the model.

    At the level `field` current loops and ripple apply the torque, to rotors behind elastic gears.
    """
    scenario = vs.load("arm_ibvs", {"detector": "oracle", "robot.realism": realism})
    recording = vs.run(scenario)
    tau, q = (
        np.array([recording[f"{stem}_{name}"][-1] for name in scenario.robot.joints])
        for stem in ("tau", "q")
    )
    scene = Scene(scenario.scene)
    scene.data.qpos[scene.at.qpos], scene.data.qvel[:] = q, 0
    mujoco.mj_forward(scene.model, scene.data)
    bias, friction = (
        scene.data.qfrc_bias[scene.at.qvel],
        scene.model.dof_frictionloss[scene.at.motor_qvel],
    )
    assert np.abs(bias).max() > 10
    # of each joint: no torque at all would fail at joint 2
    assert (np.abs(tau - bias) < friction + 0.5).all()
    assert (np.abs(bias) > friction + 0.5).any()


@pytest.fixture
def noted() -> Iterator[type]:
    @vs.LAWS.add
    @vs.spec
    class Noted(vs.Law):
        """u = pinv(B) of 0.1 m/s ahead; it logs the depth of the first marker, but not in every
        frame.
        """

        kind: Literal["noted"] = "noted"
        short: bool = False
        columns = ("law_depth", "law_twice")

        def step(self, state: Any, observation: Any, goal: Any, basis: Any) -> Any:
            command = self.limits.command(
                np.linalg.pinv(basis) @ np.array([0, 0, 0.1, 0, 0, 0]), basis
            )
            z = float(observation.depth[0])
            row = () if observation.t < 0.1 else (z,) if self.short else (z, 2 * z)
            return state, replace(command, row=row)

    yield Noted
    del vs.LAWS.members["noted"]


def test_a_law_logs_numbers_of_its_own(noted: type) -> None:
    chosen = {
        "law": {"kind": "noted", "short": False},
        "detector": "oracle",
        "stop.duration_s": 0.5,
    }
    recording = vs.run(vs.load("ibvs_book", chosen))
    depth, twice = recording["law_depth"], recording["law_twice"]
    known = recording["t"] >= 0.1
    assert np.isnan(depth[~known]).all() and known.any() and (~known).any()
    np.testing.assert_array_equal(twice[known], 2 * recording["depth_0"][known])
    failed = vs.run(vs.load("ibvs_book", chosen | {"law": {"kind": "noted", "short": True}}))
    assert (
        failed.outcome.name == "law_failed"
        and "has the columns law_depth, law_twice" in failed.reason
    )


@pytest.mark.parametrize(
    "name",
    [
        "error_px",
        "level_error_px",
        "error_grey",
        "est_position_m",
        "u_7",
        "speed_rotor_1",
        "turned_rad",
    ],
)
def test_a_law_has_no_column_that_judges_or_reports_read(noted: Any, name: str) -> None:
    """Also none that this log has not: a judge takes what is there."""
    noted.columns = ("law_depth", name)
    with pytest.raises(ParameterError, match=r"law\.columns must be names that no log has"):
        vs.run(
            vs.load(
                "ibvs_book",
                {"law": {"kind": "noted"}, "detector": "oracle", "stop.duration_s": 0.1},
            )
        )


def test_a_wrong_name_is_told_with_the_nearest() -> None:
    recording = vs.run(vs.load("ibvs_book", {"detector": "oracle", "stop.duration_s": 0.2}))
    with pytest.raises(KeyError, match=r"did you mean 'cmd_v.'.*describe log"):
        recording["cmd_v"]


def test_a_column_of_a_laws_own_has_a_name_that_a_table_can_have() -> None:
    for name in ("", "a,b", "1st", "a b", "\u00e9"):
        with pytest.raises(ParameterError, match=r"of letters, digits and _; works: law_NAME"):
            check_own((name,))
    check_own(("law_x1", "Energy"))
