"""Batch simulation of ideal closed loops:
a law from thousands of starts, vectorised over the runs.
"""

from __future__ import annotations

import contextlib
import logging
import math
import time
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, fields, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from vstestbed.camera import Camera
from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array, Pose, exp, inverse, rigid_error
from vstestbed.core.outcome import Outcome
from vstestbed.endings import (
    GOES_ON,
    OUTCOMES,
    OVER_ARRAYS,
    FrameLimits,
    IdealRuns,
    PlaneCrossed,
    codes,
)
from vstestbed.features.depth import Estimate, PnP
from vstestbed.features.observation import Goal, Observation
from vstestbed.laws import Law
from vstestbed.laws.base import Views, has_batch, inputs_of
from vstestbed.loop.controller import GuardedLaw
from vstestbed.loop.stability import LastPart, sentence, window
from vstestbed.robots import Free, Mount, Robot
from vstestbed.robots.free import FreeStart
from vstestbed.scenario.dump import dump
from vstestbed.scenario.load import parse
from vstestbed.scenario.noise import Noise
from vstestbed.scenario.scenario import Scenario
from vstestbed.sim.scene.world import World
from vstestbed.studies.pools import Request, completed, pool_of, workers
from vstestbed.tasks.base import PLANE_INPUTS
from vstestbed.tasks.monitor import REST
from vstestbed.timing.plan import Timing
from vstestbed.vision import Oracle
from vstestbed.vision.homography import left_open, relative_view

if TYPE_CHECKING:
    from vstestbed.studies.comparison.plan import Comparison

__all__ = [
    "FIRST_POSE",
    "Batch",
    "BatchSetup",
    "ideal",
    "left_out",
    "must_be_few_starts",
    "seen_by",
    "simulate_batch",
    "simulate_in_parts",
    "start_of",
    "started_at",
]


# A law without equations for many runs in a batch: its `step` is asked run by run.
SIX = np.eye(6)
LEAST_POSE = 3  # markers that leave finitely many poses


class OneByOne:
    """Keeps the state of each run; the batch holds its number.

    Args:
        law: any. camera: the lens, for pixel coordinates.
    """

    state_size = 1

    def __init__(self, law: Law[Any], camera: Camera):
        self._law, self._camera, self._states, self._inputs = law, camera, [], inputs_of(law)
        self._moved: list[Array] = []
        self._guarded: list[GuardedLaw] = []

    def step(
        self, state: Array, views: Views, seen: NDArray[np.bool_], goal: Goal
    ) -> tuple[Array, Array]:
        """One frame of m runs: the next state (m, 1), and the camera twists (m, 6), NaN where the
        law orders rest.

        state: numbers of the runs' states (m, 1); NaN before the first frame. views: of all markers
        (m, N, 3). seen: which of them the law is shown (m, N). goal: the goal view.
        """
        state, twist = state.copy(), np.full((len(state), 6), np.nan)
        for i in range(len(state)):
            if np.isnan(state[i, 0]):
                state[i, 0] = len(self._states)
                self._states.append(self._law.init(goal))
                self._moved.append(np.zeros(6))
                self._guarded.append(GuardedLaw(self._law))
            k = int(state[i, 0])
            observation = self._observation(views, i, seen[i], goal, self._moved[k])
            self._states[k], command = self._guarded[k].step(
                self._states[k], observation, goal, SIX
            )
            if not command.rest_reason:
                twist[i] = command.twist
                self._moved[k] = command.twist * self._camera.period
        return state, twist

    def failed(self, state: Array) -> NDArray[np.bool_]:
        """In which runs, by the numbers of their states (m, 1), the law has failed (m,)."""
        return np.array(
            [not np.isnan(k) and bool(self._guarded[int(k)].failure) for k in state[:, 0]],
            dtype=bool,
        )

    def _observation(
        self, views: Views, i: int, seen: NDArray[np.bool_], goal: Goal, moved: Array
    ) -> Observation:
        shown = views.of_run(i, self._inputs, moved).only(None if seen.all() else seen)
        relative = (
            relative_view(goal.xy, shown.xy, goal.normal) if "relative" in self._inputs else None
        )
        if np.count_nonzero(seen) >= LEAST_POSE:
            return replace(shown, relative=relative)
        depth = np.full_like(shown.depth, np.nan) if self._law.depth.needs_pose else shown.depth
        return replace(shown, T_camera_target=None, relative=relative, depth=depth)


