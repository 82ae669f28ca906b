"""An arm that its motors cannot hold is refused at its start, by the weight of its links and its
payload: statics by hand.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import vstestbed as vs
from tests.sim.two_mass import MASS, REACH, arm, plant_of
from vstestbed.core.errors import UnreachableError
from vstestbed.effects.joints import Gears
from vstestbed.effects.links import Payload
from vstestbed.scenario.dump import dump
from vstestbed.sim.plant import MujocoPlant
from vstestbed.studies.comparison.runs import perform

LOAD = MASS * 9.81 * REACH
"""Torque of the links' weight about the horizontal first joint [Nm]."""
MOST = 50.0
"""The motor's largest torque [Nm]."""
MOST_KG = (MOST - LOAD) / (9.81 * (REACH + 0.2))
"""The payload 0.2 m beyond the flange that this motor just holds [kg]."""


def message(folder: Path, **effects: Any) -> str:
    with pytest.raises(UnreachableError) as refused:
        plant_of(arm(folder, axis="0 1 0", **effects)).close()
    return str(refused.value)


def loaded(mass_kg: float, **more: Any) -> dict[str, Any]:
    return {
        "payload": Payload(mass_kg=mass_kg, com_m=(0.2, 0, 0)),
        "torque_limits": (MOST, MOST),
        **more,
    }


def test_the_sentence_has_both_torques_and_what_would_be_held(tmp_path: Path) -> None:
    words = message(tmp_path, **loaded(20.0))
    needed = LOAD + 20 * 9.81 * (REACH + 0.2)
    assert words.startswith(
        f"robot.payload.mass_kg asks swing for {needed:.4g} Nm to hold the arm at its start,"
        " and its motor and friction have"
    )
    assert (
        f"{MOST:g} Nm: it would fall;"
        f" works: at most {np.floor(100 * MOST_KG) / 100:g} kg here, got 20.0" in words
    )


@pytest.mark.parametrize(
    "effects",
    [{}, {"gravity_error": 0.0}, {"gears": Gears(stiffness_nmprad=(3000, 0))}],
    ids=["plain", "carried", "elastic"],
)
def test_the_limit_is_that_of_statics(tmp_path: Path, effects: dict[str, Any]) -> None:
    plant_of(arm(tmp_path, axis="0 1 0", **loaded(0.999 * MOST_KG, **effects))).close()
    assert "asks swing for 50.0" in message(tmp_path, **loaded(1.001 * MOST_KG, **effects))
    # a vertical axis feels no weight
    plant_of(arm(tmp_path, axis="0 0 1", **loaded(200.0, **effects))).close()


def test_under_the_limit_it_stands_and_over_it_falls(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("vstestbed.sim.plant.check_static_load", lambda stage: None)
    fallen = []
    for share in (0.98, 1.02):
        plant = plant_of(arm(tmp_path, axis="0 1 0", **loaded(share * MOST_KG)))
        assert isinstance(plant, MujocoPlant) and plant.advance(round(0.5 / plant.step_s))
        fallen.append(float(plant.truth().q[0]))
        plant.close()
    assert abs(fallen[0]) < 1e-3 and fallen[1] > 0.01


def test_an_arm_too_weak_for_its_own_links(tmp_path: Path) -> None:
    words = message(tmp_path, torque_limits=(10.0, 10.0))
    assert (
        words
        == f"robot.start asks swing for {LOAD:.4g} Nm to hold the arm at its start, and its motor"
        " and friction have 10 Nm: it would fall; works: another start, or stronger motors"
    )
    assert message(tmp_path, torque_limits=(10.0, 10.0), payload=Payload(mass_kg=1)).endswith(
        "works: another start, for it falls without a payload, too, got 1.0"
    )


def test_motors_without_limits_hold_all(tmp_path: Path) -> None:
    plant_of(arm(tmp_path, axis="0 1 0", actuation="ideal", payload=Payload(mass_kg=500))).close()


def test_the_puma_names_the_joint_that_gives_way() -> None:
    with pytest.raises(UnreachableError) as refused:
        vs.run(vs.load("arm_ibvs", {"robot.payload.mass_kg": 200, "detector": "oracle"}))
    found = re.search(
        r"asks (joint_\d) for ([\d.]+) Nm .* have ([\d.]+) Nm.*at most ([\d.]+) kg",
        str(refused.value),
    )
    assert (
        found
        and found[1] == "joint_5"
        and float(found[2]) > 5 * float(found[3])
        and 1 < float(found[4]) < 60
    )


def test_in_a_comparison_it_is_an_outcome() -> None:
    text = dump(vs.load("arm_ibvs", {"robot.payload.mass_kg": 200, "detector": "oracle"}))
    files = perform(text, filmed=False)
    assert (
        b'"outcome": "unreachable"' in files["summary.json"]
        and b"asks joint_5 for" in files["summary.json"]
    )
