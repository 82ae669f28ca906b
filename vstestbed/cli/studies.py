"""The commands of studies: `basin`, `sweep`, `gain-limit`, `tune`, `bench`. Heavy imports are
inside the functions.
"""

from __future__ import annotations

import json
import shlex
import sys
from collections.abc import Callable, Iterator, Sized
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from vstestbed.cli import complete
from vstestbed.cli.ending import INTERRUPTED, NOT_REACHED
from vstestbed.cli.tools import (
    Experiments,
    Force,
    Json,
    Plugins,
    Settings,
    SettingsOfAll,
    load_scenario,
    settings_of,
)
from vstestbed.core.errors import ParameterError

if TYPE_CHECKING:
    from vstestbed.studies.basin import Axis, Basin
    from vstestbed.studies.bench import BesideFloor, Suite
    from vstestbed.studies.comparison import Job
    from vstestbed.studies.convergence import Ended, RunEnding
    from vstestbed.studies.delay import Limit


RESULTS = "  results   {} (open report.html)"


def _tell(as_json: bool, quiet: bool, plain: Callable[[], Any], text: Callable[[], str]) -> None:
    """The results of a study: as JSON on standard output, or in words on standard error."""
    if as_json:
        sys.stdout.write(json.dumps(plain(), indent=1) + "\n")
    elif not quiet:
        typer.echo(text(), err=True)


def command_line() -> str:
    """The command as it was given, for the page of what it made; "" of a call from Python."""
    return shlex.join(["vstestbed", *sys.argv[1:]]) if len(sys.argv) > 1 else ""


