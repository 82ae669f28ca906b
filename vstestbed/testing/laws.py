"""What every control law must do."""

from __future__ import annotations

import inspect
import re
from dataclasses import replace
from typing import Any

import numpy as np

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array
from vstestbed.core.outcome import Outcome
from vstestbed.features.observation import Observation
from vstestbed.laws import Command, Law, Policy
from vstestbed.laws.base import LAW_CONTRACT, OBSERVATION_FIELDS
from vstestbed.loop.run import run, uninterrupted
from vstestbed.robots import Mount
from vstestbed.scenario.scenario import Scenario
from vstestbed.sim.timing import Timing
from vstestbed.targets import Points
from vstestbed.tasks.frame import Frame
from vstestbed.testing.scenarios import QUICK, quick

FREE = ("t", "uv")
"""Fields of an observation that are there for every law."""


class _Frames:
    """Keeps the frames of a run."""

    def __init__(self) -> None:
        self.kept: list[Frame] = []

    def frame(self, frame: Frame) -> None:
        """Keep one."""
        self.kept.append(frame)


def check_law(law: Law[Any], scenario: Scenario | None = None) -> None:
    """A law reaches its goal in closed loop, is a function of its memory and its observation, and refuses what it cannot do.

    Of the observation it may read the time, the pixels, and the fields that its `inputs` name.

    Args:
        law: with the parameters to test.
        scenario: the closed loop to test it in, its own law is replaced; None: a quick one for the first of `law.tasks`.

    Raises:
        AssertionError: it says what was expected and what was found.
    """
    LAW_CONTRACT.check(type(law))
    loop = scenario or quick(law.tasks[0])
    # without latency the motions are those at the exposure, which the replay needs
    loop = replace(loop, law=law, camera=replace(loop.camera, latency_s=0.0), timing=Timing())
    frames = _Frames()
    recording = uninterrupted(run(loop, watch=[frames]))
    words = f"{law.kind} must reach its goal in {loop.name}: {recording.outcome.name}, {recording.reason}"
    assert recording.outcome.success, words + (_unnamed_in_source(law) if recording.outcome is Outcome.law_failed else "")
    _check_commands(law, loop, frames.kept)
    _check_lost(law, loop, frames.kept[0])
    _check_refusals(law, loop)


def _check_commands(law: Law[Any], loop: Scenario, frames: list[Frame]) -> None:
    """Replayed by hand the law gives the same commands: it has no state of its own, and does not write into what it is given."""
    memory, mount = law.init(loop.goal_views[0]), Mount.of(loop.believed_camera.mount.T)
    for frame in frames:
        if frame.goal.view and not loop.goal.by_clock:
            return  # at a via point the loop initialises the law anew
        basis = loop.robot.motion_basis(mount, frame.truth.q)
        before = {name: value.copy() for name, value in _arrays(frame.observation).items()}
        where = f"{law.kind} in frame {frame.timing.number}"
        given, (memory, command) = memory, law.step(memory, frame.observation, frame.goal, basis)
        same = np.array_equal(command.twist, frame.command.twist)
        assert same, f"{where}: another command for the same memory and observation; state is passed, not stored"
        for name, value in _arrays(frame.observation).items():
            assert np.array_equal(value, before[name], equal_nan=True), f"{where}: it wrote into observation.{name}"
        assert np.isfinite(command.twist).all(), f"{where}: the twist must be finite, got {command.twist}"
        np.testing.assert_allclose(basis @ command.u, command.twist, atol=1e-9, err_msg=f"{where}: twist must be basis @ u")
        within = law.limits.scale(command.twist) > 1 - 1e-9
        assert within, f"{where}: the twist {command.twist} is beyond the law's own limits"
        _check_inputs(law, given, frame, basis, command)


def _check_inputs(law: Law[Any], memory: Any, frame: Frame, basis: Array, command: Command) -> None:
    """What the law's `inputs` do not name is not read: without it the command is the same."""
    if isinstance(law, Policy):  # whose function may read all that there is without asking
        return
    unnamed = [name for name in OBSERVATION_FIELDS if name not in (*FREE, *law.inputs) and getattr(frame.observation, name) is not None]
    if not _differs(law, memory, frame, basis, command, unnamed):
        return
    read = [name for name in unnamed if _differs(law, memory, frame, basis, command, [name])]
    words = f"{law.kind} reads observation.{' and observation.'.join(read or unnamed)}, which its `inputs` do not name"
    raise AssertionError(f"{words}; write inputs = {(*law.inputs, *(read or unnamed))}")


def _differs(law: Law[Any], memory: Any, frame: Frame, basis: Array, command: Command, without: list[str]) -> bool:
    """Whether the command is another one without these fields of the observation."""
    try:
        _, again = law.step(memory, replace(frame.observation, **dict.fromkeys(without)), frame.goal, basis)
    except Exception:  # whatever a law raises that computes with a None
        return True
    return not np.array_equal(again.twist, command.twist)


def _unnamed_in_source(law: Law[Any]) -> str:
    """Which fields a law that failed reads without naming them in `inputs`, as far as its text tells; "" where it tells nothing."""
    name = list(inspect.signature(type(law).step).parameters)[2]
    try:
        read = re.findall(rf"\b{name}\.(\w+)", inspect.getsource(type(law)))
    except (OSError, TypeError):  # a class that was typed in has no file
        return ""
    unnamed = [field for field in OBSERVATION_FIELDS if field in read and field not in (*FREE, *law.inputs)]
    return f"; its `inputs` do not name {', '.join(unnamed)}, which it reads, and which may be None then" if unnamed else ""


def _check_lost(law: Law[Any], loop: Scenario, first: Frame) -> None:
    """Without a marker in sight the law orders something finite, and says why if it orders rest."""
    gone = {name: np.full_like(value, np.nan) for name, value in _arrays(first.observation).items() if name in ("uv", "xy", "depth", "ray")}
    blind = replace(first.observation, **gone, T_camera_target=None, relative=None)
    _, command = law.step(law.init(loop.goal_views[0]), blind, first.goal, _basis(loop))
    assert np.isfinite(command.twist).all(), f"{law.kind} without markers in sight: the twist must be finite, got {command.twist}"
    assert command.twist.any() or command.rest_reason, f"{law.kind} without markers in sight: a rest must have a rest_reason"


def _check_refusals(law: Law[Any], loop: Scenario) -> None:
    """A task that it does not take and too few markers are refused before a run, with a ParameterError."""
    other = next((word for word in QUICK if word not in law.tasks), None)
    if other is not None:
        _must_refuse(lambda: replace(quick(other), law=law), f"{law.kind} must be refused for a {other}, which it does not take")
    needed = law.markers_needed(_basis(loop))
    if needed > 1 and len(loop.target.places):
        few = Points(at=tuple(map(tuple, loop.target.places[: needed - 1].tolist())), pose=loop.target.pose, marker=loop.target.marker)
        _must_refuse(lambda: replace(loop, target=few), f"{law.kind} needs {needed} markers, and {needed - 1} must be refused")


def _must_refuse(build: Any, words: str) -> None:
    try:
        build()
    except ParameterError:
        return
    raise AssertionError(words)


def _basis(loop: Scenario) -> Array:
    """The robot's motions at its start."""
    return loop.robot.motion_basis(Mount.of(loop.believed_camera.mount.T), loop.robot.start_joints())


def _arrays(seen: Observation) -> dict[str, Array]:
    named = {name: getattr(seen, name) for name in ("uv", "xy", "depth", "ray", "range", "T_camera_target", "place", "odometry")}
    return {name: value for name, value in named.items() if value is not None}
