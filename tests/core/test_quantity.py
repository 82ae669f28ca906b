"""Every number of a scenario has bounds with a reason, in YAML, from Python, and in the JSON
Schema.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Annotated, Any

import pydantic
import pytest
from annotated_types import Ge, Le, Len

from tests.scenario.schemas import whole_schema
from vstestbed.core.errors import ParameterError, ScenarioError
from vstestbed.core.geometry import Pose
from vstestbed.core.quantity import (
    Broadcast,
    Length,
    PositiveLength,
    PositiveTime,
    Seed,
    TighterBounds,
)
from vstestbed.core.spec import spec
from vstestbed.scenario.load import load
from vstestbed.scenario.scenario import Scenario
from vstestbed.targets import Square


@spec
class Things:
    """One of each kind of bounds."""

    at: Length = 0.0
    size: PositiveLength = 1.0
    narrow: Annotated[PositiveTime, TighterBounds(le=60)] = 1.0
    seed: Seed = 0


@spec
class Joints:
    """A list with a value for each joint."""

    most: Annotated[tuple[Annotated[float, Ge(0), Le(10)], ...], Len(1, 7), Broadcast()] = (1.0,)
    counts: Annotated[tuple[Annotated[int, Ge(0), Le(10)], ...], Len(1, 7), Broadcast()] = (1,)


def unbounded(part: Any, path: str = "") -> Iterator[str]:
    """Places in a JSON Schema where a number has no finite bounds."""
    if isinstance(part, dict):
        if part.get("type") in ("number", "integer") and "enum" not in part:
            low, high = (
                part.get("minimum", part.get("exclusiveMinimum")),
                part.get("maximum", part.get("exclusiveMaximum")),
            )
            if low is None or high is None or not math.isfinite(high - low):
                yield path
        for name, inner in part.items():
            yield from unbounded(inner, f"{path}/{name}")
    elif isinstance(part, list):
        for i, inner in enumerate(part):
            yield from unbounded(inner, f"{path}/{i}")


def test_every_number_of_a_scenario_has_bounds() -> None:
    assert list(unbounded(whole_schema(Scenario))) == [], (
        "give each field a type of core.quantity, or bounds of its own"
    )
    assert list(unbounded({"properties": {"x": {"type": "number", "minimum": 0}}})) == [
        "/properties/x"
    ]


def test_the_schema_has_the_tighter_of_two_bounds() -> None:
    shown = pydantic.TypeAdapter(Things).json_schema()["properties"]
    assert (shown["at"]["minimum"], shown["at"]["maximum"]) == (-1000, 1000)
    assert (shown["size"]["exclusiveMinimum"], shown["size"]["minimum"]) == (0, 1e-9)
    assert (shown["narrow"]["minimum"], shown["narrow"]["maximum"]) == (1e-6, 60)
    assert shown["seed"] == {
        "default": 0,
        "minimum": 0,
        "maximum": 2**63 - 1,
        "title": "Seed",
        "type": "integer",
    }


def test_a_value_beyond_is_refused_with_the_reason() -> None:
    for field, value, words in (
        (
            "at",
            1e308,
            (
                "must be -1000 to 1000 m"
                " (five times the 200 m at which a camera counts as diverged), got 1e+308"
            ),
        ),
        ("at", -1000.1, "must be -1000 to 1000 m"),
        ("at", math.inf, "finite"),
        ("size", 0, "must be > 0"),
        ("size", 1e-308, "must be 1e-09 to 1000 m (a nanometre to five times"),
        ("narrow", 61, "must be <= 60"),
        ("narrow", 1e-308, "must be 1e-06 to 1e+09 s"),
        ("seed", 2**63, "must be 0 to 9223372036854775807 (what the tables of results hold)"),
        ("seed", -1, "must be >= 0"),
    ):
        with pytest.raises(ParameterError) as refused:
            Things(**{field: value})
        assert str(refused.value).startswith(f"Things.{field} ")
        assert words in str(refused.value)


def test_the_edges_are_valid() -> None:
    made = Things(at=-1000, size=1e-9, narrow=60, seed=2**63 - 1)
    assert (made.at, made.size, made.narrow, made.seed) == (-1000, 1e-9, 60, 2**63 - 1)


def test_a_view_from_infinity_does_not_hang_the_loader() -> None:
    """Its markers' scatter was infinite, of which LAPACK's singular values never came."""
    with pytest.raises(ScenarioError) as refused:
        load("omni_via_points", {"goal.views.2.view_from.y": 1e308})
    (mistake,) = refused.value.mistakes
    assert str(mistake).startswith("overrides: goal.views.2.view_from.y: must be -1000 to 1000 m (")


def test_what_python_makes_has_the_same_bounds() -> None:
    with pytest.raises(ParameterError, match="must be -1000 to 1000 m"):
        Pose(xyz=(1e308, 0, 0))
    with pytest.raises(ParameterError, match="side must be 1e-09 to 1000 m"):
        Square(pose=Pose(), side=1e154)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        # Physically plausible extremes: a microscope's picture, a drone's flight from far away, a
        # pixel of half a micrometre.
        (
            {
                "camera.focal_length_m": 2e-3,
                "camera.pixel_size_m": 0.56e-6,
                "camera.fovy_deg": None,
            },
            "picture",
        ),
        ({"stop.duration_s": 36_000}, ""),
        ({"camera.rate_hz": 1000, "stop.duration_s": 900}, ""),
        ({"camera.rate_hz": 0.1, "stop.duration_s": 86_400}, ""),
        ({"law.gain": 1e-3}, ""),
        ({"law.gain": 1000}, ""),
        ({"camera.latency_s": 60}, ""),
    ],
)
def test_plausible_extremes_load(settings: dict[str, object], words: str) -> None:
    try:
        load("arm_ibvs", settings)
    except ScenarioError as error:
        assert words and words in str(error)
    else:
        assert not words


class TestOneNumberForAllJoints:
    def test_is_the_list_of_it(self) -> None:
        assert Joints(most=2).most == Joints(most=[2]).most == (2.0,)  # pyright: ignore[reportArgumentType] - a number for a list is the point
        assert Joints(counts=3).counts == (3,)  # pyright: ignore[reportArgumentType] - likewise
        assert Joints(most=(1, 2)).most == (1.0, 2.0)

    def test_the_schema_has_both(self) -> None:
        shown = pydantic.TypeAdapter(Joints).json_schema()["properties"]["most"]
        number = {"maximum": 10, "minimum": 0, "type": "number"}
        assert shown["anyOf"] == [
            {"items": number, "maxItems": 7, "minItems": 1, "type": "array"},
            number,
        ]

    def test_others_are_refused(self) -> None:
        for field, value, words in (
            (
                "most",
                "2",
                "Joints.most must be a number for all joints, or a list with one for each, got '2'",
            ),
            (
                "most",
                True,
                (
                    "Joints.most must be a number for all joints,"
                    " or a list with one for each, got True"
                ),
            ),
            (
                "most",
                None,
                (
                    "Joints.most must be a number for all joints,"
                    " or a list with one for each, got None"
                ),
            ),
            ("most", 11, "Joints.most must be <= 10, got 11"),
            ("most", math.nan, "Joints.most must be a finite number, got nan"),
            ("most", [1, 11], "Joints.most.1 must be <= 10, got 11"),
            ("counts", 2.5, "Joints.counts must be a whole number, got 2.5"),
        ):
            with pytest.raises(ParameterError) as refused:
                Joints(**{field: value})
            assert str(refused.value) == words
