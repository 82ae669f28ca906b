"""Scenario files: read with all mistakes reported at once (file, line, column, field), written with
all defaults.
"""

from __future__ import annotations

import dataclasses
import itertools
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path

from vstestbed.core.errors import Mistake, ParameterError, ScenarioError, nearest, short
from vstestbed.core.fields import needed
from vstestbed.core.messages import UNKNOWN, key_of
from vstestbed.core.named_files import bundled_scenarios
from vstestbed.scenario.plugins import absolute, absolute_files, load_named
from vstestbed.scenario.scenario import Scenario
from vstestbed.scenario.yaml_marks import (
    FROM_PYTHON,
    Marks,
    build,
    overlap,
    place_of,
    plain_mapping,
    put_over,
    respelled,
    text_of,
)

__all__ = ["GIVEN", "RESOLVED", "find", "for_another_folder", "load", "parse", "seeded"]

GIVEN = "scenario.yaml"
RESOLVED = "resolved.yaml"
"""In a run's folder: the scenario as it was given, and as it ran, with every default, preset and
draw written out.
"""
SCHEMA_LINE = re.compile(r"\A# yaml-language-server: \$schema=.*\n")
"""The first line of a bundled file, by which editors find its schema beside it."""


def find(name: str | Path) -> Path:
    """The file of a scenario given by path or by the name of a bundled one, which no file of the
    current folder takes: that is `./NAME`. ScenarioError names the nearest where neither exists.
    """
    path = Path(name)
    bundled = bundled_scenarios()
    try:
        if isinstance(name, str) and name in bundled:
            return bundled[name]
        if path.is_file():
            return path
        if str(name) and path.is_dir():
            raise ScenarioError.at(str(name), "", "is a folder; give a scenario's YAML file")
    except OSError as error:
        words = f"cannot be read ({error.strerror})"
        raise ScenarioError.at(short(str(name)), "", words) from None
    words = f"no such file, and no bundled scenario of that name; {nearest(path.stem, bundled)}"
    raise ScenarioError.at(str(name) or "SCENARIO", "", words)


def load(
    name: str | Path,
    overrides: Mapping[str, object] | None = None,
    seed: int | None = None,
    places: Mapping[str, Marks] | None = None,
    plugins: Sequence[str] = (),
) -> Scenario:
    """Read a scenario from a file or a bundled name. This runs the code of the plugins that it
    names.

    Args:
        name: path of a YAML file, or the name of a bundled scenario.
        overrides: values by dotted path, such as {"law.gain": 1.0}; they replace what the file says
            before it is checked.
        seed: draw the start from the robot's random block, and all noise, from this seed.
        places: for messages, where each override stands: of its value and of the keys in it,
            relative to it; by default `overrides`.
        plugins: files (`mylaw.py`) or modules that add kinds, besides those that the file names
            under `plugins`.
    Raises ScenarioError: all mistakes at once. PluginError: a plugin is not there or cannot be
    imported.
    """
    if not isinstance(overrides or {}, Mapping):
        words = f"must be a dictionary, such as {{'law.gain': 1.0}}, got {overrides!r}"
        raise ScenarioError.at("overrides", "", words)
    path = find(name)
    if path.name == RESOLVED and (overrides or seed is not None):
        words = (
            "is the record of a run, with every preset and draw written out;"
            f" put other values and seeds over {GIVEN} beside it"
        )
        raise ScenarioError.at(str(path), "", words)
    scenario = parse(text_of(path), str(path), overrides, seed, places, plugins)
    return scenario if scenario.name else scenario.but(name=path.stem)


def parse(
    text: str,
    file: str,
    overrides: Mapping[str, object] | None = None,
    seed: int | None = None,
    places: Mapping[str, Marks] | None = None,
    plugins: Sequence[str] = (),
) -> Scenario:
    """Build a scenario from YAML text; `file` is its name in messages. See `load`."""
    *others, last = needed(Scenario)
    plain, marks = plain_mapping(text, file, f"a scenario needs {', '.join(others)} and {last}")
    plain = absolute_files(plain, Path(file).absolute().parent)
    overrides = dict[str, object](absolute_files(overrides or {}, Path.cwd()))
    places = places or {}
    put_over(plain, _part(overrides, of_plugins=True), marks, places)
    # before the other settings, which may use the words that plugins add
    load_named(plain, marks, file, plugins)
    put_over(plain, _part(overrides, of_plugins=False), marks, places)
    if "draw_start" in plain and "draw_start" not in overrides and _gives_start(overrides):
        plain["draw_start"] = False
    try:
        scenario = build(Scenario, plain, marks, file)
    except ScenarioError as error:
        blamed = _blame_settings(error, text, file, overrides, places)
        raise _other_kinds(blamed, overrides, places) from None
    _refuse_drawn(scenario, overrides, places)
    if _is_plain(plain):
        scenario.loaded_from(plain)
    try:
        if seed is not None:
            scenario = seeded(scenario, seed)
        scenario.resolved  # noqa: B018 - refuses what its seed draws
        return scenario
    except ParameterError as error:
        where = place_of(key_of(error.field), marks, file)
        raise ScenarioError.at(where, error.field, error.problem) from None


