"""Pydantic's validation errors as sentences, for a scenario's file and for a constructor in Python alike."""

from __future__ import annotations

import dataclasses
import typing
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import pydantic
from annotated_types import Len

from vstestbed.core.docstrings import class_text
from vstestbed.core.errors import ParameterError, nearest, short
from vstestbed.core.registry import ROOMS, Room, blocks_in, fields_of, rooms_of, spec_named, to_mapping

Key = tuple[str | int, ...]


def refuse_conversions(made: Any, values: Mapping[str, Any]) -> None:
    """Refuse what pydantic has converted to a number or a truth value in a constructor in Python: a text, or True for 1."""
    for name, value in values.items():
        if _may_convert(value):
            for key, words in converted(value, to_mapping(getattr(made, name)), (name,)):
                raise ParameterError(".".join((type(made).__name__, *map(str, key))), words)


def _may_convert(value: Any) -> bool:
    """Whether pydantic could have converted a value, or something in it: a quick look, for this is in every constructor."""
    kind = type(value)
    if kind is tuple or kind is list:
        return any(map(_may_convert, value))
    return kind is str or kind is bool or kind is dict


def converted(plain: Any, built: Any, key: Key) -> Iterator[tuple[Key, str]]:
    """Errors for values that pydantic silently converted to another type, such as a quoted number, or true for 1. Pydantic's strict mode
    would also refuse the lists of YAML for fields that are tuples. built: what `plain` has become (`to_mapping`). key: of both.
    """
    if isinstance(plain, dict) and isinstance(built, dict):
        for name in plain:
            yield from converted(plain[name], built.get(name), (*key, name))
    elif isinstance(plain, list | tuple) and isinstance(built, list):
        for i, (p, b) in enumerate(zip(plain, built, strict=False)):
            yield from converted(p, b, (*key, i))
    elif (expected := _expected_type(plain, built)) is not None:
        yield key, f"must be {expected}, got {short(plain)}"


def _expected_type(plain: Any, built: Any) -> str | None:
    if isinstance(built, bool):  # before int: a bool is one
        return None if isinstance(plain, bool) else "true or false"
    return "a number" if isinstance(built, int | float) and isinstance(plain, str | bool) else None


UNKNOWN = "is an unknown field"  # how the sentence for one begins


def refusal(error: pydantic.ValidationError, cls: type, values: Mapping[str, Any]) -> ParameterError:
    """The error of a constructor in Python, from pydantic's: of an unknown field before all others, since another one may miss that."""
    details = _details(error)
    inner = details[0].get("ctx", {}).get("error")
    if isinstance(inner, ParameterError) and not details[0]["loc"] and inner.field:
        return inner  # raised by the __post_init__ of this class, in whose words it stays
    key, words = _finding(min(details, key=lambda d: d["type"] != "unexpected_keyword_argument"), values, cls)
    return ParameterError(".".join((cls.__name__, *map(str, key))), words)


def findings(error: pydantic.ValidationError, plain: Mapping[str, Any], cls: type) -> list[tuple[Key, str]]:
    """The key and the sentence of each mistake that pydantic found in `plain`, which should become a `cls`."""
    return [_finding(detail, plain, cls) for detail in _details(error)]


def _details(error: pydantic.ValidationError) -> list[Any]:
    """Pydantic's errors, without a list's that is called too short only because its items were refused one by one."""
    return [d for d in error.errors() if not (d["type"] == "too_short" and len(d["input"]) >= d.get("ctx", {})["min_length"])]


def _finding(detail: Any, plain: Any, cls: type) -> tuple[Key, str]:
    loc, inner = detail["loc"], detail.get("ctx", {}).get("error")
    # what is missing is a field, also where a kind has the same name
    key = (*_key_of(loc[:-1], plain), loc[-1]) if detail["type"] == "missing" else _key_of(loc, plain)
    if isinstance(inner, ParameterError):  # raised by a __post_init__; its field is relative to the block
        got = "" if inner.found is None else f", got {short(inner.found)}"
        own = inner.field.split(".") if inner.field else []  # without a field it is about the block as a whole
        return (*key, *(int(p) if p.isdecimal() else p for p in own)), f"{inner.problem}{got}"
    # The error belongs to the block; the mistake stands at its `kind`.
    if detail["type"] == "unknown_kind" and isinstance(detail["input"], dict) and "kind" in detail["input"]:
        return (*key, "kind"), _sentence(detail | {"input": detail["input"]["kind"]}, cls)
    return key, _sentence(detail, cls)


