"""A scenario's YAML: read with every mistake named at once (file, line, column, field), written with every default."""

from __future__ import annotations

import dataclasses
import importlib
import io
import typing
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TypeGuard

import pydantic
from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap, CommentedSeq
from ruamel.yaml.error import MarkedYAMLError, YAMLError

from vstestbed.assets import bundled_scenarios
from vstestbed.camera import CAMERAS
from vstestbed.errors import Mistake, ParameterError, ScenarioError, nearest
from vstestbed.features import FEATURES
from vstestbed.laws import LAWS
from vstestbed.laws.base import GAINS
from vstestbed.observation import DEPTHS
from vstestbed.robots import ROBOTS
from vstestbed.scenario import Scenario
from vstestbed.spec import OneOf, rebuild_specs, to_mapping
from vstestbed.target import MARKERS, MOTIONS, TARGETS
from vstestbed.vision import DETECTORS

Key = tuple[str | int, ...]
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
}
"""Every list of kinds; a plugin may add to each."""


def find(name: str | Path) -> Path:
    """The file of a scenario given by path or by the name of a bundled one.

    Raises:
        ScenarioError: neither exists; names the nearest bundled scenario.
    """
    path = Path(name)
    if path.is_file():
        return path
    bundled = bundled_scenarios()
    if str(name) in bundled:
        return bundled[str(name)]
    if path.is_dir():
        raise ScenarioError([Mistake(str(name), "", "is a folder; give a scenario's YAML file")])
    raise ScenarioError([Mistake(str(name), "", f"no such file, and no bundled scenario of that name; {nearest(str(name), bundled)}")])


def load(name: str | Path, overrides: Mapping[str, object] | None = None) -> Scenario:
    """Read a scenario from a file or a bundled name.

    Args:
        name: path of a YAML file, or the name of a bundled scenario.
        overrides: values by dotted path, such as {"law.gain": 1.0}; they replace what the file says before it is checked.

    Raises:
        ScenarioError: everything that is wrong, at once.
    """
    path = find(name)
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ScenarioError([Mistake(str(path), "", f"cannot be read: {error}")]) from None
    scenario = parse(text, str(path), overrides)
    return scenario if scenario.name else dataclasses.replace(scenario, name=path.stem)


def parse(text: str, file: str, overrides: Mapping[str, object] | None = None) -> Scenario:
    """Build a scenario from YAML text; `file` is what messages call it. See `load`."""
    try:
        tree = YAML(typ="rt").load(text)
    except MarkedYAMLError as error:
        mark = error.problem_mark
        where = f"{file}:{mark.line + 1}:{mark.column + 1}" if mark else file
        raise ScenarioError([Mistake(where, "", f"is not YAML: {error.problem or error.context}")]) from None
    except YAMLError as error:
        raise ScenarioError([Mistake(file, "", f"is not YAML: {error}")]) from None
    if tree is None:
        raise ScenarioError([Mistake(f"{file}:1:1", "", f"is empty; a scenario needs {_required()}")])
    if not isinstance(tree, CommentedMap):
        raise ScenarioError([Mistake(f"{file}:1:1", "", f"must be a mapping with at least {_required()}")])
    marks: dict[Key, str] = {}
    plain = _plain(tree, (), marks, file)
    for dotted, value in (overrides or {}).items():
        _override(plain, dotted, value, marks)
    return _build(plain, marks, file)


def _required() -> str:
    needed = [f.name for f in dataclasses.fields(Scenario) if f.default is dataclasses.MISSING]  # type: ignore[arg-type]
    return ", ".join(needed[:-1]) + " and " + needed[-1]


def _plain(node: Any, key: Key, marks: dict[Key, str], file: str) -> Any:
    """Plain dicts, lists and scalars of a ruamel tree; `marks` learns where each of them stands."""
    if isinstance(node, CommentedMap):
        marks.setdefault(key, f"{file}:{node.lc.line + 1}:{node.lc.col + 1}")
        for k in node:
            line, col = node.lc.key(k)
            marks[*key, k] = f"{file}:{line + 1}:{col + 1}"
        return {str(k): _plain(v, (*key, k), marks, file) for k, v in node.items()}
    if isinstance(node, CommentedSeq):
        for i in range(len(node)):
            line, col = node.lc.item(i)
            marks[*key, i] = f"{file}:{line + 1}:{col + 1}"
        return [_plain(v, (*key, i), marks, file) for i, v in enumerate(node)]
    for scalar in (bool, int, float, str):
        if isinstance(node, scalar):
            return scalar(node)
    return node


def read_value(text: str) -> object:
    """A value as it would stand in YAML (`1e-3`, `[1, 2]`, `{kind: oracle}`, `raw`), for `--set`."""
    try:
        return _plain(YAML(typ="rt").load(text), (), {}, "")
    except YAMLError as error:
        raise ParameterError("--set", f"value is not YAML ({error})", text) from None


