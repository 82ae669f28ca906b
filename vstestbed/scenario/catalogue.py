"""Every block of a scenario by the word that people have for it: `pbvs`, `law.pbvs`, `stop`,
`law.solve`, `law` for all its kinds.
"""

from __future__ import annotations

import functools
from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue
from pydantic_core.core_schema import DataclassSchema

from vstestbed.core.errors import ParameterError, nearest
from vstestbed.core.fields import DIMENSIONLESS, Node, class_text, fields, needed
from vstestbed.core.named_files import bundled_comparisons, bundled_scenarios
from vstestbed.core.registry import Registry, kind_of, whole_adapter
from vstestbed.scenario.dump import flow_text
from vstestbed.scenario.plugins import HOMES, registry
from vstestbed.scenario.scenario import Scenario
from vstestbed.scenario.yaml_marks import bundled_mapping, read_value


@dataclass(frozen=True)
class Entry:
    """A block, or a list of kinds (its `cls` is None). registry: the list of kinds that it is, or
    to which its kind belongs. field: the field that holds it, `NAME[]` where it is one of a list.
    """

    name: str
    cls: type | None
    registry: Registry | None
    field: str


def catalogue(**roots: type) -> dict[str, Entry]:
    """All entries by full name, from the outside in. roots: the blocks that are files; the fields
    of `scenario` go without that name.
    """
    found = {name: Entry(name, cls, None, name) for name, cls in roots.items()}
    # the entry of a block, or of the list of kinds to which it belongs, and its class
    waiting = deque(roots.items())
    while waiting:
        owner, cls = waiting.popleft()
        for at, place, union, inner in _blocks_in(cls):
            if union is None:
                holder = owner if _alike(_kinds_of(found[owner]), at) else kind_of(cls)
                entry = name = _field_name(holder, at, cls, inner, found)
            else:
                entry = union.what
                name = f"{entry}.{kind_of(inner)}"
                found.setdefault(entry, Entry(entry, None, union, place))
            if name not in found:
                found[name] = Entry(name, inner, union, place)
                waiting.append((entry, inner))
    return found


def _blocks_in(cls: type) -> Iterator[tuple[str, str, Registry | None, type]]:
    """Field, place (`NAME[]` for one of a list), registry and class of each block that a block of
    the class may have in it.
    """
    for each in fields(cls).values():
        place = f"{each.name}[]" if each.node.type is tuple else each.name
        for union, inner in each.node.blocks():
            yield each.name, place, union, inner


def _alike(classes: Iterable[type], field: str) -> bool:
    """Whether a field holds the same blocks in all classes that have it; `start` is another one in
    each robot.
    """
    held = [_blocks_at(cls, field) for cls in classes if field in fields(cls)]
    return all(blocks == held[0] for blocks in held)


def _field_name(owner: str, field: str, cls: type, inner: type, found: dict[str, Entry]) -> str:
    """The name of a block in a field: `stop.converged`; with its kind where the owner's is the name
    of another block.
    """
    name = f"{owner}.{field}".removeprefix("scenario.")
    if name not in found or found[name].cls is inner:
        return name
    return f"{kind_of(cls)}.{field}" if hasattr(cls, "kind") else f"{name}.{inner.__name__}"


def named(entry: Entry) -> str:
    """The last part of an entry's name: `pbvs` of `law.pbvs`."""
    return entry.name.rpartition(".")[2]


def _blocks_at(cls: type, field: str) -> list[tuple[Registry | None, type]]:
    """Registry and class of the blocks that a field may hold; none of a class without it."""
    return list(fields(cls)[field].node.blocks()) if field in fields(cls) else []


def _held_in(path: str, entries: dict[str, Entry]) -> list[Entry]:
    """The lists of kinds of which the last field of a dotted path holds one: `depth` for
    `law.depth`; none where it holds something else in some kinds of the owner, as `target.marker`
    does.
    """
    owner, _, field = path.rpartition(".")
    holders = _kinds_of(entries[owner]) if owner in entries else []
    if not _alike(holders, field):
        return []
    blocks = [block for cls in holders for block in _blocks_at(cls, field)]
    held = {registry.what for registry, _ in blocks if registry is not None}
    return [entry for entry in entries.values() if entry.cls is None and entry.name in held]


def _kinds_of(entry: Entry) -> list[type]:
    if entry.cls is not None:
        return [entry.cls]
    return [] if entry.registry is None else list(entry.registry.members.values())


# Every field of a scenario by its dotted path: `camera.readout_s`, `robot.puma560.gears.damping_s`,
# `world.plates.0.pose`, `randomise`.
MOST_NAMED = 6  # most paths that a message lists of a word that is a field of many blocks