def _key_of(loc: Sequence[int | str], plain: Any) -> Key:
    """The key in YAML for a pydantic location, which has kind tags between blocks and their fields."""
    key: list[int | str] = []
    here, tagged = plain, True  # the outermost block has no tag, for its class is known
    for part in loc:
        if spec_named(part) or _is_tag(part, here, tagged):
            tagged = True
            continue
        tagged = False
        key.append(part)
        here = _child(here, part)
    return tuple(key)


def _is_tag(part: int | str, here: Any, tagged: bool) -> bool:
    """Whether a part of a location is the kind of the value `here`, and not one of its fields."""
    if isinstance(here, dict):
        if part not in here and here.get("kind") == part:
            return True
        # A block has one tag: after it (`tagged`), the part may be a field that is named like a kind.
        return "kind" not in here and not tagged and any(part == room.default or part in room.fields.values() for room in ROOMS)
    if isinstance(here, str):
        return here == part
    return isinstance(here, int | float) and not isinstance(here, bool)  # a bare number, a shorthand for a block


def _child(here: Any, part: int | str) -> Any:
    if isinstance(here, dict):
        return here.get(part)
    return here[part] if isinstance(here, list | tuple) and isinstance(part, int) and part < len(here) else None


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


def _sentence(detail: Any, cls: type) -> str:
    kind, found, loc = detail["type"], detail["input"], detail["loc"]
    if kind == "unexpected_keyword_argument":
        return _unknown(str(loc[-1]), *_block_at(loc[:-1], cls))
    if kind == "dataclass_type":
        return _block_needed(spec_named(detail["ctx"]["class_name"]), found)
    room = _room_of_field(loc, cls)
    if kind == "missing":
        return "is missing" + _meaning(str(loc[-1]), _block_at(loc[:-1], cls)[0], room)
    if kind in ("block", "unknown_kind") and room and room.number:
        return f"must be a number, or a block of one of the kinds {', '.join(sorted(room.members))}, got {short(found)}"
    words = _WORDS[kind].format(**_shown(detail.get("ctx", {}))) if kind in _WORDS else str(detail["msg"])
    if kind in ("tuple_type", "too_short", "too_long"):
        words = _list_needed(kind, words, loc, cls)
    return f"{words}, got {short(found)}"


def _list_needed(kind: str, words: str, loc: Sequence[int | str], cls: type) -> str:
    """The sentence for what is no list, or for a list whose length is another than the only valid one."""
    at = max(i for i, part in enumerate(loc) if isinstance(part, str))
    name, block = str(loc[at]), _block_at(loc[:at], cls)[0]
    if kind != "tuple_type":
        length = _only_length(block, name) if loc[-1] == name else None
        return words if length is None else f"must be a list of {length} items"
    if loc[-1] != name:  # a list in a list
        example = _list_like(block, name)
        return f"{words}, as in {name}: {example}" if example else words
    return _such_as(words, block, name)


def _a(noun: str) -> str:
    return f"{'an' if noun[0] in 'aeiou' else 'a'} {noun}"


def _such_as(words: str, block: type, name: str) -> str:
    if blocks := _choices(block, name):
        room, inner = blocks[0]
        return f"must be a list of blocks, each {_a(room.what) if room else f'of {_listed(inner)}'}"
    example = _list_like(block, name)
    return f"{words}, such as {example}" if example else words


def _list_like(block: type, name: str) -> str:
    """A valid list: the example of a field's docstring, or its default; "" where it has neither."""
    text = class_text(block).fields.get(name)
    if text and text.example:
        return text.example
    default = next((field.default for field in dataclasses.fields(block) if field.name == name), None)
    return short(to_mapping(default)) if isinstance(default, tuple) and default else ""


