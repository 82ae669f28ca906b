"""What is registered: the spec classes, and the rooms with their kinds. `core.spec` fills it; here it is read."""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from typing import Any

from vstestbed.core.errors import ParameterError, nearest

SPECS: list[type] = []
"""Every spec in the order of definition."""
ROOMS: list[Room] = []  # every list of kinds


class Room:
    """A list of the kinds of one block; `core.spec.OneOf` is it for pydantic.

    Args:
        what: the name of the field ("law").
        number: (kind, field) for which a bare number is a shorthand; None where numbers are refused.
        default: the kind of a block without `kind`; None where `kind` is required.
        fields: the kind of a block without `kind` that has the given field, by field.
    members: the spec class of each kind.
    """

    def __init__(self, what: str, number: tuple[str, str] | None, default: str | None, fields: Mapping[str, str] | None):
        self.what, self.number, self.default, self.fields = what, number, default, dict(fields or {})
        self.members: dict[str, type] = {}
        ROOMS.append(self)

    @property
    def base(self) -> type | None:
        """The spec class from which all kinds come, and which is none of them; None where there is none."""
        kinds = self.members.values()
        return next((cls for cls in SPECS if kinds and cls not in kinds and all(issubclass(kind, cls) for kind in kinds)), None)

    def implied(self, block: Mapping[str, Any]) -> str | None:
        """The kind of a block without `kind`, by one of its fields; None where none tells it."""
        return next((kind for field, kind in self.fields.items() if field in block), None)

    def expanded(self, value: Any) -> Any:
        """A word, a number or a block as a block with its `kind`, None where it has none; any other value as it is."""
        if isinstance(value, str):
            return {"kind": value}
        # Python's bool is an int: without the exception `gain: true` would be a gain of 1.
        if self.number and isinstance(value, int | float) and not isinstance(value, bool):
            return {"kind": self.number[0], self.number[1]: value}
        return {**value, "kind": value.get("kind", self.implied(value) or self.default)} if isinstance(value, dict) else value


def rooms_of(cls: type) -> list[Room]:
    """The lists of kinds that a spec class is a member of."""
    return [room for room in ROOMS if cls in room.members.values()]


def to_mapping(value: Any) -> Any:
    """A spec as plain mappings, lists and scalars with all defaults written out: the content of `resolved.yaml`."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        # `kind` first, as people write it; the sort is stable and keeps the order of the others.
        names = sorted((f.name for f in dataclasses.fields(value) if f.init), key=lambda name: name != "kind")
        return {name: to_mapping(getattr(value, name)) for name in names}
    if isinstance(value, tuple | list):
        return [to_mapping(v) for v in value]
    if isinstance(value, dict):
        return {name: to_mapping(v) for name, v in value.items()}
    return value


def brief_mapping(value: Any) -> Any:
    """A spec as people write it: without defaults and what `preset_values` stand for, whole numbers without `.0`, with shorthands."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return _brief_block(value)
    if isinstance(value, tuple | list):
        return [brief_mapping(v) for v in value]
    if isinstance(value, float) and value.is_integer() and abs(value) < 1e6:
        return int(value)
    return value


def _brief_block(value: Any) -> Any:
    preset = getattr(value, "preset_values", {})
    block = {name: _brief_part(getattr(value, name), preset.get(name)) for name in _kept_fields(value, preset)}
    if not hasattr(value, "kind"):
        return block
    return _with_kind(value.kind, block, rooms_of(type(value)))


def _brief_part(value: Any, preset: Any) -> Any:
    """A field's value; of a block that a preset fills, the fields alone in which it differs from the preset's."""
    if dataclasses.is_dataclass(value) and type(value) is type(preset):
        different = [f.name for f in dataclasses.fields(value) if f.init and getattr(value, f.name) != getattr(preset, f.name)]
        return {name: brief_mapping(getattr(value, name)) for name in different}
    return brief_mapping(value)


def _kept_fields(value: Any, preset: Mapping[str, Any]) -> list[str]:
    """The fields that are not at their default, or at what a preset of the block fills in its place. Of a block without a kind, which needs
    something in it, the first one at least.
    """
    fields = [f for f in dataclasses.fields(value) if f.init and f.name != "kind"]
    # What makes it this kind comes before what all kinds have, as people write it: a square's side before its pose.
    own = sorted(fields, key=lambda f: f.name not in type(value).__annotations__)
    return [f.name for f in own if getattr(value, f.name) != preset.get(f.name, _default(f))] or [
        f.name for f in own[: not hasattr(value, "kind")]
    ]


