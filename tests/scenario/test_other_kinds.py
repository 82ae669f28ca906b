"""Values put over a block of a scenario that becomes another kind."""

from __future__ import annotations

import re

import pytest

import vstestbed as vs


def test_another_kind_over_the_fields_of_a_block_is_one_mistake() -> None:
    for settings, told in (
        (
            {"law.kind": "qp"},
            [
                "law.kind: .* qp has no gain, feature, interaction, depth;"
                " law=qp, without .kind, replaces the block"
            ],
        ),
        (
            {"law.kind": "qp", "law.gain": 3.0},
            ["law.gain: is an unknown field of qp; .*", "law.kind: .* qp has no feature, inter.*"],
        ),
        (
            {"robot.kind": "omni"},
            [
                "robot.kind: .* omni has no actuation, start.nominal.q_deg, start.random.q_deg;"
                " robot=omni, without .*"
            ],
        ),
        ({"law.kind": "qpp"}, ["law.kind: is no law; valid kinds: .*"]),
    ):
        with pytest.raises(vs.errors.ScenarioError) as refused:
            vs.load("arm_ibvs", settings)
        found = [f"{m.field}: {m.sentence}" for m in refused.value.mistakes]
        assert len(found) == len(told) and all(
            re.fullmatch(words, line) for words, line in zip(told, found, strict=True)
        ), found


def test_another_kind_without_the_fields_of_the_block() -> None:
    assert vs.load("arm_ibvs", {"law": "qp"}).law.kind == "qp"
