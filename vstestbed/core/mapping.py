"""Specs as plain mappings, lists and scalars: with every default, or as people write them."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

from vstestbed.core.registry import Room, rooms_of


def to_mapping(value: Any) -> Any:
    """A spec as plain mappings, lists and scalars with all defaults written out: the content of `scenario.yaml`."""
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
    """A spec as people write it: without what is a default anyway, whole numbers without `.0`, with the shorthands of its rooms.

    A spec may have `preset_values`, by field, which stand in place of defaults.
    """
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return _brief_block(value)
    if isinstance(value, tuple | list):
        return [brief_mapping(v) for v in value]
    if isinstance(value, float) and value.is_integer() and abs(value) < 1e6:
        return int(value)
    return value


def _brief_block(value: Any) -> Any:
    """A spec as a mapping, or the word or number that stands for it."""
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
    """The fields that are not at their default, or at what a preset of the block fills in its place.

    Of a block without a kind, which needs something in it, the first one at least.
    """
    fields = [f for f in dataclasses.fields(value) if f.init and f.name != "kind"]
    # What makes it this kind comes before what all kinds have, as people write it: a square's side before its pose.
    own = sorted(fields, key=lambda f: f.name not in type(value).__annotations__)
    return [f.name for f in own if getattr(value, f.name) != preset.get(f.name, _default(f))] or [
        f.name for f in own[: not hasattr(value, "kind")]
    ]


def _with_kind(kind: str, block: dict[str, Any], rooms: list[Room]) -> Any:
    """A block with its kind, where no field tells it; the number or the word that a room has for it."""
    if rooms and all(room.implied(block) == kind for room in rooms):
        return block
    for room in rooms:
        if room.number and (kind, [*block]) == (room.number[0], [room.number[1]]):
            return block[room.number[1]]
    return {"kind": kind, **block} if block or not rooms else kind


def _default(field: dataclasses.Field[Any]) -> Any:
    """The default of a field; MISSING where it has none."""
    return field.default_factory() if field.default_factory is not dataclasses.MISSING else field.default
