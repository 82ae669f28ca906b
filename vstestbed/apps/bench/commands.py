"""The command `bench`."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from vstestbed.cli import complete
from vstestbed.cli.ending import INTERRUPTED
from vstestbed.cli.options import Json, Plugins, Settings, load_scenario
from vstestbed.core.errors import ParameterError


def bench(
    scenario: Annotated[
        str | None,
        typer.Argument(
            help="A bundled scenario's name, or a YAML file. [default: arm_ibvs]",
            autocompletion=complete.scenarios,
        ),
    ] = None,
    set_: Settings = None,
    repeats: Annotated[int, typer.Option(min=1, help="Runs, each beside its floor.")] = 5,
    ideal: Annotated[
        bool,
        typer.Option(
            "--ideal", help="The ideal camera on one core instead: one run, and 1000 at once."
        ),
    ] = False,
    every: Annotated[
        bool,
        typer.Option("--all", help="Robots, films, folder, report, comparison, ideal loop, start."),
    ] = False,
    earlier: Annotated[
        Path | None,
        typer.Option(
            "--compare",
            metavar="OLD.json",
            help="What became slower since OLD.json, made by --all --json.",
        ),
    ] = None,
    as_json: Json = False,
    plugin: Plugins = None,
) -> None:
    """Real-time factor and where the time goes, against the floor: the same physics steps and
    pictures, nothing else.
    """
    whole = ideal + every + (earlier is not None)
    if whole > 1 or (whole and (scenario or set_)):
        raise ParameterError(
            "--ideal, --all and --compare",
            "each measure fixed scenarios: give one of them, without SCENARIO and --set",
        )
    from vstestbed.apps.bench import bench as room

    def say(words: str) -> None:
        if not as_json:
            typer.echo(f"{words} ...", err=True)

    left: list[str] = []
    if earlier is not None:
        before = room.read_saved(earlier).timings  # first: a wrong file should not cost minutes
        suite, left = room.measured(repeats, tuple(before), say)
        changes = room.speed_changes(before, suite.timings)
        plain = {name: asdict(change) for name, change in changes.items()}
        text = room.changes_text(changes)
    elif every:
        suite, left = room.measured(repeats, (), say)
        plain, text = asdict(suite), suite.as_text()
    elif ideal:
        found = room.measure_ideal(repeats)
        plain, text = asdict(found), found.as_text()
    else:
        one = room.measure(load_scenario(scenario or "arm_ibvs", set_, plugin), repeats)
        plain, text = asdict(one), one.as_text()
    typer.echo(json.dumps(plain, indent=1) if as_json else text)
    if left:
        typer.echo(f"interrupted: {', '.join(left)} not measured", err=True)
        raise typer.Exit(INTERRUPTED)