# What a batch of ideal closed loops needs: the scenario made ideal, and what all its runs share.

# starts that need no `--force`: one map of the largest `--n` (2000 x 2000), which takes some GB of
# memory
MOST_STARTS = 4_000_000


def ideal(scenario: Scenario, field_of_view: str | None = None) -> Scenario:
    """The same task with the ideal camera of a batch: oracle detector, no noise, no latency, no
    obstacles.

    The camera starts where the scenario's robot holds it. Gains, depth, goal, stop block and the
    camera's rate stay.

    scenario: of a robot that moves its camera with six degrees of freedom. field_of_view: `limited`
    or `unlimited`; None: that of the scenario's oracle, else limited. Raises ParameterError: the
    law works on whole pictures, the robot has fewer degrees of freedom, or the target moves.
    """
    if "image" in scenario.law.inputs:
        words = (
            "works on whole pictures, and a batch draws none;"
            " sweep and compare --vary run it start by start"
        )
        raise ParameterError("law.kind", f"{scenario.law.kind} {words}")
    robot, camera, detector = scenario.resolved.robot, scenario.camera, scenario.detector
    field_of_view = field_of_view or (
        detector.field_of_view if isinstance(detector, Oracle) else "limited"
    )
    if scenario.target.moves:
        raise ParameterError.fixed(
            "target.motion", "still", scenario.target.motion.kind, where="in a batch"
        )
    if (
        motions := robot.motion_basis(Mount.of(camera.mount.T), robot.start_joints()).shape[1]
    ) != 6:
        words = (
            f"moves its camera in {motions} directions, and the ideal camera of a batch in all six;"
            " use free or puma560"
        )
        raise ParameterError("robot.kind", words, robot.kind)
    picked = detector.rows is not None and field_of_view == "limited"
    if (
        picked
        and not camera.inside(
            camera.project(scenario.target.points_at(scenario.goal_view.T_camera_target))
        ).all()
    ):
        words = (
            f"{detector.kind} finds points of its own in pictures, and a batch, which draws none,"
            " has the target's corners in their"
        )
        more = (
            "the goal's view does not show them all; sweep and compare --vary run it start by start"
        )
        raise ParameterError("detector.kind", f"{words} place: {more}")
    start = FreeStart(nominal=Pose.of(robot.flange_pose(robot.configuration())))
    return replace(
        scenario,
        robot=robot if robot.body is None else Free(start=start),
        draw_start=False,
        camera=replace(camera, latency_s=0.0, readout_s=0.0),
        timing=Timing(),
        detector=Oracle(field_of_view=field_of_view),  # pyright: ignore[reportArgumentType]
        noise=Noise(),
        world=World(),
    )


