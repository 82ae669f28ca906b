"""From plain mappings to specs: pydantic's validation errors as sentences, each with its position in the file."""

from __future__ import annotations

import dataclasses
import typing
from collections.abc import Iterator, Sequence
from typing import Any, TypeGuard, TypeVar

import pydantic

from vstestbed.camera import CAMERAS
from vstestbed.core.errors import Mistake, ParameterError, ScenarioError, nearest
from vstestbed.core.mapping import to_mapping
from vstestbed.core.spec import OneOf, refresh_specs, spec_named
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
from vstestbed.tasks.metrics import METRICS
from vstestbed.tasks.monitors import MONITORS
from vstestbed.vision import DETECTORS
from vstestbed.vision.perturb import PERTURBATIONS

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
    "metrics": METRICS,
    "monitors": MONITORS,
    "perturbations": PERTURBATIONS,
}
"""Every list of kinds; a plugin may add to each."""


def build(cls: type[T], plain: dict[str, Any], marks: Marks, file: str) -> T:
    """An object of the spec class `cls` from a plain mapping.

    Args:
        cls: the spec class. plain: the YAML as plain values. marks: position of each key. file: the file's name in messages.

    Raises:
        ScenarioError: all mistakes at once, each with its position in the file.
    """
    refresh_specs()  # kinds may have been registered since the last scenario was built
    try:
        made = pydantic.TypeAdapter(cls).validate_python(plain)
        found = list(_coerced(plain, to_mapping(made), ()))
        if not found:
            return made
    except pydantic.ValidationError as error:
        found = [_finding(detail, plain, cls) for detail in error.errors() if not _is_count_only(detail)]
    mistakes = [Mistake(place_of(key, marks, file), ".".join(map(str, key)), words) for key, words in dict.fromkeys(found)]
    raise ScenarioError(sorted(mistakes, key=_reading_order))


def _reading_order(mistake: Mistake) -> tuple[int, ...]:
    """Sort key (line, column) of a mistake; those of --set, which have no position, come last."""
    place = mistake.where.rsplit(":", 2)[1:]
    return tuple(int(n) for n in place) if len(place) == 2 else (1 << 31,)


def _is_count_only(detail: Any) -> bool:
    """Whether a list is called too short only because its items were refused one by one: those errors are reported already."""
    return detail["type"] == "too_short" and len(detail["input"]) >= detail["ctx"]["min_length"]


def _finding(detail: Any, plain: dict[str, Any], cls: type) -> tuple[Key, str]:
    """The key and the sentence of one of pydantic's errors."""
    key, inner = _key_of(detail["loc"], plain), detail.get("ctx", {}).get("error")
    if isinstance(inner, ParameterError):  # raised by a __post_init__; its field is relative to the block
        got = "" if inner.found is None else f", got {short(inner.found)}"
        own = inner.field.split(".") if inner.field else []  # without a field it is about the block as a whole
        return (*key, *(int(p) if p.isdecimal() else p for p in own)), f"{inner.problem}{got}"
    # The error belongs to the block; the mistake stands at its `kind`.
    if detail["type"] == "unknown_kind" and isinstance(detail["input"], dict) and "kind" in detail["input"]:
        return (*key, "kind"), _sentence(detail | {"input": detail["input"]["kind"]}, cls)
    return key, _sentence(detail, cls)


def _coerced(plain: Any, built: Any, key: Key) -> Iterator[tuple[Key, str]]:
    """Errors for values that pydantic silently converted to another type, such as a quoted number, or true for 1.

    Pydantic's strict mode is no way out: it would also refuse the lists of YAML for fields that are tuples.
    """
    if isinstance(plain, dict) and isinstance(built, dict):
        for name in plain:
            yield from _coerced(plain[name], built.get(name), (*key, name))
    elif isinstance(plain, list) and isinstance(built, list):
        for i, (p, b) in enumerate(zip(plain, built, strict=False)):
            yield from _coerced(p, b, (*key, i))
    elif (expected := _expected_type(plain, built)) is not None:
        yield key, f"must be {expected}, got {short(plain)}"


def _expected_type(plain: Any, built: Any) -> str | None:
    """The type that a scalar should have had in YAML; None where it was not converted."""
    if isinstance(built, bool):  # before int: a bool is one
        return None if isinstance(plain, bool) else "true or false"
    return "a number" if isinstance(built, int | float) and isinstance(plain, str | bool) else None


