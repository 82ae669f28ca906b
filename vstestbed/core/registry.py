"""What is registered: the spec classes, and the rooms with their kinds. `core.spec` fills it; here it is read."""

from __future__ import annotations

import dataclasses
import typing
from collections.abc import Iterator, Mapping
from typing import Any

SPECS: list[type] = []
"""Every spec in the order of definition, so that `rebuild_specs` builds parts before what holds them."""
ROOMS: list[Room] = []
"""Every list of kinds."""


class Room:
    """A list of the kinds of one block; `core.spec.OneOf` is it for pydantic.

    Args:
        what: the name of the field ("law").
        number: (kind, field) for which a bare number is a shorthand; None where numbers are refused.
        default: the kind of a block without `kind`; None where `kind` is required.
        fields: the kind of a block without `kind` that has the given field, by field.

    Attributes:
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


def spec_named(word: object) -> type | None:
    """The spec class of a name: pydantic has it in the location of an error where a field may be one of two blocks; None for others."""
    return next((cls for cls in SPECS if cls.__name__ == word), None)


def rooms_of(cls: type) -> list[Room]:
    """The lists of kinds that a spec class is a member of."""
    return [room for room in ROOMS if cls in room.members.values()]


def fields_of(cls: type) -> list[str]:
    """The names of the fields of a spec class that its constructor takes."""
    return [field.name for field in dataclasses.fields(cls) if field.init]


def blocks_in(hint: Any) -> Iterator[tuple[Room | None, type]]:
    """The spec classes that a field of this type may hold, each with the room in which it is a kind; None where it is the only one."""
    metadata = getattr(hint, "__metadata__", ())
    rooms = [m for m in metadata if isinstance(m, Room)]
    if rooms:
        yield from ((rooms[0], member) for member in rooms[0].members.values())
    elif metadata:
        yield from blocks_in(hint.__origin__)
    elif dataclasses.is_dataclass(hint) and isinstance(hint, type):
        yield None, hint
    else:
        for inner in typing.get_args(hint):
            yield from blocks_in(inner)


def is_list(hint: Any) -> bool:
    """Whether a field of this type, which holds blocks, holds a list of them."""
    return "tuple[" in str(hint)
