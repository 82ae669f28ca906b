"""Options and arguments that several commands share, and how they are read.

Heavy imports are inside the functions.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from vstestbed.cli import complete
from vstestbed.core.errors import ParameterError, RunFolderError

if TYPE_CHECKING:
    from vstestbed.scenario.scenario import Scenario

__all__ = [
    "Experiments",
    "Force",
    "Json",
    "Plugins",
    "Quiet",
    "ScenarioName",
    "Settings",
    "SettingsOfAll",
    "load_scenario",
    "must_hold",
    "settings_of",
    "vary_of",
]


Plugins = Annotated[
    list[str] | None,
    typer.Option("--plugin", metavar="FILE.py|MODULE", help="Load a plugin, which adds kinds."),
]


_SET = {"metavar": "a.b=value", "autocompletion": complete.paths}


Settings = Annotated[
    list[str] | None, typer.Option("--set", help="Change a field before it is checked.", **_SET)
]


SettingsOfAll = Annotated[
    list[str] | None, typer.Option("--set", help="Change a field of all scenarios.", **_SET)
]


ScenarioName = Annotated[
    str,
    typer.Argument(
        help="A bundled scenario's name, or a YAML file.", autocompletion=complete.scenarios
    ),
]


Experiments = Annotated[
    list[str],
    typer.Argument(
        metavar="SCENARIO...",
        help="Scenarios, or one comparison: names or files.",
        autocompletion=complete.experiments,
    ),
]


Json = Annotated[
    bool, typer.Option("--json", help="Print summary.json and nothing else on standard output.")
]


Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="No progress, no words.")]


Force = Annotated[
    bool, typer.Option("--force", help="Also more than 100 000 runs (basin: 4 000 000 starts).")
]


def load_scenario(
    name: str, settings: list[str] | None, plugins: list[str] | None, seed: int | None = None
) -> Scenario:
    """Load the scenario of a command line, with `--set`, `--seed` and `--plugin` applied."""
    from vstestbed.scenario import load, yaml_marks

    overrides = settings_of(settings)
    return load.load(name, overrides, seed, yaml_marks.from_option(overrides), plugins or [])


def must_hold(folder: Path, *names: str) -> None:
    """Refuse a folder that has none of these files. Raises RunFolderError."""
    try:
        if any((folder / name).is_file() for name in names):
            return
        if folder.is_dir():
            found = "no run here"
        elif folder.exists():
            found = "is a file, and no run's folder"
        else:
            found = "no such folder"
    except OSError as error:
        found = f"cannot be read ({error.strerror})"
    raise RunFolderError(folder, found)


def _is_path(dotted: str) -> bool:
    """Whether no part of a dotted path is empty."""
    return all(part.strip() for part in dotted.split("."))


def settings_of(settings: list[str] | None) -> dict[str, object]:
    """The values of `--set` by dotted path, each read as YAML."""
    from vstestbed.scenario.yaml_marks import read_value

    overrides: dict[str, object] = {}
    for setting in settings or []:
        key, equals, value = setting.partition("=")
        # an empty value is allowed: YAML reads it as null
        if not (equals and _is_path(key)):
            raise ParameterError.form("--set", "a.b=value", setting)
        overrides[key.strip()] = read_value(value)
    return overrides


def vary_of(options: list[str] | None) -> dict[str, tuple[object, ...]]:
    """The lists of values of `--vary` by dotted path: `1,2`, `[0, 1], [1, 0]`,
    `{kind: oracle}, blobs`.
    """
    from vstestbed.scenario.yaml_marks import read_value

    texts: dict[str, str] = {}
    for option in options or []:
        path, equals, text = option.partition("=")
        if not (equals and text.strip() and _is_path(path)):
            raise ParameterError.form("--vary", "a.b=v1,v2", option)
        if path.strip() in texts:
            raise ParameterError.twice("--vary", "a field", options)
        texts[path.strip()] = text
    # in brackets it is a YAML list, whose reader knows which commas are inside nested brackets
    values = {path: read_value(f"[{text}]") for path, text in texts.items()}
    return {
        path: tuple(found) if isinstance(found, list) else (found,)
        for path, found in values.items()
    }
