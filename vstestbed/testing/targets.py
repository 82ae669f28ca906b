"""What every target must do."""

from __future__ import annotations

from contextlib import closing
from dataclasses import replace

import numpy as np

from vstestbed.camera import Perspective
from vstestbed.core.geometry import Array, Pose, inverse, transform
from vstestbed.core.outcome import Outcome
from vstestbed.core.registry import Contract
from vstestbed.loop.recording import Recording
from vstestbed.loop.session import run, uninterrupted
from vstestbed.robots import Free
from vstestbed.robots.free import FreeStart
from vstestbed.scenario.scenario import Scenario
from vstestbed.sim.base import SceneDescription
from vstestbed.sim.scene.scene import Scene
from vstestbed.sim.scene.world import World
from vstestbed.targets import Target
from vstestbed.targets.motion import MotionBase
from vstestbed.tasks import Task
from vstestbed.testing.robots import must_refuse


def check_target(target: Target) -> None:
    """A target has its markers where it says, is seen where it is, and stands so in the compiled
    scene.
    """
    Contract(Target, base=Target).check(type(target))
    points = target.points
    places = target.places
    assert points.ndim == 2 and points.shape[1] == 3, (
        f"points must have shape (N, 3), got {points.shape}"
    )
    assert np.isfinite(points).all(), "points must be finite"
    assert len(places) in (0, len(points)), (
        f"places must be all {len(points)} points or none, got {len(places)}"
    )
    assert len(target.hues_deg) == len(points), (
        f"each of {len(points)} markers needs a hue, got {len(target.hues_deg)}"
    )
    if len(places) > 1:  # a kind may forget to refuse markers that overlap
        gaps = np.linalg.norm(places[:, None] - places[None], axis=-1) + np.eye(len(places)) * 1e9
        target.marker.check_spacing(float(gaps.min()), len(places))
    T_camera_target = Pose(xyz=(0.1, -0.2, 2.0), rpy_deg=(5, -10, 20)).T
    if len(places):
        T_target_camera = inverse(T_camera_target)
        seen = target.seen_from(T_target_camera)
        error = np.abs(seen - transform(inverse(T_target_camera), points)).max()
        assert error < 1e-12, (
            f"seen_from must be points in the camera's frame, it is {error:.2g} m off"
        )
    _check_scene(target)


def _check_scene(target: Target) -> None:
    """The target compiles, and its markers stand where it says."""
    robot = Free(start=FreeStart(nominal=Pose(xyz=(0, 0, -2))))
    # out of the way of markers; lines lie on it
    world = World(floor_z=-50.0 if len(target.places) else 0.0)
    description = SceneDescription(robot, Perspective(), target, world, step=0.002)
    with closing(Scene(description)) as stage:
        for i, place in enumerate(target.places):
            found = stage.model.site(f"target/marker_{i}").pos
            assert np.allclose(found, place, atol=1e-6), (
                f"marker {i} stands at {found} in the scene and at {place} in the target"
            )


# What every motion of a target must do.
SPAN_S, STEP_S = 10.0, 1e-3
FASTEST_MPS = 50.0  # A path that moves by more than that is taken to jump [m/s]


def check_motion(motion: MotionBase) -> None:
    """The path is rigid, continuous, a function of time alone once its seed is given, and starts in
    one place whatever the seed.

    `draws` says whether another seed gives another path: a motion that draws without saying so is
    refused more than one seed.
    """
    assert isinstance(motion, MotionBase), (
        f"{type(motion).__name__}: a motion must derive from vstestbed.MotionBase"
    )
    rest = Pose(xyz=(1, 2, 3), rpy_deg=(10, -20, 30)).T
    start = motion.start(rest)
    assert start.shape == (4, 4) and np.isfinite(start).all(), (
        f"{motion.kind}: start(pose) must be a pose (4, 4), got {start}"
    )
    if motion.moves and not motion.by_itself:
        words = (
            f"{motion.kind}: a target that is carried has no path; path must raise ParameterError"
        )
        must_refuse(lambda: motion.path(np.random.default_rng(0)), words)
        return
    times = np.arange(0.0, SPAN_S, STEP_S)
    D = _along(motion, times)
    _check_rigid(motion, D)
    jumps = np.abs(np.diff(D[:, :3, 3], axis=0)).max(axis=1)
    when = times[jumps.argmax()]
    assert jumps.max() <= FASTEST_MPS * STEP_S, (
        f"{motion.kind}: the path jumps by {jumps.max():.3g} m within {STEP_S:g} s at {when:.3f} s"
    )
    backwards = _along(motion, times[::-500])[::-1]
    assert np.array_equal(backwards, D[::-500][::-1]), (
        f"{motion.kind}: another path when the times are asked for backwards"
    )
    _check_start(motion, rest, D[0])
    _check_declared(motion, times, D)


