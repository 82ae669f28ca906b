"""The commands `list`, `schema`, `doctor` and `optical-flow`, and the options that several commands share.

Heavy imports are inside the functions: `--help` must answer within 0.4 s.
"""

from __future__ import annotations

import functools
import json
from collections.abc import Callable
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from vstestbed.cli import complete
from vstestbed.core.errors import EnvironmentLackError, ParameterError

if TYPE_CHECKING:
    from vstestbed.scenario.scenario import Scenario

tools = typer.Typer()


class Listed(str, Enum):
    """Argument of `list`."""

    scenarios = "scenarios"
    robots = "robots"
    cameras = "cameras"
    targets = "targets"
    features = "features"
    laws = "laws"
    detectors = "detectors"
    keypoints = "keypoints"
    markers = "markers"
    motions = "motions"
    goals = "goals"
    metrics = "metrics"
    monitors = "monitors"
    perturbations = "perturbations"
    comparisons = "comparisons"


Plugins = Annotated[list[str] | None, typer.Option("--plugin", metavar="FILE.py|MODULE", help="Load a plugin, which adds kinds.")]
_SET = {"metavar": "a.b=value", "autocompletion": complete.paths}
Settings = Annotated[list[str] | None, typer.Option("--set", help="Change a field before it is checked.", **_SET)]
SettingsOfAll = Annotated[list[str] | None, typer.Option("--set", help="Change a field of all scenarios.", **_SET)]
ScenarioName = Annotated[str, typer.Argument(help="A bundled scenario's name, or a YAML file.", autocompletion=complete.scenarios)]
Experiments = Annotated[
    list[str],
    typer.Argument(metavar="SCENARIO...", help="Scenarios, or one comparison: names or files.", autocompletion=complete.experiments),
]
Json = Annotated[bool, typer.Option("--json", help="Print summary.json and nothing else on standard output.")]

Force = Annotated[bool, typer.Option("--force", help="Also more than 100 000 runs (basin: 4 000 000 starts).")]


def load_scenario(name: str, settings: list[str] | None, plugins: list[str] | None, seed: int | None = None) -> Scenario:
    """Load the scenario of a command line, with `--set`, `--seed` and `--plugin` applied."""
    from vstestbed.scenario.load import load
    from vstestbed.scenario.yaml_marks import from_option

    overrides = settings_of(settings)
    return load(name, overrides, seed, from_option(overrides), plugins or [])


def settings_of(settings: list[str] | None) -> dict[str, object]:
    """The values of `--set` by dotted path, each read as YAML."""
    from vstestbed.scenario.yaml_marks import read_value

    overrides: dict[str, object] = {}
    for setting in settings or []:
        key, equals, value = setting.partition("=")
        # an empty value is allowed: YAML reads it as null
        if not equals or not all(part.strip() for part in key.split(".")):
            raise ParameterError("--set", "needs the form a.b=value", setting)
        overrides[key.strip()] = read_value(value)
    return overrides


def renamed(app: typer.Typer, old: str, new: str, command: Callable[..., None]) -> None:
    """Keep the old word of a command, hidden, with a warning that names the new one."""

    @functools.wraps(command)
    def warn(*given: Any, **named: Any) -> None:
        typer.echo(f"vstestbed {old} is now called {new}; the old word works for one more version", err=True)
        command(*given, **named)

    app.command(old, hidden=True)(warn)


@tools.command("list")
def list_(
    room: Annotated[Listed | None, typer.Argument(help="What to list. [default: everything]")] = None, plugin: Plugins = None
) -> None:
    """What there is, one line each."""
    from vstestbed.scenario.plugins import load_plugins

    load_plugins(plugin or [])
    for name in [room] if room else Listed:
        if room is None:
            typer.echo(f"{name.value}:")
        entries = _entries(name)
        width = max((len(entry) for entry, _ in entries), default=0)
        for entry, text in entries:
            typer.echo(f"{'' if room else '  '}{entry:{width}}  {text}")


