"""Pydantic's validation errors as sentences, for a scenario's file and for a constructor in Python
alike.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Union

import pydantic

from vstestbed.core.errors import ParameterError, nearest, short
from vstestbed.core.fields import Node, SchemaField, class_text, fields, needed
from vstestbed.core.registry import Registry, kind_of, registries_of, to_mapping

Key = tuple[str | int, ...]


def key_of(dotted: str) -> Key:
    """The key of a dotted path, such as `randomise.2`."""
    return tuple(int(part) if part.isdecimal() else part for part in dotted.split("."))


def refuse_conversions(made: Any, values: Mapping[str, Any]) -> None:
    """Refuse what pydantic has converted to a number or a truth value in a constructor in Python: a
    text, or True for 1.
    """
    for name, value in values.items():
        if _may_convert(value):
            for key, words in converted(value, to_mapping(getattr(made, name)), (name,)):
                raise ParameterError(".".join((type(made).__name__, *map(str, key))), words)


def _may_convert(value: Any) -> bool:
    """Whether pydantic could have converted a value, or something in it: a quick look, for this is
    in every constructor.
    """
    kind = type(value)
    if kind is tuple or kind is list:
        return any(map(_may_convert, value))
    return kind is str or kind is bool or kind is dict


def converted(plain: Any, built: Any, key: Key) -> Iterator[tuple[Key, str]]:
    """Errors for values that pydantic silently converted to another type, such as a quoted number,
    or true for 1. Pydantic's strict mode would also refuse the lists of YAML for fields that are
    tuples. built: what `plain` has become (`to_mapping`). key: of both.
    """
    if isinstance(plain, dict) and isinstance(built, dict):
        for name in plain:
            yield from converted(plain[name], built.get(name), (*key, name))
    elif isinstance(plain, list | tuple) and isinstance(built, list):
        for i, (p, b) in enumerate(zip(plain, built, strict=False)):
            yield from converted(p, b, (*key, i))
    elif wanted := _wanted(plain, built):
        yield key, f"must be {wanted}, got {short(plain)}"


def _wanted(plain: Any, built: Any) -> str:
    """What a value is that pydantic has made of another type; "" of one that it has not."""
    if isinstance(built, bool):  # before int: a bool is one
        return "" if isinstance(plain, bool) else "true or false"
    converted = isinstance(built, int | float) and isinstance(plain, str | bool)
    return "a number" if converted else ""


UNKNOWN = "is an unknown field"  # how the sentence for one begins


def message(
    error: pydantic.ValidationError, cls: type, values: Mapping[str, Any]
) -> ParameterError:
    """The error of a constructor in Python, from pydantic's: of an unknown field before all others,
    since another one may miss that.
    """
    details = _details(error)
    inner = details[0].get("ctx", {}).get("error")
    if isinstance(inner, ParameterError) and not details[0]["loc"] and inner.field:
        return inner  # raised by the __post_init__ of this class, in whose words it stays
    first = min(details, key=lambda d: d["type"] != "unexpected_keyword_argument")
    key, words = _message(first, values, cls)
    return ParameterError(".".join((cls.__name__, *map(str, key))), words)


def all_messages(
    error: pydantic.ValidationError, plain: Mapping[str, Any], cls: type
) -> list[tuple[Key, str]]:
    """The key and the sentence of each mistake that pydantic found in `plain`, which should become
    a `cls`.
    """
    return [_message(detail, plain, cls) for detail in _details(error)]


def _details(error: pydantic.ValidationError) -> list[Any]:
    """Pydantic's errors, without a list's that is called too short only because its items were
    refused one by one.
    """
    return [
        d
        for d in error.errors()
        if d["type"] != "too_short" or len(d["input"]) < d.get("ctx", {})["min_length"]
    ]


@dataclass(frozen=True)
class _Place:
    """Where a mistake is. key: in YAML. block: the innermost block there. registry: of whose kinds
    the block is one. name, field: of the last field on the way. node: what may stand there; None
    for an unknown field.
    """

    key: Key
    block: type
    registry: Registry | None
    name: str = ""
    field: SchemaField | None = None
    node: Node | None = None

    def inner(self, part: int | str, here: Any, key: Key) -> _Place:
        """The place of a field, or of an item, of the value that stands here. key: of it."""
        node = self.node
        if isinstance(part, int) or (node is not None and node.type is dict):
            if node and node.type in (tuple, dict):
                node = node.parts[0]
            return replace(self, key=key, node=node)
        block = (node and node.block_of(here)) or (self.block, self.registry)
        of_part = fields(block[0]).get(part)
        return _Place(key, *block, part, of_part, of_part and of_part.node)


def _place(loc: Sequence[int | str], plain: Any, cls: type) -> _Place:
    """The place of a pydantic location in the values that should become a `cls`."""
    here = plain
    place = _Place((), cls, next(iter(registries_of(cls)), None))
    for part in loc:
        if place.node is not None and place.node.type is Union:
            place = replace(place, node=_meant_alternative(place.node, part))
            continue
        # A number, a word or a text may stand for a block or a list: its place is then that of the
        # whole.
        named = isinstance(here, dict if isinstance(part, str) else list | tuple)
        key = (*place.key, part) if named else place.key
        place = place.inner(part, here, key)
        if named:
            try:
                here = here[part]  # type: ignore[index] - named: it is a mapping or a list
            except LookupError:  # a missing field, or one of a preset's file
                here = {}
    return place


def _meant_alternative(node: Node, part: int | str) -> Node:
    """The alternative of which a part of a pydantic location is the name."""
    for one in node.parts:
        if getattr(one.type, "__name__", "") == part:
            return one
    return node.parts[0]


def _message(detail: Any, plain: Any, cls: type) -> tuple[Key, str]:
    place = _place(detail["loc"], plain, cls)
    inner = detail.get("ctx", {}).get("error")
    # raised by a __post_init__; its field is relative to the block
    if isinstance(inner, ParameterError):
        got = "" if inner.found is None else f", got {short(inner.found)}"
        # without a field it is about the block as a whole
        own = key_of(inner.field) if inner.field else ()
        return (*place.key, *own), f"{inner.problem}{got}"
    # what is missing is a field, also of a block that is a bare word
    if detail["type"] == "missing" and place.key[-1:] != (place.name,):
        place = replace(place, key=(*place.key, place.name))
    found = detail["input"]
    # The error belongs to the block; the mistake stands at its `kind`.
    if detail["type"] == "unknown_kind" and isinstance(found, dict) and "kind" in found:
        return (*place.key, "kind"), _sentence(detail | {"input": found["kind"]}, place)
    return place.key, _sentence(detail, place)


_WORDS = {
    "missing": "is missing",
    "greater_than": "must be > {gt}",
    "greater_than_equal": "must be >= {ge}",
    "less_than": "must be < {lt}",
    "less_than_equal": "must be <= {le}",
    "finite_number": "must be a finite number",
    "float_parsing": "must be a number",
    "float_type": "must be a number",
    "int_parsing": "must be a whole number",
    "int_type": "must be a whole number",
    "int_from_float": "must be a whole number",
    "bool_parsing": "must be true or false",
    "bool_type": "must be true or false",
    "string_type": "must be a text",
    "tuple_type": "must be a list",
    "too_short": "must be a list of {min_length} or more items",
    "too_long": "must be a list of {max_length} items or fewer",
    "literal_error": "must be one of {expected}",
    "dict_type": "must be a block (a mapping)",
}


def _sentence(detail: Any, place: _Place) -> str:
    kind = detail["type"]
    found = detail["input"]
    if kind == "unexpected_keyword_argument":
        return _unknown(place)
    if kind == "dataclass_type":
        return _block_needed(place.block if place.node is None else place.node.type, found)
    if kind == "missing":
        return "is missing" + _meaning(place)
    return f"{_rule(kind, detail, place)}, got {short(found)}"


def _rule(kind: str, detail: Any, place: _Place) -> str:
    """What a value must be: the sentence's first part."""
    node = place.node
    registry = node.registry if node else None
    length = node.length if node else None
    if kind in ("block", "unknown_kind") and registry and registry.number:
        kinds = ", ".join(sorted(registry.members))
        return f"must be a number, or a block of one of the kinds {kinds}"
    if kind in ("too_short", "too_long") and length is not None:
        return f"must be a list of {length} items"
    if kind == "tuple_type":
        return _WORDS[kind] + _such_as(place)
    if kind in _WORDS:
        return _WORDS[kind].format(**_shown(detail.get("ctx", {})))
    return str(detail["msg"])


