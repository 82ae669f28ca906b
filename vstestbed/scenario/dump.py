"""Scenarios as YAML: short, as people write them, or with every default; and the two documents of a
run's folder.
"""

from __future__ import annotations

import dataclasses
import importlib.metadata
import io
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

import yaml

from vstestbed.core.errors import ParameterError
from vstestbed.core.files import write_whole
from vstestbed.core.named_files import (
    CALIBRATED,
    absolute_file,
    bundled_scenarios,
    is_there,
    kept_at,
    module_of,
)
from vstestbed.core.registry import brief_mapping, to_mapping
from vstestbed.robots import Robot
from vstestbed.scenario.load import GIVEN, RESOLVED, load, parse
from vstestbed.scenario.plugins import HOMES, absolute, absolute_files, is_file_name, relative_files
from vstestbed.scenario.scenario import Scenario, check_scenario
from vstestbed.scenario.yaml_marks import plain_mapping, text_of

__all__ = [
    "as_yaml",
    "block_text",
    "changes",
    "check_plugins",
    "documents",
    "dump",
    "flow_text",
    "given_text",
    "kept_files",
    "load_run",
]

LIBYAML: Any = getattr(yaml, "CSafeDumper", yaml.SafeDumper)
WIDTH = 120  # columns of a line
ON_ONE_LINE = 110  # columns of a block that stands on one line


def dump(scenario: Scenario, path: str | Path | None = None, *, defaults: bool = False) -> str:
    """The scenario as YAML text, which `load` turns into an equal one; a scenario without a name
    gets that of the file.

    path: a file to write, in place of one that is there; files in its folder, or below, are named
    relative to it. defaults: write them, too.
    Raises ParameterError: `scenario` is not a Scenario, or has a kind of your own that is in no
    file of `plugins`. OutputError, EnvironmentLackError: the file cannot be written.
    """
    check_scenario(scenario)
    if defaults:
        plain = to_mapping(scenario)
    else:
        check_plugins(scenario)
        plain = _brief(scenario)
    if path is not None:
        if plain.get("name") == Path(path).stem:
            del plain["name"]
        plain = relative_files(plain, Path(path).absolute().parent)
    text = as_yaml(plain, brief=not defaults)
    if path is not None:
        write_whole(Path(path), text)
    return text


def _brief(scenario: Scenario) -> dict[str, Any]:
    plain = absolute_files(brief_mapping(scenario), Path.cwd())
    if scenario.plugins:
        plain["plugins"] = [absolute(name, Path.cwd()) for name in scenario.plugins]
    return plain


def given_text(scenario: Scenario) -> str:
    """What was given as YAML: the file's values with what was put over them; of a scenario made in
    Python what is no default.
    """
    return as_yaml(scenario.given.made_of or _brief(scenario.given), brief=True)


def documents(scenario: Scenario) -> dict[str, str]:
    """The two documents of a run's folder by name, which name the copies of files there
    (`kept_files`). `scenario.yaml` is what was given, and running it again gives the same log;
    `resolved.yaml` is what ran, with every default, preset and draw.
    """
    copies = {file: place for file, _, place in _kept(scenario) if file}
    copies |= {absolute_file(file, Path.cwd()): place for file, place in copies.items()}
    given = scenario.given.made_of or _brief(scenario.given)
    resolved = to_mapping(scenario.resolved)
    return {
        GIVEN: as_yaml(_renamed(given, copies), brief=True),
        RESOLVED: as_yaml(_renamed(resolved, copies)),
    }


def _renamed(value: Any, names: Mapping[str, str], without: Sequence[str] = ()) -> Any:
    """Plain values with texts in place of others, and without some fields."""
    if isinstance(value, dict):
        kept = [key for key in value if key not in without]
        return {key: _renamed(value[key], names, without) for key in kept}
    if isinstance(value, list | tuple):
        return [_renamed(inner, names, without) for inner in value]
    return names.get(value, value) if isinstance(value, str) else value


def kept_files(scenario: Scenario) -> dict[str, Path]:
    """The files that a run's folder has a copy of, by their names there: the target's, and those of
    the goal's pictures.
    """
    return {place: path for _, path, place in _kept(scenario)}