def _override(plain: dict[str, Any], dotted: str, value: object, marks: dict[Key, str]) -> None:
    """Set one dotted path in the mapping; blocks on the way are made, a bare kind word becomes a block."""
    parts = dotted.split(".")
    here: Any = plain
    for i, part in enumerate(parts[:-1]):
        step: str | int = int(part) if isinstance(here, list) and part.isdigit() else part
        child = here.get(step) if isinstance(here, dict) else here[step] if isinstance(step, int) and step < len(here) else None
        if isinstance(child, str):
            child = {"kind": child}
        elif child is None:
            child = {}
        if not isinstance(child, dict | list) or (isinstance(here, list) and not isinstance(step, int)):
            raise ScenarioError([Mistake("--set", dotted, f"{'.'.join(parts[: i + 1])} is a value, not a block")])
        here[step] = child
        here = child
    last: str | int = int(parts[-1]) if isinstance(here, list) and parts[-1].isdigit() else parts[-1]
    if isinstance(here, list) and (not isinstance(last, int) or last >= len(here)):
        raise ScenarioError([Mistake("--set", dotted, f"there is no item {parts[-1]} in a list of {len(here)}")])
    here[last] = value
    key: Key = tuple(int(p) if p.isdigit() else p for p in parts)
    for old in [k for k in marks if k[: len(key)] == key]:
        del marks[old]
    marks[key] = "--set"


def _build(plain: dict[str, Any], marks: dict[Key, str], file: str) -> Scenario:
    try:
        return pydantic.TypeAdapter(Scenario).validate_python(plain)
    except pydantic.ValidationError as error:
        details = error.errors()
    mistakes = []
    for detail in details:
        key, reason = _place(detail["loc"], plain), _sentence(detail, plain)
        inner = detail.get("ctx", {}).get("error")
        if isinstance(inner, ParameterError):
            key += tuple(int(p) if p.isdigit() else p for p in inner.field.split("."))
            got = "" if inner.found is None else f", got {inner.found!r}"
            reason = f"{inner.problem}{got}"
        mistakes.append((key, reason))
    raise ScenarioError([Mistake(_mark(key, marks, file), ".".join(map(str, key)), reason) for key, reason in dict.fromkeys(mistakes)])


def _mark(key: Key, marks: Mapping[Key, str], file: str) -> str:
    """Where a key stands, or the nearest block above it."""
    for n in range(len(key), -1, -1):
        if key[:n] in marks:
            return marks[key[:n]]
    return f"{file}:1:1"


def _place(loc: Sequence[int | str], plain: Any) -> Key:
    """Pydantic's location without the kind tags that it puts between a block and its fields."""
    key: list[int | str] = []
    here = plain
    for part in loc:
        is_tag = isinstance(here, dict) and part not in here and here.get("kind") == part
        is_tag = is_tag or (isinstance(here, str) and here == part)
        number_tag = isinstance(here, int | float) and not isinstance(here, bool)
        if is_tag or number_tag:
            continue
        key.append(part)
        if isinstance(here, dict):
            here = here.get(part)  # type: ignore[arg-type]
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


def _sentence(detail: Any, plain: Any) -> str:
    """Pydantic's finding in this project's words, with what was found."""
    kind, found = detail["type"], detail["input"]
    if kind == "unexpected_keyword_argument":
        return f"unknown field; {nearest(str(detail['loc'][-1]), _fields_at(detail['loc'][:-1]))}"
    if kind == "missing":
        return _WORDS[kind]
    words = _WORDS.get(kind, detail["msg"])
    context = {k: f"{v:g}" if isinstance(v, float) else v for k, v in detail.get("ctx", {}).items()}
    return words.format(**context) + f", got {_short(found)}" if kind in _WORDS else f"{words}, got {_short(found)}"


def _short(found: object) -> str:
    text = repr(found)
    return text if len(text) <= 60 else text[:57] + "..."


def _is_spec(value: object) -> TypeGuard[type]:
    return isinstance(value, type) and dataclasses.is_dataclass(value)


def _fields_at(loc: Sequence[int | str]) -> list[str]:
    """Names of the fields of the spec class at a pydantic location (where kinds stand as tags)."""
    cls: type = Scenario
    for part in loc:
        by_kind = {k: m for one in KINDS.values() for k, m in one.members.items()}
        if isinstance(part, str) and (field := _spec_of_field(cls, part)) is not None:
            cls = field
        elif isinstance(part, str) and part in by_kind:
            cls = by_kind[part]
    return [f.name for f in dataclasses.fields(cls) if f.init]  # type: ignore[arg-type]


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


def dump(scenario: Scenario) -> str:
    """The scenario as YAML, every default written out; `parse` of it gives the same scenario."""
    yaml = YAML()
    yaml.default_flow_style = None
    yaml.width = 120
    out = io.StringIO()
    yaml.dump(_drop_none(to_mapping(scenario)), out)
    return out.getvalue()


def _drop_none(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: _drop_none(v) for k, v in value.items() if v is not None}
    return [_drop_none(v) for v in value] if isinstance(value, list) else value


def schema() -> dict[str, Any]:
    """JSON Schema of a scenario, for editors."""
    return pydantic.TypeAdapter(Scenario).json_schema()


def load_plugins(modules: Sequence[str]) -> None:
    """Import plugin modules (which add to the rooms' lists) and installed entry points; then rebuild the checks.

    Raises:
        ParameterError: a module that cannot be imported.
    """
    for name in modules:
        try:
            importlib.import_module(name)
        except ImportError as error:
            raise ParameterError("--plugin", f"cannot be imported ({error}); give a module's name as Python imports it", name) from None
    grown = [kinds.load_entry_points() for kinds in KINDS.values()]
    if modules or any(grown):
        rebuild_specs()