def _check_declared(motion: MotionBase, times: Array, D: Array) -> None:
    """`draws` and `moves` are true of the path: displacements (n, 4, 4) at times (n,) [s]."""
    drawn = not np.array_equal(_along(motion, times, seed=8), D)
    another = "another" if drawn else "the same"
    assert drawn is motion.draws, (
        f"{motion.kind}: `draws` is {motion.draws}, and another seed gives {another} path"
    )
    still = bool(np.all(D[0] == D))
    how = "stands still" if still else "moves"
    assert still is not motion.moves, (
        f"{motion.kind}: `moves` is {motion.moves}, and the path {how}"
    )


def _check_rigid(motion: MotionBase, D: Array) -> None:
    """Displacements (n, 4, 4) are motions of a rigid body."""
    assert D.shape[1:] == (4, 4) and np.isfinite(D).all(), (
        f"{motion.kind}: a displacement must be a finite matrix (4, 4)"
    )
    R = D[:, :3, :3]
    off = float(np.abs(R @ R.mT - np.eye(3)).max())
    assert off < 1e-9, (
        f"{motion.kind}: the rotation of a displacement must be orthonormal, it is {off:.3g} off"
    )
    assert (np.linalg.det(R) > 0).all(), (
        f"{motion.kind}: the rotation of a displacement must not mirror"
    )
    last = np.tile([0.0, 0, 0, 1], (len(D), 1))
    assert np.array_equal(D[:, 3], last), (
        f"{motion.kind}: the last row of a displacement must be 0 0 0 1"
    )


def _check_start(motion: MotionBase, rest: Array, D: Array) -> None:
    """The displacement at 0 s (4, 4) is that of every seed, and where `start` says."""
    for seed in range(3):
        off = float(np.abs(motion.path(np.random.default_rng(seed))(0.0) - D).max())
        assert off < 1e-12, (
            f"{motion.kind}: every seed must start at the same place, one is {off:.3g} off"
        )
    off = float(np.abs(rest @ D - motion.start(rest)).max())
    assert off < 1e-9, (
        f"{motion.kind}: start(pose) must be pose @ path(rng)(0), it is {off:.3g} off"
    )


def _along(motion: MotionBase, times: Array, seed: int = 7) -> Array:
    """Displacements (n, 4, 4) of one seed at times (n,) [s]."""
    at = motion.path(np.random.default_rng(seed))
    return np.array([at(float(t)) for t in times])


# What every task must do.
SHORT_FRAMES = 3  # A run of so many frames cannot end a task


def check_task(scenario: Scenario) -> None:
    """A task ends as it should: reached in its scenario, not reached when there is no time; its
    columns are in the log.
    """
    task = scenario.goal
    Contract(Task, base=Task).check(type(task))
    n = len(scenario.goal_views)
    poses = len(scenario.goal_poses)
    assert poses == n, f"{task.kind}: each of {n} goal views needs its pose, there are {poses}"
    numbers = [view.view for view in scenario.goal_views]
    assert numbers == list(range(n)), (
        f"{task.kind}: goal views must be numbered 0 to {n - 1}, got {numbers}"
    )
    stop = replace(scenario.stop, duration_s=SHORT_FRAMES * scenario.camera.period)
    short = uninterrupted(run(replace(scenario, stop=stop)))
    assert short.outcome is Outcome.timed_out, (
        f"{task.kind}: 3 frames must not be enough, {short.outcome.name}: {short.reason}"
    )
    whole = uninterrupted(run(scenario))
    assert whole.outcome is task.ends, (
        f"{task.kind}: must end {task.ends.name}, ended {whole.outcome.name}: {whole.reason}"
    )
    own = [name for name in scenario.own_columns if name not in whole.columns]
    assert not own, f"{task.kind}: its log lacks the columns {', '.join(own)}"
    if task.continuing:
        _check_continuing(task, whole)


def _check_continuing(task: Task, whole: Recording) -> None:
    """The logged error was within the tolerance, since the run counts as completed."""
    assert "task_error_m" in whole.columns, (
        f"{task.kind}: a continuing task must log its error as task_error_m [m]"
    )
    assert task.tolerance_m is not None, f"{task.kind}: a continuing task must have a tolerance_m"
    worst = float(np.abs(whole["task_error_m"][whole["t"] >= task.settle_s]).max())
    assert worst <= task.tolerance_m, (
        f"{task.kind}: completed with an error of {worst:.3g} m, over its tolerance"
    )
