"""Terminal output during a run and after it: progress bars, the outcome in a few lines."""

from __future__ import annotations

import logging
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

import numpy as np

if TYPE_CHECKING:
    from rich.progress import ProgressColumn

    from vstestbed.loop.recording import Recording
    from vstestbed.scenario.scenario import Scenario
    from vstestbed.tasks.frame import Frame

__all__ = ["Counter", "Progress", "ProgressBar", "show_notes", "summary_text"]


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
        from rich.console import Console
        from rich.progress import Progress as Bar

        console = Console(stderr=True)
        self._bar = Bar(
            *columns, console=console, disable=not (shown and console.is_terminal), transient=True
        )
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


class Progress(ProgressBar):
    """Progress bar of a run (a Watcher)."""

    def __init__(self, scenario: Scenario, shown: bool):
        from rich.progress import BarColumn, TimeElapsedColumn

        state = "{task.completed:5.1f} of {task.total:g} s   error {task.fields[error]} px"
        columns = "{task.description}", BarColumn(), state, TimeElapsedColumn()
        super().__init__(columns, shown, scenario.name, scenario.stop.duration_s, error="-")

    def frame(self, frame: Frame) -> None:
        """Advance the bar."""
        error = "lost" if frame.error.lost else f"{frame.error.rms_px:.2f}"
        self._bar.update(self._task, completed=frame.t, error=error)


class Counter(ProgressBar):
    """Progress bar of a comparison: runs done, failures, time left. done: number of runs that were
    done before (`--resume`).
    """

    def __init__(self, total: int, done: int, shown: bool):
        from rich.progress import BarColumn, MofNCompleteColumn, TimeRemainingColumn

        state = "runs   {task.fields[failed]} failed   left"
        columns = (
            "{task.description}",
            BarColumn(),
            MofNCompleteColumn(),
            state,
            TimeRemainingColumn(),
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


def summary_text(recording: Recording, folder: Path, filmed: bool) -> str:
    """The outcome of a run in a few lines."""
    s = recording.summary()
    lines = [f"{s['outcome']}: {s['reason']}"]
    if not s["frames"]:
        lines.append("  error     not a single frame was seen")
    else:
        lines.append(f"  judged    {_judged(s)}")
        # where the truth decided, the pose at the end is that of no goal
        if s["judged_by"] != "truth":
            lines.append(f"  error     {_error_text(recording)}")
            since, ratio = (
                s["time_to_converge_s"],
                ""
                if s["path_ratio"] is None
                else f"; {s['path_ratio']:.2f} times the straight line",
            )
            reached = "goal not reached" if since is None else f"at the goal from {since:.1f} s on"
            lines.append(
                f"  path      {reached}{ratio};"
                f" largest retreat {_number(s, 'max_retreat_m', digits=_digits(s))}"
            )
    speed = _number(s, "real_time_factor", " real time", digits=1) + (
        " with films and log" if filmed else " with its log"
    )
    lines.append(
        f"  time      {_number(s, 'sim_time_s')} simulated in {_number(s, 'wall_time_s')}: {speed}"
    )
    lines.append(f"  results   {folder} (open report.html)")
    return "\n".join(lines)


def _judged(summary: Mapping[str, Any]) -> str:
    from vstestbed.tasks.judged import MEASURED_BY, in_words_unit

    limit, unit = in_words_unit(summary["judged_limit"], summary["judged_unit"])
    error = summary["judged_error"]
    value = (
        "unknown at the end"
        if error is None
        else f"{in_words_unit(error, summary['judged_unit'])[0]:.4f} {unit}"
    )
    return f"by {MEASURED_BY[summary['judged_by']]}: {value}, limit {limit:.3g} {unit}"


def _error_text(recording: Recording) -> str:
    s = recording.summary()
    error = (
        _number(s, "final_error_px", " in the image", digits=3)
        if s["final_error_px"] is not None
        else _why_no_error(recording)
    )
    if "error_grey" in recording.columns and np.isfinite(recording["error_grey"][-1]):
        error = f"{recording['error_grey'][-1]:.3f} grey levels in the picture"
    pose = (
        f"{_number(s, 'final_position_error_m', digits=_digits(s))} and"
        f" {_number(s, 'final_rotation_error_deg', digits=3)} from the goal"
    )
    free = recording.scenario.free_motions
    if free:
        pose += f", where {free} motion{'s are' if free > 1 else ' is'} free (law.redundant)"
    return (
        f"{error}; true pose of the"
        f" {'vehicle' if recording.scenario.robot.base == 'planar' else 'camera'}: {pose}"
    )


def _why_no_error(recording: Recording) -> str:
    if recording.outcome.name == "law_failed":
        return "not known, since the law failed"
    seen = [name for name in recording.columns if name.startswith("u_") and name[2:].isdecimal()]
    if recording.scenario.detector.rows == 0 or any(
        np.isfinite(recording[name][-1]) for name in seen
    ):
        return "not known, since the law could not work with what was in sight"
    return "target not in sight"


def _digits(summary: Mapping[str, Any]) -> int:
    """Decimals with which lengths of a run are told: two; of a camera whose way was under 10 cm
    more, at most six.
    """
    way = summary["path_length_m"] or 1.0
    return min(6, max(2, 1 - math.floor(math.log10(way))))


def _number(summary: Mapping[str, Any], name: str, more: str = "", digits: int = 2) -> str:
    """A number of the summary in the unit in which metrics are shown, with more words behind it."""
    from vstestbed.tasks.metrics import KNOWN

    value, unit = summary[name], {"×": "times"}.get(KNOWN[name].unit, KNOWN[name].unit) + more
    return (
        f"{value * KNOWN[name].scale:.{digits}f} {unit}"
        if isinstance(value, float)
        else f"no {unit}"
    )
