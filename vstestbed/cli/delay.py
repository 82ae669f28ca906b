"""The command `gain-limit`: the gain limit of the loop for each delay. Heavy imports are inside the function."""

from __future__ import annotations

import json
import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from vstestbed.cli import complete
from vstestbed.cli.tools import Json, Plugins, Settings, load_scenario, renamed
from vstestbed.core.errors import ParameterError

if TYPE_CHECKING:
    from vstestbed.experiments.delay import Limit

delays = typer.Typer()
LAGGING = 0.95
"""A limit below this share of the theory for the delay alone shows the lag of the servos."""
EXPLAINED = 0.9
"""A limit below this share of the nearest model is told as not explained by it."""


@delays.command("gain-limit")
def gain_limit(
    scenario: Annotated[
        str, typer.Argument(help="A bundled scenario's name, or a YAML file; robot free or puma560.", autocompletion=complete.scenarios)
    ],
    frames: Annotated[
        str, typer.Option(metavar="D1,D2,...", help="Delays, in frames of the camera, beside the scenario's own latency.")
    ] = "0,1,2,3,4,5",
    set_: Settings = None,
    out: Annotated[Path | None, typer.Option(metavar="DIR", help="Folder of the results. [default: runs/gain-limit/NUMBER]")] = None,
    as_json: Json = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No words.")] = False,
    plugin: Plugins = None,
) -> None:
    """The gain at which the loop goes unstable for each delay, by bisection of runs near the goal, over what theory says.

    The oracle detects, so that nothing but dynamics and delay counts. An arm's servos are measured, too. The answer for the latency of the
    scenario (`--set camera.latency_s=0.06`) comes first.
    """
    from vstestbed.core.folders import study_folder
    from vstestbed.experiments.delay import find_limits, write

    chosen, delays = load_scenario(scenario, set_, plugin), _numbers(frames)
    shown = not (quiet or as_json)
    with study_folder("gain-limit", out) as folder:
        limits = find_limits(chosen, delays, lambda one: typer.echo(_summary_line(one), err=True) if shown else None)
        page = write(folder, limits, chosen.name, shlex.join(["vstestbed", *sys.argv[1:]]) if len(sys.argv) > 1 else "")
    if as_json:
        sys.stdout.write(json.dumps([limit.row() for limit in limits], indent=1) + "\n")
    elif not quiet:
        typer.echo(f"  results   {page.parent} (open report.html)", err=True)


def _numbers(text: str) -> list[int]:
    try:
        return sorted({int(part) for part in text.split(",")})  # in order, and no delay twice
    except ValueError:
        raise ParameterError("--frames", "needs whole numbers between commas, such as 0,1,2", text) from None


def _summary_line(limit: Limit) -> str:
    """The limit, how far it is from the theory of the delay alone, and what of that the servos explain, with the figure that shows it."""
    row = limit.row()
    delay = f"{limit.latency_s:g} s ({limit.delay_frames:g} frame{'' if limit.delay_frames == 1 else 's'})"
    if limit.unlimited:
        return f"{delay}: stable up to {limit.gain:.4g} 1/s, the largest gain that was tried"
    line = f"{delay}: unstable from {limit.gain:.4g} 1/s, {row['measured_to_theory']:.3f} of theory for the delay alone"
    with_servos = []
    if limit.g_lag is not None:
        lag = f"{limit.joint} by {1e3 * limit.lag_of_first:.1f} ms"
        with_servos.append(f"{row['measured_to_lag']:.3f} of theory with their lag ({lag})")
    if limit.g_linear is not None:
        with_servos.append(f"{row['measured_to_linear']:.3f} of a linear model of the whole arm")
    if not with_servos:
        return line
    nearest = min((limit.g / g for g in (limit.g_lag, limit.g_linear) if g is not None), key=lambda ratio: abs(1 - ratio))
    left = "; what is left is not explained" if nearest < EXPLAINED else ""
    why = ", since its servos lag" if limit.g < LAGGING * limit.g_theory else ""
    return f"{line}{why}; {', '.join(with_servos)}{left}"


renamed(delays, "delay", "gain-limit", gain_limit)