@dataclass(frozen=True)
class BatchSetup:
    """What all runs of a batch share: the scenario, checked, and values derived from it."""

    scenario: Scenario

    def __post_init__(self) -> None:
        """Refuse what a batch cannot simulate."""
        for field, fits, words in self._conditions():
            if not fits:
                raise ParameterError(field, words)

    def _conditions(self) -> Iterator[tuple[str, bool, str]]:
        """Field, whether it fits, and what else the message says."""
        yield from self._of_law()
        yield from self._of_task()
        yield from self._of_plant()

    def _of_law(self) -> Iterator[tuple[str, bool, str]]:
        law = self.scenario.law
        foreign = sorted({"proprioception", "motion", "odometry", "place"} & set(law.inputs))
        first = "".join(foreign[:1])
        words = f"{law.kind} reads {first}, which the ideal cameras of a batch do not measure"
        yield "law.kind", not foreign, words
        margin_px = law.visibility.margin_px
        yield "law.visibility.margin_px", margin_px == 0, f"must be 0 in a batch, got {margin_px}"
        yield "law.feedforward", law.feedforward.kind == "none", "must be none in a batch"
        known = not (isinstance(law.depth, Estimate) or law.depth.measured)
        words = f"may not be {law.depth.kind} in a batch; valid: pnp, constant, goal, oracle"
        yield "law.depth", known, words

    def _of_task(self) -> Iterator[tuple[str, bool, str]]:
        s = self.scenario
        words = (
            "must be [] in a batch, whose runs share one scenario;"
            " compare --seeds draws it for each run"
        )
        yield "randomise", not s.randomise, words
        still = not (s.target.moves or s.goal.continuing or s.goal.lands)
        one_view = still and len(s.goal_views) <= 1
        yield "goal", one_view, "must be one view of a target that stands still, in a batch"
        in_pixels = s.stop.converged.error_px is not None and not s.stop.converged.by_estimate
        yield "stop.converged", in_pixels, "must be judged by error_px alone in a batch"
        solid = s.target.body is not None and not s.target.outlined
        bordered = isinstance(s.detector, Oracle) and s.detector.field_of_view == "limited"
        words = (
            "has a solid, and a batch does not know which markers it hides;"
            " give an unlimited field of view, or a target without one"
        )
        yield "target", not (solid and bordered), words
        words = "must be none in a batch, which ends runs by the loop's own alone"
        yield "monitors", not s.monitors, words

    def _of_plant(self) -> Iterator[tuple[str, bool, str]]:
        s = self.scenario
        exact = s.calibration.camera_exact and s.calibration.depth_exact
        yield "calibration", exact, "must be exact in a batch, whose poses and depths are true"
        yield "cameras", not s.cameras, "must be none in a batch, whose runs have one camera each"
        on_time = s.timing == Timing() and not (s.camera.latency_s or s.camera.readout_s)
        seen_exactly = isinstance(s.detector, Oracle) and s.noise == Noise()
        open_view = s.robot.body is None and not s.world.hides
        words = (
            "must have a free camera, detector oracle, no latency, no noise, no rolling shutter,"
            " and no plates or scenery for a batch; `basin.setup.ideal` makes it so"
        )
        yield "scenario", on_time and seen_exactly and open_view, words

    @cached_property
    def law(self) -> Any:
        """The law, where it takes many runs at once; else `OneByOne`."""
        law = self.scenario.law
        return law if has_batch(law) else OneByOne(law, self.scenario.camera)

    def needed_at(self, t: float) -> int:
        """How many markers a run must see at a time [s] for a command: more for the first pose that
        is solved from pixels, or depths from it.
        """
        law = self.scenario.law
        posed = isinstance(law.depth, PnP) and law.inputs != ("relative",)
        return max(self.needed, FIRST_POSE) if posed and t == 0 else self.needed

    @cached_property
    def error_px(self) -> float:
        """RMS error that counts as converged [px]."""
        return s if (s := self.scenario.stop.converged.error_px) is not None else math.nan

    @cached_property
    def needed(self) -> int:
        """Fewest visible markers with which the law gives a command."""
        return self.scenario.law.markers_needed(np.eye(6))

    @cached_property
    def limits(self) -> FrameLimits:
        """The limits of each run."""
        return FrameLimits.of(self.scenario.setup)


def start_of(scenario: Scenario, seed: int | None = None) -> Array:
    """The scenario's own start T_camera_target (4, 4), or the one that a seed draws."""
    robot = (
        scenario.robot
        if seed is None or scenario.robot.start.random is None
        else scenario.start(seed)
    )
    T_world_camera = robot.flange_pose(robot.configuration()) @ scenario.camera.mount.T
    return inverse(T_world_camera) @ scenario.target.pose.T


