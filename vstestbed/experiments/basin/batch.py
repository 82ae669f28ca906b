"""Many ideal closed loops at once: a law flown from thousands of starts, one numpy call for all. The time loop of one run is in `loop`."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array, Pose, exp, inverse, transform
from vstestbed.core.outcome import Outcome
from vstestbed.features.depth import Estimate, PnP
from vstestbed.features.observation import Goal
from vstestbed.laws.views import BatchLaw, Views
from vstestbed.loop.monitors import FAR_M
from vstestbed.robots import Free, Mount
from vstestbed.robots.free import FreeStart
from vstestbed.scenario.scenario import Noise, Scenario
from vstestbed.sim.scene.world import World
from vstestbed.sim.timing import Timing
from vstestbed.tasks.reached import REST, REST_S
from vstestbed.tasks.visible import PLANE_INPUTS
from vstestbed.vision import Oracle
from vstestbed.vision.pose.homography import left_open

AT_ONCE = 2000
"""Runs that fly together: their arrays fit a processor's cache, which is worth a third of the time."""
SLACK_S = 1e-9
"""The judge of one run allows this much when it compares times [s]."""
FLAT2 = 0.15**2
"""Views under this ratio of width to length (squared) are asked whether they leave a homography open; those left open have under .03."""
FIRST_POSE = 4
"""Markers that tell a first pose; three leave several, and only a known one can be gone on with."""
GOING = 0
CODES: tuple[Outcome | None, ...] = (None, *Outcome)
_CODE = {outcome: code for code, outcome in enumerate(CODES)}


@dataclass(frozen=True)
class Batch:
    """How the runs ended.

    Attributes:
        outcome: an `Outcome` each, shape (M,).
        steps: after how many steps, shape (M,). near: of them, those before the error came under the threshold for good (M,);
            -1 where it did not.
        T_camera_target: where each ended, shape (M, 4, 4). farthest_m: largest distance to the target's origin (M,) [m].
        error_px: RMS error at the end over the markers seen (M,) [px].
        crossed: of runs that lost their target, whether they crossed its plane (M,); the others lost it from sight.
        run_steps: steps of all runs together.
    """

    outcome: NDArray[np.object_]
    steps: NDArray[np.int_]
    near: NDArray[np.int_]
    T_camera_target: Array
    farthest_m: Array
    error_px: Array
    crossed: NDArray[np.bool_]
    run_steps: int


def ideal(scenario: Scenario, field_of_view: str | None = None) -> Scenario:
    """The same task for the ideal camera that flies a batch: oracle, no noise, no latency, nothing in the way.

    The camera starts where the scenario's robot holds it. Gains, depth, goal, stop block and the camera's rate stay.

    Args:
        scenario: of a robot that moves its camera in all six directions.
        field_of_view: `limited` or `unlimited`; None for that of its oracle, else limited.

    Raises:
        ParameterError: the robot has fewer motions, or the target moves.
    """
    robot, camera, detector = scenario.robot, scenario.camera, scenario.detector
    if scenario.target.moves:
        raise ParameterError("target.motion", "must be still in a batch", scenario.target.motion.kind)
    if (motions := robot.motion_basis(Mount.of(camera.mount.T), robot.start_joints()).shape[1]) != 6:
        words = f"moves its camera in {motions} directions, and the ideal camera of a batch in all six; use free or puma560"
        raise ParameterError("robot.kind", words, robot.kind)
    if field_of_view is None:
        field_of_view = detector.field_of_view if isinstance(detector, Oracle) else "limited"
    start = FreeStart(nominal=Pose.of(robot.flange_pose(robot.configuration())))
    return replace(
        scenario,
        robot=robot if robot.model is None else Free(start=start),
        camera=replace(camera, latency_s=0.0),
        timing=Timing(),
        detector=Oracle(field_of_view=field_of_view),  # pyright: ignore[reportArgumentType]
        noise=Noise(),
        world=World(),
    )


