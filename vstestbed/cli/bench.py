"""The command `bench`: where the time goes, and what became slower. Heavy imports are inside the functions."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Protocol

import typer

from vstestbed.cli import complete
from vstestbed.cli.tools import Json, Plugins, Settings, load_scenario
from vstestbed.core.errors import ParameterError

if TYPE_CHECKING:
    from vstestbed.experiments.bench.suite import Suite

benchmarks = typer.Typer()


class _Result(Protocol):
    def as_dict(self) -> dict[str, object]: ...
    def as_text(self) -> str: ...


@benchmarks.command()
def bench(
    scenario: Annotated[
        str | None, typer.Argument(help="A bundled scenario's name, or a YAML file. [default: arm_ibvs]", autocompletion=complete.scenarios)
    ] = None,
    set_: Settings = None,
    repeats: Annotated[int, typer.Option(min=1, help="Runs, each beside its floor.")] = 5,
    ideal: Annotated[bool, typer.Option("--ideal", help="The ideal camera on one core instead: one run, and 1000 at once.")] = False,
    every: Annotated[bool, typer.Option("--all", help="Robots, films, folder, report, comparison, ideal loop, start.")] = False,
    earlier: Annotated[
        Path | None, typer.Option("--compare", metavar="OLD.json", help="What became slower since OLD.json, made by --all --json.")
    ] = None,
    as_json: Json = False,
    plugin: Plugins = None,
) -> None:
    """Real-time factor and where the time goes, against the floor: the same physics steps and pictures, nothing else."""
    whole = ideal + every + (earlier is not None)
    if whole > 1 or (whole and (scenario or set_)):
        raise ParameterError("--ideal, --all and --compare", "each measure fixed scenarios: give one of them, without SCENARIO and --set")
    if earlier is not None:
        result: _Result = _changes_since(earlier, repeats, quiet=as_json)
    elif every:
        result = _suite(repeats, (), quiet=as_json)
    elif ideal:
        from vstestbed.experiments.bench.ideal import measure_ideal

        result = measure_ideal(repeats)
    else:
        from vstestbed.experiments.bench.scenario import measure

        result = measure(load_scenario(scenario or "arm_ibvs", set_, plugin), repeats)
    typer.echo(json.dumps(result.as_dict(), indent=1) if as_json else result.as_text())


def _changes_since(earlier: Path, repeats: int, quiet: bool) -> _Result:
    """The benchmarks of an earlier measurement, measured again."""
    from vstestbed.experiments.bench.changes import SpeedChanges, read_saved

    before = read_saved(earlier).timings  # read first: a wrong file should not cost minutes
    return SpeedChanges.between(before, _suite(repeats, tuple(before), quiet).timings)


def _suite(repeats: int, only: tuple[str, ...], quiet: bool) -> Suite:
    from vstestbed.experiments.bench.suite import measure_all

    return measure_all(repeats, only, lambda name: None if quiet else typer.echo(f"{name} ...", err=True))