def started_at(scenario: Scenario, T_camera_target: Array) -> Scenario:
    """The scenario of an ideal camera, started at a pose T_camera_target (4, 4)."""
    T_world_flange = (
        scenario.target.pose.T @ inverse(T_camera_target) @ inverse(scenario.camera.mount.T)
    )
    return replace(scenario, robot=Free(start=FreeStart(nominal=Pose.of(T_world_flange))))


def must_be_few_starts(comparison: Comparison, n: int, force: bool = False) -> None:
    """Refuse maps of more than MOST_STARTS starts in all (each n x n), unless by force."""
    maps = len(comparison.base) * math.prod(map(len, (comparison.cases | comparison.axes).values()))
    if maps * n * n > MOST_STARTS and not force:
        words = (
            f"would make {maps:,} maps of {n} x {n} starts;"
            f" more than {MOST_STARTS:,} starts in all need --force"
        )
        raise ParameterError("basin", words)


# Batch simulation of ideal closed loops: a law from thousands of starts, vectorised over the runs.
#
# A single run with robot dynamics, images and delays is in `run`; the tests and `basin --check`
# compare the outcomes of the two.

# runs that are simulated together: their arrays fit the processor's cache, which saves a third of
# the time
AT_ONCE = 2000
FLAT2 = 0.15**2
"""Squared ratio of width to length of the marker pattern below which it is tested whether the
homography is undetermined; those that are have a ratio below 0.03.
"""
# markers for a first pose: with three the pose is ambiguous, and can only be continued from a known
# one
FIRST_POSE = 4


@dataclass(frozen=True)
class Batch:
    """Results of M runs.

    Attributes:
        outcome: an `Outcome` of each run, shape (M,).
        steps: number of steps of each run, shape (M,). near: number of steps after which the error
            stayed below the threshold (M,); -1 for runs that did not converge.
        T_camera_target: final pose, shape (M, 4, 4). farthest_m: largest distance to the target's
            origin (M,) [m].
        error_px: RMS error at the end over the visible markers (M,) [px].
        crossed: whether a run with lost target crossed the target's plane (M,); the others lost it
            out of the field of view.
        unstable: how a run's loop is unstable, in words (M,); "" of the others. run_steps: steps of
            all runs together.
    """

    outcome: NDArray[np.object_]
    steps: NDArray[np.int_]
    near: NDArray[np.int_]
    T_camera_target: Array
    farthest_m: Array
    error_px: Array
    crossed: NDArray[np.bool_]
    unstable: NDArray[np.object_]
    run_steps: int

    @classmethod
    def joined(cls, parts: Sequence[Batch]) -> Batch:
        """Several batches as one."""
        joined = {
            f.name: np.concatenate([getattr(part, f.name) for part in parts])
            for f in fields(Batch)
            if f.name != "run_steps"
        }
        return cls(**joined, run_steps=sum(part.run_steps for part in parts))

    @classmethod
    def without(cls, start: Array) -> Batch:
        """A batch of runs from these poses (M, 4, 4) that were not flown."""
        m = len(start)
        ended = (
            np.full(m, Outcome.interrupted, dtype=object),
            np.zeros(m, int),
            np.full(m, -1),
            start,
            np.zeros(m),
            np.full(m, np.nan),
        )
        return cls(*ended, np.zeros(m, dtype=bool), np.full(m, "", dtype=object), 0)


