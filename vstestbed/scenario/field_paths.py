"""Every field of a scenario by its dotted path: `camera.readout_s`, `robot.puma560.gears.damping_s`, `world.plates.0.pose`, `randomise`."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from vstestbed.core.errors import ParameterError, nearest
from vstestbed.core.registry import blocks_in, fields_of, is_list
from vstestbed.scenario.catalogue import Entry, entry_of, hint_of, named

MOST_NAMED = 6
"""Most paths that a message lists of a word that is a field of many blocks."""


@dataclass(frozen=True)
class FieldPlace:
    """A field in all the blocks that have it at one place of a scenario.

    Attributes:
        path: as it was asked for; of a name alone the path to it. name: its own.
        owners: the classes that have it, by the names of their entries. settable: whether `--set` takes the path.
    """

    path: str
    name: str
    owners: Mapping[str, type]
    settable: bool


def looked_up(word: str, entries: dict[str, Entry]) -> Entry | FieldPlace:
    """A kind, a block or a field, by any of its names.

    Raises:
        ParameterError: there is none, or there are several: it has the nearest, or their names.
    """
    return entry_of(word, entries) or _at(word, entries)


def _at(path: str, entries: dict[str, Entry]) -> Entry | FieldPlace:
    """What stands at a dotted path, with or without kinds and places in a list."""
    *before, name = (part.removesuffix("[]") for part in path.split(".") if not part.isdecimal())
    if not before:
        return _top_or_only(name, entries)
    holders = {_name_of(cls, entries): cls for cls in _holders(path, before, entries)}
    if owners := {named_so: cls for named_so, cls in holders.items() if name in fields_of(cls)}:
        return FieldPlace(path, name, owners, _settable(before, entries))
    for named_so, cls in holders.items():
        if _kind(cls) == name:
            return entries[named_so]
    raise _none_in(path, name, before, list(holders.values()))


def _name_of(cls: type, entries: Mapping[str, Entry]) -> str:
    """The name of a class's first entry."""
    return next(entry.name for entry in entries.values() if entry.cls is cls)


def _holders(path: str, before: Sequence[str], entries: Mapping[str, Entry]) -> list[type]:
    """The classes of the blocks to which the parts of a path before its last one lead.

    Raises:
        ParameterError: one of them leads nowhere.
    """
    holders = [_scenario(entries)]
    for i, part in enumerate(before):
        within = list(_within(holders, part)) if i else _begun(part, entries)
        if not within:
            raise _none_in(path, part, before[:i], holders)
        holders = within
    return holders


def _top_or_only(name: str, entries: Mapping[str, Entry]) -> FieldPlace:
    """A field of the scenario itself, else the one of this name in all of it."""
    scenario, held = _scenario(entries), dict[str, dict[str, type]]()
    if name in fields_of(scenario):
        return FieldPlace(name, name, {"scenario": scenario}, True)
    for entry in entries.values():
        if entry.cls is not None and name in fields_of(entry.cls):
            place = entry.name if entry.room is None else entry.room.what
            held.setdefault(f"{place}.{name}", {})[entry.name] = entry.cls
    if len(held) == 1:
        path, owners = next(iter(held.items()))
        return FieldPlace(path, name, owners, _settable(path.split(".")[:-1], entries))
    if held:
        shown = ", ".join(list(held)[:MOST_NAMED])
        raise ParameterError(name, f"is a field of {len(held)} blocks; give its path, such as {shown}")
    raise ParameterError(name, f"is no kind, block or field of a scenario; {_nearest_of_all(name, entries)}")


def _scenario(entries: Mapping[str, Entry]) -> type:
    cls = entries["scenario"].cls
    assert cls is not None  # it is a block, and no list of kinds
    return cls


def _begun(word: str, entries: Mapping[str, Entry]) -> list[type]:
    """The classes that the first word of a path may mean: a field of the scenario, a list of kinds, a kind or a block by its name.

    Raises:
        ParameterError: it is no word at all.
    """
    scenario = _scenario(entries)
    if word in fields_of(scenario):
        return list(_within([scenario], word))
    found = [e.cls for e in entries.values() if e.cls is not None and (word == named(e) or (e.room is not None and e.room.what == word))]
    if not found:
        raise ParameterError(word, f"is no kind and no block of a scenario; {_nearest_of_all(word, entries)}")
    return found


def _within(holders: Sequence[type], part: str) -> Iterator[type]:
    """The classes of the blocks to which a part of a path leads: those that a field of this name holds, and the kind of this name."""
    inner = [inner for cls in holders if part in fields_of(cls) for _, inner in blocks_in(hint_of(cls, part))]
    yield from dict.fromkeys([*inner, *(cls for cls in holders if _kind(cls) == part)])


@functools.cache
def _kind(cls: type) -> str:
    """The word of a kind; "" for a block that has none."""
    return next((str(f.default) for f in dataclasses.fields(cls) if f.name == "kind"), "")


def _settable(before: Iterable[str], entries: Mapping[str, Entry]) -> bool:
    """Whether the blocks on the way to a field are fields of fields of a scenario, and no lists."""
    holders = [_scenario(entries)]
    for part in before:
        hints = [hint_of(cls, part) for cls in holders if part in fields_of(cls)]
        if not hints or any(map(is_list, hints)):
            return False
        holders = list(_within(holders, part))
    return True


def _none_in(path: str, name: str, before: Sequence[str], holders: Iterable[type]) -> ParameterError:
    """The error for a part of a path that leads nowhere, behind the parts `before` it."""
    inside = {inner for cls in holders for inner in fields_of(cls) if inner != "kind"}
    if name in inside:
        return ParameterError(path, f"is no field of a scenario: {'.'.join((*before, name))} is no block, and has no fields")
    return ParameterError(path, f"is no field of a scenario: {'.'.join(before)} has no {name}; {nearest(name, inside)}")


def _nearest_of_all(word: str, entries: Mapping[str, Entry]) -> str:
    """The nearest name, or where to begin: a list of all names would fill a screen."""
    fields = {name for entry in entries.values() if entry.cls is not None for name in fields_of(entry.cls)}
    hint = nearest(word, {named(entry) for entry in entries.values()} | set(entries) | fields)
    return hint if hint.startswith("did you mean") else f"a scenario has {', '.join(fields_of(_scenario(entries)))}"
