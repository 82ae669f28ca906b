"""The commands `list`, `schema`, `describe`, `doctor`, `optical-flow` and `new`.

Heavy imports are inside the functions: `--help` must answer within 0.4 s.
"""

from __future__ import annotations

import importlib.util
import json
import keyword
import re
from pathlib import Path
from typing import Annotated, Literal, get_args

import typer

from vstestbed.cli import complete
from vstestbed.cli.options import Plugins
from vstestbed.core.errors import EnvironmentLackError, OutputError, ParameterError

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
    from vstestbed.scenario.plugins import load_plugins

    load_plugins(plugin or [])
    if registry is not None:
        _list_one(registry, "")
        return
    for name in get_args(Listed):
        typer.echo(f"{name}:")
        _list_one(name, "  ")


def _list_one(name: str, indent: str) -> None:
    """The words of a registry, or of bundled files, a line each."""
    entries = _entries(name)
    if not entries:
        words = "none; those of the package are blocks of robots (vstestbed describe puma560)"
        typer.echo(f"{indent}{words}")
        return
    width = max(map(len, entries))
    for word, text in entries.items():
        typer.echo(f"{indent}{word:{width}}  {text}")


def _entries(name: str) -> dict[str, str]:
    """The words of a registry, or of bundled files, and what they are."""
    from vstestbed.core.fields import class_text
    from vstestbed.core.named_files import bundled_comparisons, bundled_scenarios
    from vstestbed.scenario.plugins import registry
    from vstestbed.scenario.yaml_marks import bundled_mapping

    bundled = {"scenarios": bundled_scenarios, "comparisons": bundled_comparisons}.get(name)
    if bundled is None:
        return {word: class_text(cls).summary for word, cls in registry(name).members.items()}
    # as they are written: an arm's file may be in a package that is not installed
    return {word: str(bundled_mapping(path)["description"]) for word, path in bundled().items()}


def schema(
    comparison: Annotated[
        bool, typer.Option("--comparison", help="Of a comparison's file, in place of a scenario's.")
    ] = False,
    plugin: Plugins = None,
) -> None:
    """JSON Schema of a scenario's file for editors: every field with its unit, default and an
    example.
    """
    from vstestbed.scenario.catalogue import schema_of
    from vstestbed.scenario.plugins import load_plugins

    load_plugins(plugin or [])
    if comparison:
        from vstestbed.studies.comparison.plan import Comparison as Block
    else:
        from vstestbed.scenario.scenario import Scenario as Block
    typer.echo(json.dumps(schema_of(Block), indent=1, ensure_ascii=False))


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
    from rich.console import Console

    from vstestbed.cli.describe import describe_entry, describe_field, describe_record
    from vstestbed.scenario.catalogue import Entry, catalogue, looked_up
    from vstestbed.scenario.plugins import load_plugins
    from vstestbed.scenario.scenario import Scenario

    load_plugins(plugin or [])
    entries = catalogue(scenario=Scenario)
    of_results = kind in ("log", "summary", "table") or kind.startswith("log.")
    try:
        found = None if of_results else looked_up(kind, entries)
    except ParameterError:
        # here: most words are of a scenario, and it takes 0.3 s to import
        from vstestbed.studies.comparison.plan import Comparison

        entries = catalogue(scenario=Scenario, comparison=Comparison)
        found = looked_up(kind, entries)
    console = Console(highlight=False)
    with console.capture() as text:
        if found is None:
            describe_record(kind, console)
        elif isinstance(found, Entry):
            describe_entry(found, entries, console)
        else:
            describe_field(found, entries, console)
    # rich has left colours out where none are wanted
    typer.echo("\n".join(line.rstrip() for line in text.get().splitlines()), color=True)