@dataclass(frozen=True)
class BatchFrame:
    """One frame of the m runs that go on.

    Attributes:
        step: number of the frame. index: of the runs in the batch (m,). T: poses T_camera_target
            (m, 4, 4).
        twist: commanded twists (m, 6). error: RMS errors (m,) [px]. code: outcomes, positions in
            OUTCOMES (m,). ended: frames at which the runs end, where they do (m,).
        behind: which cameras are behind the face of their target (m,).
    """

    step: int
    index: NDArray[np.int_]
    T: Array
    twist: Array
    error: Array
    code: NDArray[np.int_]
    ended: NDArray[np.int_]
    behind: NDArray[np.bool_]


def simulate_batch(scenario: Scenario, start: Array) -> Batch:
    """Simulate ideal cameras from their own starts, each until it ends as a single run would
    (`run`).

    T_camera_target <- exp(-v period) T_camera_target, with the twist v of the law. A run that has
    ended leaves the batch. Markers that a run does not see are left out of its equations. Depths
    and poses that a law solves from the pixels are true, since the pixels are exact; `constant` and
    `goal` depths are as in a single run.

    scenario: an ideal scenario, as from `ideal`; its own start is ignored. start: start poses
    T_camera_target, shape (M, 4, 4). Raises
    ParameterError: the law cannot run in a batch, or the scenario is not ideal.
    """
    setup = BatchSetup(scenario)
    # a batch without starts still gives arrays of the right shapes
    start = np.asarray(start, dtype=float).reshape(-1, 4, 4)
    parts = [
        _simulate(setup, start[i : i + AT_ONCE]) for i in range(0, max(len(start), 1), AT_ONCE)
    ]
    return Batch.joined(parts)


def simulate_in_parts(scenario: Scenario, start: Array, jobs: int | None, folder: Path) -> Batch:
    """As `simulate_batch`, of a law that is asked run by run: the starts are shared among worker
    processes, after a word on how long it takes. After Ctrl-C it returns what is done, and the
    other runs have the outcome `interrupted`.

    jobs: worker processes; None: one per core. folder: of the study, for temporary files.
    """
    few = start[np.linspace(0, len(start) - 1, min(len(start), 5)).astype(int)]
    began = time.perf_counter()
    simulate_batch(scenario, few)
    count = workers(jobs, len(start))
    minutes = (time.perf_counter() - began) / len(few) * len(start) / count / 60
    words = (
        "law %s has no equations for many runs at once, and is asked run by run:"
        " %d starts take some %.2g min with %d workers"
    )
    logging.getLogger("vstestbed").warning(words, scenario.law.kind, len(start), minutes, count)
    shares = [
        start[rows] for rows in np.array_split(np.arange(len(start)), min(len(start), 8 * count))
    ]
    work = [(i, Request(str(i), _part, (dump(scenario), share))) for i, share in enumerate(shares)]
    parts = [Batch.without(share) for share in shares]
    with closing(pool_of("local", count, folder)) as pool, contextlib.suppress(KeyboardInterrupt):
        for i, _, future in completed(pool, work, []):
            parts[i] = future.result()
    return Batch.joined(parts)


def _part(text: str, start: Array, place: str | None = None) -> Batch:
    """Some starts of a map, in a worker."""
    return simulate_batch(parse(text, "the scenario of a map"), start)


@dataclass
class _Runs:
    """The m runs that have not ended: index in the batch, pose, state of the law, frames near the
    goal and at rest, largest distance.
    """

    index: NDArray[np.int_]
    T: Array
    state: Array
    near: NDArray[np.int_]
    rest: NDArray[np.int_]
    farthest: Array

    def keep(self, which: NDArray[np.bool_]) -> _Runs:
        return _Runs(*(getattr(self, f.name)[which] for f in fields(self)))