def _such_as(place: _Place) -> str:
    """How a sentence goes on for what is no list: with what its blocks are, or an example."""
    if place.node is None or place.field is None:
        return ""
    for registry, block in place.node.blocks():
        return f" of blocks, each {_a(registry.what) if registry else f'of {_listed(block)}'}"
    # the example of the field's docstring, or its default
    default = place.field.default
    example = class_text(place.block).fields[place.name].example
    if not example and default and isinstance(default, list):
        example = short(default)
    if not example:
        return ""
    if place.node is place.field.node:
        return f", such as {example}"
    return f", as in {place.name}: {example}"


def _a(noun: str) -> str:
    return f"{'an' if noun[0] in 'aeiou' else 'a'} {noun}"


def _shown(context: dict[str, Any]) -> dict[str, Any]:
    """The limits in an error's context as messages show them: 1, not 1.0."""
    return {k: f"{v:g}" if isinstance(v, float) else v for k, v in context.items()}


def _meaning(place: _Place) -> str:
    """The rest of the sentence for a missing field: the kinds that it may be, or what its docstring
    says of it.
    """
    node = place.node
    text = class_text(place.block).fields.get(place.name)
    if node is None or text is None:
        return ""
    if node.registry is not None:
        return f"; valid kinds: {', '.join(sorted(node.registry.members))}"
    words = f": {text.description.rstrip('.')}" if text.description else ""
    words += f", e.g. {text.example}" if text.example else ""
    blocks = [block for _, block in node.blocks()]
    return f"{words}; a block of {_listed(blocks[0])}" if len(blocks) == 1 else words


