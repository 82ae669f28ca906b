"""Scenarios as YAML: short, as people write them, or with every default; and the two documents of a
run's folder.
"""

from __future__ import annotations

import dataclasses
import importlib.metadata
import io
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
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

WIDTH, ON_ONE_LINE = 120, 110  # columns of a line, and of a block that stands on one line


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
    given, resolved = (
        scenario.given.made_of or _brief(scenario.given),
        to_mapping(scenario.resolved),
    )
    return {
        GIVEN: as_yaml(_renamed(given, copies), brief=True),
        RESOLVED: as_yaml(_renamed(resolved, copies)),
    }


def _renamed(value: Any, names: Mapping[str, str], without: Sequence[str] = ()) -> Any:
    """Plain values with texts in place of others, and without some fields."""
    if isinstance(value, dict):
        return {
            key: _renamed(inner, names, without)
            for key, inner in value.items()
            if key not in without
        }
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
    parts = {"target": scenario.target} | {
        f"goal_{i}": said for i, said in enumerate(scenario.goal.pictures)
    }
    sources = [(what, part, part.source) for what, part in parts.items()]
    kept = [
        (getattr(part, "file", None), source, kept_at(source, what))
        for what, part, source in sources
        if source
    ]
    given: Any = scenario.given.made_of or {}
    blocks = [(f"{name}_", given.get(name)) for name in ("robot", "camera", "calibration")] + [
        ("", given)
    ]
    for name, further in (given.get("cameras") or {}).items():
        blocks += [
            (f"{name}_", further),
            (f"{name}_camera_", further.get("camera")),
            (f"{name}_calibration_", further.get("calibration")),
        ]
    for what, block in blocks:
        named = {name: block.get(name) for name in CALIBRATED} if isinstance(block, Mapping) else {}
        files = {
            what + name: file
            for name, file in named.items()
            if isinstance(file, str) and is_there(Path(file))
        }
        kept += [(file, Path(file), kept_at(Path(file), name)) for name, file in files.items()]
    return kept


FORMER = ("filled", "drawn_about", "drawn_offsets", "drawn_errors", "drawn_seed")
"""Fields of a run's folder of before, whose one file was both what was given and what was drawn:
the seed draws them again.
"""


def load_run(folder: Path, plugins: Sequence[str] = ()) -> Scenario:
    """The scenario of a run's folder as it ran; its `given` is what was given. Folders of before
    have one file that is both.
    """
    path, record = folder / GIVEN, folder / RESOLVED
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
    libyaml: Any = getattr(yaml, "CSafeDumper", yaml.SafeDumper)

    class Dumper(libyaml):
        """PyYAML writes YAML 1.1, where `1e3` is text; it is read as YAML 1.2, where it is a
        number.
        """

        def represent_data(self, data: Any) -> Any:
            node = super().represent_data(data)
            if brief and not isinstance(node.value, str):
                node.flow_style = _width(node) <= ON_ONE_LINE  # the whole scenario never
            return node

    def plain_or_quoted(dumper: Any, text: str) -> Any:
        return dumper.represent_scalar(
            "tag:yaml.org,2002:str", text, "'" if text[:1] in "+-.0123456789" else None
        )

    Dumper.add_representer(str, plain_or_quoted)
    # nested blocks on lines of their own, the innermost mappings and lists on one line
    out = io.StringIO()
    yaml.dump(
        plain,
        out,
        Dumper=Dumper,
        default_flow_style=None,
        width=WIDTH,
        sort_keys=False,
        allow_unicode=True,
    )
    return out.getvalue()


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
    libyaml, out = getattr(yaml, "CSafeDumper", yaml.SafeDumper), io.StringIO()
    yaml.dump(value, out, Dumper=libyaml, sort_keys=False, allow_unicode=True, **style)
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
        if type(part).__module__.partition(".")[0] != "vstestbed"
    }
    if not foreign:
        return
    offered: Any = importlib.metadata.entry_points()
    installed = [
        entry.module for name in HOMES for entry in offered.select(group=f"vstestbed.{name}")
    ]
    packages = {
        name.partition(".")[0]
        for name in (*installed, *(p for p in scenario.plugins if not is_file_name(p)))
    }
    loaded = [
        module_of(Path(absolute(name, Path.cwd())))
        for name in scenario.plugins
        if is_file_name(name)
    ]
    for cls, field in foreign.items():
        home = sys.modules.get(cls.__module__)
        in_file = any(
            m is home or any(value is cls or value is home for value in vars(m).values())
            for m in loaded
            if m is not None
        )
        if in_file or cls.__module__.partition(".")[0] in packages:
            continue
        file = getattr(home, "__file__", None)
        if file is None or cls.__module__ == "__main__":
            words = (
                f"is {cls.__name__}, which is defined in the program that runs"
                " (a script, a notebook), where no scenario file finds it"
            )
            remedy = (
                "put the class into a file mine.py, import it from there,"
                " and give the scenario plugins=('mine.py',)"
            )
            raise ParameterError(field, f"{words}; {remedy}")
        file = str(Path(file).resolve())
        words = (
            f"is {cls.__name__} of {file}, which the file would not name;"
            f" give the scenario plugins=({file!r},)"
        )
        raise ParameterError(field, words)


def _parts(part: Any, field: str = "scenario") -> Iterator[tuple[str, Any]]:
    if isinstance(part, tuple | dict):
        for name, item in part.items() if isinstance(part, dict) else enumerate(part):
            yield from _parts(item, f"{field}.{name}")
    elif dataclasses.is_dataclass(part) and not isinstance(part, type):
        yield field, part
        for f in dataclasses.fields(part):
            if f.init:
                yield from _parts(
                    getattr(part, f.name), f.name if field == "scenario" else f"{field}.{f.name}"
                )


OF_THE_RUN = ("name", "description", "plugins", "seed", "draw_start")


def changes(scenario: Scenario) -> tuple[str, ...]:
    """The changed fields with their values, as `--set` takes them: `("derotation=none",)`; () for
    one that has no bundled namesake. A block whose kind was changed is one field with its whole
    value. What a preset has filled is told by the preset's name.
    """
    if scenario.name not in bundled_scenarios():
        return ()
    given, original = scenario.given, load(scenario.name)
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
    brief, preset = brief_mapping(robot), getattr(robot, "preset_values", {})
    own = brief if isinstance(brief, Mapping) else {}
    kept = {
        name: value
        for name, value in to_mapping(robot).items()
        if name in own or name not in preset
    }
    return kept | {name: own[name] for name in kept.keys() & preset.keys()}


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
    return (
        path.as_posix().endswith(kept_at(Path(other), path.parent.name))
        and path.parent.parent.name == "assets"
    )