def _simulate(setup: BatchSetup, start: Array) -> Batch:
    m = len(start)
    last = setup.limits.last
    runs = _Runs(
        np.arange(m),
        start,
        np.full((m, setup.law.state_size), np.nan),
        np.zeros(m, int),
        np.zeros(m, int),
        np.zeros(m),
    )
    outcome = np.full(m, None, dtype=object)
    steps = np.zeros(m, dtype=int)
    near = np.full(m, -1)
    final = start.copy()
    farthest = np.zeros(m)
    errors = np.full(m, np.nan)
    crossed = np.zeros(m, dtype=bool)
    words = np.full(m, "", dtype=object)
    watched = _LastHalf(setup.scenario, last)
    done = 0
    for step in range(last + 1):
        p = setup.scenario.target.points_at(runs.T)
        now = _frame(setup, runs, p, step)
        watched.add(now)
        twist = now.twist
        over = now.code != GOES_ON
        if over.any():
            at = runs.index[over]
            outcome[at] = [OUTCOMES[c] for c in now.code[over]]
            steps[at] = now.ended[over]
            final[at] = runs.T[over]
            farthest[at] = runs.farthest[over]
            errors[at] = now.error[over]
            # the two ways to lose the target are one outcome, but different failures of a law
            crossed[at] = (outcome[at] == Outcome.target_lost) & now.behind[over]
            reached = outcome[at] == Outcome.converged
            near[at] = np.where(reached, step - runs.near[over] + 1, -1)
            if step == last:
                words[at] = watched.unstable(now)
                outcome[words != ""] = Outcome.unstable
            runs = runs.keep(~over)
            twist = twist[~over]
        if not len(runs.index):  # all have ended before the time is over
            break
        done += len(runs.index)
        runs.T = exp(-setup.scenario.camera.period * twist) @ runs.T
    return Batch(outcome, steps, near, final, farthest, errors, crossed, words, done)