def _only_length(block: type, name: str) -> int | None:
    hint = _hint(block, name)
    for part in (hint, *typing.get_args(hint)):  # a list that may be None is one of two
        for bound in getattr(part, "__metadata__", ()):
            if isinstance(bound, Len) and bound.min_length == bound.max_length:
                return bound.min_length
    return None


def _shown(context: dict[str, Any]) -> dict[str, Any]:
    """The limits in an error's context as messages show them: 1, not 1.0."""
    return {k: f"{v:g}" if isinstance(v, float) else v for k, v in context.items()}


def _meaning(name: str, block: type, room: Room | None) -> str:
    """The rest of the sentence for a missing field: the kinds that it may be, or what its docstring says of it."""
    if room:
        return f"; valid kinds: {', '.join(sorted(room.members))}"
    text = class_text(block).fields.get(name)
    words = f": {text.description.rstrip('.')}" if text and text.description else ""
    words += f", e.g. {text.example}" if text and text.example else ""
    inner = [cls for _, cls in _choices(block, name)]
    return f"{words}; a block of {_listed(inner[0])}" if len(inner) == 1 else words


def _block_needed(block: type | None, found: Any) -> str:
    """The sentence for a value where a block belongs: its fields, and the block of the one that takes the value."""
    words = f"must be a block (a mapping){f' of {_listed(block)}' if block else ''}, got {short(found)}"
    fitting = next((name for name in _meant(block, found) if _takes(block, name, found)), None) if block else None
    return (
        words if fitting is None else f"{words}; did you mean {{{fitting}: {short(list(found) if isinstance(found, tuple) else found)}}}?"
    )


def _listed(block: type) -> str:
    return ", ".join(fields_of(block))


def _meant(block: type, value: Any) -> list[str]:
    """The fields of a block that a list may be meant for; of a number its only field, or the only one that it needs."""
    names = fields_of(block)
    if isinstance(value, list | tuple):
        return names if value else []
    needed = [f.name for f in dataclasses.fields(block) if f.init and f.default is f.default_factory is dataclasses.MISSING]
    only = needed or names
    return only if isinstance(value, int | float) and not isinstance(value, bool) and len(only) == 1 else []


def _takes(block: type, name: str, value: Any) -> bool:
    try:
        block(**{name: value})
    except ParameterError:
        return False
    return True


def _unknown(name: str, block: type, room: Room | None) -> str:
    able = [kind for kind, member in room.members.items() if name in fields_of(member)] if room else []
    if able and room:
        kind = next(kind for kind, member in room.members.items() if member is block)
        words = f"{', '.join(able[:-1])} and {able[-1]} have" if able[1:] else f"{able[0]} has"
        return f"{UNKNOWN} of {kind}; {words} it"
    return f"{UNKNOWN}; {nearest(name, fields_of(block))}"


def _block_at(loc: Sequence[int | str], cls: type) -> tuple[type, Room | None]:
    """The spec class at a pydantic location in `cls`, and its room; None for a block that has no kinds."""
    room = next(iter(rooms_of(cls)), None)
    choices: list[tuple[Room | None, type]] = []
    for part in loc:
        tagged = [(r, c) for r, c in choices if r is not None and r.members.get(str(part)) is c]
        if named := spec_named(part):
            cls, room, choices = named, None, []
        elif tagged:
            (room, cls), choices = tagged[0], []
        elif not isinstance(part, int):  # an index: all items of a list are of one class
            choices = _choices(cls, part)
            if len(choices) == 1 and choices[0][0] is None:
                cls, room, choices = choices[0][1], None, []
    return cls, room


def _room_of_field(loc: Sequence[int | str], cls: type) -> Room | None:
    if not loc or isinstance(loc[-1], int):
        return None
    return next((room for room, _ in _choices(_block_at(loc[:-1], cls)[0], loc[-1])), None)


def _choices(cls: type, name: str) -> list[tuple[Room | None, type]]:
    return list(blocks_in(_hint(cls, name)))


def _hint(cls: type, name: str) -> Any:
    try:
        return typing.get_type_hints(cls, include_extras=True).get(name)
    except NameError:  # of a class defined in a function, where pydantic alone knows the names
        return None
