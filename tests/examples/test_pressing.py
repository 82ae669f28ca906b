"""A hybrid law of pictures and force as a plugin: the plug sits with the ordered force, by the truth."""

from __future__ import annotations

from pathlib import Path

import pytest

import vstestbed as vs

NEAR = {"robot.start.nominal.q_deg": [13.0, 34.0, -168.0, 18.4, 46.0, -13.0]}  # 4 cm before the mouth
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


def test_the_plug_sits_with_the_ordered_force_where_a_law_of_pictures_presses_on():
    assert pressed(law={"kind": "pressing", "gain": 1, "force_n": 20.0}, **{"goal.seat_s": 4.0}) == pytest.approx(20, abs=3)
    assert pressed(**{"goal.seat_s": 2.0}) > 40