def fly(scenario: Scenario, start: Array) -> Batch:
    """Ideal cameras, each from its own start, until each has ended as a run of the scenario would (`loop.run`, `loop.judge.Judge`).

    T_camera_target <- exp(-v period) T_camera_target, with v by the law's own equations. A run that has ended leaves the
    batch. Markers that a run does not see are left out of its equations. Depth and pose are true where they are solved from
    the pixels, which are exact; `constant` and `goal` depths are as they say.

    Args:
        scenario: as `ideal` makes it; its own start does not count.
        start: poses T_camera_target, shape (M, 4, 4).

    Raises:
        ParameterError: the law cannot fly a batch, or the scenario is not ideal.
    """
    flight = Flight(scenario)
    start = np.asarray(start, dtype=float).reshape(-1, 4, 4)
    parts = [_fly(flight, start[i : i + AT_ONCE]) for i in range(0, max(len(start), 1), AT_ONCE)]
    joined = {f.name: np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(Batch) if f.name != "run_steps"}
    return Batch(**joined, run_steps=sum(part.run_steps for part in parts))


@dataclass(frozen=True)
class Flight:
    """What all runs of a batch share: the scenario, and the judge's times in steps."""

    scenario: Scenario

    def __post_init__(self) -> None:
        """Refuse what a batch cannot fly."""
        s = self.scenario
        if not isinstance(s.law, BatchLaw):
            raise ParameterError("law.kind", "must have equations for many runs at once (laws.views.BatchLaw)", s.law.kind)
        if s.law.visibility.margin_px > 0:
            raise ParameterError("law.visibility.margin_px", "must be 0 in a batch", s.law.visibility.margin_px)
        if s.law.feedforward.kind != "none":
            raise ParameterError("law.feedforward", "must be none in a batch")
        if isinstance(s.law.depth, Estimate):
            raise ParameterError("law.depth", "may not be estimate in a batch; valid: pnp, constant, goal, oracle")
        if len(s.goal_views) > 1 or s.target.moves:
            raise ParameterError("goal", "must be one view of a target that stands still, in a batch")
        if s.stop.converged.error_px is None or s.stop.converged.by_estimate:
            raise ParameterError("stop.converged", "must be told by error_px alone in a batch")
        noisy = s.noise.pixel_sigma_px > 0 or s.noise.image_sigma > 0 or s.timing != Timing()
        if not (s.calibration.camera_exact and s.calibration.depth_exact):
            raise ParameterError("calibration", "must be exact in a batch, whose poses and depths are true")
        if not (s.robot.model is None and isinstance(s.detector, Oracle)) or s.camera.latency_s or noisy or s.world.plates:
            words = "must have a free camera, detector oracle, no latency, no noise and no plates for a batch; `batch.ideal` makes it so"
            raise ParameterError("scenario", words)

    @cached_property
    def law(self) -> BatchLaw:
        """The law, known to fly many."""
        assert isinstance(self.scenario.law, BatchLaw)
        return self.scenario.law

    @cached_property
    def error_px(self) -> float:
        """Under which the goal counts as reached [px]."""
        return s if (s := self.scenario.stop.converged.error_px) is not None else math.nan

    @cached_property
    def needed(self) -> int:
        """Markers without which the law orders rest."""
        return self.scenario.law.markers_needed(np.eye(6))

    @cached_property
    def posed(self) -> bool:
        """Whether the law works with a pose solved from the pixels, or with depths from it."""
        law = self.scenario.law
        return isinstance(law.depth, PnP) and law.inputs != ("relative",)

    def frames(self, duration_s: float) -> int:
        """After how many frames a time has passed."""
        return max(0, math.ceil((duration_s - SLACK_S) * self.scenario.camera.rate_hz - 1e-9))

    def goal(self, rows: NDArray[np.bool_] | slice) -> Goal:
        """The goal view of some of the markers."""
        g = self.scenario.goal_view
        return replace(g, uv=g.uv[rows], depth=g.depth[rows], ray=g.ray[rows], range=g.range[rows])


