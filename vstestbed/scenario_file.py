"""A scenario's YAML: read with every mistake named at once (file, line, column, field), written with every default."""

from __future__ import annotations

import dataclasses
import importlib
import io
import sys
import typing
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeGuard

import pydantic
from ruamel.yaml import YAML

from vstestbed.assets import bundled_scenarios
from vstestbed.camera import CAMERAS
from vstestbed.errors import Mistake, ParameterError, ScenarioError, VstestbedError, nearest
from vstestbed.features import FEATURES
from vstestbed.laws import LAWS
from vstestbed.laws.base import GAINS
from vstestbed.observation import DEPTHS
from vstestbed.robots import ROBOTS
from vstestbed.scenario import Scenario
from vstestbed.spec import OneOf, rebuild_specs, to_mapping
from vstestbed.target import MARKERS, MOTIONS, TARGETS
from vstestbed.vision import DETECTORS
from vstestbed.yaml_tree import Key, Marks, override, place_of, plain_mapping, short

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
    path, bundled = Path(name), bundled_scenarios()
    try:
        if path.is_file():
            return path
        if str(name) in bundled:
            return bundled[str(name)]
        if str(name) and path.is_dir():
            raise ScenarioError([Mistake(str(name), "", "is a folder; give a scenario's YAML file")])
    except OSError as error:
        raise ScenarioError([Mistake(short(str(name)), "", f"cannot be read ({error.strerror})")]) from None
    words = f"no such file, and no bundled scenario of that name; {nearest(path.stem, bundled)}"
    raise ScenarioError([Mistake(str(name) or "SCENARIO", "", words)])


def load(name: str | Path, overrides: Mapping[str, object] | None = None, seed: int | None = None) -> Scenario:
    """Read a scenario from a file or a bundled name.

    Args:
        name: path of a YAML file, or the name of a bundled scenario.
        overrides: values by dotted path, such as {"law.gain": 1.0}; they replace what the file says before it is checked.
        seed: draw the start from the robot's random block, and all noise, from this seed.

    Raises:
        ScenarioError: everything that is wrong, at once.
    """
    path = find(name)
    scenario = parse(_text(path), str(path), overrides, seed)
    return scenario if scenario.name else dataclasses.replace(scenario, name=path.stem)


def _text(path: Path) -> str:
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise ScenarioError([Mistake(str(path), "", f"cannot be read ({error.strerror})")]) from None
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = raw.count(b"\n", 0, error.start) + 1
        col = error.start - (raw.rfind(b"\n", 0, error.start) + 1) + 1
        words = f"is not UTF-8 text (byte 0x{raw[error.start]:02x}); save the file as UTF-8"
        raise ScenarioError([Mistake(f"{path}:{line}:{col}", "", words)]) from None


def parse(text: str, file: str, overrides: Mapping[str, object] | None = None, seed: int | None = None) -> Scenario:
    """Build a scenario from YAML text; `file` is what messages call it. See `load`."""
    plain, marks = plain_mapping(text, file, f"a scenario needs {_required()}")
    for dotted, value in (overrides or {}).items():
        override(plain, dotted, value, marks, _is_kind)
    try:
        scenario = _build(plain, marks, file)
    except ScenarioError as error:
        raise (_blame_settings(error, text, file) if overrides else error) from None
    try:
        return scenario if seed is None else _seeded(scenario, seed)
    except ParameterError as error:
        where = place_of(tuple(error.field.split(".")), marks, file)
        raise ScenarioError([Mistake(where, error.field, error.problem)]) from None


def _blame_settings(error: ScenarioError, text: str, file: str) -> ScenarioError:
    """The same mistakes, those that the file does not have by itself laid to --set."""
    try:
        parse(text, file)
        own: set[tuple[str, str]] = set()
    except ScenarioError as without:
        own = {(m.field, m.sentence) for m in without.mistakes}
    return ScenarioError([m if (m.field, m.sentence) in own else dataclasses.replace(m, where="--set") for m in error.mistakes])


def _seeded(scenario: Scenario, seed: int) -> Scenario:
    """The seed's start; without a random block a seed still draws the noise, and is refused where there is none."""
    noise = scenario.noise
    if scenario.robot.start.random is None and (noise.image_sigma > 0 or noise.pixel_sigma_px > 0):
        return dataclasses.replace(scenario, seed=seed)
    return scenario.randomised(seed)


def _is_kind(word: str) -> bool:
    return any(word in kinds.members for kinds in KINDS.values())


