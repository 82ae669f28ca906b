"""The commands `suite` and `submit`: the same tasks for any law."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from vstestbed.cli.ending import INTERRUPTED, NOT_REACHED
from vstestbed.cli.options import Quiet
from vstestbed.cli.progress import Counter, show_notes
from vstestbed.core import files


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
    quiet: Quiet = False,
) -> None:
    """Fly the suite's tasks by its laws and yours: successes, times and ranks, each with its
    interval.
    """
    from vstestbed.apps.suite import scores, suite
    from vstestbed.studies import comparison

    comparison.must_be_known(executor)
    parent = Path("runs") / "suite"
    if check is not None:
        _check(check, files.new_folder(parent, out), jobs, (name, quick, word))
        return
    entry = suite.opened(law, name, quick, word, alone)
    share = None if shard is None else comparison.Shard.read(shard)
    show_notes(not quiet)
    if out is not None and out.exists():
        folder = files.make_folder(out)
    else:
        folder = files.new_folder(parent, out)
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
    lines = [*scores.ranking(found)]
    lines += [f"{one} takes no part in {task}: {why}" for (one, task), why in entry.blank.items()]
    typer.echo("\n".join([*lines, f"  results   {folder} (open report.html)"]), err=True)


def _check(file: Path, folder: Path, jobs: int | None, asked: tuple[str, bool, str | None]) -> None:
    """Say whether a submission agrees with what is flown here; exit 3 where it does not."""
    from vstestbed.apps.suite import scores, submission

    found = submission.check(file, folder, jobs, asked=submission.Asked(*asked))
    agree = found.runs - len(found.otherwise)
    lines = [
        *found.otherwise,
        f"{agree} of {found.runs} runs that were flown again agree",
        *found.flattering,
        *scores.ranking(found.scores),
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

    path = out or folder.with_name(f"{folder.resolve().name}.zip")
    files.must_be_new(path, "give a new file with --out")
    typer.echo(str(pack(folder, path)), err=True)
