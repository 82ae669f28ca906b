"""The command `basin`: outcome of each start over two of its coordinates. Heavy imports are inside the function."""

from __future__ import annotations

import json
import shlex
import sys
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from vstestbed.cli.tools import Experiments, Force, Json, Plugins, SettingsOfAll, settings_of
from vstestbed.core.errors import ParameterError

if TYPE_CHECKING:
    from vstestbed.experiments.basin.maps import Axis, Basin

basins = typer.Typer()


class FieldOfView(str, Enum):
    """Field of view of the camera of a map."""

    limited = "limited"
    unlimited = "unlimited"


@basins.command()
def basin(
    scenarios: Experiments,
    x: Annotated[str, typer.Option("--x", metavar="NAME=LOW:HIGH", help="First coordinate: x y z [m], roll pitch yaw [deg].")],
    y: Annotated[str, typer.Option("--y", metavar="NAME=LOW:HIGH", help="Second coordinate; both in the frame of the goal camera.")],
    at: Annotated[list[str] | None, typer.Option("--at", metavar="NAME=VALUE", help="Another coordinate. [default: the start's]")] = None,
    n: Annotated[int, typer.Option("--n", min=2, max=2000, help="Places along each axis; 316 make 100 000 starts.")] = 316,
    vary: Annotated[list[str] | None, typer.Option("--vary", metavar="a.b=v1,v2", help="A map for each of these values.")] = None,
    set_: SettingsOfAll = None,
    field_of_view: Annotated[
        FieldOfView | None, typer.Option(help="Whether the picture has a border. [default: as the oracle's, or limited]")
    ] = None,
    check: Annotated[int, typer.Option(min=0, help="So many random starts, and 4 frontal ones, also fly in the time loop of `run`.")] = 0,
    out: Annotated[Path | None, typer.Option(metavar="DIR", help="Folder of the results. [default: runs/basin/NUMBER]")] = None,
    force: Force = False,
    as_json: Json = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No words.")] = False,
    plugin: Plugins = None,
) -> None:
    """From where each law reaches its goal, and why not from elsewhere: a map of ideal runs over two coordinates of the start."""
    from vstestbed.cli.compare import vary_of
    from vstestbed.cli.progress import show_notes
    from vstestbed.core.folders import study_folder
    from vstestbed.experiments.basin.maps import basins_of, laws, write
    from vstestbed.experiments.basin.setup import must_be_few_starts
    from vstestbed.experiments.comparison import chosen

    # mistakes on the command line are reported before the scenarios are loaded
    across, up, rest = _axis("--x", x, n), _axis("--y", y, n), _coordinates("--at", at or [])
    comparison = chosen(scenarios, settings_of(set_), vary_of(vary), None, plugin or [])
    must_be_few_starts(comparison, n, force)
    show_notes(not quiet)
    found = laws(comparison, None if field_of_view is None else field_of_view.value, force)
    shown = not (quiet or as_json)
    with study_folder("basin", out) as folder:
        mapped = basins_of(found, across, up, rest, check, lambda one: typer.echo(_summary_text(one), err=True) if shown else None)
        page = write(folder, mapped, shlex.join(["vstestbed", *sys.argv[1:]]) if len(sys.argv) > 1 else "")
    if as_json:
        sys.stdout.write(json.dumps([b.summary() for b in mapped], indent=1) + "\n")
    elif not quiet:
        typer.echo(f"  results   {page.parent} (open report.html)", err=True)


def _axis(option: str, text: str, n: int) -> Axis:
    from vstestbed.experiments.basin.maps import Axis

    name, _, ends = text.partition("=")
    low, _, high = ends.partition(":")
    try:
        return Axis(name.strip(), float(low), float(high), n)
    # the same problem under the name of the option
    except ParameterError as error:
        raise ParameterError(option, f"{error.field} {error.problem}" if error.field != "axis" else error.problem, error.found) from None
    except ValueError:
        raise ParameterError(option, "needs the form NAME=LOW:HIGH, such as yaw=-180:180", text) from None


def _coordinate(option: str, text: str) -> tuple[str, float]:
    name, _, value = text.partition("=")
    try:
        return name.strip(), float(value)
    except ValueError:
        raise ParameterError(option, "needs the form NAME=VALUE, such as z=-1", text) from None


def _coordinates(option: str, texts: list[str]) -> dict[str, float]:
    found: dict[str, float] = {}
    for name, value in (_coordinate(option, text) for text in texts):
        if name in found:
            raise ParameterError(option, "must give each coordinate once", name)
        found[name] = value
    return found


def _summary_text(mapped: Basin) -> str:
    summary = mapped.summary()
    shares = ", ".join(f"{ending.replace('_', ' ')} {100 * share:.1f} %" for ending, share in summary["shares"].items())
    lines = [f"{mapped.label}: {shares}; {summary['starts']} starts in {mapped.processor_s:.1f} s of one core"]
    if mapped.checked:
        lines.append(f"  the time loop agrees on {summary['agreeing']} of {mapped.checked}")
    lines += [f"    not at {d.words(mapped.x.name, mapped.y.name)}" for d in mapped.disagreements]
    return "\n".join(lines)
