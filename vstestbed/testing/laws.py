"""What every control law must do."""

from __future__ import annotations

import inspect
import re
from dataclasses import replace
from typing import Any

import numpy as np

from vstestbed.camera import Perspective
from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array, exp, inverse, transform
from vstestbed.core.outcome import Outcome
from vstestbed.features import FEATURES, Feature
from vstestbed.features.observation import Goal, Observation
from vstestbed.laws import Command, ErrorLaw, Law, Policy
from vstestbed.laws.base import LAW_CONTRACT, OBSERVATION_FIELDS, inputs_of
from vstestbed.loop.ego_motion import believed_mount, start_basis
from vstestbed.loop.session import run, uninterrupted
from vstestbed.robots.own_model import OwnModel
from vstestbed.scenario.load import load
from vstestbed.scenario.scenario import Scenario
from vstestbed.targets import Points
from vstestbed.tasks.frame import Frame
from vstestbed.testing.robots import check_contract, must_refuse
from vstestbed.timing.plan import Timing

__all__ = ["check_feature", "check_law", "quick", "unnamed_in_source"]

STEP = 1e-6  # motion of the camera for a difference quotient [m, rad], which then has 9 digits
VIEWS = 20
RADIUS_M = 0.35


def check_feature(feature: Feature, seed: int = 0) -> None:
    """On a circle of markers L is the derivative of the error over motions of the camera; shapes
    are right; leading axes are taken.
    """
    check_contract(FEATURES, feature)
    rng = np.random.default_rng(seed)
    many = []
    markers = _on_a_circle(max(4, feature.least_markers))
    for _ in range(VIEWS):
        twist = rng.uniform(-1, 1, 6) * [0.2, 0.2, 0, 0.6, 0.6, 3.0]
        T = np.eye(4)
        T[2, 3] = rng.uniform(0.8, 2.0)
        p = transform(T @ exp(twist), markers)
        many.append(_inputs(feature, p))
        _check_derivative(feature, p)
    one = np.stack([feature.interaction(*inputs) for inputs in many])
    together = feature.interaction(*(np.stack(values) for values in zip(*many, strict=True)))
    assert np.allclose(one, together), (
        f"{feature.kind}: interaction must take leading axes:"
        f" {VIEWS} views at once differ from one by one"
    )


def _on_a_circle(n: int) -> Array:
    """Points (n, 3) on a circle [m], at uneven distances: the symmetries of a regular polygon leave
    some features undefined.
    """
    i = np.arange(n)
    angle = 2 * np.pi * i / n + 0.4 * np.sin(2 * i)
    return RADIUS_M * np.column_stack([np.cos(angle), np.sin(angle), np.zeros(n)])


def _inputs(feature: Feature, p: Array) -> tuple[Array, Array]:
    """The feature's two inputs, for points p (N, 3) in the camera's frame."""
    view = Goal.of_points(Perspective(), p, np.eye(4))
    first, second = (np.asarray(getattr(view, name)) for name in feature.inputs)
    return first, second


def _check_derivative(feature: Feature, p: Array) -> None:
    kind = feature.kind
    inputs = _inputs(feature, p)
    s = feature.measure(inputs[0])
    L = feature.interaction(*inputs)
    assert L.ndim == 2 and L.shape[1] == 6, (
        f"{kind}: interaction must have shape (rows, 6), got {L.shape}"
    )
    rows = feature.error(s, s).shape
    assert rows == L.shape[:1], (
        f"{kind}: error must have as many rows as L, {L.shape[0]}, got the shape {rows}"
    )
    expected = feature.rows_per_marker * len(p)
    assert not expected or len(L) == expected, (
        f"{kind}: {feature.rows_per_marker} rows for each of {len(p)} markers, L has {len(L)}"
    )
    assert np.abs(feature.error(s, s)).max() < 1e-9, f"{kind}: error(s, s) must be 0"
    for i, name in enumerate(("vx", "vy", "vz", "wx", "wy", "wz")):
        step = STEP * (np.arange(6) == i)
        after = _measured_after(feature, step, p)
        before = _measured_after(feature, -step, p)
        measured = (feature.error(after, s) - feature.error(before, s)) / (2 * STEP)
        off = float(np.abs(measured - L[:, i]).max())
        assert off < 1e-5 * max(1.0, float(np.abs(L).max())), (
            f"{kind}: column {name} of L is {off:.3g} from the error's difference quotient"
        )


