"""Scenario files: read with all mistakes reported at once (file, line, column, field), written with all defaults."""

from __future__ import annotations

import dataclasses
import importlib
import io
import itertools
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pydantic
from ruamel.yaml import YAML

from vstestbed.core.assets import bundled_scenarios
from vstestbed.core.errors import Mistake, ParameterError, ScenarioError, VstestbedError, nearest
from vstestbed.core.spec import rebuild_specs, to_mapping
from vstestbed.scenario.scenario import Scenario
from vstestbed.scenario.validation import KINDS, build
from vstestbed.scenario.yaml_marks import FROM_OPTION, Marks, override, place_of, plain_mapping, short

MOST_BYTES = 100_000
"""Largest file that is read: fifty times the largest bundled one, and parsed in 2 s; one of 10 MB would take minutes."""


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


def load(
    name: str | Path, overrides: Mapping[str, object] | None = None, seed: int | None = None, places: Mapping[str, Marks] | None = None
) -> Scenario:
    """Read a scenario from a file or a bundled name.

    Args:
        name: path of a YAML file, or the name of a bundled scenario.
        overrides: values by dotted path, such as {"law.gain": 1.0}; they replace what the file says before it is checked.
        seed: draw the start from the robot's random block, and all noise, from this seed.
        places: for messages, where each override stands: of its value and of the keys in it, relative to it; by default `--set`.

    Raises:
        ScenarioError: all mistakes at once.
    """
    path = find(name)
    scenario = parse(text_of(path), str(path), overrides, seed, places)
    return scenario if scenario.name else dataclasses.replace(scenario, name=path.stem)


def text_of(path: Path) -> str:
    """The text of a UTF-8 file; ScenarioError where it cannot be read."""
    try:
        # Bytes first: the position of a bad byte is its line and column only while nothing is decoded.
        with path.open("rb") as stream:
            raw = stream.read(MOST_BYTES + 1)
    except OSError as error:
        raise ScenarioError([Mistake(str(path), "", f"cannot be read ({error.strerror})")]) from None
    if len(raw) > MOST_BYTES:
        words = f"has more than {MOST_BYTES // 1000} kB; a scenario needs far less"
        raise ScenarioError([Mistake(f"{path}:1:1", "", words)])
    try:
        return raw.decode("utf-8-sig")  # editors on Windows begin a file with a byte order mark
    except UnicodeDecodeError as error:
        line = raw.count(b"\n", 0, error.start) + 1
        col = error.start - (raw.rfind(b"\n", 0, error.start) + 1) + 1
        words = f"is not UTF-8 text (byte 0x{raw[error.start]:02x}); save the file as UTF-8"
        raise ScenarioError([Mistake(f"{path}:{line}:{col}", "", words)]) from None


def parse(
    text: str,
    file: str,
    overrides: Mapping[str, object] | None = None,
    seed: int | None = None,
    places: Mapping[str, Marks] | None = None,
) -> Scenario:
    """Build a scenario from YAML text; `file` is its name in messages. See `load`."""
    plain, marks = plain_mapping(text, file, f"a scenario needs {_required()}")
    overrides, places = overrides or {}, places or {}
    for dotted, value in overrides.items():
        override(plain, dotted, value, marks, _is_kind, places.get(dotted, FROM_OPTION))
    try:
        scenario = build(Scenario, plain, marks, file)
    except ScenarioError as error:
        raise (_blame_settings(error, text, file, overrides, places) if overrides else error) from None
    try:
        return scenario if seed is None else seeded(scenario, seed)
    except ParameterError as error:
        where = place_of(tuple(error.field.split(".")), marks, file)
        raise ScenarioError([Mistake(where, error.field, error.problem)]) from None


def _blame_settings(
    error: ScenarioError, text: str, file: str, overrides: Mapping[str, object], places: Mapping[str, Marks]
) -> ScenarioError:
    """The same mistakes, each with the position of the override that brings it; those that the file has by itself are left alone.

    A contradiction between two fields names one of them, which may be the file's: so the file is read again with one more override
    at a time.
    """
    known = {place for dotted in overrides for place in places.get(dotted, FROM_OPTION).values()}
    if all(m.where in known for m in error.mistakes):
        return error
    origins = _origins(text, file, overrides, places)
    places_found = [m.where if m.where in known else origins[m.field, m.sentence] or m.where for m in error.mistakes]
    return ScenarioError([dataclasses.replace(m, where=where) for m, where in zip(error.mistakes, places_found, strict=True)])


