"""A hybrid law of pictures and force as a plugin: the plug sits with the ordered force, by the
truth.
"""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import pytest

import vstestbed as vs
from vstestbed.effects import RobotModel

# 4 cm before the mouth
NEAR = {"robot.start.nominal.q_deg": [13.0, 34.0, -168.0, 18.4, 46.0, -13.0]}
SEATED = NEAR | {"detector": "oracle", "goal.press_n": None, "goal.jam_s": 8.0}


@pytest.fixture(autouse=True)
def plugin(own_kinds, monkeypatch: pytest.MonkeyPatch):
    """The file's folder is where a user would have it: beside the scenario."""
    monkeypatch.syspath_prepend(str(Path(__file__).parent))
    monkeypatch.delitem(__import__("sys").modules, "pressing", raising=False)


def pressed(**changes: object) -> float:
    """Mean force on the plug over the last second [N]."""
    run = vs.run(vs.load("arm_insert", SEATED | changes, plugins=["pressing"]))
    assert run.outcome is vs.Outcome.inserted
    return float(run["plug_force_n"][run["t"] > run["t"][-1] - 1].mean())


def pressed_most(**changes: object) -> float:
    """Largest force on the plug of the bundled scenario's law at 5 mm/s [N]."""
    run = vs.run(vs.load("arm_insert", NEAR | {"detector": "oracle"} | changes))
    return float(run["plug_force_n"].max())


def test_the_plug_sits_with_the_ordered_force_where_a_law_of_pictures_presses_on():
    assert pressed(
        law={"kind": "pressing", "gain": 1, "force_n": 20.0}, **{"goal.seat_s": 4.0}
    ) == pytest.approx(20, abs=3)
    assert pressed(**{"goal.seat_s": 2.0}) > 40


@pytest.mark.study
def test_what_is_over_the_ordered_force_is_coulomb_friction_of_the_joints_alone():
    """Motors, limits and damping of the joints stay; the effect takes the friction alone."""

    @vs.EFFECTS.add
    @vs.spec
    class Smooth(vs.EffectBase):
        """Joints without Coulomb friction."""

        kind: Literal["smooth"] = "smooth"

        def edit(self, robot: RobotModel) -> None:
            """Also the friction of the file's."""
            for joint in robot.spec.joints:
                joint.frictionloss = 0.0

    law, seat = {"kind": "pressing", "gain": 1, "force_n": 20.0}, {"goal.seat_s": 6.0}
    assert pressed(law=law, **seat) > 21.5  # 22.4 N were measured
    smooth = {"robot.effects": [{"kind": "smooth"}]}
    # e^-6 of the 65 N of the impact are 0.2 N
    assert pressed(law=law, **seat, **smooth) == pytest.approx(20, abs=0.3)
    touch = pressed_most(**{"robot.actuation": "industrial"}), pressed_most(**smooth)
    assert touch[1] < 0.5 * touch[0]  # 66 of 167 N at 5 mm/s
