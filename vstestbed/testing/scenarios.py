"""A quick closed loop for each kind of task: ideal motion where the task has it, markers by the oracle, no pictures."""

from __future__ import annotations

from vstestbed.core.errors import ParameterError
from vstestbed.scenario.load import load
from vstestbed.scenario.scenario import Scenario

QUICK: dict[str, tuple[str, dict[str, object]]] = {
    "view": ("ibvs_book", {"camera.rate_hz": 25.0}),
    "pose": ("car_parking", {}),
    "gap": ("car_pursuit", {"stop.duration_s": 15.0}),
    "line": ("omni_line", {"robot.wheels": "planar", "stop.duration_s": 10.0}),
    "path": ("quadrotor_path", {}),
    "landing": ("quadrotor_land", {}),
}
"""Bundled scenario and what is changed in it, by the word of `Law.tasks`. The longer tasks are cut to what shows the steady state."""


def quick(task: str) -> Scenario:
    """The closed loop for a kind of task.

    Raises:
        ParameterError: there is none of this kind.
    """
    if task not in QUICK:
        raise ParameterError("tasks", f"has no closed loop to be tested in; valid: {', '.join(QUICK)}", task)
    name, changes = QUICK[task]
    return load(name, {"detector": {"kind": "oracle"}, **changes})