@contextmanager
def _results_in(
    kind: str,
    out: Path | None,
    found: Sized,
    total: int,
    things: str,
    write: Callable[[Path], object],
) -> Iterator[Path]:
    """The folder of a study, into which `write` puts its results when it ends, also those of an
    interrupted one. kind: the command. found: the results so far. total: how many there are to be.
    things: what they are of.
    """
    from vstestbed.studies.folder import study_folder

    with study_folder(kind, out) as folder:
        try:
            yield folder
        except KeyboardInterrupt:
            where = f"; results in {folder} (open report.html)" if found else ""
            typer.echo(f"interrupted: {len(found)} of {total} {things} are done{where}", err=True)
            raise typer.Exit(INTERRUPTED) from None
        finally:
            if len(found):
                write(folder)


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
    from vstestbed.cli.compare import vary_of
    from vstestbed.cli.progress import show_notes
    from vstestbed.studies.basin import basin as map_of
    from vstestbed.studies.basin import laws, write
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
    with _results_in(
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
    _tell(as_json, quiet, lambda: [b.summary() for b in mapped], lambda: RESULTS.format(folder))


def _axis(option: str, text: str, n: int) -> Axis:
    from vstestbed.studies.basin import Axis

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
    from vstestbed.cli.compare import vary_of
    from vstestbed.studies.comparison import chosen
    from vstestbed.studies.convergence import Study, summaries, write

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
    with _results_in(
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
    from vstestbed.studies.delay import delays_of, find_limits, write

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

    with _results_in(
        "gain-limit",
        out,
        limits,
        total,
        "delays",
        lambda folder: write(folder, limits, chosen.name, command_line()),
    ) as folder:
        find_limits(chosen, delays, done)
    _tell(as_json, quiet, lambda: [limit.row() for limit in limits], lambda: RESULTS.format(folder))


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


RANGES = (
    "A range LOW:HIGH or LOW:HIGH:log, or values to choose from; may be repeated."
    " [default: all gains, of a comparison]"
)


def tune(
    scenario: Annotated[
        str | None,
        typer.Argument(
            help=(
                "A scenario, or a comparison, each law of which is tuned before: a name or a file."
            ),
            autocompletion=complete.experiments,
        ),
    ] = None,
    vary: Annotated[
        list[str] | None,
        typer.Option("--vary", metavar="a.b=LOW:HIGH", help=RANGES, autocompletion=complete.paths),
    ] = None,
    metric: Annotated[
        str,
        typer.Option(
            metavar="NAME",
            help="Number of summary.json; less is better.",
            autocompletion=complete.figures,
        ),
    ] = "time_to_converge_s",
    maximise: Annotated[
        bool,
        typer.Option(
            "--maximise", help="More of the metric is better. [default: as is known of it]"
        ),
    ] = False,
    trials: Annotated[
        int | None, typer.Option(min=1, max=1000, help="How many settings are tried. [default: 30]")
    ] = None,
    seeds: Annotated[
        int | None, typer.Option(min=1, max=1000, help="Random starts of each trial. [default: 10]")
    ] = None,
    batch: Annotated[
        int,
        typer.Option(min=1, max=1000, help="Trials that are chosen together; more use more cores."),
    ] = 4,
    check: Annotated[
        int, typer.Option(min=0, max=1000, help="Fresh starts on which the best is checked.")
    ] = 20,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the search.")] = 0,
    set_: Settings = None,
    jobs: Annotated[
        int | None, typer.Option(min=1, help="Worker processes. [default: one a core]")
    ] = None,
    executor: Annotated[
        str,
        typer.Option(metavar="WHERE", help="local, warp (a graphics card), or dask://HOST:PORT."),
    ] = "local",
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Folder of the results. [default: runs/tune/NUMBER]"),
    ] = None,
    resume: Annotated[
        bool,
        typer.Option("--resume", help="Go on with the search in --out DIR; --trials may be more."),
    ] = False,
    as_json: Json = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No progress, no words.")] = False,
    plugin: Plugins = None,
) -> None:
    """The settings with which a scenario does best: a search over ranges and choices, each trial
    from the same random starts.
    """
    from vstestbed.cli.compare import vary_of
    from vstestbed.cli.progress import Counter, show_notes
    from vstestbed.studies.comparison import must_be_known
    from vstestbed.studies.tuned import names_comparison
    from vstestbed.studies.tuning import begun, finished, planned

    must_be_known(executor)
    plan, settings = None, settings_of(set_)
    numbers = {"trials": trials or 30, "seeds": seeds, "batch": batch, "check": check, "seed": seed}
    if names_comparison(scenario) and not resume:
        numbers |= {"metric": metric, "maximise": maximise or None}
        _tune_comparison(
            str(scenario),
            vary_of(vary),
            out,
            settings,
            plugin or [],
            jobs,
            executor,
            quiet,
            numbers,
        )
        return
    if not resume:
        plan = planned(
            scenario,
            vary_of(vary),
            settings,
            plugin or [],
            metric=metric,
            maximise=maximise or None,
            **numbers,
        )
    elif any((scenario, vary, settings)):
        raise ParameterError(
            "--resume",
            "goes on with what the folder searches; leave the rest out, but for --trials",
        )
    with begun(plan, out, trials, plugin or []) as search:
        show_notes(not quiet)
        search.jobs, search.executor = jobs, executor
        try:
            with Counter(search.total, 0, not quiet and not as_json) as counter:
                search.listener = counter
                result = finished(search)
        except KeyboardInterrupt:
            words = (
                f"interrupted: {len(search.trials)} of {search.plan.trials} trials"
                " are done; go on with: "
            )
            typer.echo(
                f"{words}vstestbed tune --resume --out {shlex.quote(str(search.folder))}", err=True
            )
            raise typer.Exit(INTERRUPTED) from None
    lines = [result.headline, *(f"  {words}" for words in result.sentences())]
    lines += [f"  take it   {result.command}"] if result.best else []
    _tell(as_json, quiet, result.plain, lambda: "\n".join([*lines, RESULTS.format(result.folder)]))
    if result.best is None:
        raise typer.Exit(NOT_REACHED)


def _tune_comparison(
    name: str,
    vary: dict[str, tuple[object, ...]],
    out: Path | None,
    settings: dict[str, object],
    plugins: list[str],
    jobs: int | None,
    executor: str,
    quiet: bool,
    numbers: dict[str, Any],
) -> None:
    """Tune each law of a comparison, then compare them."""
    from vstestbed.report.comparison.tables import statistics_text
    from vstestbed.studies.folder import study_folder
    from vstestbed.studies.tuned import tune_comparison

    def say(words: str) -> None:
        if not quiet:
            typer.echo(words, err=True)

    with study_folder("tune", out) as folder:
        table, laws = tune_comparison(
            name, vary, folder, settings, plugins, jobs, executor, say=say, **numbers
        )
    for law in laws:
        say(f"  {law.words()}")
    say("\n".join(filter(None, (statistics_text(table.folder), RESULTS.format(table.folder)))))


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
    from vstestbed.core.files import make_folder
    from vstestbed.core.named_files import bundled_labs
    from vstestbed.testing.grading import grade as mark_of
    from vstestbed.testing.grading import read_lab

    place = bundled_labs().get(lab, Path(lab))
    read = read_lab(place)

    def told(title: str) -> None:
        if not (quiet or as_json):
            typer.echo(f"{title} ...", err=True)

    mark = mark_of(read, student, first_seed, place.parent, told)
    if out is not None:
        make_folder(out)
        mark.write(out)
    typer.echo(json.dumps(mark.plain(), indent=1) if as_json else mark.markdown())
    if mark.missing or (least is not None and mark.points[0] < least):
        raise typer.Exit(NOT_REACHED)


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
        from vstestbed.studies.bench import changes_text, read_saved, speed_changes

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
        from vstestbed.studies.bench import measure_ideal

        found = measure_ideal(repeats)
        plain, text = asdict(found), found.as_text()
    else:
        from vstestbed.studies.bench import measure

        one = measure(load_scenario(scenario or "arm_ibvs", set_, plugin), repeats)
        plain, text = asdict(one), one.as_text()
    typer.echo(json.dumps(plain, indent=1) if as_json else text)
    if left:
        typer.echo(f"interrupted: {', '.join(left)} not measured", err=True)
        raise typer.Exit(INTERRUPTED)


def _suite(repeats: int, only: tuple[str, ...], quiet: bool) -> tuple[Suite, list[str]]:
    """What was measured, and the names of the benchmarks that an interrupt has left out."""
    from vstestbed.studies.bench import Suite, benchmarks, measure_one

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
