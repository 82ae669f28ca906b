"""The commands `excite` and `identify`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from vstestbed.cli.options import Plugins, Quiet, ScenarioName, Settings, load_scenario
from vstestbed.cli.progress import show_notes
from vstestbed.cli.results import command_line
from vstestbed.core import apps
from vstestbed.core.errors import ParameterError
from vstestbed.core.files import study_folder

METADATA = "metadata.yaml"  # what a bag's folder holds


def excite(
    scenario: ScenarioName,
    set_: Settings = None,
    seed: Annotated[
        int | None, typer.Option(min=0, help="Draw the start and the noise from this seed.")
    ] = None,
    fly: Annotated[
        bool,
        typer.Option(
            "--fly", help="Let the simulated robot do it, and keep what is read: record.parquet."
        ),
    ] = False,
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="--fly: a new folder. [default: runs/excite/NUMBER]"),
    ] = None,
    quiet: Quiet = False,
    plugin: Plugins = None,
) -> None:
    """A motion by which a robot shows its latencies and time constants: steps and sines, as a table
    of commands.
    """
    from vstestbed.apps.identify import identification as room

    given = load_scenario(scenario, set_, plugin, seed)
    motion = room.motion_of(given)
    if not fly:
        typer.echo(motion.write_csv(), nl=False)
        return
    with study_folder("excite", out) as folder:
        record = room.fly(given.resolved, motion)
        path = room.keep(folder, given, motion, record)
    if not quiet:
        typer.echo(f"{len(record)} of {len(motion)} commands were flown\n{path}", err=True)


def identify(
    record: Annotated[
        Path,
        typer.Argument(
            metavar="RECORD|BAG", help="Of `excite --fly`; a table with its columns; or a rosbag2."
        ),
    ],
    scenario: ScenarioName,
    set_: Settings = None,
    fit: Annotated[
        list[str] | None,
        typer.Option(
            metavar="FIELD=LOW..HIGH",
            help="What to find; xLOW..xHIGH is a factor. [default: by the robot]",
        ),
    ] = None,
    remap: Annotated[
        list[str] | None, typer.Option(metavar="TOPIC=OTHER", help="BAG: another name of a topic.")
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="A new folder. [default: runs/identify/NUMBER]"),
    ] = None,
    quiet: Quiet = False,
    plugin: Plugins = None,
) -> None:
    """Latencies, time constants, wheel radii and noise of a robot, from a record of its motion, as
    a preset for `robot.realism`.
    """
    from vstestbed.apps.identify import identification as room

    given = load_scenario(scenario, set_, plugin, None)
    show_notes(not quiet)
    ending = METADATA if (record / METADATA).is_file() else record.suffix
    of_app = apps.loaded("records", ending)
    table = of_app(record, given, remap or []) if of_app else room.read_record(record)
    say = (
        (lambda words: None) if quiet else (lambda words: typer.echo(f"  tries {words}", err=True))
    )
    parameters = [room.Parameter.of(words) for words in fit or []]
    try:
        found = room.identify(table, given, parameters, say)
    except ParameterError as error:
        if error.field != "record":
            raise
        raise ParameterError(str(record), error.problem, error.found) from None
    with study_folder("identify", out) as folder:
        room.write(folder, found, record.name, command_line())
    for line in room.lines_of(found):
        typer.echo(f"{line[0]:40s} {line[1]:>12s}   {line[2]}")
    if not quiet:
        typer.echo(
            (
                f"{room.tested(found)}\n"
                f"{room.INTERVAL}\n"
                f"  results   {folder} (robot.yaml, report.html)"
            ),
            err=True,
        )
