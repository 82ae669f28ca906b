"""From plain mappings to specs: what pydantic finds wrong, in this project's words, with its place in the file."""

from __future__ import annotations

import dataclasses
import typing
from collections.abc import Iterator, Sequence
from typing import Any, TypeGuard, TypeVar

import pydantic

from vstestbed.camera import CAMERAS
from vstestbed.core.errors import Mistake, ParameterError, ScenarioError, nearest
from vstestbed.core.spec import OneOf, to_mapping
from vstestbed.features import FEATURES
from vstestbed.features.depth import DEPTHS
from vstestbed.laws import LAWS
from vstestbed.laws.base import GAINS
from vstestbed.laws.feedforward import FEEDFORWARDS
from vstestbed.robots import ROBOTS
from vstestbed.scenario.yaml_marks import Key, Marks, place_of, short
from vstestbed.targets import TARGETS
from vstestbed.targets.attached import MOTIONS
from vstestbed.targets.markers import MARKERS
from vstestbed.targets.route import ROUTES
from vstestbed.tasks import GOALS, VIEWS
from vstestbed.vision import DETECTORS

T = TypeVar("T")
KINDS: dict[str, OneOf] = {
    "robots": ROBOTS,
    "cameras": CAMERAS,
    "targets": TARGETS,
    "markers": MARKERS,
    "motions": MOTIONS,
    "detectors": DETECTORS,
    "features": FEATURES,
    "laws": LAWS,
    "gains": GAINS,
    "depths": DEPTHS,
    "feedforwards": FEEDFORWARDS,
    "goals": GOALS,
    "views": VIEWS,
    "routes": ROUTES,
}
"""Every list of kinds; a plugin may add to each."""


def build(cls: type[T], plain: dict[str, Any], marks: Marks, file: str) -> T:
    """An object of the spec class `cls` from a plain mapping.

    Raises:
        ScenarioError: everything that is wrong, at once, with its place in the file.
    """
    try:
        made = pydantic.TypeAdapter(cls).validate_python(plain)
        found = [(key, words) for key, words in _bent(plain, to_mapping(made), ())]
        if not found:
            return made
    except pydantic.ValidationError as error:
        found = [_finding(detail, plain, cls) for detail in error.errors() if not _echo(detail)]
    mistakes = [Mistake(place_of(key, marks, file), ".".join(map(str, key)), words) for key, words in dict.fromkeys(found)]
    raise ScenarioError(sorted(mistakes, key=_reading_order))


def _reading_order(mistake: Mistake) -> tuple[int, ...]:
    """Line and column of a mistake; what --set brought comes last."""
    place = mistake.where.rsplit(":", 2)[1:]
    return tuple(int(n) for n in place) if len(place) == 2 else (1 << 31,)


def _echo(detail: Any) -> bool:
    """Whether pydantic only counts the items of a list that it refused one by one."""
    return detail["type"] == "too_short" and len(detail["input"]) >= detail["ctx"]["min_length"]


def _finding(detail: Any, plain: dict[str, Any], cls: type) -> tuple[Key, str]:
    """One of pydantic's findings: the key it is about, and a sentence."""
    key, inner = _place(detail["loc"], plain), detail.get("ctx", {}).get("error")
    if isinstance(inner, ParameterError):
        got = "" if inner.found is None else f", got {short(inner.found)}"
        return (*key, *(int(p) if p.isdecimal() else p for p in inner.field.split("."))), f"{inner.problem}{got}"
    if detail["type"] == "unknown_kind" and isinstance(detail["input"], dict) and "kind" in detail["input"]:
        return (*key, "kind"), _sentence(detail | {"input": detail["input"]["kind"]}, cls)
    return key, _sentence(detail, cls)


def _bent(plain: Any, built: Any, key: Key) -> Iterator[tuple[Key, str]]:
    """Values that pydantic bent into another type: a quoted number, true for 1."""
    if isinstance(plain, dict) and isinstance(built, dict):
        for name in plain:
            yield from _bent(plain[name], built.get(name), (*key, name))
    elif isinstance(plain, list) and isinstance(built, list):
        for i, (p, b) in enumerate(zip(plain, built, strict=False)):
            yield from _bent(p, b, (*key, i))
    elif isinstance(built, bool) and not isinstance(plain, bool):
        yield key, f"must be true or false, got {short(plain)}"
    elif isinstance(built, int | float) and not isinstance(built, bool) and isinstance(plain, str | bool):
        yield key, f"must be a number, got {short(plain)}"


