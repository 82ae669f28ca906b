"""What every task must do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vstestbed.core.contract import Contract
from vstestbed.core.outcome import Outcome
from vstestbed.loop.recording import Recording
from vstestbed.loop.run import run, uninterrupted
from vstestbed.scenario.scenario import Scenario
from vstestbed.tasks import Task, TaskBase

SHORT_FRAMES = 3
"""A run of so many frames cannot end a task."""


def check_task(scenario: Scenario) -> None:
    """A task ends as it should: reached in its scenario, not reached when there is no time; its columns are in the log.

    Args:
        scenario: with the task as its goal, which its robot and law reach.

    Raises:
        AssertionError: it says what was expected and what was found.
    """
    task = scenario.goal
    Contract(Task, base=TaskBase).check(type(task))
    poses, views = scenario.goal_poses, scenario.goal_views
    assert len(poses) == len(views), f"{task.kind}: each of {len(views)} goal views needs its pose, there are {len(poses)}"
    numbers = [view.view for view in views]
    assert numbers == list(range(len(views))), f"{task.kind}: goal views must be numbered 0 to {len(views) - 1}, got {numbers}"
    _check_ends(scenario)


def _check_ends(scenario: Scenario) -> None:
    task, period = scenario.goal, scenario.camera.period
    short = uninterrupted(run(replace(scenario, stop=replace(scenario.stop, duration_s=SHORT_FRAMES * period))))
    assert short.outcome is Outcome.timed_out, f"{task.kind}: 3 frames must not be enough, {short.outcome.name}: {short.reason}"
    whole = uninterrupted(run(scenario))
    expected = Outcome.landed if task.lands else Outcome.completed if task.continuing else Outcome.converged
    assert whole.outcome is expected, f"{task.kind}: must end {expected.name}, ended {whole.outcome.name}: {whole.reason}"
    own = [name for name in scenario.own_columns if name not in whole.columns]
    assert not own, f"{task.kind}: its log lacks the columns {', '.join(own)}"
    if task.continuing:
        _check_error(task, whole)


def _check_error(task: Task, whole: Recording) -> None:
    """A continuing task logs its error, which was within the tolerance where the run counts as completed."""
    assert "task_error_m" in whole.columns, f"{task.kind}: a continuing task must log its error as task_error_m [m]"
    assert task.tolerance_m is not None, f"{task.kind}: a continuing task must have a tolerance_m"
    settled = whole["t"] >= task.settle_s
    worst = float(np.abs(whole["task_error_m"][settled]).max())
    assert worst <= task.tolerance_m, f"{task.kind}: completed with an error of {worst:.3g} m, over its tolerance"