def _block_needed(block: type, found: Any) -> str:
    """The sentence for a value where a block belongs: its fields, and the block of the one that
    takes the value.
    """
    words = f"must be a block (a mapping) of {_listed(block)}, got {short(found)}"
    meant = list(found) if isinstance(found, tuple) else found
    for name in _meant(block, found):
        with contextlib.suppress(ParameterError):
            block(**{name: found})
            return f"{words}; did you mean {{{name}: {short(meant)}}}?"
    return words


def _listed(block: type) -> str:
    return ", ".join(fields(block))


def _meant(block: type, value: Any) -> list[str]:
    """The fields of a block that a list may be meant for; of a number its only field, or the only
    one that it needs.
    """
    if isinstance(value, list | tuple):
        return list(fields(block)) if value else []
    only = needed(block) or list(fields(block))
    number = isinstance(value, int | float) and not isinstance(value, bool)
    return only if number and len(only) == 1 else []


def _unknown(place: _Place) -> str:
    members = place.registry.members if place.registry else {}
    able = [kind for kind, member in members.items() if place.name in fields(member)]
    if not able:
        return f"{UNKNOWN}; {nearest(place.name, fields(place.block))}"
    *others, last = able
    words = f"{', '.join(others)} and {last} have" if others else f"{last} has"
    return f"{UNKNOWN} of {kind_of(place.block)}; {words} it"
