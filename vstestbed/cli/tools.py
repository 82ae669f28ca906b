"""The commands `list`, `schema`, `describe`, `doctor`, `optical-flow` and `new`. What they do is
imported when they are carried out: `--help` must answer within 0.4 s.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Literal, get_args

import typer

from vstestbed.cli import complete
from vstestbed.cli.options import Plugins

Listed = Literal[
    "scenarios",
    "robots",
    "effects",
    "cameras",
    "targets",
    "features",
    "laws",
    "detectors",
    "keypoints",
    "markers",
    "motions",
    "goals",
    "metrics",
    "monitors",
    "perturbations",
    "comparisons",
]


def list_(
    registry: Annotated[
        Listed | None, typer.Argument(help="What to list. [default: everything]")
    ] = None,
    plugin: Plugins = None,
) -> None:
    """What there is, one line each."""
    from vstestbed.cli import listing

    listing.show([registry] if registry else get_args(Listed), plugin or [])


def schema(
    comparison: Annotated[
        bool, typer.Option("--comparison", help="Of a comparison's file, in place of a scenario's.")
    ] = False,
    plugin: Plugins = None,
) -> None:
    """JSON Schema of a scenario's file for editors: every field with its unit, default and an
    example.
    """
    from vstestbed.scenario import catalogue, plugins, scenario

    plugins.load_plugins(plugin or [])
    block = scenario.Scenario
    if comparison:
        from vstestbed.studies import comparison as study

        block = study.Comparison
    typer.echo(json.dumps(catalogue.schema_of(block), indent=1, ensure_ascii=False))


def describe(
    kind: Annotated[
        str,
        typer.Argument(
            metavar="KIND",
            help=(
                "Such as pbvs, camera.spherical, noise, camera.readout_s; law: all laws; log,"
                " log.cmd_vx, summary, table: the results."
            ),
            autocompletion=complete.kinds,
        ),
    ],
    plugin: Plugins = None,
) -> None:
    """What a law, a robot, a camera or another block takes: its equation, source, fields and an
    example; or what a field is.
    """
    from vstestbed.cli.describe import described

    # rich has left colours out where none are wanted
    typer.echo(described(kind, plugin or []), color=True)


def doctor(
    model: Annotated[
        str | None,
        typer.Argument(metavar="[FILE.xml]", help="An arm's MJCF or URDF: what of it can be used."),
    ] = None,
) -> None:
    """Versions, OpenGL, codecs, cores: what works here, and the command that mends what does not;
    or what works of an arm's file.
    """
    from vstestbed.cli.doctor import examined

    raise typer.Exit(examined(model))


def optical_flow(
    feature: Annotated[
        str, typer.Option(metavar="NAME", help="point, polar or spherical.")
    ] = "point",
    depth: Annotated[
        float, typer.Option(metavar="METRES", help="Depth (spherical: distance) of every point.")
    ] = 1.0,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="A .png, .svg or .pdf. [default: runs/optical_flow/NAME.png]"
        ),
    ] = None,
) -> None:
    """Draw the optical flow of the six camera motions, in a feature's own coordinates."""
    from vstestbed.report.optical_flow import write_flow

    for path in write_flow(feature, depth, out):
        typer.echo(str(path))


NewKind = Literal[
    "law",
    "feature",
    "robot",
    "detector",
    "keypoints",
    "lens",
    "target",
    "motion",
    "metric",
    "noise",
    "effect",
    "monitor",
    "task",
]


def new(
    kind: Annotated[NewKind, typer.Argument(help="What to write.")],
    name: Annotated[str, typer.Argument(help="Its word in a scenario, such as my_law.")],
    out: Annotated[
        Path | None, typer.Option(metavar="FILE.py", help="The file. [default: NAME.py]")
    ] = None,
) -> None:
    """Write a commented file for a kind of one's own, with its test; it runs as it is."""
    from vstestbed.cli.new import write_new

    write_new(kind, name, out)