def _gives_start(overrides: Iterable[str]) -> bool:
    return any(overlap(dotted, "robot.start.nominal") for dotted in overrides)


def _part(overrides: Mapping[str, object], of_plugins: bool) -> dict[str, object]:
    return {
        path: value
        for path, value in overrides.items()
        if (path.split(".")[0] == "plugins") == of_plugins
    }


def _is_plain(value: object) -> bool:
    """Whether values can be written as YAML: overrides in Python may be objects."""
    if isinstance(value, dict):
        value = list(value.values())
    if isinstance(value, list | tuple):
        return all(map(_is_plain, value))
    return value is None or type(value) in (bool, int, float, str)


def _refuse_drawn(
    scenario: Scenario, overrides: Mapping[str, object], places: Mapping[str, Marks]
) -> None:
    for i, one in enumerate(scenario.randomise):
        for dotted in overrides:
            if f"{dotted}.".startswith(f"{one.field}."):
                words = (
                    f"is drawn from the seed by randomise.{i};"
                    " set randomise=[], or leave that distribution out, to give it a value"
                )
                raise ScenarioError.at(places.get(dotted, FROM_PYTHON)[()], dotted, words)


def _blame_settings(
    error: ScenarioError,
    text: str,
    file: str,
    overrides: Mapping[str, object],
    places: Mapping[str, Marks],
) -> ScenarioError:
    """The same mistakes, each with the position of the override that brings it; those that the file
    has by itself are left alone. A contradiction between two fields names one of them, which may be
    the file's: so the file is read again with one more override at a time.
    """
    known = {place for dotted in overrides for place in places.get(dotted, FROM_PYTHON).values()}
    if not overrides or all(m.where in known for m in error.mistakes):
        return error
    # the position of the first override with which a mistake is there
    origins = dict.fromkeys(_mistakes(text, file, {}), "")
    for number, dotted in enumerate(overrides, start=1):
        found = _mistakes(text, file, dict(itertools.islice(overrides.items(), number)))
        origins = dict.fromkeys(found, places.get(dotted, FROM_PYTHON)[()]) | origins
    mistakes = []
    for m in error.mistakes:
        if m.where not in known:
            m = dataclasses.replace(m, where=origins[m.field, m.sentence] or m.where)
        mistakes.append(m)
    return ScenarioError(mistakes)


def _other_kinds(
    error: ScenarioError, overrides: Mapping[str, object], places: Mapping[str, Marks]
) -> ScenarioError:
    """The same mistakes, with one in place of those of fields that a block keeps though an override
    makes another kind of it.
    """
    mistakes = list(error.mistakes)
    for dotted, kind in overrides.items():
        block, _, last = dotted.rpartition(".")
        given = tuple(f"{other}." for other in overrides if other != dotted)
        kept = [*_unknown_in(block, given, mistakes)] if last == "kind" else []
        if not kept:
            continue
        names = ", ".join(dict.fromkeys(m.field.removeprefix(f"{block}.") for m in kept))
        words = (
            f"leaves the block's other fields as they are, and {kind} has no {names};"
            f" {block}={kind}, without .kind, replaces the block"
        )
        mistakes = [m for m in mistakes if m not in kept]
        mistakes.append(Mistake(places.get(dotted, FROM_PYTHON)[()], dotted, words))
    return ScenarioError(mistakes)


def _unknown_in(
    block: str, given: tuple[str, ...], mistakes: Iterable[Mistake]
) -> Iterator[Mistake]:
    """The mistakes of unknown fields of a block which none of the paths `given` (with a dot at
    their end) brings.
    """
    for m in mistakes:
        own = m.field.startswith(f"{block}.") and not f"{m.field}.".startswith(given)
        if own and UNKNOWN in m.sentence:
            yield m


def _mistakes(text: str, file: str, overrides: Mapping[str, object]) -> list[tuple[str, str]]:
    """The field and the sentence of each mistake of a file with these values put over it."""
    plain, marks = plain_mapping(text, file, "")
    plain = absolute_files(plain, Path(file).absolute().parent)
    put_over(plain, overrides, marks, {})
    try:
        build(Scenario, plain, marks, file)
    except ScenarioError as error:
        return [(m.field, m.sentence) for m in error.mistakes]
    return []


def seeded(scenario: Scenario, seed: int) -> Scenario:
    """The scenario with a start drawn from a seed, and all else that is random with it; without a
    random block that alone.
    """
    # A fixed start with noise is a fair experiment for many seeds; without either, every seed would
    # give the same run.
    if scenario.robot.start.random is None and scenario.draws:
        return scenario.with_seed(seed)
    return scenario.randomised(seed)


def for_another_folder(path: Path) -> str:
    """The text of a scenario file for a copy elsewhere. Its plugins and the files that it names are
    named absolutely; it names no schema, which an editor would not find there.
    """
    text = SCHEMA_LINE.sub("", text_of(path))
    folder = path.absolute().parent
    plain, _ = plain_mapping(text, str(path), "")
    named = plain.get("plugins")
    moved = absolute_files(plain, folder)
    if isinstance(named, list):
        moved["plugins"] = [absolute(str(name), folder) for name in named]
    if moved == plain:
        return text
    return respelled(text, str(path), moved)