def _kept(scenario: Scenario) -> list[tuple[str | None, Path, str]]:
    """Name in the scenario, file, and place of the copy in a run's folder: of the target's file, of
    each of the goal's pictures, and of calibrations, whose numbers alone the record has.
    """
    parts: dict[str, Any] = {"target": scenario.target}
    parts |= {f"goal_{i}": said for i, said in enumerate(scenario.goal.pictures)}
    kept = []
    for what, part in parts.items():
        source = part.source
        if source:
            kept.append((getattr(part, "file", None), source, kept_at(source, what)))
    for what, block in _calibrated(scenario.given.made_of or {}):
        if not isinstance(block, Mapping):
            continue
        for name in CALIBRATED:
            file = block.get(name)
            if isinstance(file, str) and is_there(Path(file)):
                kept.append((file, Path(file), kept_at(Path(file), what + name)))
    return kept


def _calibrated(given: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """The blocks of a scenario that may name a calibration, after the beginning of the name of its
    copy.
    """
    for name in ("robot", "camera", "calibration"):
        yield f"{name}_", given.get(name)
    yield "", given
    for name, further in (given.get("cameras") or {}).items():
        yield f"{name}_", further
        for part in ("camera", "calibration"):
            yield f"{name}_{part}_", further.get(part)


FORMER = ("filled", "drawn_about", "drawn_offsets", "drawn_errors", "drawn_seed")
"""Fields of a run's folder of before, whose one file was both what was given and what was drawn:
the seed draws them again.
"""


def load_run(folder: Path, plugins: Sequence[str] = ()) -> Scenario:
    """The scenario of a run's folder as it ran; its `given` is what was given. Folders of before
    have one file that is both.
    """
    path = folder / GIVEN
    record = folder / RESOLVED
    text = text_of(path)
    if record.is_file():
        given = parse(text, str(path), plugins=plugins)
        scenario = parse(text_of(record), str(record), plugins=plugins).resolved
        scenario.__dict__["given"] = given
        return scenario
    if any(f"{word}:" in text for word in FORMER):
        text = as_yaml(_renamed(plain_mapping(text, str(path), "")[0], {}, FORMER))
    return parse(text, str(path), plugins=plugins).resolved


def as_yaml(plain: Any, brief: bool = False) -> str:
    """Plain mappings, lists and scalars as YAML. brief: each block that fits on one line stands on
    one; else the innermost alone do.
    """

    class Dumper(LIBYAML):
        """PyYAML writes YAML 1.1, where `1e3` is text; it is read as YAML 1.2, where it is a
        number.
        """

        def represent_data(self, data: Any) -> Any:
            node = super().represent_data(data)
            if brief and not isinstance(node.value, str):
                node.flow_style = _width(node) <= ON_ONE_LINE  # the whole scenario never
            return node

    def plain_or_quoted(dumper: Any, text: str) -> Any:
        quote = "'" if text[:1] in "+-.0123456789" else None
        return dumper.represent_scalar("tag:yaml.org,2002:str", text, quote)

    Dumper.add_representer(str, plain_or_quoted)
    # nested blocks on lines of their own, the innermost mappings and lists on one line
    return _yaml_text(plain, Dumper=Dumper, default_flow_style=None, width=WIDTH)


def flow_text(value: object) -> str:
    """Plain values as YAML on one line: `{kind: pbvs, gain: 0.5}`."""
    # the dots end a single word
    return _yaml_text(value, default_flow_style=True, width=10**6).removesuffix("...\n").strip()


def block_text(value: object, width: int) -> str:
    """Plain values as YAML for people: innermost mappings and lists on one line, as far as `width`
    characters hold them.
    """
    return _yaml_text(value, default_flow_style=None, width=width).strip()


def _yaml_text(value: object, **style: Any) -> str:
    style.setdefault("Dumper", LIBYAML)
    out = io.StringIO()
    yaml.dump(value, out, sort_keys=False, allow_unicode=True, **style)
    return out.getvalue()


def _width(node: Any) -> int:
    if isinstance(node.value, str):
        return len(node.value) + 2
    return 2 + sum(
        sum(map(_width, item)) if isinstance(item, tuple) else _width(item) for item in node.value
    )


def check_plugins(scenario: Scenario) -> None:
    """Refuse a scenario with a kind of the user's own that a file of the scenario would lack."""
    foreign = {
        type(part): field
        for field, part in _parts(scenario)
        if _package(type(part).__module__) != "vstestbed"
    }
    if not foreign:
        return
    packages = _packages(scenario.plugins)
    here = Path.cwd()
    loaded = [
        module_of(Path(absolute(name, here))) for name in scenario.plugins if is_file_name(name)
    ]
    for cls, field in foreign.items():
        in_file = any(_has(module, cls) for module in loaded)
        if not in_file and _package(cls.__module__) not in packages:
            raise ParameterError(field, _unnamed(cls))


def _package(module: str) -> str:
    return module.partition(".")[0]


def _packages(plugins: Iterable[str]) -> set[str]:
    """The packages of the plugins that are named as modules, and of those that are installed."""
    packages = {_package(name) for name in plugins if not is_file_name(name)}
    offered: Any = importlib.metadata.entry_points()
    for name in HOMES:
        packages.update(_package(e.module) for e in offered.select(group=f"vstestbed.{name}"))
    return packages


def _has(module: ModuleType | None, cls: type) -> bool:
    """Whether a module is the one of a class, or imports it or its module."""
    home = sys.modules.get(cls.__module__)
    if module is None or module is home:
        return module is not None
    return any(value is cls or value is home for value in vars(module).values())


def _unnamed(cls: type) -> str:
    """The sentence for a class of the user's own that no scenario file finds."""
    file = getattr(sys.modules.get(cls.__module__), "__file__", None)
    if file is None or cls.__module__ == "__main__":
        return (
            f"is {cls.__name__}, which is defined in the program that runs"
            " (a script, a notebook), where no scenario file finds it;"
            " put the class into a file mine.py, import it from there,"
            " and give the scenario plugins=('mine.py',)"
        )
    file = str(Path(file).resolve())
    return (
        f"is {cls.__name__} of {file}, which the file would not name;"
        f" give the scenario plugins=({file!r},)"
    )


def _parts(part: Any, field: str = "scenario") -> Iterator[tuple[str, Any]]:
    if isinstance(part, tuple):
        part = dict(enumerate(part))
    if isinstance(part, dict):
        for name, item in part.items():
            yield from _parts(item, f"{field}.{name}")
    elif dataclasses.is_dataclass(part) and not isinstance(part, type):
        yield field, part
        for f in dataclasses.fields(part):
            if f.init:
                name = f"{field}.{f.name}".removeprefix("scenario.")
                yield from _parts(getattr(part, f.name), name)


OF_THE_RUN = ("name", "description", "plugins", "seed", "draw_start")


def changes(scenario: Scenario) -> tuple[str, ...]:
    """The changed fields with their values, as `--set` takes them: `("derotation=none",)`; () for
    one that has no bundled namesake. A block whose kind was changed is one field with its whole
    value. What a preset has filled is told by the preset's name.
    """
    if scenario.name not in bundled_scenarios():
        return ()
    given = scenario.given
    original = load(scenario.name)
    bundled = to_mapping(original) | {"robot": _own(original.robot)}
    mine = {key: value for key, value in to_mapping(given).items() if key not in OF_THE_RUN}
    own = _own(given.robot)
    mine["robot"] = {
        key: own.get(key, value)
        for key, value in mine["robot"].items()
        if key in own or key in bundled["robot"]
    }
    return tuple(f"{path}={flow_text(value)}" for path, value in _different(mine, bundled))


def _own(robot: Robot) -> dict[str, Any]:
    """A robot's fields without what its preset has filled; of a block that it has filled in part
    the rest.
    """
    brief = brief_mapping(robot)
    preset = getattr(robot, "preset_values", {})
    own = brief if isinstance(brief, Mapping) else {}
    kept = {}
    for name, value in to_mapping(robot).items():
        if name not in preset:
            kept[name] = value
        elif name in own:
            kept[name] = own[name]
    return kept


def _different(
    given: Mapping[str, Any], bundled: Mapping[str, Any], prefix: str = ""
) -> Iterator[tuple[str, Any]]:
    for key, value in given.items():
        other = bundled.get(key)
        if (
            isinstance(value, dict)
            and isinstance(other, dict)
            and value.get("kind") == other.get("kind")
        ):
            yield from _different(value, other, f"{prefix}{key}.")
        elif (value != other or key not in bundled) and not _is_copy(value, other):
            yield prefix + key, value


def _is_copy(value: Any, other: Any) -> bool:
    """Whether a value names the copy of the target's file, or of a goal's picture, in a run's
    folder.
    """
    if not (isinstance(value, str) and isinstance(other, str)):
        return False
    path = Path(value)
    copy = kept_at(Path(other), path.parent.name)
    return path.as_posix().endswith(copy) and path.parent.parent.name == "assets"
