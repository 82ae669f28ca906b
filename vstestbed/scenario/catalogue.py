"""Every block of a scenario by the word that people have for it: `pbvs`, `law.pbvs`, `stop`, `law.solve`, `law` for all its kinds."""

from __future__ import annotations

import dataclasses
import functools
import typing
from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

from vstestbed.core.errors import ParameterError
from vstestbed.core.registry import Room, blocks_in, fields_of, is_list
from vstestbed.core.spec import kind_of


@dataclass(frozen=True)
class Entry:
    """A block, or a list of kinds.

    Attributes:
        name: its full name. cls: its class; None for a list of kinds. room: the list of kinds that it is, or to which its kind belongs.
        field: the field that holds it, `NAME[]` where it is one of a list.
    """

    name: str
    cls: type | None
    room: Room | None
    field: str


def catalogue(**roots: type) -> dict[str, Entry]:
    """All entries by their full names, from the outside in.

    Args:
        roots: the blocks that are files of their own, by name; the fields of `scenario` go without that name.
    """
    found = {name: Entry(name, cls, None, name) for name, cls in roots.items()}
    waiting = deque(("" if name == "scenario" else name, cls) for name, cls in roots.items())
    while waiting:
        owner, cls = waiting.popleft()
        kinds = _kinds_of(found[owner]) if owner in found else [cls]
        for field, listed, room, inner in _blocks_of(cls):
            place = f"{field}[]" if listed else field
            if room is None:
                name = _field_name(owner if _alike(kinds, field) else kind_of(cls), field, cls, inner, found)
            else:
                name = f"{room.what}.{kind_of(inner)}"
                found.setdefault(room.what, Entry(room.what, None, room, place))
            if name not in found:
                found[name] = Entry(name, inner, room, place)
                waiting.append((name if room is None else room.what, inner))
    return found


def _blocks_of(cls: type) -> Iterator[tuple[str, bool, Room | None, type]]:
    """Field, whether it is a list, room and class of each block that a block may hold."""
    for field in dataclasses.fields(cls):
        if field.init:
            hint = hint_of(cls, field.name)
            yield from ((field.name, is_list(hint), room, inner) for room, inner in blocks_in(hint))


def _alike(classes: Iterable[type], field: str) -> bool:
    """Whether a field holds the same blocks in all classes that have it; `start` is another one in each robot."""
    held = [tuple(blocks_in(hint_of(cls, field))) for cls in classes if field in fields_of(cls)]
    return all(blocks == held[0] for blocks in held)


def _field_name(owner: str, field: str, cls: type, inner: type, found: dict[str, Entry]) -> str:
    """The name of a block in a field: `stop.converged`; with its kind where the owner's is the name of another block."""
    name = f"{owner}.{field}".removeprefix(".")
    if name not in found or found[name].cls is inner:
        return name
    return f"{kind_of(cls)}.{field}" if hasattr(cls, "kind") else f"{name}.{inner.__name__}"


def entry_of(word: str, entries: dict[str, Entry]) -> Entry | None:
    """The entry of a full name, of its last part where that is the name of one thing, or of a field as `--set` calls it, with or without
    a kind: `law.depth`, `law.depth.pnp`. None where there is none.

    Raises:
        ParameterError: there are several: it has their full names.
    """
    if word in entries:
        return entries[word]
    if "." in word:
        held = _held_in(word, entries) or _kind_held_in(word, entries)
        return held[0] if len(held) == 1 else None
    by_name = [entry for entry in entries.values() if named(entry) == word]
    # a kind that its field alone may hold, such as the marker `stripe` of target `lines`, has the field's name
    by_kind = [entry for entry in entries.values() if getattr(entry.cls, "kind", None) == word]
    things = list({entry.cls: entry for entry in reversed(by_name or by_kind)}.values())
    if len(things) > 1:
        names = sorted(entry.name for entry in things)
        raise ParameterError(word, f"is {', '.join(names[:-1])} and {names[-1]}; give one of these names")
    return things[0] if things else None


def named(entry: Entry) -> str:
    """The last part of an entry's name: `pbvs` of `law.pbvs`."""
    return entry.name.rpartition(".")[2]


def hint_of(cls: type, field: str) -> Any:
    """The type of a field, with its bounds and its list of kinds."""
    return _hints(cls)[field]


@functools.cache
def _hints(cls: type) -> dict[str, Any]:
    return typing.get_type_hints(cls, include_extras=True)


def _held_in(path: str, entries: dict[str, Entry]) -> list[Entry]:
    """The lists of kinds of which the last field of a dotted path holds one: `depth` for `law.depth`; none where it holds something else
    in some kinds of the owner, as `target.marker` does.
    """
    owner, _, field = path.rpartition(".")
    holders = _kinds_of(entries[owner]) if owner in entries else []
    if not _alike(holders, field):
        return []
    rooms = {room.what for cls in holders if field in fields_of(cls) for room, _ in blocks_in(hint_of(cls, field)) if room is not None}
    return [entry for entry in entries.values() if entry.cls is None and entry.name in rooms]


def _kinds_of(entry: Entry) -> list[type]:
    """The class of a block, or those of a list of kinds."""
    if entry.cls is not None:
        return [entry.cls]
    return [] if entry.room is None else list(entry.room.members.values())


def _kind_held_in(path: str, entries: dict[str, Entry]) -> list[Entry]:
    """The kinds at the end of a dotted path that the field before it may hold: `pnp` for `law.depth.pnp`."""
    field, _, kind = path.rpartition(".")
    return [entries[name] for room in _held_in(field, entries) if (name := f"{room.name}.{kind}") in entries]
