"""The commands `suite` and `submit`: the same tasks for any law.

Heavy imports are inside the functions.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from vstestbed.cli.ending import INTERRUPTED, NOT_REACHED

if TYPE_CHECKING:
    from vstestbed.apps.suite.scores import Score


def suite(
    law: Annotated[
        str | None,
        typer.Argument(
            metavar="[LAW_FILE]",
            help="A law of your own: a plugin with one law, or a YAML file with law and plugins.",
        ),
    ] = None,
    name: Annotated[
        str, typer.Option("--suite", metavar="NAME", help="The suite, by name or file.")
    ] = "VS-1",
    quick: Annotated[
        bool, typer.Option("--quick", help="One or two starts of each of a task's lists.")
    ] = False,
    alone: Annotated[
        bool,
        typer.Option(
            "--alone",
            help=(
                "Fly LAW_FILE alone; the suite's own laws stand beside it"
                " with the runs that are kept."
            ),
        ),
    ] = False,
    word: Annotated[
        str | None,
        typer.Option(
            metavar="WORD", help="Draw the random starts by a word that was not known before."
        ),
    ] = None,
    check: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Fly drawn runs of a submission again: do they agree?"),
    ] = None,
    shard: Annotated[
        str | None,
        typer.Option(metavar="I/N", help="Fly the share I of N of each task, into its own DIR."),
    ] = None,
    merge: Annotated[
        list[Path] | None,
        typer.Option(
            "--merge",
            metavar="DIR",
            help="Put shards together: the folder of one; repeat it for each.",
        ),
    ] = None,
    jobs: Annotated[
        int | None, typer.Option(min=1, help="Worker processes. [default: one a core]")
    ] = None,
    executor: Annotated[
        str,
        typer.Option(metavar="WHERE", help="local, warp (a graphics card), or dask://HOST:PORT."),
    ] = "local",
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Folder of the results; one that is there goes on."),
    ] = None,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No progress, no words.")] = False,
) -> None:
    """Fly the suite's tasks by its laws and yours: successes, times and ranks, each with its
    interval.
    """
    from vstestbed.apps.suite.suite import opened
    from vstestbed.cli.progress import Counter, show_notes
    from vstestbed.core.files import make_folder, new_folder
    from vstestbed.studies.comparison import Shard, must_be_known

    must_be_known(executor)
    if check is not None:
        _check(
            check,
            new_folder(Path("runs") / "suite", out, "give a new one"),
            jobs,
            (name, quick, word),
        )
        return
    entry, share = (
        opened(law, name, quick, word, alone),
        None if shard is None else Shard.read(shard),
    )
    show_notes(not quiet)
    folder = make_folder(
        out
        if out is not None and out.exists()
        else new_folder(Path("runs") / "suite", out, "give a new one")
    )
    entry.mark(folder)
    say = (lambda words: None) if quiet else lambda words: typer.echo(words, err=True)
    if merge:
        runs = entry.merged(merge, folder, say)
    else:
        try:
            shards = share.of if share else 1
            say(entry.effort(shards, jobs))
            with Counter(entry.total // shards, 0, not quiet) as counter:
                runs = entry.fly(folder, jobs, executor, counter.run_done, counter.say, share)
        except KeyboardInterrupt:
            typer.echo(f"interrupted; go on with the same command and --out {folder}", err=True)
            raise typer.Exit(INTERRUPTED) from None
    if share is not None:
        typer.echo(
            (
                f"shard {share} is in {folder};"
                " `vstestbed suite ... --merge DIR --merge DIR` puts all together"
            ),
            err=True,
        )
        return
    found = entry.write(folder, runs)
    if quiet:
        return
    lines = [*_ranking(found)]
    lines += [f"{one} takes no part in {task}: {why}" for (one, task), why in entry.blank.items()]
    typer.echo("\n".join([*lines, f"  results   {folder} (open report.html)"]), err=True)


def _ranking(found: Sequence[Score]) -> Iterator[str]:
    from vstestbed.apps.suite.scores import overall

    for one in overall(found):
        rank = f"mean rank {one.rank.mean:.1f} [{one.rank.low:.1f}, {one.rank.high:.1f}]"
        yield (
            f"{one.law}: {rank} over {one.tasks} tasks,"
            f" place {one.place} of the {one.of} laws that flew them"
        )


def _check(file: Path, folder: Path, jobs: int | None, asked: tuple[str, bool, str | None]) -> None:
    """Say whether a submission agrees with what is flown here; exit 3 where it does not."""
    from vstestbed.apps.suite.submission import Asked, check

    found = check(file, folder, jobs, asked=Asked(*asked))
    agree = found.runs - len(found.otherwise)
    lines = [
        *found.otherwise,
        f"{agree} of {found.runs} runs that were flown again agree",
        *found.flattering,
        *_ranking(found.scores),
    ]
    typer.echo(
        "\n".join(
            [*lines, f"  results   {folder} (open report.html: the runs as they were handed in)"]
        ),
        err=True,
    )
    if found.otherwise or found.flattering:
        raise typer.Exit(NOT_REACHED)


def submit(
    folder: Annotated[
        Path, typer.Argument(metavar="DIR", help="A suite's folder, with a law of your own.")
    ],
    out: Annotated[
        Path | None, typer.Option(metavar="FILE", help="The file. [default: DIR.zip]")
    ] = None,
) -> None:
    """Pack a suite's results with the law, the versions and the machine into one file, which
    `suite --check` flies again in part.
    """
    from vstestbed.apps.suite.submission import pack
    from vstestbed.core.files import must_be_new

    path = out or folder.with_name(f"{folder.resolve().name}.zip")
    must_be_new(path, "give a new file with --out")
    typer.echo(str(pack(folder, path)), err=True)
