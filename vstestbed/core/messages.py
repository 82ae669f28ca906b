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
from vstestbed.core.registry import Registry, registries_of, to_mapping

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
    elif isinstance(built, bool):  # before int: a bool is one
        if not isinstance(plain, bool):
            yield key, f"must be true or false, got {short(plain)}"
    elif isinstance(built, int | float) and isinstance(plain, str | bool):
        yield key, f"must be a number, got {short(plain)}"


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
    key, words = _message(
        min(details, key=lambda d: d["type"] != "unexpected_keyword_argument"), values, cls
    )
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
        if not (d["type"] == "too_short" and len(d["input"]) >= d.get("ctx", {})["min_length"])
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


def _place(loc: Sequence[int | str], plain: Any, cls: type) -> _Place:
    """The place of a pydantic location in the values that should become a `cls`."""
    here, place = plain, _Place((), cls, next(iter(registries_of(cls)), None))
    for part in loc:
        node = place.node
        # the part says which of the alternatives is meant
        if node is not None and node.type is Union:
            place = replace(
                place,
                node=next(
                    (one for one in node.parts if getattr(one.type, "__name__", "") == part),
                    node.parts[0],
                ),
            )
            continue
        # A number, a word or a text may stand for a block or a list: its place is then that of the
        # whole.
        named = isinstance(here, dict if isinstance(part, str) else list | tuple)
        key = (*place.key, part) if named else place.key
        if isinstance(part, str) and (node is None or node.type is not dict):
            block, registry = (node and node.block_of(here)) or (place.block, place.registry)
            of_part = fields(block).get(part)
            place = _Place(key, block, registry, part, of_part, of_part and of_part.node)
        else:
            place = replace(
                place, key=key, node=node.parts[0] if node and node.type in (tuple, dict) else node
            )
        if named:
            try:
                here = here[part]  # type: ignore[index] - named: it is a mapping or a list
            except LookupError:  # a missing field, or one of a preset's file
                here = {}
    return place


def _message(detail: Any, plain: Any, cls: type) -> tuple[Key, str]:
    place, inner = _place(detail["loc"], plain, cls), detail.get("ctx", {}).get("error")
    # raised by a __post_init__; its field is relative to the block
    if isinstance(inner, ParameterError):
        got = "" if inner.found is None else f", got {short(inner.found)}"
        # without a field it is about the block as a whole
        own = key_of(inner.field) if inner.field else ()
        return (*place.key, *own), f"{inner.problem}{got}"
    # what is missing is a field, also of a block that is a bare word
    if detail["type"] == "missing" and place.key[-1:] != (place.name,):
        place = replace(place, key=(*place.key, place.name))
    # The error belongs to the block; the mistake stands at its `kind`.
    if (
        detail["type"] == "unknown_kind"
        and isinstance(detail["input"], dict)
        and "kind" in detail["input"]
    ):
        return (*place.key, "kind"), _sentence(detail | {"input": detail["input"]["kind"]}, place)
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
    kind, found, node = detail["type"], detail["input"], place.node
    if kind == "unexpected_keyword_argument":
        return _unknown(place)
    if kind == "dataclass_type":
        return _block_needed(place.block if node is None else node.type, found)
    if kind == "missing":
        return "is missing" + _meaning(place)
    if kind in ("block", "unknown_kind") and node and node.registry and node.registry.number:
        return (
            "must be a number, or a block of one of the kinds"
            f" {', '.join(sorted(node.registry.members))}, got {short(found)}"
        )
    words = (
        _WORDS[kind].format(**_shown(detail.get("ctx", {})))
        if kind in _WORDS
        else str(detail["msg"])
    )
    if kind == "tuple_type":
        words += _such_as(place)
    elif kind in ("too_short", "too_long") and node and node.length is not None:
        words = f"must be a list of {node.length} items"
    return f"{words}, got {short(found)}"


def _such_as(place: _Place) -> str:
    """How a sentence goes on for what is no list: with what its blocks are, or an example."""
    if place.node is None or place.field is None:
        return ""
    for registry, block in place.node.blocks():
        return f" of blocks, each {_a(registry.what) if registry else f'of {_listed(block)}'}"
    # the example of the field's docstring, or its default
    default = place.field.default
    example = class_text(place.block).fields[place.name].example or (
        short(default) if isinstance(default, list) and default else ""
    )
    if not example:
        return ""
    return (
        f", such as {example}"
        if place.node is place.field.node
        else f", as in {place.name}: {example}"
    )


def _a(noun: str) -> str:
    return f"{'an' if noun[0] in 'aeiou' else 'a'} {noun}"


def _shown(context: dict[str, Any]) -> dict[str, Any]:
    """The limits in an error's context as messages show them: 1, not 1.0."""
    return {k: f"{v:g}" if isinstance(v, float) else v for k, v in context.items()}


def _meaning(place: _Place) -> str:
    """The rest of the sentence for a missing field: the kinds that it may be, or what its docstring
    says of it.
    """
    node, text = place.node, class_text(place.block).fields.get(place.name)
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
    for name in _meant(block, found):
        with contextlib.suppress(ParameterError):
            block(**{name: found})
            return (
                f"{words}; did you mean {{{name}:"
                f" {short(list(found) if isinstance(found, tuple) else found)}}}?"
            )
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
    return (
        only
        if isinstance(value, int | float) and not isinstance(value, bool) and len(only) == 1
        else []
    )


def _unknown(place: _Place) -> str:
    able = (
        [kind for kind, member in place.registry.members.items() if place.name in fields(member)]
        if place.registry
        else []
    )
    if able and place.registry:
        kind = next(
            kind for kind, member in place.registry.members.items() if member is place.block
        )
        words = f"{', '.join(able[:-1])} and {able[-1]} have" if able[1:] else f"{able[0]} has"
        return f"{UNKNOWN} of {kind}; {words} it"
    return f"{UNKNOWN}; {nearest(place.name, fields(place.block))}"
