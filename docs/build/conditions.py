"""Under what a command's numbers hold: what measures the picture, and what moves, read from the
scenarios that the command flies.

The law sees either the truth (*oracle*, within the picture's border or without one) or rendered
*pictures*. What moves is *ideal* (a camera, or servos that follow at once) or has *dynamics*, in
part with the imperfections of `robot.realism`.
"""

from __future__ import annotations

import functools
import itertools
import json
import re
import shlex
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import typer.main

import vstestbed as vs
from vstestbed.apps.maps.basin import laws
from vstestbed.apps.maps.delay import by_the_oracle
from vstestbed.cli.app import program
from vstestbed.cli.options import settings_of, vary_of
from vstestbed.studies.comparison import chosen
from vstestbed.studies.comparison.plan import Comparison, changed, merged
from vstestbed.vision.oracle import Oracle

LINE = "*Conditions: "
"""What the line of a table or a section begins with."""
DECIDES = re.compile(
    r"detector|detector\.kind|detector\.field_of_view|noise|noise\.pixel_sigma_px|robot|robot\.(kind|actuation|realism|arm.*)"
)
"""Fields that decide what the conditions are; whatever else is set or varied leaves them as they
are.
"""
KNOWN = "basin, compare, gain-limit, run, sweep, tune"
"""Commands of which it is known what they fly."""
Settings = Mapping[str, Any]


def conditions_line(*commands: str) -> str:
    """The line of a table or a section: one for all commands where all hold under the same, else an
    entry for each that differs.

    What three commands or more have in common comes first and names none of them: the entries after
    it are the exceptions.

    Raises:
        ValueError: there is no command, or of one it is not known what it flies.
    """
    if not commands:
        raise ValueError("conditions are those of a command; give one or more")
    by_words: dict[str, list[str]] = {}
    for command in commands:
        by_words.setdefault(conditions(command), []).append(f"`{command}`")
    if len(by_words) == 1:
        return f"{LINE}{conditions(commands[0])}.*"
    most = max(by_words, key=lambda words: len(by_words[words]))
    common = [most] if len(by_words[most]) > 2 else []
    entries = common + [
        f"{', '.join(those)}: {words}" for words, those in by_words.items() if words not in common
    ]
    return f"{LINE}{'. '.join(entries)}.*"


@functools.cache
def conditions(command: str) -> str:
    """What holds of a command's numbers, such as `oracle without border; ideal camera`.

    Raises:
        ValueError: it is not known what the command flies.
    """
    flown = list(flown_by(command))
    return f"{_seen(flown)}; {_moved(flown)}"


def flown_by(command: str) -> Iterator[vs.Scenario]:
    """Scenarios of all the conditions under which a command flies: one of each combination of what
    decides them.

    Raises:
        ValueError: the command's first word is not known here.
    """
    word, *rest = shlex.split(command)
    given = _parameters(word, rest)
    settings = settings_of(given.get("set_"))
    # a law of a plugin decides no conditions, and a build must not know it afterwards
    if given.get("plugin"):
        settings = {path: value for path, value in settings.items() if path.split(".")[0] != "law"}
    if word in ("run", "tune"):
        yield _loaded(given["scenario"], settings)
    elif word == "gain-limit":
        yield by_the_oracle(_loaded(given["scenario"], settings))
    elif word in ("compare", "sweep"):
        yield from _compared(_comparison(given, settings))
    elif word == "basin":
        comparison = changed(_comparison(given, settings), cases={}, axes={}, tasks={}, seeds=None)
        yield from (scenario for _, scenario in laws(comparison, given["field_of_view"]))
    else:
        raise ValueError(
            f"what `vstestbed {word}` flies is not known in"
            f" docs/build/conditions.py; known: {KNOWN}"
        )


def comparison_of(command: str) -> Comparison:
    """The plan of `compare ...`.

    Raises:
        ValueError: it is another command.
    """
    word, *rest = shlex.split(command)
    if word != "compare":
        raise ValueError(f"`vstestbed {word}` is no comparison")
    given = _parameters(word, rest)
    plan = _comparison(given, settings_of(given.get("set_")))
    numbers = {
        name: given[name]
        for name in ("seeds", "primary", "reference")
        if given.get(name) is not None
    }
    return changed(plan, **numbers)