@dataclass(frozen=True)
class FieldPlace:
    """A field in all the blocks that have it at one place of a scenario.
    path: as it was asked for. owners: the classes that have it, by their entries. settable: whether
    `--set` takes the path.
    """

    path: str
    name: str
    owners: Mapping[str, type]
    settable: bool


def looked_up(word: str, entries: dict[str, Entry]) -> Entry | FieldPlace:
    """The entry of a full name, of its last part where only one thing has that, or of a field with
    or without a kind (`law.depth.pnp`); else the field of this name. Raises ParameterError: there
    is none, with the nearest, or there are several, with their full names.
    """
    if word in entries:
        return entries[word]
    found = _by_path(word, entries) if "." in word else _by_last_part(word, entries)
    return found[0] if len(found) == 1 else _at(word, entries)


def _by_path(path: str, entries: dict[str, Entry]) -> list[Entry]:
    """The lists of kinds of a field, else the kind that the field before it may hold: `pnp` of
    `law.depth.pnp`.
    """
    if held := _held_in(path, entries):
        return held
    field, _, kind = path.rpartition(".")
    names = [f"{registry.name}.{kind}" for registry in _held_in(field, entries)]
    return [entries[name] for name in names if name in entries]


def _by_last_part(word: str, entries: dict[str, Entry]) -> list[Entry]:
    """The entry whose name ends with a word, or none. Raises ParameterError: there are several."""
    by_name = [entry for entry in entries.values() if named(entry) == word]
    # a kind that its field alone may hold, such as the marker `stripe` of target `lines`, has the
    # field's name
    by_kind = [entry for entry in entries.values() if getattr(entry.cls, "kind", None) == word]
    things = list({entry.cls: entry for entry in reversed(by_name or by_kind)}.values())
    if len(things) > 1:
        *names, last = sorted(entry.name for entry in things)
        raise ParameterError(word, f"is {', '.join(names)} and {last}; give one of these names")
    return things


def _at(path: str, entries: dict[str, Entry]) -> Entry | FieldPlace:
    """What stands at a dotted path, with or without kinds and places in a list."""
    *before, name = (part.removesuffix("[]") for part in path.split(".") if not part.isdecimal())
    if not before:
        return _top_or_only(name, entries)
    holders = _led_to(path, before, entries)
    by_class = {entry.cls: entry for entry in reversed(entries.values())}
    owners = {by_class[cls].name: cls for cls in holders if name in fields(cls)}
    if owners:
        return FieldPlace(path, name, owners, _settable(before, entries))
    for cls in holders:
        if getattr(cls, "kind", "") == name:
            return by_class[cls]
    raise _none_in(path, name, before, holders)


def _led_to(path: str, before: Sequence[str], entries: dict[str, Entry]) -> list[type]:
    """The classes of the blocks to which the first parts of a path lead. Raises ParameterError: one
    of them leads nowhere.
    """
    holders = [_scenario(entries)]
    for i, part in enumerate(before):
        inner = list(_within(holders, part)) if i else _begun(part, entries)
        if not inner:
            raise _none_in(path, part, before[:i], holders)
        holders = inner
    return holders


def _top_or_only(name: str, entries: Mapping[str, Entry]) -> FieldPlace:
    """A field of the scenario itself, else the one of this name in all of it."""
    scenario = _scenario(entries)
    if name in fields(scenario):
        return FieldPlace(name, name, {"scenario": scenario}, True)
    held: dict[str, dict[str, type]] = {}
    for entry in entries.values():
        if entry.cls is not None and name in fields(entry.cls):
            place = entry.name if entry.registry is None else entry.registry.what
            held.setdefault(f"{place}.{name}", {})[entry.name] = entry.cls
    if len(held) == 1:
        path, owners = next(iter(held.items()))
        return FieldPlace(path, name, owners, _settable(path.split(".")[:-1], entries))
    if held:
        shown = ", ".join(list(held)[:MOST_NAMED])
        raise ParameterError(
            name, f"is a field of {len(held)} blocks; give its path, such as {shown}"
        )
    raise ParameterError.unknown(
        name, "kind, block or field of a scenario", _nearest_of_all(name, entries)
    )


def _scenario(entries: Mapping[str, Entry]) -> type:
    cls = entries["scenario"].cls
    assert cls is not None  # it is a block, and no list of kinds
    return cls


def _begun(word: str, entries: Mapping[str, Entry]) -> list[type]:
    """The classes that the first word of a path may mean: a field of the scenario, a list of kinds,
    a kind or a block by its name.
    """
    scenario = _scenario(entries)
    if word in fields(scenario):
        return list(_within([scenario], word))
    found = [
        e.cls
        for e in entries.values()
        if e.cls is not None
        and (word == named(e) or (e.registry is not None and e.registry.what == word))
    ]
    if not found:
        raise ParameterError.unknown(
            word, "kind and no block of a scenario", _nearest_of_all(word, entries)
        )
    return found