@dataclass
class _Runs:
    """The runs that still fly, m of them: `index` in the batch; frames for which each has been near and at rest; `memory`."""

    index: NDArray[np.int_]
    T: Array
    memory: Array
    near: NDArray[np.int_]
    rest: NDArray[np.int_]
    farthest: Array

    def keep(self, which: NDArray[np.bool_]) -> _Runs:
        return _Runs(*(getattr(self, f.name)[which] for f in fields(self)))


def _fly(flight: Flight, start: Array) -> Batch:
    m, stop = len(start), flight.scenario.stop
    last = flight.frames(stop.duration_s)
    runs = _Runs(np.arange(m), start, np.full((m, flight.law.state_size), np.nan), np.zeros(m, int), np.zeros(m, int), np.zeros(m))
    outcome, steps, near = np.full(m, None, dtype=object), np.zeros(m, dtype=int), np.full(m, -1)
    final, farthest, errors, crossed, done = start.copy(), np.zeros(m), np.full(m, np.nan), np.zeros(m, dtype=bool), 0
    for step in range(last + 1):
        p = transform(runs.T, flight.scenario.target.points)
        twist, error, code, ended = _frame(flight, runs, p, step, last)
        over = code != GOING
        if over.any():
            at = runs.index[over]
            outcome[at] = [CODES[c] for c in code[over]]
            steps[at], final[at], farthest[at], errors[at] = ended[over], runs.T[over], runs.farthest[over], error[over]
            reached = code[over] == _CODE[Outcome.converged]
            crossed[at] = (code[over] == _CODE[Outcome.target_lost]) & _behind(flight.scenario, runs.T[over])
            near[at] = np.where(reached, step - runs.near[over] + 1, -1)
            runs, twist = runs.keep(~over), twist[~over]
        if not len(runs.index):
            break
        done += len(runs.index)
        runs.T = exp(-flight.scenario.camera.period * twist) @ runs.T
    return Batch(outcome, steps, near, final, farthest, errors, crossed, done)


def _frame(flight: Flight, runs: _Runs, p: Array, step: int, last: int) -> tuple[Array, Array, NDArray[np.int_], NDArray[np.int_]]:
    """Of each run: twist (m, 6), RMS error (m,) [px], how it has ended (m,) or 0, and at which frame (m,).

    The order is that of `Judge.verdict`. A law that orders rest in a world that stands still rests for good, so that a
    target once lost is lost.
    """
    s = flight.scenario
    seen, error, all_seen = _seen(s, p)
    memory, twist, works = _orders(flight, runs, p, seen, step / s.camera.rate_hz)
    runs.memory = memory
    lost = ~works | ~np.isfinite(error)
    near = ~lost & all_seen & (error < flight.error_px)
    runs.near = np.where(near, runs.near + 1, 0)
    resting = ~lost & ~near & (np.abs(twist).max(axis=1) < REST)
    runs.rest = np.where(resting, runs.rest + 1, 0)
    distance = np.linalg.norm(runs.T[:, :3, 3], axis=1)
    runs.farthest = np.maximum(runs.farthest, distance)
    gone = step + flight.frames(s.stop.lost_after_s)
    code, ended = np.zeros(len(p), dtype=int), np.full(len(p), step)
    for which, how in (
        (np.full(len(p), step >= last), Outcome.timed_out),
        (runs.rest > flight.frames(REST_S), Outcome.local_minimum),
        (lost, Outcome.target_lost if gone <= last else Outcome.timed_out),
        (_behind(s, runs.T), Outcome.target_lost),
        (distance > FAR_M, Outcome.diverged),
        (runs.near > flight.frames(s.stop.converged.hold_s), Outcome.converged),
    ):
        if which.any():  # the later ones come first in the judge's order
            code[which] = _CODE[how]
            ended[which] = min(gone, last) if which is lost else step
    return np.where(works[:, None], twist, 0.0), error, code, ended


def _behind(s: Scenario, T: Array) -> NDArray[np.bool_]:
    """Which cameras are behind the plane of their target (m,)."""
    if not s.target.one_sided:
        return np.zeros(len(T), dtype=bool)
    return np.einsum("mi,mi->m", T[:, :3, 2], T[:, :3, 3]) <= 0


