"""Contracts: what a class must have to become a member of a room,
and the sentence that refuses it.
"""

from __future__ import annotations

from typing import ClassVar, Literal, Protocol

import pytest

from vstestbed.core.errors import ParameterError
from vstestbed.core.registry import Contract, Registry
from vstestbed.core.spec import spec
from vstestbed.features import FEATURES
from vstestbed.scenario.plugins import registries
from vstestbed.vision import DETECTORS


class Shape(Protocol):
    corners: ClassVar[int]

    @property
    def kind(self) -> str: ...

    @property
    def colours(self) -> tuple[str, ...]: ...

    def area(self, scale: float) -> float: ...


class ShapeBase:
    corners = 0
    colours = ("red",)


def shapes() -> Registry:
    return Registry(
        "shape", contract=Contract(Shape, base=ShapeBase, words={"colours": ("red", "green")})
    )


def test_a_base_with_defaults_leaves_the_kind_and_one_method_to_write() -> None:
    @spec
    class Disc(ShapeBase):
        kind: Literal["disc"] = "disc"
        radius: (
            float  # a required field: properties of such a class cannot be read before it is used
        )

        def area(self, scale: float, power: int = 2) -> float:
            return scale * self.radius**power

    assert shapes().add(Disc) is Disc


def test_fields_and_static_methods_count() -> None:
    @spec
    class Square:
        kind: Literal["square"] = "square"
        corners: int = 4
        colours: tuple[str, ...]

        @staticmethod
        def area(scale: float) -> float:
            return scale

    assert shapes().add(Square) is Square


def test_a_missing_member_is_named_with_the_base_that_has_it() -> None:
    @spec
    class Bare:
        kind: Literal["bare"] = "bare"

    with pytest.raises(
        ParameterError,
        match=(
            r"^Bare lacks corners, colours, area\(scale\);"
            r" derive it from .*ShapeBase.* all but kind and area$"
        ),
    ):
        shapes().add(Bare)


def test_a_missing_method_of_a_class_with_the_base_is_to_be_added() -> None:
    @spec
    class Still(ShapeBase):
        kind: Literal["still"] = "still"

    with pytest.raises(
        ParameterError, match=r"^Still lacks area\(scale\); add what is missing \(see .*\.Shape\)$"
    ):
        shapes().add(Still)


def test_the_stubs_of_the_protocol_itself_do_not_count() -> None:
    @spec
    class Stub(ShapeBase, Shape):
        kind: Literal["stub"] = "stub"

    with pytest.raises(ParameterError, match=r"^Stub lacks area\(scale\)"):
        shapes().add(Stub)


def test_a_wrong_number_of_parameters_is_refused() -> None:
    @spec
    class Narrow(ShapeBase):
        kind: Literal["narrow"] = "narrow"

        def area(self) -> float:
            return 1.0

    with pytest.raises(
        ParameterError,
        match=(
            r"^Narrow\.area must take the arguments of area\(scale\); it has the signature \(self\)"
        ),
    ):
        shapes().add(Narrow)


def test_attributes_and_methods_are_told_apart() -> None:
    @spec
    class Called(ShapeBase):
        kind: Literal["called"] = "called"

        def colours(self) -> tuple[str, ...]:
            return ("red",)

        def area(self, scale: float) -> float:
            return scale

    @spec
    class Value(ShapeBase):
        kind: Literal["value"] = "value"
        area: float = 1.0

    with pytest.raises(
        ParameterError,
        match=r"^Called\.colours must be an attribute, and is a method; write @property above it",
    ):
        shapes().add(Called)
    with pytest.raises(ParameterError, match=r"^Value\.area must be a method area\(scale\)"):
        shapes().add(Value)


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (("red", "grean"), "'grean' is no valid word; did you mean 'green'"),
        ("red", "must be a tuple of words"),
    ],
)
def test_unknown_words_are_refused_in_attributes_and_properties(
    words: tuple[str, ...], sentence: str
) -> None:
    @spec
    class Plain(ShapeBase):
        kind: Literal["plain"] = "plain"
        colours = words

        def area(self, scale: float) -> float:
            return scale

    @spec
    class Computed(ShapeBase):
        kind: Literal["computed"] = "computed"

        @property
        def colours(self) -> tuple[str, ...]:
            return words

        def area(self, scale: float) -> float:
            return scale

    for member in (Plain, Computed):
        with pytest.raises(ParameterError, match=rf"^{member.__name__}\.colours:? {sentence}"):
            shapes().add(member)


@pytest.mark.parametrize(
    "room",
    [room for room in registries().values() if room.contract is not None],
    ids=lambda room: room.what,
)
def test_every_bundled_kind_keeps_the_contract_of_its_room(room: Registry) -> None:
    assert room.contract is not None
    for member in room.members.values():
        room.contract.check(member)


def test_features_and_detectors_have_contracts() -> None:
    @spec
    class Feature:
        kind: Literal["own"] = "own"
        inputs: ClassVar[tuple[str, ...]] = ("xy", "depht")
        rows_per_marker: ClassVar[int] = 2
        least_markers: ClassVar[int] = 1

        def measure(self, xy): ...
        def interaction(self, xy, depth): ...
        def error(self, s, s_star): ...

    @spec
    class Seer:
        kind: Literal["seer"] = "seer"

    with pytest.raises(
        ParameterError, match=r"^Feature\.inputs: 'depht' is no valid word; did you mean 'depth'"
    ):
        FEATURES.add(Feature)
    with pytest.raises(
        ParameterError,
        match=r"^Seer lacks needs_image, .*detect\(state, picture, view, camera, target, rng\)",
    ):
        DETECTORS.add(Seer)
    assert "own" not in FEATURES.members and "seer" not in DETECTORS.members