def _within(holders: Sequence[type], part: str) -> Iterator[type]:
    """The classes of the blocks to which a part of a path leads: those that a field of this name
    holds, and the kind of this name.
    """
    inner = [inner for cls in holders for _, inner in _blocks_at(cls, part)]
    inner += [cls for cls in holders if getattr(cls, "kind", "") == part]
    yield from dict.fromkeys(inner)


def _settable(before: Iterable[str], entries: Mapping[str, Entry]) -> bool:
    """Whether the blocks on the way to a field are fields of fields of a scenario, and no lists."""
    holders = [_scenario(entries)]
    for part in before:
        nodes = [fields(cls)[part].node for cls in holders if part in fields(cls)]
        if not nodes or any(node.type is tuple for node in nodes):
            return False
        holders = list(_within(holders, part))
    return True


def _none_in(
    path: str, name: str, before: Sequence[str], holders: Iterable[type]
) -> ParameterError:
    inside = {inner for cls in holders for inner in fields(cls) if inner != "kind"}
    what = "field of a scenario"
    if name in inside:
        hint = f"{'.'.join((*before, name))} is no block, and has no fields"
        return ParameterError.unknown(path, what, hint)
    what += f": {'.'.join(before)} has no {name}"
    return ParameterError.unknown(path, what, nearest(name, inside))


def _nearest_of_all(word: str, entries: Mapping[str, Entry]) -> str:
    """The nearest name, or where to begin: a list of all names would fill a screen."""
    names = set(entries)
    for entry in entries.values():
        names.add(named(entry))
        if entry.cls is not None:
            names.update(fields(entry.cls))
    hint = nearest(word, names)
    if hint.startswith("did you mean"):
        return hint
    return f"a scenario has {', '.join(fields(_scenario(entries)))}"


@dataclass
class Uses:
    """What is written in bundled files. files: names of those that use a class. blocks: the field
    (`NAME[]` for one of a list) and the block in the first of them. values: what is written in each
    field, by the name of its class and its own, in the order of the files.
    """

    files: dict[type, list[str]] = field(default_factory=dict)
    blocks: dict[type, tuple[str, Any]] = field(default_factory=dict)
    values: dict[tuple[str, str], list[Any]] = field(default_factory=dict)

    def add(self, cls: type, file: str, name: str, written: Any) -> None:
        """Take in a block of a class, as it is written in a field of a file: a mapping, or the
        shorthand for one.
        """
        files = self.files.setdefault(cls, [])
        if file not in files:
            files.append(file)
        self.blocks.setdefault(cls, (name, written))
        self.add_fields(cls.__name__, written)

    def add_fields(self, name: str, written: Any) -> None:
        """Take in the fields of a block of the class of this name; a shorthand has none."""
        if isinstance(written, Mapping):
            for inner, value in written.items():
                self.values.setdefault((name, inner), []).append(value)


@functools.cache
def bundled_uses() -> Uses:
    """The uses in all bundled scenarios, and in comparisons of what no scenario has before."""
    uses = Uses()
    for name, path in bundled_scenarios().items():
        for cls, key, written in _in_block(Scenario, "scenario", bundled_mapping(path)):
            uses.add(cls, name, key, written)
    for name, path in bundled_comparisons().items():
        plain = bundled_mapping(path)
        uses.add_fields("Comparison", plain)  # by their names: their room is above this one
        for table in plain.get("tasks", {}).values():
            uses.add_fields("StartTable", table)
        for cls, key, written in _in_comparison("", plain):
            uses.add(cls, f"compare/{name}", key, written)
    return uses


def _in_block(cls: type, key: str, written: Any) -> Iterator[tuple[type, str, Any]]:
    """Class, field and text of a block that is written in a scenario, and of the blocks in it."""
    yield cls, key, written
    if isinstance(written, Mapping):
        for name, value in written.items():
            if name in fields(cls):
                yield from _in_field(fields(cls)[name].node, name, value)


def _in_field(node: Node, key: str, written: Any) -> Iterator[tuple[type, str, Any]]:
    items: Iterable[Any] = ()
    if isinstance(written, list):
        items = written if node.type is tuple else ()
    elif node.type is dict and isinstance(written, Mapping):
        items = written.values()
    elif block := node.block_of(written):
        yield from _in_block(block[0], key, written)
    for item in items:
        yield from _in_field(node.parts[0], f"{key}[]", item)