# Pydantic's locations have the kind of a block between the block and its field, also where YAML leaves the kind out.
_DEFAULT_KINDS = {kinds.default for kinds in KINDS.values() if kinds.default} | {k for one in KINDS.values() for k in one.fields.values()}


def _key_of(loc: Sequence[int | str], plain: Any) -> Key:
    """The key in YAML for a pydantic location, which has kind tags between blocks and their fields."""
    key: list[int | str] = []
    here, tagged = plain, False
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
        return "kind" not in here and part in _DEFAULT_KINDS and not tagged
    if isinstance(here, str):
        return here == part
    return isinstance(here, int | float) and not isinstance(here, bool)  # a bare number, a shorthand for a block


def _child(here: Any, part: int | str) -> Any:
    """The value at a key of a mapping or an index of a list; None where there is none."""
    if isinstance(here, dict):
        return here.get(part)
    return here[part] if isinstance(here, list) and isinstance(part, int) and part < len(here) else None


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
    "dict_type": "must be a block (a mapping)",
}


def _sentence(detail: Any, cls: type) -> str:
    """The sentence for one of pydantic's errors, with the value found."""
    kind, found = detail["type"], detail["input"]
    if kind == "unexpected_keyword_argument":
        return _unknown(str(detail["loc"][-1]), *_block_at(detail["loc"][:-1], cls))
    kinds = KINDS.get(f"{detail['loc'][-1]}s") if detail["loc"] else None
    if kind == "missing":
        return _WORDS[kind] + (f"; valid kinds: {', '.join(sorted(kinds.members))}" if kinds else "")
    if kind in ("block", "unknown_kind") and kinds and kinds.number:
        return f"must be a number, or a block of one of the kinds {', '.join(sorted(kinds.members))}, got {short(found)}"
    words = _WORDS[kind].format(**_shown(detail.get("ctx", {}))) if kind in _WORDS else str(detail["msg"])
    return f"{words}, got {short(found)}"


def _shown(context: dict[str, Any]) -> dict[str, Any]:
    """The limits in an error's context as messages show them: 1, not 1.0."""
    return {k: f"{v:g}" if isinstance(v, float) else v for k, v in context.items()}


def _is_spec(value: object) -> TypeGuard[type]:
    return isinstance(value, type) and dataclasses.is_dataclass(value)


def _unknown(name: str, block: type, room: OneOf | None) -> str:
    """The sentence for an unknown field: the kinds of the room that have it, or the nearest valid name."""
    able = [kind for kind, member in room.members.items() if name in _fields(member)] if room else []
    if able and room:
        kind = next(kind for kind, member in room.members.items() if member is block)
        words = f"{', '.join(able[:-1])} and {able[-1]} have" if able[1:] else f"{able[0]} has"
        return f"unknown field of {kind}; {words} it"
    return f"unknown field; {nearest(name, _fields(block))}"


def _fields(block: type) -> list[str]:
    return [f.name for f in dataclasses.fields(block) if f.init]


def _block_at(loc: Sequence[int | str], cls: type) -> tuple[type, OneOf | None]:
    """The spec class at a pydantic location in `cls`, and its room; None for a block that has no kinds."""
    room, asked = None, None
    for part in loc:
        if isinstance(part, int):  # an index: all items of a list are of one class
            continue
        if (field := spec_named(part) or _spec_of_field(cls, part)) is not None:
            cls, room = field, None
        # The room of the last field first: a kind such as `spherical` is a word in more than one room.
        rooms = [one for one in (asked, *KINDS.values()) if one is not None and part in one.members]
        if rooms and field is None:
            cls, room = rooms[0].members[part], rooms[0]
        asked = KINDS.get(f"{part}s", asked)
    return cls, room


def _spec_of_field(cls: type, name: str) -> type | None:
    """The spec class of a field that is one block; None for scalars and for blocks with kinds."""
    hints = typing.get_type_hints(cls)
    hint = hints.get(name)
    for candidate in (hint, *typing.get_args(hint)):
        if _is_spec(candidate):
            return candidate
        for inner in typing.get_args(candidate):
            if _is_spec(inner):
                return inner
    return None