def _with_kind(kind: str, block: dict[str, Any], rooms: list[Room]) -> Any:
    if rooms and all(room.implied(block) == kind for room in rooms):
        return block
    for room in rooms:
        if room.number and (kind, [*block]) == (room.number[0], [room.number[1]]):
            return block[room.number[1]]
    return {"kind": kind, **block} if block or not rooms else kind


def _default(field: dataclasses.Field[Any]) -> Any:
    return field.default_factory() if field.default_factory is not dataclasses.MISSING else field.default


# Contract: what each member of a `OneOf` must have, checked once, when the member is registered.
#
# A plugin that lacks a method would otherwise run until the loop first calls that method, and end with a traceback there.
@dataclass(frozen=True)
class Contract:
    """What a class must have to be a member of a room: the public methods and attributes of `protocol`, which may have defaults.
    base: a class with defaults for most of them, or None. words: the valid items of attributes that are tuples of words, by name.
    """

    protocol: type
    base: type | None = None
    words: Mapping[str, Collection[str]] = field(default_factory=dict)

    def check(self, member: type) -> None:
        """Refuse a class that breaks the contract. member: a dataclass; its fields count as attributes."""
        required = _public_members(self.protocol)
        missing = [name for name in required if not self._has(member, name)]
        if missing:
            names = ", ".join(_shown(name, required[name]) for name in missing)
            raise ParameterError(member.__name__, f"lacks {names}; {self._remedy(member)}")
        for name, method in required.items():
            _check_shape(member, name, method)
        for name, valid in self.words.items():
            _check_words(member, name, valid)

    def _has(self, member: type, name: str) -> bool:
        """Whether a class has a member that is no stub: neither abstract, nor inherited from a `typing.Protocol`."""
        own = inspect.getattr_static(member, name, None)
        if own is None:
            return hasattr(member, name) or name in getattr(member, "__dataclass_fields__", {})
        inherited = own is vars(self.protocol).get(name) and getattr(self.protocol, "_is_protocol", False)
        return not inherited and not getattr(getattr(own, "func", own), "__isabstractmethod__", False)  # func: of a cached property

    def _remedy(self, member: type) -> str:
        if self.base is None or issubclass(member, self.base):
            return f"add what is missing (see {self.protocol.__module__}.{self.protocol.__name__})"
        rest = [name for name in _public_members(self.protocol) if not self._has(self.base, name)]
        return f"derive it from {self.base.__module__}.{self.base.__name__}, which has defaults for all but {' and '.join(rest)}"


def _public_members(protocol: type) -> dict[str, Callable[..., Any] | None]:
    found: dict[str, Callable[..., Any] | None] = {}
    for cls in reversed(protocol.__mro__):
        found |= dict.fromkeys(name for name in inspect.get_annotations(cls) if not name.startswith("_"))
        found |= {name: value if inspect.isfunction(value) else None for name, value in vars(cls).items() if not name.startswith("_")}
    return found


def _shown(name: str, method: Callable[..., Any] | None) -> str:
    return name if method is None else f"{name}({', '.join(list(inspect.signature(method).parameters)[1:])})"


def _check_shape(member: type, name: str, method: Callable[..., Any] | None) -> None:
    """Refuse a method where an attribute belongs, an attribute where a method belongs, and a wrong number of parameters."""
    own, where = inspect.getattr_static(member, name, None), f"{member.__name__}.{name}"
    if method is None:
        if inspect.isfunction(own):
            raise ParameterError(where, "must be an attribute, and is a method; write @property above it")
        return
    if not callable(getattr(member, name, None)):
        raise ParameterError(where, f"must be a method {_shown(name, method)}")
    # Read off the class, a plain function still has its `self`; a static or class method does not.
    arguments = list(inspect.signature(method).parameters)[0 if inspect.isfunction(own) else 1 :]
    signature = inspect.signature(getattr(member, name))
    try:
        signature.bind(*arguments)
    except TypeError:
        raise ParameterError(where, f"must take the arguments of {_shown(name, method)}; it has the signature {signature}") from None


def _check_words(member: type, name: str, valid: Collection[str]) -> None:
    """Refuse an unknown word in a tuple of words. A property is read from an object made of the defaults alone; of a class that has none
    such, its words stay unchecked.
    """
    words = getattr(member, name, ())
    if isinstance(words, property):
        try:
            words = getattr(member(), name)
        except (TypeError, ParameterError):  # a field without a default, or defaults that need another value beside them
            return
    if not isinstance(words, tuple):
        raise ParameterError(f"{member.__name__}.{name}", "must be a tuple of words, such as ('xy', 'depth')", words)
    for word in words:
        if word not in valid:
            raise ParameterError(f"{member.__name__}.{name}", f"has no valid word {word!r}; {nearest(str(word), valid)}")