def _in_comparison(key: str, written: Any) -> Iterator[tuple[type, str, Any]]:
    """The same of a comparison, whose blocks with a `kind` stand anywhere: under a dotted path, or
    in a list of values.
    """
    what = key.rpartition(".")[2]
    kind = written.get("kind") if isinstance(written, Mapping) else written
    members = registry(f"{what}s").members if f"{what}s" in HOMES else {}
    if isinstance(kind, str) and kind in members:
        yield members[kind], what, written
    if isinstance(written, Mapping):
        for name, value in written.items():
            yield from _in_comparison(str(name), value)
    elif isinstance(written, list):
        for value in written:
            yield from _in_comparison(key, value)


# JSON Schema with the words of the docstrings: a description, a unit and an example for every
# field.
#
# Editors show the description where the cursor is. `unit` is no word of JSON Schema, which leaves
# room for such: a reader that does not know it passes over it.
LONGEST_EXAMPLE = 100  # longest example of a field, in characters of its YAML
_NOTHING = ({}, [], "", None)


def schema_of(cls: type) -> dict[str, Any]:
    """JSON Schema of a spec class, Scenario or Comparison, with the kinds that plugins have added
    until now.
    """
    draft = {"$schema": "https://json-schema.org/draft/2020-12/schema"}
    whole = whole_adapter(cls).json_schema(schema_generator=_Described)
    return draft | whole | {"$defs": dict(sorted(whole["$defs"].items()))}


class _Described(GenerateJsonSchema):
    """Pydantic's generator, which takes a whole docstring for a class
    and nothing for its fields.
    """

    def dataclass_schema(self, schema: DataclassSchema) -> JsonSchemaValue:
        """The block of a class."""
        block = super().dataclass_schema(schema)
        cls = schema["cls"]
        words = class_text(cls)
        sources = [f"Source: {source}" for source in words.sources]
        block["description"] = "\n\n".join(filter(None, [words.summary, words.text, *sources]))
        # Pydantic has fields here, too, that no constructor takes.
        taken = {name: rule for name, rule in block["properties"].items() if name in words.fields}
        for name, rule in taken.items():
            rule.pop("title", None)  # the name of the field once more
            if not fields(cls)[name].needed:
                rule.setdefault("default", fields(cls)[name].default)  # one that a function makes
            if name == "kind":
                rule["description"] = words.summary or f"The kind of {cls.__name__}."
                rule["examples"] = [kind_of(cls)]
            else:
                rule |= _described(cls, name)
        block["properties"] = taken
        return block

    def sort(self, value: JsonSchemaValue, parent_key: str | None = None) -> JsonSchemaValue:
        """As it was made: pydantic would sort the keys in examples, too."""
        return value


def _described(cls: type, name: str) -> dict[str, Any]:
    """What the schema says of a field in words: its description, its unit, an example."""
    text = class_text(cls).fields[name]
    description = text.description
    if description and text.unit not in ("", DIMENSIONLESS) and "[" not in description:
        description += f" [{text.unit}]"
    examples = list(examples_of(cls, name, bundled_uses()))
    found = {"description": description, "unit": text.unit, "examples": examples}
    return {word: value for word, value in found.items() if value}


def examples_of(cls: type, name: str, uses: Uses) -> Iterator[Any]:
    """One example of a field, if there is any: one in a bundled file that is not its default; the
    docstring's; the default.
    """
    default = fields(cls)[name].default
    dull = (default, *_NOTHING)
    written = [v for v in uses.values.get((cls.__name__, name), []) if v not in dull]
    if written:
        # the first that is short enough, else the shortest
        yield min(written, key=lambda v: max(len(flow_text(v)), LONGEST_EXAMPLE))
    elif example := class_text(cls).fields[name].example:
        yield read_value(example)
    elif (filled := _filled(default)) not in _NOTHING:
        yield filled
    elif inner := _blocks_at(cls, name):
        block = example_block(inner[0][1], uses)
        yield [block] if fields(cls)[name].node.type is tuple else block


def example_block(cls: type, uses: Uses) -> dict[str, Any]:
    """A block of a class, which need not be used anywhere: its kind and the fields that it needs,
    else its first field.
    """
    block: dict[str, Any] = {}
    names = needed(cls)
    if "kind" in fields(cls):
        block["kind"] = kind_of(cls)
    elif not names:
        names = list(fields(cls))[:1]
    for name in names:
        block[name] = next(examples_of(cls, name, uses), None)
    return block


def _filled(value: Any) -> Any:
    """Plain values without the fields that are None, which say nothing in an example."""
    if isinstance(value, dict):
        return {name: _filled(inner) for name, inner in value.items() if inner is not None}
    return value