def _required() -> str:
    needed = [f.name for f in dataclasses.fields(Scenario) if f.default is dataclasses.MISSING]  # type: ignore[arg-type]
    return ", ".join(needed[:-1]) + " and " + needed[-1]


def _build(plain: dict[str, Any], marks: Marks, file: str) -> Scenario:
    try:
        scenario = pydantic.TypeAdapter(Scenario).validate_python(plain)
        found = [(key, words) for key, words in _bent(plain, to_mapping(scenario), ())]
        if not found:
            return scenario
    except pydantic.ValidationError as error:
        found = [_finding(detail, plain) for detail in error.errors() if not _echo(detail)]
    mistakes = [Mistake(place_of(key, marks, file), ".".join(map(str, key)), words) for key, words in dict.fromkeys(found)]
    raise ScenarioError(sorted(mistakes, key=_reading_order))


def _reading_order(mistake: Mistake) -> tuple[int, ...]:
    """Line and column of a mistake; what --set brought comes last."""
    place = mistake.where.rsplit(":", 2)[1:]
    return tuple(int(n) for n in place) if len(place) == 2 else (1 << 31,)


def _echo(detail: Any) -> bool:
    """Whether pydantic only counts the items of a list that it refused one by one."""
    return detail["type"] == "too_short" and len(detail["input"]) >= detail["ctx"]["min_length"]


def _finding(detail: Any, plain: dict[str, Any]) -> tuple[Key, str]:
    """One of pydantic's findings: the key it is about, and a sentence."""
    key, inner = _place(detail["loc"], plain), detail.get("ctx", {}).get("error")
    if isinstance(inner, ParameterError):
        got = "" if inner.found is None else f", got {short(inner.found)}"
        return (*key, *(int(p) if p.isdecimal() else p for p in inner.field.split("."))), f"{inner.problem}{got}"
    if detail["type"] == "unknown_kind" and isinstance(detail["input"], dict) and "kind" in detail["input"]:
        return (*key, "kind"), _sentence(detail | {"input": detail["input"]["kind"]})
    return key, _sentence(detail)


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


_DEFAULT_KINDS = {kinds.default for kinds in KINDS.values() if kinds.default}


def _place(loc: Sequence[int | str], plain: Any) -> Key:
    """Pydantic's location without the kind tags that it puts between a block and its fields."""
    key: list[int | str] = []
    here = plain
    for part in loc:
        is_tag = isinstance(here, dict) and part not in here and here.get("kind") == part
        is_tag = is_tag or (isinstance(here, str) and here == part)
        is_tag = is_tag or (isinstance(here, dict) and "kind" not in here and part in _DEFAULT_KINDS)
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


def _sentence(detail: Any) -> str:
    """Pydantic's finding in this project's words, with what was found."""
    kind, found = detail["type"], detail["input"]
    if kind == "unexpected_keyword_argument":
        return f"unknown field; {nearest(str(detail['loc'][-1]), _fields_at(detail['loc'][:-1]))}"
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
    yaml.representer.add_representer(type(None), lambda r, _: r.represent_scalar("tag:yaml.org,2002:null", "null"))
    yaml.dump(to_mapping(scenario), out)
    return out.getvalue()


def schema() -> dict[str, Any]:
    """JSON Schema of a scenario, for editors."""
    return pydantic.TypeAdapter(Scenario).json_schema()


def load_plugins(modules: Sequence[str]) -> None:
    """Import plugin modules (which add to the rooms' lists) and installed entry points; then rebuild the checks.

    A module is looked for where Python looks, and in the current folder.

    Raises:
        ParameterError: a module that cannot be imported, an entry point that cannot be loaded.
    """
    if modules and (here := str(Path.cwd())) not in sys.path:
        sys.path.append(here)
    for name in modules:
        with _loading("--plugin", "cannot be imported", name):
            importlib.import_module(name)
    grown = []
    for room, kinds in KINDS.items():
        with _loading(f"vstestbed.{room}", "has an installed plugin that cannot be loaded; mend or uninstall it", None):
            grown.append(kinds.load_entry_points())
    if modules or any(grown):
        rebuild_specs()


@contextmanager
def _loading(field: str, problem: str, name: str | None) -> Iterator[None]:
    """Somebody else's code may fail in any way when it is imported; say what it said."""
    try:
        yield
    except VstestbedError:
        raise
    except Exception as error:
        raise ParameterError(field, f"{problem} ({type(error).__name__}: {error})", name) from error
