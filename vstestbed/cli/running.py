"""What `run` does: one run with its bar, its folder, and its outcome in a few lines."""

from __future__ import annotations

import math
import signal
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import typer
from rich.progress import BarColumn, TimeElapsedColumn

from vstestbed.cli.ending import GOAL_REACHED, INTERRUPTED, NOT_REACHED
from vstestbed.cli.progress import ProgressBar, show_notes
from vstestbed.core.shares import STOPS
from vstestbed.loop.recording import Recording, Watcher
from vstestbed.scenario.scenario import Scenario
from vstestbed.studies import run_folder
from vstestbed.tasks.frame import Frame
from vstestbed.tasks.judged import MEASURED_BY, in_words_unit
from vstestbed.tasks.metrics import KNOWN

__all__ = ["Progress", "flown", "summary_text"]


def flown(
    scenario: Scenario,
    out: Path | None,
    films: run_folder.Films,
    fine: bool,
    as_json: bool,
    quiet: bool,
) -> int:
    """Run a scenario into its folder, and tell how it ended; the exit code."""
    folder = run_folder.new_folder(scenario, out)
    with Progress(scenario, shown=not quiet and not as_json) as progress, _interrupts() as watch:
        show_notes(not quiet)
        watchers = [progress, watch]
        recording = run_folder.run_into(folder, scenario, films, watchers, progress.say, fine=fine)
    if as_json:
        typer.echo((folder / "summary.json").read_text(encoding="utf-8"), nl=False)
    elif not quiet:
        typer.echo(summary_text(recording, folder, filmed=films != "none"), err=True)
    if recording.outcome.name == "interrupted":
        return INTERRUPTED
    return GOAL_REACHED if recording.outcome.success else NOT_REACHED


class Progress(ProgressBar):
    """Progress bar of a run (a Watcher)."""

    def __init__(self, scenario: Scenario, shown: bool):
        state = "{task.completed:5.1f} of {task.total:g} s   error {task.fields[error]} px"
        columns = "{task.description}", BarColumn(), state, TimeElapsedColumn()
        super().__init__(columns, shown, scenario.name, scenario.stop.duration_s, error="-")

    def frame(self, frame: Frame) -> None:
        """Advance the bar."""
        error = "lost" if frame.error.lost else f"{frame.error.rms_px:.2f}"
        self._bar.update(self._task, completed=frame.t, error=error)


@contextmanager
def _interrupts() -> Iterator[Watcher]:
    """The first Ctrl-C (SIGTERM, SIGHUP) ends the run at the next frame, with a complete folder;
    the second one ends it at once.
    """

    class _Stop:
        asked = False

        def ask(self, *_: object) -> None:
            self.asked = True
            for number, handler in before.items():  # the next signal has its usual effect
                signal.signal(number, handler)

        def frame(self, frame: Frame) -> None:
            if self.asked:
                # inside the loop, which turns it into the outcome `interrupted`
                raise KeyboardInterrupt

    stop = _Stop()
    # one that is ignored (`nohup`, `&` in a script) stays so
    before = {
        number: handler
        for number in STOPS
        if (handler := signal.getsignal(number)) != signal.SIG_IGN
    }
    for number in before:
        signal.signal(number, stop.ask)
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


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
    value, unit = summary[name], {"×": "times"}.get(KNOWN[name].unit, KNOWN[name].unit) + more
    return (
        f"{value * KNOWN[name].scale:.{digits}f} {unit}"
        if isinstance(value, float)
        else f"no {unit}"
    )