def _seen(s: Scenario, p: Array) -> tuple[NDArray[np.bool_], Array, NDArray[np.bool_]]:
    """Which markers p (m, N, 3) are seen (m, N), the RMS error over their coordinates (m,) [px], and whether all are seen (m,)."""
    uv = s.camera.project(p)
    seen = np.isfinite(uv[..., 0])
    if isinstance(s.detector, Oracle) and s.detector.field_of_view == "limited":
        seen &= s.camera.whole(p.reshape(-1, 3), s.target.marker.radius).reshape(seen.shape)
    d, all_seen = uv - s.goal_view.uv, np.asarray(seen.all(axis=1))
    if all_seen.all():
        return seen, np.sqrt(np.einsum("mni,mni->m", d, d) / (2 * p.shape[1])), all_seen
    d[~seen] = 0.0
    count = np.maximum(seen.sum(axis=1), 1)
    return seen, np.where(seen.any(axis=1), np.sqrt(np.einsum("mni,mni->m", d, d) / (2 * count)), np.nan), all_seen


def _orders(flight: Flight, runs: _Runs, p: Array, seen: NDArray[np.bool_], t: float) -> tuple[Array, Array, NDArray[np.bool_]]:
    """The memory (m, k) after this frame, the twists ordered (m, 6), and where the law works (m,).

    Runs that see the same markers are one group: for most frames, all markers and one group.
    """
    law, plane = flight.scenario.law, bool(PLANE_INPUTS & set(flight.scenario.law.inputs))
    usable = seen & (p[..., 2] > 0) if plane else seen
    memory, twist = runs.memory.copy(), np.full((len(p), 6), np.nan)
    groups = np.zeros(len(p), dtype=int) if usable.all() else usable @ (1 << np.arange(usable.shape[1]))
    for group in np.unique(groups):
        rows = usable[np.argmax(groups == group)]
        if np.count_nonzero(rows) < (max(flight.needed, FIRST_POSE) if flight.posed and t == 0 else flight.needed):
            continue
        which = slice(None) if len(groups) == np.count_nonzero(groups == group) else groups == group
        goal = flight.goal(slice(None) if rows.all() else rows)
        views = Views(t, p[which] if rows.all() else p[which][:, rows], runs.T[which], goal, law.depth)
        memory[which], twist[which] = flight.law.step_batch(runs.memory[which], views, goal)
        if law.inputs == ("relative",):
            twist[which] = np.where(_untold(views, goal)[:, None], np.nan, twist[which])
    return memory, twist, np.isfinite(twist[:, 0])


def _untold(views: Views, goal: Goal) -> NDArray[np.bool_]:
    """Whose homography from the goal view is open (m,): views of the plane edge on."""
    d = views.xy - views.xy.mean(axis=1, keepdims=True)
    a, b, c = (np.einsum("mn,mn->m", d[..., i], d[..., j]) for i, j in ((0, 0), (0, 1), (1, 1)))
    flat = a * c - b * b < FLAT2 * (0.5 * (a + c)) ** 2  # the product of the two eigenvalues under .15^2 times the larger's square
    open_ = np.zeros(len(d), dtype=bool)
    if flat.any():
        open_[flat] = left_open(goal.xy, views.xy[flat])
    return open_


def start_of(scenario: Scenario) -> Array:
    """The scenario's own start as T_camera_target (4, 4)."""
    T_world_camera = scenario.robot.flange_pose(scenario.robot.configuration()) @ scenario.camera.mount.T
    return inverse(T_world_camera) @ scenario.target.pose.T


def started_at(scenario: Scenario, T_camera_target: Array) -> Scenario:
    """The scenario of an ideal camera, begun from a pose T_camera_target (4, 4)."""
    T_world_flange = scenario.target.pose.T @ inverse(T_camera_target) @ inverse(scenario.camera.mount.T)
    return replace(scenario, robot=Free(start=FreeStart(nominal=Pose.of(T_world_flange))))
