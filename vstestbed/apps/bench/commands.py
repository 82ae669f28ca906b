"""The command `bench`. Heavy imports are inside the functions."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from vstestbed.cli import complete
from vstestbed.cli.ending import INTERRUPTED
from vstestbed.cli.options import (
    Json,
    Plugins,
    Settings,
    load_scenario,
)
from vstestbed.core.errors import ParameterError

if TYPE_CHECKING:
    from vstestbed.apps.bench.bench import BesideFloor, Suite


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
    left: list[str] = []
    if earlier is not None:
        from vstestbed.apps.bench.bench import changes_text, read_saved, speed_changes

        before = read_saved(earlier).timings  # read first: a wrong file should not cost minutes
        suite, left = _suite(repeats, tuple(before), quiet=as_json)
        changes = speed_changes(before, suite.timings)
        plain, text = (
            {name: asdict(change) for name, change in changes.items()},
            changes_text(changes),
        )
    elif every:
        suite, left = _suite(repeats, (), quiet=as_json)
        plain, text = asdict(suite), suite.as_text()
    elif ideal:
        from vstestbed.apps.bench.bench import measure_ideal

        found = measure_ideal(repeats)
        plain, text = asdict(found), found.as_text()
    else:
        from vstestbed.apps.bench.bench import measure

        one = measure(load_scenario(scenario or "arm_ibvs", set_, plugin), repeats)
        plain, text = asdict(one), one.as_text()
    typer.echo(json.dumps(plain, indent=1) if as_json else text)
    if left:
        typer.echo(f"interrupted: {', '.join(left)} not measured", err=True)
        raise typer.Exit(INTERRUPTED)


def _suite(repeats: int, only: tuple[str, ...], quiet: bool) -> tuple[Suite, list[str]]:
    """What was measured, and the names of the benchmarks that an interrupt has left out."""
    from vstestbed.apps.bench.bench import Suite, benchmarks, measure_one

    chosen = {name: one for name, one in benchmarks().items() if not only or name in only}
    timings: dict[str, BesideFloor] = {}
    try:
        for name, (floor, pair) in chosen.items():
            if not quiet:
                typer.echo(f"{name} ...", err=True)
            timings[name] = measure_one(floor, pair, repeats)
    except KeyboardInterrupt:
        if not timings:
            raise
    return Suite.of(timings), [name for name in chosen if name not in timings]
