"""The command `calibrate`."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from vstestbed.cli import complete
from vstestbed.cli.options import Plugins, Quiet, load_scenario
from vstestbed.cli.progress import ProgressBar, show_notes
from vstestbed.cli.results import command_line
from vstestbed.core.errors import ParameterError
from vstestbed.core.files import study_folder

if TYPE_CHECKING:
    from vstestbed.apps.calibrate.calibration import Board

BOARD = "7x5:0.04:0.03:4X4_50"


def calibrate(
    source: Annotated[
        str,
        typer.Argument(
            metavar="RUN|PICTURES|SCENARIO",
            help="A run's folder; one with poses.csv; with --table a scenario.",
            autocompletion=complete.scenarios,
        ),
    ],
    board: Annotated[
        str,
        typer.Option(
            metavar="CxR:SQUARE:MARKER:DICT",
            help="The ChArUco board: squares, sides [m], dictionary.",
        ),
    ] = BOARD,
    robot: Annotated[
        str | None,
        typer.Option(metavar="SCENARIO", help="PICTURES: whose arm's joints are in poses.csv."),
    ] = None,
    setup: Annotated[
        Literal["hand", "room"],
        typer.Option(help="Where the camera is: on the flange, or in the room."),
    ] = "hand",
    model: Annotated[
        Literal["plumb_bob", "rational_polynomial", "equidistant"] | None,
        typer.Option(help="The lens. [default: plumb_bob]"),
    ] = None,
    intrinsics: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="The lens is known: of a calibration's file."),
    ] = None,
    corner_px: Annotated[
        float, typer.Option(min=1e-3, metavar="PX", help="Standard deviation of a corner.")
    ] = 0.1,
    joint_deg: Annotated[
        float,
        typer.Option(min=1e-6, metavar="DEG", help="Standard deviation of a joint's reading."),
    ] = 0.01,
    table: Annotated[
        bool,
        typer.Option(
            "--table",
            help="How exact it will be, by simulated calibrations of SCENARIO's arm and camera.",
        ),
    ] = False,
    trials: Annotated[
        int,
        typer.Option(min=2, max=10_000, metavar="N", help="--table: calibrations for each line."),
    ] = 50,
    print_board: Annotated[
        Path | None,
        typer.Option("--print", metavar="FILE.png", help="Write the board as a picture, and end."),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="A new folder. [default: runs/calibrate/NUMBER]"),
    ] = None,
    quiet: Quiet = False,
    plugin: Plugins = None,
) -> None:
    """Intrinsics and hand-eye pose of a camera, from pictures of a ChArUco board."""
    from vstestbed.apps.calibrate import calibration as room

    show_notes(not quiet)
    of = room.Board.of(board)
    if print_board is not None:
        room.print_to(of, print_board)
        typer.echo(f"{print_board}: print it {1e3 * of.columns * of.square_m:g} mm wide", err=True)
        return
    if table:
        _table(source, of, trials, out, quiet, plugin)
        return
    truth = None
    place = Path(source)
    if (place / "scenario.yaml").is_file():
        truth, shots = room.shots_of_run(place)
    else:
        scenario = load_scenario(robot, None, plugin, None) if robot else None
        shots = room.shots_of_folder(place, scenario.robot if scenario else None)
    known = room.camera_of(intrinsics) if intrinsics else None
    try:
        made = room.calibrated(
            shots, of, setup == "hand", model, known, corner_px, math.radians(joint_deg)
        )
    except ParameterError as error:
        if error.field != "pictures":
            raise
        raise ParameterError(f"pictures of {place}", error.problem, error.found) from None
    with study_folder("calibrate", out) as folder:
        room.write(folder, made, place.name, truth, command_line())
    if not quiet:
        for line in room.told(made, truth):
            typer.echo(line, err=True)
        typer.echo(f"  results   {folder} (calibration.yaml, report.html)", err=True)


def _table(
    source: str, board: Board, trials: int, out: Path | None, quiet: bool, plugin: list[str] | None
) -> None:
    from vstestbed.apps.calibrate import calibration as room

    scenario = load_scenario(source, None, plugin, None)
    total = trials * sum(map(len, room.OVER.values()))
    with study_folder("calibrate", out) as folder:
        with ProgressBar((), not quiet, "calibrating", total) as bar:
            lines = room.exactness(scenario, board, trials, bar.were_done)
        room.write_table(folder, lines, scenario, command_line())
    if not quiet:
        typer.echo(f"{folder / 'report.html'}", err=True)
