"""@spec and Registry: what a block may be, how it refuses, how a room grows."""

from __future__ import annotations

import dataclasses
from importlib.metadata import EntryPoint, EntryPoints
from typing import Annotated, Literal

import pydantic
import pytest
from annotated_types import Gt

from vstestbed.core.errors import ParameterError
from vstestbed.core.registry import Registry, kind_of, to_mapping, whole_adapter
from vstestbed.core.spec import spec


@spec
class Disc:
    """A flat marker."""

    kind: Literal["disc"] = "disc"
    radius: Annotated[float, Gt(0)] = 0.5


@spec
class Ring:
    """A marker with a hole."""

    kind: Literal["ring"] = "ring"
    inner: Annotated[float, Gt(0)]
    outer: float = 1.0

    def __post_init__(self) -> None:
        if self.outer <= self.inner:
            raise ParameterError("outer", "must be over inner", self.outer)


def room(**more: object) -> tuple[Registry, pydantic.TypeAdapter]:
    shapes = Registry("shape", Disc, Ring, **more)
    return shapes, pydantic.TypeAdapter(Annotated[Disc | Ring, shapes])


def test_a_spec_is_frozen_keyword_only_and_compares_by_value() -> None:
    disc = Disc(radius=1)
    assert disc == Disc(radius=1.0)
    with pytest.raises(dataclasses.FrozenInstanceError):
        disc.radius = 2.0
    with pytest.raises(
        ParameterError,
        match=(
            r"^Disc takes its fields by their names, such as Disc\(radius=\.\.\.\), got \(0\.5,\)$"
        ),
    ):
        Disc(0.5)


def test_a_constructor_refuses_with_the_name_of_the_field() -> None:
    for values, words in (
        ({"radius": -1}, "radius must be > 0, got -1"),
        ({"radius": float("nan")}, "radius .*finite number, got nan"),
        ({"radius": float("inf")}, "radius .*finite number, got inf"),
        ({"radius": "wide"}, "radius must be a number, got 'wide'"),
        ({"radius": "1"}, "radius must be a number, got '1'"),
        ({"radius": True}, "radius must be a number, got True"),
        (
            {"radios": 1.0, "radius": -1},
            r"^Disc\.radios is an unknown field; did you mean 'radius'\?$",
        ),
        ({"kind": "square"}, "kind .*'disc'"),
    ):
        with pytest.raises(ParameterError, match=words):
            Disc(**values)


def test_a_required_field_and_a_rule_between_fields() -> None:
    with pytest.raises(ParameterError, match="inner"):
        Ring()
    with pytest.raises(ParameterError, match=r"outer must be over inner, got 0\.5"):
        Ring(inner=0.7, outer=0.5)


def test_a_block_a_bare_word_and_an_object_become_the_same() -> None:
    _, adapter = room()
    assert (
        adapter.validate_python({"kind": "disc"})
        == adapter.validate_python("disc")
        == adapter.validate_python(Disc())
        == Disc()
    )


def test_a_number_and_a_default_kind_stand_for_a_block() -> None:
    _, adapter = room(number=("disc", "radius"), default="disc")
    assert adapter.validate_python(2) == adapter.validate_python({"radius": 2}) == Disc(radius=2.0)
    with pytest.raises(pydantic.ValidationError, match="must be a shape block"):
        adapter.validate_python(True)  # no number, although Python calls it one


@pytest.mark.parametrize("value", [{"kind": "cube"}, "cube", {"kind": 3}])
def test_an_unknown_kind_is_refused_with_the_list(value: object) -> None:
    with pytest.raises(pydantic.ValidationError, match="is no shape; valid kinds: disc, ring"):
        room()[1].validate_python(value)


def test_a_block_without_a_kind_is_refused_with_the_list() -> None:
    with pytest.raises(pydantic.ValidationError, match="needs a kind; valid kinds: disc, ring"):
        room()[1].validate_python({"radius": 1})


def test_a_room_refuses_a_word_twice_and_a_member_without_a_word() -> None:
    shapes, _ = room()

    @spec
    class OtherDisc:
        kind: Literal["disc"] = "disc"

    @spec
    class Nameless:
        size: float = 1.0

    with pytest.raises(ParameterError, match="'disc' is already a shape"):
        shapes.add(OtherDisc)
    assert shapes.add(Disc) is Disc  # the same member again changes nothing
    with pytest.raises(ParameterError, match="Nameless needs `kind: Literal"):
        kind_of(Nameless)


def test_installed_packages_add_kinds_through_their_entry_points(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    offered = EntryPoints(
        EntryPoint(name, f"{__name__}:Ring", group)
        for name, group in (("a", "vstestbed.shapes"), ("b", "vstestbed.laws"))
    )
    shapes = Registry("shape", Disc)
    monkeypatch.setattr(EntryPoint, "load", lambda self: {"a": Ring}[self.name])
    assert shapes.load_entry_points(offered)
    assert list(shapes.members) == ["disc", "ring"]
    assert not shapes.load_entry_points(offered)  # nothing new the second time


def test_a_mapping_has_every_default_and_the_kind_first() -> None:
    assert to_mapping(Ring(inner=0.25)) == {"kind": "ring", "inner": 0.25, "outer": 1.0}
    assert next(iter(to_mapping(Disc()))) == "kind"
    assert to_mapping((Disc(), 3, "x")) == [{"kind": "disc", "radius": 0.5}, 3, "x"]


def test_the_schema_offers_blocks_words_that_need_no_more_and_numbers() -> None:
    shapes, _ = room(number=("disc", "radius"))
    choices = whole_adapter(Annotated[Disc | Ring, shapes]).json_schema()["anyOf"]
    assert [c["$ref"] for c in choices if "$ref" in c] == ["#/$defs/Disc", "#/$defs/Ring"]
    assert {"enum": ["disc"]} in choices  # a bare `ring` would lack its inner radius
    assert {"type": "number", "exclusiveMinimum": 0} in choices  # the radius, with its bounds