def _parameters(word: str, rest: Sequence[str]) -> dict[str, Any]:
    """The options of a command, read as the program reads them.

    Raises:
        ValueError: there is no such command.
    """
    commands = _commands()
    if word not in commands:
        raise ValueError(f"`vstestbed {word}` is no command; known: {KNOWN}")
    return commands[word].make_context(word, list(rest)).params


@functools.cache
def _commands() -> dict[str, Any]:
    """The program's commands by their first words."""
    group: Any = typer.main.get_command(program())
    return group.commands


def _comparison(given: dict[str, Any], settings: dict[str, object]) -> Comparison:
    """The comparison of a command, as the program makes it."""
    return chosen(given["scenarios"], settings, vary_of(given.get("vary")))


def _compared(comparison: Comparison) -> Iterator[vs.Scenario]:
    """A comparison's scenarios, of each combination of settings that decide conditions; laws and
    starts are left out.
    """
    tasks = [task.set for task in comparison.tasks.values()] or [{}]
    cases = [list(those.values()) for those in comparison.cases.values()]
    axes = [[{path: value} for value in values] for path, values in comparison.axes.items()]
    choices = [_deciding(blocks) for blocks in (tasks, *cases, *axes)]
    for base in comparison.base:
        for blocks in itertools.product(*choices):
            yield _loaded(base, merged(comparison.set, *blocks))


def _deciding(blocks: Iterable[Settings]) -> list[Settings]:
    """The different blocks that decide conditions; one empty block stands for all others."""
    different: dict[str, Settings] = {}
    for block in blocks:
        kept = block if any(DECIDES.fullmatch(path) for path in block) else {}
        different[_key(kept)] = kept
    return list(different.values())


def _loaded(name: str, settings: Settings) -> vs.Scenario:
    """A scenario with what decides its conditions; with all its settings only where one of them
    does.
    """
    decides = any(DECIDES.fullmatch(path) for path in settings)
    return _load(name, _key(settings if decides else {}))


@functools.cache
def _load(name: str, settings: str) -> vs.Scenario:
    return vs.load(name, json.loads(settings))


def _key(settings: Settings) -> str:
    return json.dumps(settings)


def _seen(flown: Iterable[vs.Scenario]) -> str:
    """What measures the picture; noise is named of the oracle alone, which has no other error."""
    kinds, noises = [], []
    for scenario in flown:
        if not isinstance(scenario.detector, Oracle):
            kinds.append("pictures")
            continue
        sigma_px = scenario.noise.pixel_sigma_px
        kinds.append(
            "oracle without border"
            if scenario.detector.field_of_view == "unlimited"
            else "oracle with border"
        )
        noises.append(f"{sigma_px:g} px of noise" if sigma_px else "")
    return _either(kinds) + _in_part(noises)


def _moved(flown: Iterable[vs.Scenario]) -> str:
    """What moves, with the imperfections of `realism`."""
    kinds, levels = [], []
    for scenario in flown:
        if scenario.robot.body is None:
            kinds.append("ideal camera")
            continue
        level = getattr(scenario.robot, "realism", "none")
        kinds.append(
            "ideal servos" if getattr(scenario.robot, "actuation", "") == "ideal" else "dynamics"
        )
        levels.append("" if level == "none" else f"`{level}`")
    return _either(kinds) + _in_part(levels)


def _either(words: Iterable[str]) -> str:
    """The different words in their order: `a`, `a or b`, `a, b or c`."""
    *first, last = dict.fromkeys(words)
    return f"{', '.join(first)} or {last}" if first else last


def _in_part(words: Sequence[str]) -> str:
    """What all have, ` (0.1 px of noise)`, or some, ` (in part lab or field)`; "" for nothing."""
    different = [word for word in dict.fromkeys(words) if word]
    if not different:
        return ""
    return f" ({'' if all(words) and len(different) == 1 else 'in part '}{_either(different)})"
