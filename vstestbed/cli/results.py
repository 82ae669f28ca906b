"""What commands of studies share: the folder of their results, and how they are told."""

from __future__ import annotations

import json
import shlex
import sys
from collections.abc import Callable, Iterator, Sized
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import typer

from vstestbed.cli.ending import INTERRUPTED
from vstestbed.core.files import study_folder

__all__ = ["RESULTS", "command_line", "results_in", "tell"]

RESULTS = "  results   {} (open report.html)"


def tell(as_json: bool, quiet: bool, plain: Callable[[], Any], text: Callable[[], str]) -> None:
    """The results of a study: as JSON on standard output, or in words on standard error."""
    if as_json:
        sys.stdout.write(json.dumps(plain(), indent=1) + "\n")
    elif not quiet:
        typer.echo(text(), err=True)


def command_line() -> str:
    """The command as it was given, for the page of what it made; "" of a call from Python."""
    return shlex.join(["vstestbed", *sys.argv[1:]]) if len(sys.argv) > 1 else ""


@contextmanager
def results_in(
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