class _LastHalf:
    """The last half of the runs that take the whole time, for `loop.stability`.

    Args:
        scenario: of the runs. last: the number of their last frame.
    """

    def __init__(self, scenario: Scenario, last: int):
        self._scenario, self._from = scenario, last + 1 - min(window(scenario), (last + 1) // 2)
        self._first, self._T = np.empty(0), np.empty((0, 4, 4))
        self._kept: list[tuple[NDArray[np.int_], Array, Array]] = []

    def add(self, now: BatchFrame) -> None:
        if now.step == 0:
            self._first = now.error
        if now.step >= self._from:
            self._T = self._T if self._kept else now.T
            self._kept.append((now.index, now.twist, now.error))

    def unstable(self, now: BatchFrame) -> NDArray[np.object_]:
        """The words of each run of the last frame (m,); "" of those that have not timed out."""
        s, out = self._scenario, np.full(len(now.index), "", dtype=object)
        over = np.flatnonzero(now.code == OUTCOMES.index(Outcome.timed_out))
        if not len(over) or not self._kept:
            return out
        # a run of the last frame is in all of them
        rows = [np.searchsorted(index, now.index[over]) for index, _, _ in self._kept]
        twist = np.array([each[at] for (_, each, _), at in zip(self._kept, rows, strict=True)])
        error = np.array([each[at] for (_, _, each), at in zip(self._kept, rows, strict=True)])
        frames = np.arange(self._from, self._from + len(rows), dtype=float)
        for k, i in enumerate(over):
            ends = self._T[rows[0][k]], now.T[i]
            away = np.array(
                [rigid_error(inverse(T), inverse(s.goal_view.T_camera_target)) for T in ends]
            )
            limited, still = s.law.limits.reached(twist[:, k]), np.zeros((len(rows), 1))
            part = LastPart(
                frames * s.camera.period, error[:, k], twist[:, k], limited, still, away
            )
            out[i] = sentence(s, part, float(self._first[now.index[i]]))
        return out


def _frame(setup: BatchSetup, runs: _Runs, p: Array, step: int) -> BatchFrame:
    """One frame of all runs with their commands and outcomes.

    Without a target the law commands rest, and in a static world the target stays lost: such a run
    ends at once, with the frame at which a single one would end.
    """
    s = setup.scenario
    limits = setup.limits
    m = len(p)
    _, seen, error, all_seen = seen_by(s, p)
    state, twist, works = _commands(setup, runs, p, seen, step / s.camera.rate_hz)
    runs.state = state
    lost = ~works | ~np.isfinite(error)
    near = ~lost & all_seen & (error < setup.error_px)
    runs.near = np.where(near, runs.near + 1, 0)
    least = REST * np.repeat((s.goal_view.reach_m, 1.0), 3)
    resting = ~lost & ~near & (np.abs(twist) < least).all(axis=1)
    runs.rest = np.where(resting, runs.rest + 1, 0)
    distance = np.linalg.norm(runs.T[:, :3, 3], axis=1)
    runs.farthest = np.maximum(runs.farthest, distance)
    failed = setup.law.failed(state) if isinstance(setup.law, OneByOne) else np.zeros(m, dtype=bool)
    not_yet = np.zeros(m, dtype=int)
    ideal_runs = IdealRuns(
        frame=np.full(m, step),
        near=runs.near,
        rest=runs.rest,
        blind=not_yet,
        blind_m=np.zeros(m),
        T_camera_target=runs.T,
        failed=failed,
    )
    code = codes(ideal_runs, limits)
    ended = np.full(m, step)
    behind = PlaneCrossed.over(ideal_runs, limits)
    gone = step + limits.lost
    how = Outcome.target_lost if gone <= limits.last else Outcome.timed_out
    # what would come first in this frame stays
    will_be_lost = lost & ((code == GOES_ON) | (code > OVER_ARRAYS.index(PlaneCrossed)))
    code[will_be_lost] = OUTCOMES.index(how)
    ended[will_be_lost] = min(gone, limits.last)
    ordered = np.where(works[:, None], twist, 0.0)
    return BatchFrame(step, runs.index, runs.T, ordered, error, code, ended, behind)


def seen_by(s: Scenario, p: Array) -> tuple[Array, NDArray[np.bool_], Array, NDArray[np.bool_]]:
    """Pixels (m, N, 2) of markers p (m, N, 3), their visibility (m, N), RMS error over the visible
    ones (m,) [px], and whether all are visible (m,).
    """
    uv = s.camera.project(p)
    seen = np.isfinite(uv[..., 0])
    if isinstance(s.detector, Oracle) and s.detector.field_of_view == "limited":
        seen &= s.camera.whole(p.reshape(-1, 3), s.target.marker.radius).reshape(seen.shape)
    d, all_seen = uv - s.goal_view.uv, np.asarray(seen.all(axis=1))
    if all_seen.all():  # nearly every frame: no masks needed
        return uv, seen, np.sqrt(np.einsum("mni,mni->m", d, d) / (2 * p.shape[1])), all_seen
    d[~seen] = 0.0  # NaN otherwise
    count = np.maximum(seen.sum(axis=1), 1)  # 1: no division by zero where nothing is seen
    return (
        uv,
        seen,
        np.where(seen.any(axis=1), np.sqrt(np.einsum("mni,mni->m", d, d) / (2 * count)), np.nan),
        all_seen,
    )


def _commands(
    setup: BatchSetup, runs: _Runs, p: Array, seen: NDArray[np.bool_], t: float
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """State of the law after this frame (m, k), commanded twists (m, 6), and whether the law gave a
    command (m,).

    The law is evaluated once for each group of runs that see the same markers.
    """
    scenario, law = setup.scenario, setup.scenario.law
    goal = scenario.goal_view
    # a wide camera sees points behind its image plane, which have no normalised coordinates
    in_plane = bool(PLANE_INPUTS & set(law.inputs))
    usable = seen & (p[..., 2] > 0) if in_plane else seen
    state = runs.state.copy()
    twist = np.full((len(p), 6), np.nan)
    needed = setup.needed_at(t)
    radius = scenario.target.marker.radius
    if isinstance(setup.law, OneByOne):
        enough = np.count_nonzero(usable, axis=1) >= needed
        views = Views(t, p[enough], runs.T[enough], goal, law.depth, radius)
        stepped = setup.law.step(state[enough], views, usable[enough], goal)
        state[enough], twist[enough] = stepped
        return state, twist, np.isfinite(twist[:, 0])
    for which, rows in _groups(usable):
        if np.count_nonzero(rows) < needed:
            continue
        whole = rows.all()
        of_rows = goal if whole else goal.of_rows(rows)
        points = p[which] if whole else p[which][:, rows]
        views = Views(t, points, runs.T[which], of_rows, law.depth, radius)
        stepped = setup.law.step_batch(runs.state[which], views, of_rows)
        state[which], twist[which] = stepped
        if law.inputs == ("relative",):
            undetermined = _undetermined(views, of_rows)[:, None]
            twist[which] = np.where(undetermined, np.nan, twist[which])
    return state, twist, np.isfinite(twist[:, 0])


def _groups(
    usable: NDArray[np.bool_],
) -> Iterator[tuple[NDArray[np.bool_] | slice, NDArray[np.bool_]]]:
    """Groups of runs with the same row of usable markers (m, N): the runs as a mask (m,), and their
    markers (N,).

    In most frames all markers are usable: one group, with a slice in place of the mask, which
    copies no arrays.
    """
    # a bit per marker
    groups = (
        np.zeros(len(usable), dtype=int)
        if usable.all()
        else usable @ (1 << np.arange(usable.shape[1]))
    )
    for group in np.unique(groups):
        members = groups == group
        yield slice(None) if members.all() else members, usable[np.argmax(members)]


def _undetermined(views: Views, goal: Goal) -> NDArray[np.bool_]:
    """Whether the homography from the goal view is undetermined (m,): the plane is seen edge on."""
    d = views.xy - views.xy.mean(axis=1, keepdims=True)
    a, b, c = (np.einsum("mn,mn->m", d[..., i], d[..., j]) for i, j in ((0, 0), (0, 1), (1, 1)))
    flat = a * c - b * b < FLAT2 * (0.5 * (a + c)) ** 2
    undetermined = np.zeros(len(d), dtype=bool)
    if flat.any():
        undetermined[flat] = left_open(goal.xy, views.xy[flat])
    return undetermined


def left_out(scenario: Scenario) -> list[str]:
    """What `ideal` takes out of a scenario: a robot's body, points of a detector's own, effects on
    pictures and timing by their paths.
    """
    found = [] if scenario.robot.body is None else [*_of_robot(scenario.robot)]
    if scenario.detector.rows is not None:
        found.append(
            f"the points that detector {scenario.detector.kind} finds"
            " (the law has the target's corners in their place)"
        )
    of_cameras = "latency_s", "readout_s", "optics", "exposure", "sensor", "stream"
    found += [
        f"camera.{name}" for name in of_cameras if getattr(scenario.camera, name) not in (0.0, None)
    ]
    for name in ("noise", "timing"):
        block = getattr(scenario, name)
        plain = type(block)()
        found += [
            f"{name}.{f.name}"
            for f in fields(block)
            if getattr(block, f.name) != getattr(plain, f.name)
        ]
    # what may stand before a target; the rest of the world changes how pictures look
    return found + [
        f"world.{name}" for name in ("plates", "scenery") if getattr(scenario.world, name)
    ]


def _of_robot(robot: Robot) -> Iterator[str]:
    """Its dynamics and limits, its preset, and the effects that it has: the blocks that are none by
    default.
    """
    yield f"the dynamics and limits of robot {robot.kind}"
    if getattr(robot, "realism", "none") != "none":
        yield "robot.realism"  # which fills the others
        return
    names = {field.name: field.default for field in fields(robot) if field.init}  # pyright: ignore[reportArgumentType] - a spec
    yield from (
        f"robot.{name}"
        for name, default in names.items()
        if default is None and getattr(robot, name) is not None
    )
