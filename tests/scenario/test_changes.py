"""What was changed in a bundled scenario, as the report shows it."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import vstestbed as vs
from vstestbed.scenario.dump import changes, documents


def test_changed_fields_are_named_as_set_takes_them() -> None:
    for name, settings, changed in (
        ("quadrotor_aggressive", {}, ()),
        ("quadrotor_aggressive", {"derotation": "none", "seed": 3}, ("derotation=none",)),
        ("omni_blended", {"goal.speed_mps": None}, ("goal.speed_mps=null",)),
        ("arm_track_circle", {"law.feedforward": "none"}, ("law.feedforward={kind: none}",)),
    ):
        assert changes(vs.load(name, settings)) == changed


def test_a_copy_of_the_targets_file_is_no_change(tmp_path: Path) -> None:
    place = tmp_path / "arm_mesh.yaml"
    place.write_text(documents(vs.load("arm_mesh"))["scenario.yaml"], encoding="utf-8")
    copy = tmp_path / "assets" / "target" / "flange.stl"
    copy.parent.mkdir(parents=True)
    copy.write_bytes(Path(vs.load("arm_mesh").target.source or "").read_bytes())
    assert changes(vs.load(place)) == ()


def test_a_scenario_of_the_users_own_has_no_changes() -> None:
    assert changes(dataclasses.replace(vs.load("ibvs_book", {"law.gain": 3}), name="mine")) == ()
