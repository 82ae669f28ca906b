"""What the bundled scenarios and comparisons use: which kinds, which fields, and the values that people wrote there."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from vstestbed.core.assets import bundled_comparisons, bundled_scenarios
from vstestbed.core.errors import ScenarioError
from vstestbed.core.named_files import PACKAGE
from vstestbed.scenario.load import load, text_of
from vstestbed.scenario.validation import KINDS
from vstestbed.scenario.yaml_marks import plain_mapping


@dataclass
class Uses:
    """What is written in bundled files.

    Attributes:
        files: names of the files that use a class, by class, in their order.
        blocks: the field and the block in the first of them; the field is `NAME[]` where the block is one of a list.
        values: what is written in each field, by the name of its class and its own, in the order of the files.
    """

    files: dict[type, list[str]] = field(default_factory=dict)
    blocks: dict[type, tuple[str, Any]] = field(default_factory=dict)
    values: dict[tuple[str, str], list[Any]] = field(default_factory=dict)

    def add(self, cls: type, file: str, name: str, written: Any) -> None:
        """Take in a block of a class, as it is written in a field of a file: a mapping, or the shorthand for one."""
        files = self.files.setdefault(cls, [])
        if file not in files:
            files.append(file)
        self.blocks.setdefault(cls, (name, written))
        self.add_fields(cls.__name__, written)

    def add_fields(self, name: str, written: Any) -> None:
        """Take in the fields of a block of the class of this name; a shorthand has none."""
        for inner, value in written.items() if isinstance(written, Mapping) else ():
            self.values.setdefault((name, inner), []).append(value)


@functools.cache
def bundled_uses() -> Uses:
    """The uses in all bundled scenarios, and in comparisons of what no scenario has before.

    A scenario with an arm's file inside a package is left out where that package is not installed.
    """
    uses = Uses()
    for name, path in bundled_scenarios().items():
        try:
            built = load(name)
        except ScenarioError:
            if PACKAGE in text_of(path):
                continue
            raise
        for cls, key, written in _in_scenario("scenario", _plain(path), built):
            uses.add(cls, name, key, written)
    for name, path in bundled_comparisons().items():
        plain = _plain(path)
        uses.add_fields("Comparison", plain)  # by their names: their room is above this one
        for table in plain.get("tasks", {}).values():
            uses.add_fields("StartTable", table)
        for cls, key, written in _in_comparison("", plain):
            uses.add(cls, f"compare/{name}", key, written)
    return uses


def _plain(path: Path) -> dict[str, Any]:
    return plain_mapping(text_of(path), str(path), "")[0]


def _in_scenario(key: str, written: Any, built: Any) -> Iterator[tuple[type, str, Any]]:
    """Class, field and text of each block that is written in a scenario, by the object that was built of it."""
    if isinstance(written, list) and isinstance(built, tuple):
        for one, made in zip(written, built, strict=False):
            yield from _in_scenario(f"{key}[]", one, made)
    elif dataclasses.is_dataclass(built):
        yield type(built), key, written
        for name, value in written.items() if isinstance(written, Mapping) else ():
            yield from _in_scenario(name, value, getattr(built, name, None))


def _in_comparison(key: str, written: Any) -> Iterator[tuple[type, str, Any]]:
    """The same of a comparison, whose blocks with a `kind` stand anywhere: under a dotted path, or in a list of values."""
    what, kind = key.rpartition(".")[2], written.get("kind") if isinstance(written, Mapping) else written
    if isinstance(kind, str) and kind in (members := _members(what)):
        yield members[kind], what, written
    if isinstance(written, Mapping):
        for name, value in written.items():
            yield from _in_comparison(str(name), value)
    elif isinstance(written, list):
        for value in written:
            yield from _in_comparison(key, value)


def _members(what: str) -> dict[str, type]:
    """The kinds of a field; none where it has no kinds."""
    return next((room.members for room in KINDS.values() if room.what == what), {})
