"""Sentences on lists, blocks and missing fields: what was found, where, and what would work."""

from __future__ import annotations

import pytest

import vstestbed as vs
from vstestbed.core.errors import ScenarioError

BOX = {"pose": {"xyz": [1, 0, 0]}}


def test_a_mistake_is_told_with_what_works() -> None:
    for field, value, sentence in (
        # no list: an example, the default, or what its blocks are of
        (
            "robot.payload",
            {"mass_kg": 1, "com_m": 0.1},
            "robot.payload.com_m: must be a list, such as [0.0, 0.0, 0.1], got 0.1",
        ),
        (
            "world.clutter",
            BOX | {"shapes": "ball"},
            "world.clutter.shapes: must be a list, such as ['ball', 'disc', 'box'], got 'ball'",
        ),
        (
            "world.windows",
            {},
            (
                "world.windows: must be a list of blocks, each of pose, width,"
                " height, brightness, got {}"
            ),
        ),
        ("randomise", {}, "randomise: must be a list of blocks, each a distribution, got {}"),
        (
            "randomise",
            [{"field": "law.gain", "uniform": 1}],
            "randomise.0.uniform: must be a list, such as [0.5, 1.5], got 1",
        ),
        (
            "camera.exposure.light",
            [2],
            "camera.exposure.light.0: must be a list, as in light: [[2.0, 4.0]], got 2",
        ),
        # of another length
        (
            "robot.payload",
            {"mass_kg": 1, "com_m": [0, 1]},
            "robot.payload.com_m: must be a list of 3 items, got [0, 1]",
        ),
        ("camera.distortion", [0.1], "camera.distortion: must be a list of 5 items, got [0.1]"),
        (
            "robot.encoders.counts",
            [],
            "robot.encoders.counts: must be a list of 1 or more items, got []",
        ),
        # a number in place of a block that needs one field alone
        (
            "robot.payload",
            3,
            (
                "robot.payload: must be a block (a mapping) of mass_kg, com_m, edge_m, declared,"
                " got 3; did you mean {mass_kg: 3}?"
            ),
        ),
        (
            "robot.drives",
            200,
            "robot.drives: must be a block (a mapping) of bandwidth_hz, delay_s, got 200",
        ),
        # a missing field that has the name of a kind
        (
            "world.windows",
            [{}],
            (
                "world.windows.0.pose: is missing: its middle and axes in the world;"
                " it spans its x and y axes, and shines along z, e.g."
                " {xyz: [1, 2, 1.5], rpy_deg: [90, 0, 0]}; a block of xyz, rpy_deg"
            ),
        ),
        # the field of the scenario, not that of the file's reader
        (
            "world.floor.texture",
            "brick",
            (
                "world.floor.texture: must be a picture, FILE.png or FILE.jpg, or texture:NAME"
                " (alphabet, brick, clutter, faint, flat, leaves, objects, poster, repetitive,"
                " small_print, text), got 'brick'"
            ),
        ),
    ):
        with pytest.raises(ScenarioError) as refused:
            vs.load("arm_ibvs", {field: value})
        assert str(refused.value) == f"overrides: {sentence}"
