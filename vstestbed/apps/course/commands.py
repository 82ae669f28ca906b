"""The command `grade`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from vstestbed.cli.ending import NOT_REACHED
from vstestbed.core.files import make_folder
from vstestbed.core.named_files import bundled_labs


def grade(
    lab: Annotated[
        str,
        typer.Argument(
            metavar="LAB", help="What is asked: lab_1, lab_2 or lab_3 of the course, or a file."
        ),
    ],
    student: Annotated[
        Path, typer.Argument(metavar="STUDENT.py", help="A student's plugin. Its code is run.")
    ],
    first_seed: Annotated[
        int,
        typer.Option(
            min=0,
            envvar="VSTESTBED_FIRST_SEED",
            help="Of the random starts; students need not know it.",
        ),
    ] = 0,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Write mark.json and mark.md there.")
    ] = None,
    least: Annotated[
        float | None,
        typer.Option("--pass", min=0, metavar="POINTS", help="Exit with 3 below so many points."),
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print mark.json and nothing else on standard output.")
    ] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No progress.")] = False,
) -> None:
    """Mark a student's file by a lab's tasks, with the reason for each point that is not given."""
    from vstestbed.apps.course import grading

    place = bundled_labs().get(lab, Path(lab))
    read = grading.read_lab(place)

    def told(title: str) -> None:
        if not (quiet or as_json):
            typer.echo(f"{title} ...", err=True)

    mark = grading.grade(read, student, first_seed, place.parent, told)
    if out is not None:
        make_folder(out)
        mark.write(out)
    typer.echo(json.dumps(mark.plain(), indent=1) if as_json else mark.markdown())
    if mark.missing or (least is not None and mark.points[0] < least):
        raise typer.Exit(NOT_REACHED)