def _origins(text: str, file: str, overrides: Mapping[str, object], places: Mapping[str, Marks]) -> dict[tuple[str, str], str]:
    """For each mistake, by field and sentence, the position of the first override with which it is there; "" for the file's own."""
    origins = dict.fromkeys(_mistakes(text, file, {}), "")
    for number, dotted in enumerate(overrides, start=1):
        found = _mistakes(text, file, dict(itertools.islice(overrides.items(), number)))
        origins = dict.fromkeys(found, places.get(dotted, FROM_OPTION)[()]) | origins
    return origins


def _mistakes(text: str, file: str, overrides: Mapping[str, object]) -> list[tuple[str, str]]:
    """Field and sentence of each mistake in a scenario."""
    plain, marks = plain_mapping(text, file, "")
    for dotted, value in overrides.items():
        override(plain, dotted, value, marks, _is_kind)
    try:
        build(Scenario, plain, marks, file)
    except ScenarioError as error:
        return [(m.field, m.sentence) for m in error.mistakes]
    return []


def seeded(scenario: Scenario, seed: int) -> Scenario:
    """The scenario with a start drawn from a seed, and its noise with it; without a random block the noise alone.

    Raises:
        ParameterError: nothing is random, or no start was found with the target in view.
    """
    noise = scenario.noise
    # A fixed start with noise is a fair experiment for many seeds; without noise either, every seed would give the same run.
    if scenario.robot.start.random is None and (noise.image_sigma > 0 or noise.pixel_sigma_px > 0):
        return dataclasses.replace(scenario, seed=seed)
    return scenario.randomised(seed)


def _is_kind(word: str) -> bool:
    return any(word in kinds.members for kinds in KINDS.values())


def _required() -> str:
    needed = [f.name for f in dataclasses.fields(Scenario) if f.default is dataclasses.MISSING]
    return ", ".join(needed[:-1]) + " and " + needed[-1]


def dump(scenario: Scenario) -> str:
    """The scenario as YAML with all defaults; `parse` of it gives the same scenario."""
    return dump_mapping(scenario)


def dump_mapping(spec: object) -> str:
    """A spec as YAML with all defaults."""
    yaml = YAML()
    yaml.default_flow_style = None  # nested blocks on lines of their own, the innermost mappings and lists on one line
    yaml.width = 120
    out = io.StringIO()
    yaml.representer.add_representer(type(None), lambda r, _: r.represent_scalar("tag:yaml.org,2002:null", "null"))
    yaml.dump(to_mapping(spec), out)
    return out.getvalue()


def schema() -> dict[str, Any]:
    """JSON Schema of a scenario, for editors."""
    return pydantic.TypeAdapter(Scenario).json_schema()


def load_plugins(modules: Sequence[str]) -> None:
    """Import plugin modules, which register their kinds, and installed entry points; then rebuild the validators.

    A module is searched on Python's path, and in the current folder.

    Raises:
        ParameterError: a module cannot be imported, an entry point cannot be loaded, or a class breaks its room's contract.
    """
    # At the end of the path: a file here named like an installed package must not replace it.
    if modules and (here := str(Path.cwd())) not in sys.path:
        sys.path.append(here)
    for name in modules:
        with _loading("--plugin", "cannot be imported", name):
            importlib.import_module(name)
    grown = []
    for room, kinds in KINDS.items():
        with _loading(f"vstestbed.{room}", "has an installed plugin that cannot be loaded; mend or uninstall it", None):
            grown.append(kinds.load_entry_points())
    if modules or any(grown):  # it takes time, and without plugins nothing has changed
        rebuild_specs()


@contextmanager
def _loading(field: str, problem: str, name: str | None) -> Iterator[None]:
    """Turn any error of a plugin's import, which is code of others, into a ParameterError with the same message."""
    try:
        yield
    except VstestbedError:
        raise
    except (Exception, SystemExit) as error:  # a module that calls sys.exit does not end the program
        raise ParameterError(field, f"{problem} ({type(error).__name__}: {error})", name) from error