def _entries(room: Listed) -> list[tuple[str, str]]:
    """Names of the scenarios or kinds in a room, each with its description: for kinds the first line of the class's docstring."""
    from vstestbed.core.assets import bundled_comparisons, bundled_scenarios
    from vstestbed.scenario.load import text_of
    from vstestbed.scenario.validation import KINDS
    from vstestbed.scenario.yaml_marks import plain_mapping

    if room is Listed.scenarios:  # as they are written: an arm's file may be in a package that is not installed
        return [(name, str(plain_mapping(text_of(path), str(path), "")[0]["description"])) for name, path in bundled_scenarios().items()]
    if room is Listed.comparisons:
        from vstestbed.experiments.comparison.plan import read_comparison  # here: a list of kinds need not wait for it

        return [(name, read_comparison(path).description) for name, path in bundled_comparisons().items()]
    return [(kind, (cls.__doc__ or "").strip().split("\n")[0]) for kind, cls in KINDS[room.value].members.items()]


@tools.command()
def schema(
    comparison: Annotated[bool, typer.Option("--comparison", help="Of a comparison's file, in place of a scenario's.")] = False,
    plugin: Plugins = None,
) -> None:
    """JSON Schema of a scenario's file for editors: every field with its unit, default and an example."""
    from vstestbed.scenario.described import schema_of
    from vstestbed.scenario.plugins import load_plugins

    load_plugins(plugin or [])
    if comparison:
        from vstestbed.experiments.comparison.plan import Comparison as Block
    else:
        from vstestbed.scenario.scenario import Scenario as Block
    typer.echo(json.dumps(schema_of(Block), indent=1, ensure_ascii=False))


@tools.command()
def describe(
    kind: Annotated[
        str,
        typer.Argument(
            metavar="KIND", help="Such as pbvs, camera.spherical, noise, camera.readout_s; law: all laws.", autocompletion=complete.kinds
        ),
    ],
    plugin: Plugins = None,
) -> None:
    """What a law, a robot, a camera or another block takes: its equation, source, fields and an example; or what a field is."""
    from rich.console import Console

    from vstestbed.cli.describe import describe_entry, describe_field
    from vstestbed.experiments.comparison.plan import Comparison
    from vstestbed.scenario.catalogue import Entry, catalogue
    from vstestbed.scenario.field_paths import looked_up
    from vstestbed.scenario.plugins import load_plugins
    from vstestbed.scenario.scenario import Scenario

    load_plugins(plugin or [])
    entries = catalogue(scenario=Scenario, comparison=Comparison)
    console, found = Console(highlight=False), looked_up(kind, entries)
    with console.capture() as text:
        if isinstance(found, Entry):
            describe_entry(found, entries, console)
        else:
            describe_field(found, entries, console)
    typer.echo("\n".join(line.rstrip() for line in text.get().splitlines()), color=True)  # rich has left colours out where none are wanted


@tools.command()
def doctor(
    model: Annotated[str | None, typer.Argument(metavar="[FILE.xml]", help="An arm's MJCF or URDF: what of it can be used.")] = None,
) -> None:
    """Versions, OpenGL, codecs, cores: what works here, and the command that mends what does not; or what works of an arm's file."""
    from vstestbed.cli.doctor import examine, examine_file, show

    sound = show(examine() if model is None else examine_file(model))
    raise typer.Exit(0 if sound else EnvironmentLackError.exit_code if model is None else ParameterError.exit_code)


@tools.command("optical-flow")
def optical_flow(
    feature: Annotated[str, typer.Option(metavar="NAME", help="point, polar or spherical.")] = "point",
    depth: Annotated[float, typer.Option(metavar="METRES", help="Depth (spherical: distance) of every point.")] = 1.0,
    out: Annotated[Path | None, typer.Option(metavar="FILE", help="A .png, .svg or .pdf. [default: flow_NAME.png]")] = None,
) -> None:
    """Draw the optical flow of the six camera motions, in a feature's own coordinates."""
    from vstestbed.core.files import make_parents
    from vstestbed.report.studies.flow import write_flow

    for path in write_flow(feature, depth, None if out is None else make_parents(out)):
        typer.echo(str(path))


renamed(tools, "flow", "optical-flow", optical_flow)