def _measured_after(feature: Feature, motion: Array, p: Array) -> Array:
    """The feature of points p (N, 3) after a motion (6,) of the camera."""
    return feature.measure(_inputs(feature, transform(inverse(exp(motion)), p))[0])


# A quick closed loop for each kind of task: ideal motion where the task has it, markers by the
# oracle, no pictures.
QUICK: dict[str, tuple[str, dict[str, object]]] = {
    "view": ("ibvs_book", {"camera.rate_hz": 25.0}),
    "pose": ("car_parking", {}),
    "gap": ("car_pursuit", {"stop.duration_s": 15.0}),
    "line": ("omni_line", {"robot.wheels": "planar", "stop.duration_s": 10.0}),
    "path": ("quadrotor_path", {}),
    "landing": ("quadrotor_land", {}),
}
"""Bundled scenario and what is changed in it, by the word of `Law.tasks`. The longer tasks are cut
to what shows the steady state.
"""


def quick(task: str) -> Scenario:
    """The closed loop for a kind of task. Raises ParameterError: there is none of this kind."""
    if task not in QUICK:
        raise ParameterError.choice(
            "tasks", QUICK, task, why="these have closed loops to be tested in"
        )
    name, changes = QUICK[task]
    return load(name, {"detector": {"kind": "oracle"}, **changes})


FREE = ("t", "uv")  # fields of an observation that are there for every law


class _Frames:
    """Keeps the frames of a run."""

    def __init__(self) -> None:
        self.kept: list[Frame] = []

    def frame(self, frame: Frame) -> None:
        self.kept.append(frame)


def check_law(law: Law[Any], scenario: Scenario | None = None) -> None:
    """A law reaches its goal in closed loop, is a function of its state and its observation, and
    refuses what it cannot do.

    Of the observation it may read the time, the pixels, and the fields that its `inputs` name.

    law: with the parameters to test. scenario: the closed loop to test it in, its own law is
    replaced; None: a quick one for the first of `law.tasks`.
    """
    LAW_CONTRACT.check(type(law))
    loop = scenario or quick(law.tasks[0])
    # without latency the motions are those at the exposure, which the replay needs
    loop = replace(loop, law=law, camera=replace(loop.camera, latency_s=0.0), timing=Timing())
    frames = _Frames()
    recording = uninterrupted(run(loop, watch=[frames]))
    words = (
        f"{law.kind} must reach its goal in {loop.name}:"
        f" {recording.outcome.name}, {recording.reason}"
    )
    if recording.outcome is Outcome.law_failed:
        words += unnamed_in_source(law)
    assert recording.outcome.success, words
    _check_commands(law, loop, frames.kept)
    _check_blind(law, loop, frames.kept[0])
    _check_refusals(law, loop)


def _check_blind(law: Law[Any], loop: Scenario, first: Frame) -> None:
    """Without a marker in sight the law orders something finite, and says why if it orders rest."""
    gone = {
        name: np.full_like(value, np.nan)
        for name, value in _arrays(first.observation).items()
        if name in ("uv", "xy", "depth", "ray")
    }
    blind = replace(first.observation, **gone, T_camera_target=None, relative=None)
    _, command = law.step(law.init(loop.goal_views[0]), blind, first.goal, start_basis(loop))
    assert np.isfinite(command.twist).all(), (
        f"{law.kind} without markers in sight: the twist must be finite, got {command.twist}"
    )
    assert command.twist.any() or command.rest_reason, (
        f"{law.kind} without markers in sight: a rest must have a rest_reason"
    )


def _check_refusals(law: Law[Any], loop: Scenario) -> None:
    """A task that a law does not take and too few markers are refused before a run."""
    if other := next((word for word in QUICK if word not in law.tasks), None):
        must_refuse(
            lambda: replace(quick(other), law=law),
            f"{law.kind} must be refused for a {other}, which it does not take",
        )
    needed = law.markers_needed(start_basis(loop))
    target = loop.target
    if needed > 1 and len(target.places):
        places = tuple(map(tuple, target.places[: needed - 1].tolist()))
        few = Points(at=places, pose=target.pose, marker=target.marker)
        must_refuse(
            lambda: replace(loop, target=few),
            f"{law.kind} needs {needed} markers, and {needed - 1} must be refused",
        )