def doctor(
    model: Annotated[
        str | None,
        typer.Argument(metavar="[FILE.xml]", help="An arm's MJCF or URDF: what of it can be used."),
    ] = None,
) -> None:
    """Versions, OpenGL, codecs, cores: what works here, and the command that mends what does not;
    or what works of an arm's file.
    """
    from vstestbed.cli.doctor import Finding, examine, show
    from vstestbed.core.named_files import absolute_file

    if model is None:
        sound = show(examine())
    else:
        from vstestbed.sim.scene.model_report import examine_model

        sound = show(Finding(*line) for line in examine_model(absolute_file(model, Path.cwd())))
    raise typer.Exit(
        0
        if sound
        else EnvironmentLackError.exit_code
        if model is None
        else ParameterError.exit_code
    )


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
REGISTRY_OF = {
    "keypoints": "keypoints",
    "lens": "cameras",
    "noise": "perturbations",
    "task": "goals",
}
"""The registry (`scenario.plugins.HOMES`) of a kind, where it is not the plural of its word."""


def new(
    kind: Annotated[NewKind, typer.Argument(help="What to write.")],
    name: Annotated[str, typer.Argument(help="Its word in a scenario, such as my_law.")],
    out: Annotated[
        Path | None, typer.Option(metavar="FILE.py", help="The file. [default: NAME.py]")
    ] = None,
) -> None:
    """Write a commented file for a kind of one's own, with its test; it runs as it is."""
    path = out or Path(f"{name}.py")
    if not re.fullmatch(r"[a-z][a-z0-9_]*", name) or keyword.iskeyword(name):
        raise ParameterError.form(
            "NAME", f"of a word in small letters, digits and _, such as my_{kind}", name
        )
    # after the cheap check: it imports much of the package
    from vstestbed.scenario.plugins import registry

    if name in registry(REGISTRY_OF.get(kind, f"{kind}s")).members:
        raise ParameterError(
            "NAME", f"is bundled already ({kind}); take another, such as my_{name}", name
        )
    _must_be_free(path, "NAME" if out is None else "--out")
    text = text_of(kind, name, str(path))
    from vstestbed.core.files import make_parents, write_whole

    write_whole(make_parents(path), text)
    typer.echo(f"{path} runs as it is. Next:")
    for command in commands_of(text):
        typer.echo(f"  {command}")
    if importlib.util.find_spec("pytest") is None:
        typer.echo("pytest is not installed here; pip install pytest", err=True)


def _must_be_free(path: Path, said: str) -> None:
    """Refuse a file that is no module, is there already, or has the name of another module. said:
    where the name was given.
    """
    stem = path.stem
    if path.suffix != ".py" or not stem.isidentifier() or keyword.iskeyword(stem):
        works = f"{re.sub(r'[^0-9A-Za-z_]', '_', stem) or 'my'}_.py"
        raise ParameterError("--out", f"must be a Python file, such as {works}", str(path))
    if path.exists() or path.is_symlink():
        raise OutputError(
            path, "is there already, and is not written over", "give another name, or --out FILE.py"
        )
    if (taken := importlib.util.find_spec(stem)) is not None:
        other = f"{stem}_2" if stem.startswith("my_") else f"my_{stem}"
        words = (
            f"is the name of a module that Python finds already ({taken.origin}),"
            f" and pytest would import that in its place; take another, such as {other}"
        )
        raise ParameterError(said, words, stem)


def text_of(kind: str, name: str, path: str) -> str:
    """The file of a kind's template under another name: the word, the class, and the file in its
    commands.
    """
    camel, quoted = (
        "".join(part.capitalize() for part in name.split("_")),
        f'"{path}"' if " " in path else path,
    )
    text = (
        (Path(__file__).parent / "templates" / f"{kind}.py")
        .read_text(encoding="utf-8")
        .replace(f"my_{kind}.py", quoted)
    )
    return text.replace(f"my_{kind}", name).replace(f"My{kind.capitalize()}", camel)


def commands_of(text: str) -> list[str]:
    """The commands in the docstring of a template: its lines that are indented."""
    return [line.strip() for line in text.split('"""')[1].splitlines() if line.startswith("    ")]