_DEFAULT_KINDS = {kinds.default for kinds in KINDS.values() if kinds.default} | {k for one in KINDS.values() for k in one.fields.values()}


def _place(loc: Sequence[int | str], plain: Any) -> Key:
    """Pydantic's location without the kind tags that it puts between a block and its fields."""
    key: list[int | str] = []
    here, tagged = plain, False
    for part in loc:
        is_tag = isinstance(here, dict) and part not in here and here.get("kind") == part
        is_tag = is_tag or (isinstance(here, str) and here == part)
        is_tag = is_tag or (isinstance(here, dict) and "kind" not in here and part in _DEFAULT_KINDS and not tagged)
        number_tag = isinstance(here, int | float) and not isinstance(here, bool)
        if is_tag or number_tag:
            tagged = True  # a block has one; what follows may be a field of the same name
            continue
        tagged = False
        key.append(part)
        if isinstance(here, dict):
            here = here.get(part)
        elif isinstance(here, list) and isinstance(part, int) and part < len(here):
            here = here[part]
        else:
            here = None
    return tuple(key)


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
    "dataclass_type": "must be a block (a mapping)",
}


def _sentence(detail: Any, cls: type) -> str:
    """Pydantic's finding in this project's words, with what was found."""
    kind, found = detail["type"], detail["input"]
    if kind == "unexpected_keyword_argument":
        return _unknown(str(detail["loc"][-1]), *_block_at(detail["loc"][:-1], cls))
    kinds = KINDS.get(f"{detail['loc'][-1]}s") if detail["loc"] else None
    if kind == "missing":
        return _WORDS[kind] + (f"; valid kinds: {', '.join(sorted(kinds.members))}" if kinds else "")
    if kind in ("block", "unknown_kind") and kinds and kinds.number:
        return f"must be a number, or a block of one of the kinds {', '.join(sorted(kinds.members))}, got {short(found)}"
    context = {k: f"{v:g}" if isinstance(v, float) else v for k, v in detail.get("ctx", {}).items()}
    words = _WORDS[kind].format(**context) if kind in _WORDS else str(detail["msg"])
    return f"{words}, got {short(found)}"


def _is_spec(value: object) -> TypeGuard[type]:
    return isinstance(value, type) and dataclasses.is_dataclass(value)


def _unknown(name: str, block: type, room: OneOf | None) -> str:
    """What is said of a field that a block does not have: who else of its room has it, or what it may have been meant to be."""
    able = [kind for kind, member in room.members.items() if name in _fields(member)] if room else []
    if able and room:
        kind = next(kind for kind, member in room.members.items() if member is block)
        words = f"{', '.join(able[:-1])} and {able[-1]} have" if able[1:] else f"{able[0]} has"
        return f"unknown field of {kind}; {words} it"
    return f"unknown field; {nearest(name, _fields(block))}"


def _fields(block: type) -> list[str]:
    return [f.name for f in dataclasses.fields(block) if f.init]


def _block_at(loc: Sequence[int | str], cls: type) -> tuple[type, OneOf | None]:
    """The spec class at a pydantic location in `cls` (where kinds stand as tags), and the room it is one of, where there is one."""
    room, asked = None, None
    for part in loc:
        if isinstance(part, int):
            continue
        if (field := _spec_of_field(cls, part)) is not None:
            cls, room = field, None
        rooms = [one for one in (asked, *KINDS.values()) if one is not None and part in one.members]
        if rooms and field is None:
            cls, room = rooms[0].members[part], rooms[0]
        asked = KINDS.get(f"{part}s", asked)
    return cls, room


def _spec_of_field(cls: type, name: str) -> type | None:
    """The spec class of a plain block field, None for scalars and for blocks with kinds."""
    hints = typing.get_type_hints(cls)
    hint = hints.get(name)
    for candidate in (hint, *typing.get_args(hint)):
        if _is_spec(candidate):
            return candidate
        for inner in typing.get_args(candidate):
            if _is_spec(inner):
                return inner
    return None
