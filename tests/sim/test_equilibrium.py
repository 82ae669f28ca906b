"""Arms begin in equilibrium; the weight that a wrong gravity compensation leaves makes them sag, a
payload asks for its torque.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import vstestbed as vs
from tests.sim.two_mass import MASS, REACH, arm, plant_of
from vstestbed.effects.joints import CurrentLoops, Gears
from vstestbed.effects.links import Payload
from vstestbed.sim.build import build_plant
from vstestbed.sim.plant import MujocoPlant

LOAD = MASS * 9.81 * REACH
"""Torque of the weight about the horizontal first joint [Nm]."""
KP = 2000.0


def after(robot: Any, seconds: float = 1.0) -> tuple[np.ndarray, float]:
    """Joints at rest after a while, and the first servo's torque."""
    plant = plant_of(robot)
    assert isinstance(plant, MujocoPlant) and plant.advance(round(seconds / plant.step_s))
    data = plant._stage.data
    at = (
        plant.truth().q,
        float(
            data.qfrc_actuator[plant._stage.at.motor_qvel[0]]
            + data.qfrc_applied[plant._stage.at.motor_qvel[0]]
        ),
    )
    plant.close()
    return at


@pytest.mark.parametrize(
    "effects",
    [
        {},
        {"gears": Gears(stiffness_nmprad=(3000, 0))},
        {"gears": Gears(stiffness_nmprad=(3000, 0), backlash_deg=(0.1, 0))},
        {"drives": CurrentLoops()},
        {"drives": CurrentLoops(delay_s=0.002), "gears": Gears(stiffness_nmprad=(3000, 0))},
    ],
    ids=["plain", "elastic", "play", "loops", "all"],
)
def test_it_stays_where_it_begins(tmp_path: Path, effects: dict[str, Any]) -> None:
    q, torque = after(arm(tmp_path, axis="0 1 0", **effects), 0.3)
    assert q == pytest.approx([0, 0], abs=2e-7)
    assert abs(torque) == pytest.approx(LOAD, rel=1e-4)


@pytest.mark.parametrize("share", [0.1, -0.05])
def test_a_wrong_compensation_makes_it_sag(tmp_path: Path, share: float) -> None:
    q, torque = after(arm(tmp_path, axis="0 1 0", gravity_error=share))
    assert q[0] == pytest.approx(share * LOAD / KP, rel=1e-3)  # m g r share / kp, towards the floor
    assert abs(torque) == pytest.approx(abs(share) * LOAD, rel=1e-3)


def test_elastic_gears_sag_by_both_springs(tmp_path: Path) -> None:
    """The link begins where the scenario says, the rotor wound up by the load: only the servo gives
    way.
    """
    q, _ = after(
        arm(tmp_path, axis="0 1 0", gravity_error=0.1, gears=Gears(stiffness_nmprad=(3000, 0)))
    )
    assert q[0] == pytest.approx(0.1 * LOAD / KP, rel=1e-3)


def test_a_payload_asks_for_its_torque(tmp_path: Path) -> None:
    q, torque = after(
        arm(tmp_path, axis="0 1 0", payload=Payload(mass_kg=1.5, com_m=(0.2, 0, 0))), 0.1
    )
    assert q == pytest.approx([0, 0], abs=1e-7)
    assert abs(torque) == pytest.approx(LOAD + 1.5 * 9.81 * (REACH + 0.2), rel=1e-5)


@pytest.mark.parametrize(("declared", "carried"), [(True, 0.0), (False, 1.5 * 9.81 * 0.8)])
def test_a_compensation_carries_a_declared_payload(
    tmp_path: Path, declared: bool, carried: float
) -> None:
    payload = Payload(mass_kg=1.5, com_m=(0.2, 0, 0), declared=declared)
    _, torque = after(arm(tmp_path, axis="0 1 0", gravity_error=0.0, payload=payload))
    assert abs(torque) == pytest.approx(carried, rel=1e-2, abs=1e-6)


def test_the_puma_with_all_imperfections_of_the_field_stands_still() -> None:
    s = vs.load("arm_ibvs", {"robot.realism": "field"})
    plant, _ = build_plant(s.scene)
    plant.advance(round(0.4 / plant.step_s))
    assert plant.truth().q == pytest.approx(s.robot.configuration(), abs=1e-5)
    plant.close()
