"""Which spec classes hold a block of a room, at any depth: those whose validators a new kind of it makes stale."""

from __future__ import annotations

import functools
import typing
from collections.abc import Collection
from typing import Any

from vstestbed.core.registry import SPECS, blocks_in


def holders(rooms: Collection[str]) -> list[type]:
    """The spec classes, in the order of definition, in which a block of one of these rooms (`Room.what`) may stand.

    A class that holds one that does is one of them, too: pydantic compiles the validators of the parts into that of the whole.
    """
    direct, inner = _blocks()
    found = {cls for cls, whats in direct.items() if not whats.isdisjoint(rooms)} | {cls for cls in SPECS if not _types(cls)}
    while more := {cls for cls, held in inner.items() if held & found} - found:
        found |= more
    return [cls for cls in SPECS if cls in found]


def _blocks() -> tuple[dict[type, set[str]], dict[type, set[type]]]:
    """Of each class the rooms of its own fields, and the classes of the blocks that may stand in them."""
    direct: dict[type, set[str]] = {}
    inner: dict[type, set[type]] = {}
    ahead = list(SPECS)
    while ahead:
        cls = ahead.pop()
        if cls not in inner:
            blocks = [block for hint in _types(cls) for block in blocks_in(hint)]
            direct[cls] = {room.what for room, _ in blocks if room is not None}
            inner[cls] = {held for _, held in blocks}
            ahead += inner[cls]
    return direct, inner


@functools.cache
def _types(cls: type) -> tuple[Any, ...]:
    """The types of a class's fields; none where a name in them cannot be found, as in a class within a function."""
    try:
        return tuple(typing.get_type_hints(cls, include_extras=True).values())
    except NameError:
        return ()
