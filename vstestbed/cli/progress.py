"""Terminal output while a command works: progress bars, and notes."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

if TYPE_CHECKING:
    from rich.progress import ProgressColumn

__all__ = ["Counter", "ProgressBar", "show_notes"]


class ProgressBar:
    """A progress bar on standard error, one task; hidden if that is no terminal, or `shown` is
    False.
    """

    def __init__(
        self,
        columns: Sequence[str | ProgressColumn],
        shown: bool,
        what: str,
        total: float,
        **fields: Any,
    ):
        from rich import console, progress

        terminal = console.Console(stderr=True)
        hidden = not (shown and terminal.is_terminal)
        self._bar = progress.Progress(*columns, console=terminal, disable=hidden, transient=True)
        self._task = self._bar.add_task(what, total=total, **fields)

    def say(self, words: str) -> None:
        """Show what is being done."""
        self._bar.update(self._task, description=words)

    def were_done(self, runs: int = 1) -> None:
        """Advance the bar."""
        self._bar.update(self._task, advance=runs)

    def __enter__(self) -> Self:
        self._bar.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._bar.stop()


class Counter(ProgressBar):
    """Progress bar of a comparison: runs done, failures, time left. done: number of runs that were
    done before (`--resume`).
    """

    def __init__(self, total: int, done: int, shown: bool):
        from rich import progress

        columns = (
            "{task.description}",
            progress.BarColumn(),
            progress.MofNCompleteColumn(),
            "runs   {task.fields[failed]} failed   left",
            progress.TimeRemainingColumn(),
        )
        super().__init__(columns, shown, "comparing", total, completed=done, failed=0)
        self._failed = 0

    def run_done(self, job: object, summary: dict[str, Any]) -> None:
        """Advance the bar by one run."""
        self._failed += not summary["success"]  # a bool counts as 0 or 1
        self._bar.update(self._task, advance=1, failed=self._failed)


def show_notes(shown: bool) -> None:
    """Print the library's warnings (such as ray casting in place of OpenGL) on standard error, or
    suppress them.
    """
    logger = logging.getLogger("vstestbed")
    logger.setLevel(logging.WARNING if shown else logging.ERROR)
    if logging.lastResort is not None:
        # prints the bare message, without level and logger name
        logger.addHandler(logging.lastResort)
        logger.propagate = False
