"""The commands `basin`, `sweep` and `gain-limit`. Heavy imports are inside the functions."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from vstestbed.cli import complete
from vstestbed.cli.options import (
    Experiments,
    Force,
    Json,
    Plugins,
    Settings,
    SettingsOfAll,
    load_scenario,
    settings_of,
    vary_of,
)
from vstestbed.cli.results import RESULTS, command_line, results_in, tell
from vstestbed.core.errors import ParameterError

if TYPE_CHECKING:
    from vstestbed.apps.maps.basin import Axis, Basin
    from vstestbed.apps.maps.convergence import Ended, RunEnding
    from vstestbed.apps.maps.delay import Limit
    from vstestbed.studies.comparison import Job


def basin(
    scenarios: Experiments,
    x: Annotated[
        str,
        typer.Option(
            "--x",
            metavar="NAME=LOW:HIGH",
            help="First coordinate: x y z [m], roll pitch yaw [deg].",
        ),
    ],
    y: Annotated[
        str,
        typer.Option(
            "--y",
            metavar="NAME=LOW:HIGH",
            help="Second coordinate; both in the frame of the goal camera.",
        ),
    ],
    at: Annotated[
        list[str] | None,
        typer.Option(
            "--at", metavar="NAME=VALUE", help="Another coordinate. [default: the start's]"
        ),
    ] = None,
    n: Annotated[
        int,
        typer.Option(
            "--n", min=2, max=2000, help="Places along each axis; 316 make 100 000 starts."
        ),
    ] = 316,
    vary: Annotated[
        list[str] | None,
        typer.Option("--vary", metavar="a.b=v1,v2", help="A map for each of these values."),
    ] = None,
    set_: SettingsOfAll = None,
    field_of_view: Annotated[
        Literal["limited", "unlimited"] | None,
        typer.Option(
            help="Whether the picture has a border. [default: as the oracle's, or limited]"
        ),
    ] = None,
    jobs: Annotated[
        int | None,
        typer.Option(
            min=1, help="Workers, for a law without equations of a batch. [default: one a core]"
        ),
    ] = None,
    check: Annotated[
        int,
        typer.Option(
            min=0,
            help="So many random starts, and 4 frontal ones, also fly in the time loop of `run`.",
        ),
    ] = 0,
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Folder of the results. [default: runs/basin/NUMBER]"),
    ] = None,
    force: Force = False,
    as_json: Json = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No words.")] = False,
    plugin: Plugins = None,
) -> None:
    """From where each law reaches its goal, and why not from elsewhere: a map of ideal runs over
    two coordinates of the start.
    """
    from vstestbed.apps.maps.basin import basin as map_of
    from vstestbed.apps.maps.basin import laws, write
    from vstestbed.cli.progress import show_notes
    from vstestbed.studies.batch import must_be_few_starts
    from vstestbed.studies.comparison import chosen

    # mistakes on the command line are reported before the scenarios are loaded
    across, up, rest = _axis("--x", x, n), _axis("--y", y, n), dict[str, float]()
    for text in at or []:
        name, _, value = text.partition("=")
        try:
            number = float(value)
        except ValueError:
            raise ParameterError.form("--at", "NAME=VALUE, such as z=-1", text) from None
        if name.strip() in rest:
            raise ParameterError.twice("--at", name.strip())
        rest[name.strip()] = number
    comparison = chosen(scenarios, settings_of(set_), vary_of(vary), plugin or [])
    must_be_few_starts(comparison, n, force)
    show_notes(not quiet)
    found = laws(comparison, field_of_view, force)
    mapped: list[Basin] = []
    with results_in(
        "basin",
        out,
        mapped,
        len(found),
        "maps",
        lambda folder: write(folder, mapped, command_line()),
    ) as folder:
        for label, scenario in found:
            mapped.append(
                map_of(label, scenario, across, up, rest, check, jobs=jobs, folder=folder)
            )
            if mapped[-1].interrupted:
                raise KeyboardInterrupt
            if not (quiet or as_json):
                typer.echo(_summary_text(mapped[-1]), err=True)
    tell(as_json, quiet, lambda: [b.summary() for b in mapped], lambda: RESULTS.format(folder))


def _axis(option: str, text: str, n: int) -> Axis:
    from vstestbed.apps.maps.basin import Axis

    name, _, ends = text.partition("=")
    low, _, high = ends.partition(":")
    try:
        return Axis(name.strip(), float(low), float(high), n)
    # the same problem under the name of the option
    except ParameterError as error:
        raise ParameterError(
            option,
            f"{error.field} {error.problem}" if error.field != "axis" else error.problem,
            error.found,
        ) from None
    except ValueError:
        raise ParameterError.form(option, "NAME=LOW:HIGH, such as yaw=-180:180", text) from None


def _summary_text(mapped: Basin) -> str:
    summary = mapped.summary()
    shares = ", ".join(
        f"{ending.replace('_', ' ')} {100 * share:.1f} %"
        for ending, share in summary["shares"].items()
    )
    lines = [
        f"{mapped.label}: {shares};"
        f" {summary['starts']} starts in {mapped.processor_s:.1f} s of one core"
    ]
    if mapped.checked:
        lines.append(f"  the time loop agrees on {summary['agreeing']} of {mapped.checked}")
    lines += [f"    not at {d.words(mapped.x.name, mapped.y.name)}" for d in mapped.disagreements]
    return "\n".join(lines)


def sweep(
    scenarios: Experiments,
    vary: Annotated[
        list[str] | None,
        typer.Option("--vary", metavar="a.b=v1,v2", help="A map's axis: first x, then y."),
    ] = None,
    set_: SettingsOfAll = None,
    seeds: Annotated[
        int | None, typer.Option(min=1, help="How many random starts in each cell.")
    ] = None,
    jobs: Annotated[
        int | None, typer.Option(min=1, help="Worker processes. [default: one a core]")
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Folder of the results. [default: runs/sweep/NUMBER]"),
    ] = None,
    force: Force = False,
    as_json: Json = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No words.")] = False,
    plugin: Plugins = None,
) -> None:
    """How many seeds reach the goal over two varied fields, one map a law; runs leave no folders of
    their own.
    """
    from vstestbed.apps.maps.convergence import Study, summaries, write
    from vstestbed.studies.comparison import chosen

    study = Study(
        chosen(scenarios, settings_of(set_), vary_of(vary), plugin or [], seeds=seeds), force
    )
    found: dict[int, tuple[Job, RunEnding]] = {}

    def ended() -> Ended:
        return [found[place] for place in sorted(found)]

    def done(place: int, job: Job, ending: RunEnding) -> None:
        found[place] = job, ending
        # a line every 100 runs: a run takes some 50 ms
        if not (quiet or as_json) and (len(found) == total or len(found) % 100 == 0):
            typer.echo(f"{len(found)} of {total} runs", err=True)

    total = len(study.runs)
    with results_in(
        "sweep",
        out,
        found,
        total,
        "runs",
        lambda folder: write(folder, study, ended(), command_line()),
    ) as folder:
        study.run_all(folder, jobs, done)
    if as_json:
        sys.stdout.write(study.table(ended()).write_json() + "\n")
    elif not quiet:
        for one in summaries(study.maps(ended())):
            typer.echo(
                f"{one['label']}: {100 * float(str(one['converged'])):.1f} % of all runs converged",
                err=True,
            )
        typer.echo(RESULTS.format(folder), err=True)


def gain_limit(
    scenario: Annotated[
        str,
        typer.Argument(
            help=(
                "A free camera or an arm, with a law of one gain: ibvs, pbvs, hybrid, predictive,"
                " or your own ErrorLaw."
            ),
            autocompletion=complete.scenarios,
        ),
    ],
    frames: Annotated[
        str,
        typer.Option(
            metavar="D1,D2,...",
            help="Delays, in frames of the camera, beside the scenario's own latency.",
        ),
    ] = "0,1,2,3,4,5",
    set_: Settings = None,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR", help="Folder of the results. [default: runs/gain-limit/NUMBER]"
        ),
    ] = None,
    as_json: Json = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No words.")] = False,
    plugin: Plugins = None,
) -> None:
    """The gain at which the loop goes unstable for each delay, by bisection of runs near the goal,
    over what theory says. The oracle detects, without noise, so that nothing but dynamics and delay
    counts. An arm's servos are measured, too. The answer for the latency of the scenario
    (`--set camera.latency_s=0.06`) comes first.
    """
    from vstestbed.apps.maps.delay import delays_of, find_limits, write

    chosen = load_scenario(scenario, set_, plugin)
    try:
        delays = sorted({int(part) for part in frames.split(",")})  # in order, and no delay twice
    except ValueError:
        raise ParameterError.form("--frames", "N,N,..., such as 0,1,2", frames) from None
    limits: list[Limit] = []
    total = len(delays_of(chosen, delays))

    def done(one: Limit) -> None:
        limits.append(one)
        if not (quiet or as_json):
            typer.echo(_summary_line(one), err=True)

    with results_in(
        "gain-limit",
        out,
        limits,
        total,
        "delays",
        lambda folder: write(folder, limits, chosen.name, command_line()),
    ) as folder:
        find_limits(chosen, delays, done)
    tell(as_json, quiet, lambda: [limit.row() for limit in limits], lambda: RESULTS.format(folder))


def _summary_line(limit: Limit) -> str:
    """The limit, how far it is from the theory of the delay alone, and what of that the servos
    explain, with the figure that shows it.
    """
    row = limit.row()
    delay = (
        f"{limit.latency_s:g} s"
        f" ({limit.delay_frames:g} frame{'' if limit.delay_frames == 1 else 's'})"
    )
    if limit.unlimited:
        return f"{delay}: stable up to {limit.gain:.4g} 1/s, the largest gain that was tried"
    line = (
        f"{delay}: unstable from {limit.gain:.4g} 1/s, {row['measured_to_theory']:.3f} of theory"
        " for the delay alone"
    )
    with_servos = []
    if first := limit.first:
        lag = f"{first.joint} by {1e3 * first.lag_s:.1f} ms"
        with_servos.append(f"{row['measured_to_lag']:.3f} of theory with their lag ({lag})")
    if limit.g_linear is not None:
        with_servos.append(f"{row['measured_to_linear']:.3f} of a linear model of the whole arm")
    if not with_servos:
        return line
    nearest = min(
        (limit.g / g for g in (limit.g_lag, limit.g_linear) if g is not None),
        key=lambda ratio: abs(1 - ratio),
    )
    left = "; what is left is not explained" if nearest < 0.9 else ""
    why = ", since its servos lag" if limit.g < 0.95 * limit.g_theory else ""
    return f"{line}{why}; {', '.join(with_servos)}{left}"