def _check_commands(law: Law[Any], loop: Scenario, frames: list[Frame]) -> None:
    """Replayed by hand the law gives the same commands: it has no state of its own, and does not
    write into what it is given.
    """
    state = law.init(loop.goal_views[0])
    mount = believed_mount(loop)
    for frame in frames:
        if frame.goal.view and not loop.goal.by_clock:
            return  # at a via point the loop initialises the law anew
        basis = loop.robot.motion_basis(mount, frame.truth.q)
        before = {name: value.copy() for name, value in _arrays(frame.observation).items()}
        where = f"{law.kind} in frame {frame.timing.number}"
        given = state
        state, command = law.step(given, frame.observation, frame.goal, basis)
        same = np.array_equal(command.twist, frame.command.twist)
        assert same, (
            f"{where}: another command for the same state and observation;"
            " state is passed, not stored"
        )
        for name, value in _arrays(frame.observation).items():
            assert np.array_equal(value, before[name], equal_nan=True), (
                f"{where}: it wrote into observation.{name}"
            )
        assert np.isfinite(command.twist).all(), (
            f"{where}: the twist must be finite, got {command.twist}"
        )
        np.testing.assert_allclose(
            basis @ command.u, command.twist, atol=1e-9, err_msg=f"{where}: twist must be basis @ u"
        )
        _check_rates(where, command, frame.observation.robot)
        within = law.limits.scale(command.twist) > 1 - 1e-9
        assert within, f"{where}: the twist {command.twist} is beyond the law's own limits"
        _check_inputs(law, given, frame, basis, command)


def _check_rates(where: str, command: Command, robot: OwnModel | None) -> None:
    """The twist is what the robot's own velocities make of it: these move it, not the twist."""
    if command.rates is not None and robot is not None:
        np.testing.assert_allclose(
            robot.J @ command.rates,
            command.twist,
            atol=1e-9,
            err_msg=f"{where}: twist must be observation.robot.J @ rates",
        )


def _check_inputs(law: Law[Any], state: Any, frame: Frame, basis: Array, command: Command) -> None:
    """What the law's `inputs` do not name is not read: without it the command is the same."""
    if isinstance(law, Policy):  # whose function may read all that there is without asking
        return
    unnamed = [
        name
        for name in OBSERVATION_FIELDS
        if name not in (*FREE, *_named(law)) and getattr(frame.observation, name) is not None
    ]
    if not _differs(law, state, frame, basis, command, unnamed):
        return
    read = [name for name in unnamed if _differs(law, state, frame, basis, command, [name])]
    read = read or unnamed
    words = (
        f"{law.kind} reads observation.{' and observation.'.join(read)},"
        " which its `inputs` do not name"
    )
    raise AssertionError(f"{words}; write inputs = {(*law.inputs, *read)}")


def _named(law: Law[Any]) -> tuple[str, ...]:
    """The fields of an observation that a law may read; `xyw` is made of two."""
    named = inputs_of(law)
    return (*named, "xy", "depth") if "xyw" in named else named


def _differs(
    law: Law[Any], state: Any, frame: Frame, basis: Array, command: Command, without: list[str]
) -> bool:
    """Whether the command is another one without these fields of the observation."""
    seen = replace(frame.observation, **dict.fromkeys(without))
    try:
        _, again = law.step(state, seen, frame.goal, basis)
    except Exception:  # whatever a law raises that computes with a None
        return True
    return not np.array_equal(again.twist, command.twist)


def unnamed_in_source(law: Law[Any]) -> str:
    """Which fields a law that failed reads without naming them in `inputs`, as far as its text
    tells; "" where it tells nothing.
    """
    called = [list(inspect.signature(type(law).step).parameters)[2]]
    if isinstance(law, ErrorLaw):
        called.append(list(inspect.signature(type(law).equations).parameters)[1])
    try:
        read = re.findall(rf"\b(?:{'|'.join(called)})\.(\w+)", inspect.getsource(type(law)))
    except (OSError, TypeError):  # a class that was typed in has no file
        return ""
    named = (*FREE, *_named(law))
    unnamed = ", ".join(f for f in OBSERVATION_FIELDS if f in read and f not in named)
    if not unnamed:
        return ""
    return f"; its `inputs` do not name {unnamed}, which it reads, and which may be None then"


def _arrays(seen: Observation) -> dict[str, Array]:
    named = {
        name: getattr(seen, name)
        for name in ("uv", "xy", "depth", "ray", "range", "T_camera_target", "place", "odometry")
    }
    return {name: value for name, value in named.items() if value is not None}
