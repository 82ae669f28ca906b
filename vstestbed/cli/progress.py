"""What a person at a terminal sees while a run goes, and after it."""

from __future__ import annotations

import logging
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from vstestbed.loop.recording import Recording
    from vstestbed.scenario.scenario import Scenario
    from vstestbed.tasks.frame import Frame


class Progress:
    """A progress bar on standard error while a run goes (a Watcher); nothing where that is no terminal.

    Args:
        scenario: its duration is the full bar.
        shown: False for silence.
    """

    def __init__(self, scenario: Scenario, shown: bool):
        from rich.console import Console
        from rich.progress import BarColumn, TextColumn, TimeElapsedColumn
        from rich.progress import Progress as Bar

        console = Console(stderr=True)
        self._bar = Bar(
            TextColumn("{task.description}"),
            BarColumn(),
            TextColumn("{task.completed:5.1f} of {task.total:g} s   error {task.fields[error]} px"),
            TimeElapsedColumn(),
            console=console,
            disable=not (shown and console.is_terminal),
            transient=True,
        )
        self._task = self._bar.add_task(scenario.name, total=scenario.stop.duration_s, error="-")

    def frame(self, frame: Frame) -> None:
        """Move the bar."""
        error = "lost" if frame.error.lost else f"{frame.error.rms_px:.2f}"
        self._bar.update(self._task, completed=frame.t, error=error)

    def say(self, words: str) -> None:
        """Say what is being done after the run."""
        self._bar.update(self._task, description=words)

    def __enter__(self) -> Progress:
        """Show the bar."""
        self._bar.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        """Take the bar away."""
        self._bar.stop()


class Counter:
    """A progress bar on standard error while a comparison goes: runs done, failures, time left; nothing where that is no terminal.

    Args:
        total: how many runs. done: how many of them were done before. shown: False for silence.
    """

    def __init__(self, total: int, done: int, shown: bool):
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
        from rich.progress import Progress as Bar

        console = Console(stderr=True)
        self._bar = Bar(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("runs   {task.fields[failed]} failed   left"),
            TimeRemainingColumn(),
            console=console,
            disable=not (shown and console.is_terminal),
            transient=True,
        )
        self._failed = 0
        self._task = self._bar.add_task("comparing", total=total, completed=done, failed=0)

    def run_done(self, job: object, summary: dict[str, Any]) -> None:
        """Move the bar."""
        self._failed += not summary["success"]
        self._bar.update(self._task, advance=1, failed=self._failed)

    def say(self, words: str) -> None:
        """Say what is being done after the runs."""
        self._bar.update(self._task, description=words)

    def __enter__(self) -> Counter:
        """Show the bar."""
        self._bar.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        """Take the bar away."""
        self._bar.stop()


def show_notes(shown: bool) -> None:
    """Let what the library has to say (that rays draw instead of OpenGL) pass to standard error as it is, or not."""
    logger = logging.getLogger("vstestbed")
    logger.setLevel(logging.WARNING if shown else logging.ERROR)
    if logging.lastResort is not None:
        logger.addHandler(logging.lastResort)
        logger.propagate = False


def words(recording: Recording, folder: Path, filmed: bool) -> str:
    """The outcome in a few lines."""
    s = recording.summary()

    def figure(name: str, unit: str, factor: float = 1.0, digits: int = 2) -> str:
        value = s[name]
        return f"{value * factor:.{digits}f} {unit}" if isinstance(value, float) else f"no {unit}"

    error = figure("final_error_px", "px in the image", digits=3) if s["final_error_px"] is not None else "target not in sight"
    if "level_error_px" in recording.columns and len(recording["level_error_px"]):
        error += f" ({recording['level_error_px'][-1]:.3f} turned level)"
    pose = f"{figure('final_position_error_m', 'mm', 1000)} and {figure('final_rotation_error_deg', 'deg', digits=3)} from the goal"
    who = "vehicle" if recording.scenario.robot.base == "planar" else "camera"
    kept = (
        f"{figure('worst_task_error_m', 'm', digits=4)} off at most once settled"
        if s.get("worst_task_error_m") is not None
        else "not settled yet"
    )
    error = kept if "worst_task_error_m" in s else f"{error}, {who} {pose}"
    speed = figure("real_time_factor", "times real time", digits=1) + (" with films and log" if filmed else " with its log")
    return "\n".join(
        [
            f"{s['outcome']}: {s['reason']}",
            *([f"  error     {error}" if s["frames"] else "  error     not a single frame was seen"] if s["outcome"] != "landed" else []),
            f"  time      {figure('sim_time_s', 's')} simulated in {figure('wall_time_s', 's')}: {speed}",
            f"  results   {folder} (open report.html)",
        ]
    )
