"""Do the missing runs of a comparison: submit, collect, store, repeat a run whose worker died."""

from __future__ import annotations

import contextlib
import itertools
import pickle
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, fields, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np

from vstestbed.core.errors import EnvironmentLackError, ParameterError, UnreachableError, VstestbedError
from vstestbed.core.geometry import Array, exp, inverse
from vstestbed.core.outcome import Outcome
from vstestbed.core.provenance import versions
from vstestbed.laws.views import Views
from vstestbed.loop.columns import Layout
from vstestbed.loop.episode import PARTS
from vstestbed.loop.judge import BEHIND_WORDS, CROSSED_WORDS, FAR_WORDS
from vstestbed.loop.recording import MemoryRows, Recording
from vstestbed.robots import Robot
from vstestbed.robots.base import FOLLOWS
from vstestbed.scenario.dump import dump
from vstestbed.scenario.load import parse
from vstestbed.scenario.scenario import Scenario
from vstestbed.studies.batch import Batch, BatchSetup, Instant, fly, start_of
from vstestbed.studies.comparison.folder import finished, store
from vstestbed.studies.comparison.pools import (
    MOST_TRIES,
    Files,
    Pool,
    Request,
    RunRequest,
    WorkerLostError,
    completed,
    crashed,
    picture_of_the_end,
    request_of,
)
from vstestbed.studies.comparison.runs import Job
from vstestbed.studies.run_folder import files_of
from vstestbed.tasks.monitor import at_rest_words, converged_words, timed_out_words

# Runs of ideal cameras that fly in one batch, each with the folder that it would have by itself.


LEAST, MOST = 10, 50
"""Runs of a batch: with fewer a batch saves little, with more two workers could not share a comparison of some hundred runs."""
OWN = ("seed", "robot")
"""The fields in which runs of one batch may differ, and there in the start alone."""
TWIN = np.array([1.0, -0.7, 0.4, 0.6, -0.3, 0.8]) * 1e-10
"""Displacement of a run's twins [m, rad], here and there: far more than rounding does in a step."""
APART = 1e-6
"""Distance of a run from a twin at which rounding decides where it goes [m, rad]: a growth by 10^4."""


@dataclass(frozen=True)
class BatchRequest:
    """Runs that fly in one batch, as they are sent to a worker.

    Attributes:
        folder: identifies the request. text: the scenario of the first run.
        own: seed and robot of each run, pickled: the text may name the plugins with which they can be read.
    """

    folder: str
    text: str
    own: bytes

    @classmethod
    def of(cls, folder: str, scenarios: Sequence[Scenario]) -> BatchRequest:
        """The request for scenarios that differ in their starts alone; folder: of the first run."""
        first = dump(scenarios[0], defaults=True)
        return cls(f"{folder} and {len(scenarios) - 1} more", first, pickle.dumps([(s.seed, s.robot) for s in scenarios]))

    def perform(self, place: str | None = None) -> list[Files | None]:
        """The folder of each run; None for one that must fly by itself, and for all where the batch fails.

        A run flies by itself where the law does not measure all markers in all frames (what a robot without sight does is the loop's),
        and where rounding decides its way, as after an exact half turn: each has two twins that start beside it, and must stay near.

        Raises:
            EnvironmentLackError: as in `execute`.
        """
        first = parse(self.text, "scenario.yaml")
        own: list[tuple[int, Robot]] = pickle.loads(self.own)
        try:
            return _flown([replace(first, seed=seed, robot=robot) for seed, robot in own], place)
        except EnvironmentLackError:
            raise
        except Exception:  # of a law of one's own: the loop says of each run what is wrong
            return [None] * len(own)


def batches(scenarios: Sequence[Scenario | None]) -> list[list[int]]:
    """Which scenarios fly in one batch: places in the list, LEAST to MOST of them; the others fly by themselves.

    Args:
        scenarios: None for those that fly by themselves in any case.
    """
    groups: list[tuple[Scenario, list[int]]] = []
    for i, s in enumerate(scenarios):
        if s is None:
            continue
        group = next((places for head, places in groups if _differ_in_start(head, s)), None)
        if group is None:
            groups.append((s, [i]))
        else:
            group.append(i)
    return [part for head, places in groups if len(places) >= LEAST and flies_in_batch(head) for part in _parts(places)]


def flies_in_batch(scenario: Scenario) -> bool:
    """Whether a batch gives the log and the summary of a run of this scenario."""
    try:
        return BatchSetup(scenario).complete
    except ParameterError:
        return False


def _differ_in_start(a: Scenario, b: Scenario) -> bool:
    """Whether two scenarios are equal but for the seed and the robot's start."""
    names = (f.name for f in fields(a) if f.name not in OWN)
    return all(getattr(a, n) is getattr(b, n) or getattr(a, n) == getattr(b, n) for n in names) and (
        type(a.robot) is type(b.robot) and replace(a.robot, start=b.robot.start) == b.robot
    )


def _parts(places: list[int]) -> list[list[int]]:
    """The places in as few parts of up to MOST as possible, of about equal length."""
    return [list(part) for part in np.array_split(places, -(-len(places) // MOST))]


class _Record:
    """The frames of a batch, for its logs.

    Attributes:
        T, twist, error: poses T_camera_target (frames, M, 4, 4), twists (frames, M, 6), errors (frames, M) [px].
        whole: runs in which the law measured all markers in all frames (M,).
    """

    def __init__(self, runs: int):
        self._frames: list[Instant] = []
        self.whole = np.ones(runs, dtype=bool)

    def add(self, now: Instant) -> None:
        """Keep a frame."""
        self._frames.append(now)
        self.whole[now.index] &= now.whole & np.isfinite(now.twist).all(axis=1)

    def of(self, name: str) -> Array:
        """`T`, `twist` or `error` of all frames (frames, M, ...); 0 where a run has ended."""
        values = [getattr(now, name) for now in self._frames]
        out = np.zeros((len(values), len(self.whole), *values[0].shape[1:]))
        for frame, (now, value) in enumerate(zip(self._frames, values, strict=True)):
            out[frame, now.index] = value
        return out


def _flown(scenarios: list[Scenario], place: str | None) -> list[Files | None]:
    """The folders of runs that flew in one batch with their twins; None for a run that lost a marker or left a twin."""
    began = time.perf_counter()
    m, start = len(scenarios), np.array([start_of(s) for s in scenarios])
    record, setup = _Record(3 * m), BatchSetup(scenarios[0])
    flight = fly(scenarios[0], np.concatenate([start, exp(TWIN) @ start, exp(-TWIN) @ start]), record.add)
    T, twist, error = map(record.of, ("T", "twist", "error"))
    good = record.whole[:m].copy()
    for twins in (slice(m, 2 * m), slice(2 * m, 3 * m)):
        good &= record.whole[twins] & (flight.outcome[:m] == flight.outcome[twins]) & (flight.steps[:m] == flight.steps[twins])
        good &= np.abs(T[:, :m] - T[:, twins]).max(axis=(0, 2, 3)) < APART
    law_s, layout = time.perf_counter() - began, Layout(scenarios[0])
    flown: list[Files | None] = []
    for i, scenario in enumerate(scenarios):
        if not good[i]:
            flown.append(None)
            continue
        began, frames = time.perf_counter(), int(flight.steps[i]) + 1
        table = layout.stacked_rows(_stacked(setup, T[:frames, i], twist[:frames, i], error[:frames, i]))
        record_s, law_part_s = time.perf_counter() - began, law_s * frames / (flight.run_steps + 3 * m) * 3
        spent = dict.fromkeys(PARTS, 0.0) | {"law": 1e3 * law_part_s, "record": 1e3 * record_s}
        took_s, rows = law_part_s + record_s, MemoryRows(layout.columns, table)
        outcome, made_by = flight.outcome[i], versions() | {"renderer": "none"}
        reason = _reason(scenario, flight, i)
        recording = Recording(scenario, outcome, reason, rows, took_s, took_s, spent, made_by, float(table[-1, 0]))
        flown.append(_folder(recording, place))
    return flown


def _stacked(setup: BatchSetup, T: Array, twist: Array, error: Array) -> dict[str, Array]:
    """The numbers of all frames of a run (`loop.columns.kept`), from its poses (n, 4, 4), twists (n, 6) and errors (n,)."""
    s, n = setup.scenario, len(T)
    step_s, steps = s.clock
    t, p, goal = np.arange(n) * steps * step_s, s.target.points_at(T), s.goal_view
    views = Views(0.0, p, T, goal, s.law.depth, s.target.marker.radius)
    return {
        "t": t,
        "frame": np.arange(n),
        "lost": np.zeros(n, dtype=bool),
        "error_px": error,
        "t_cmd": t,
        "scale": np.ones(n),
        "uv": s.camera.project(p),
        "depth": views.depth,
        "p_camera": p,
        "T_camera": s.target.pose.T @ inverse(T),
        "T_target": np.broadcast_to(s.target.pose.T, T.shape),
        "cmd": twist,
        "act": np.vstack([np.zeros((1, 6)), twist[:-1]]),  # what was commanded a frame earlier has moved the camera until now
        "applied": twist,
        "goal_uv": np.broadcast_to(goal.uv, (n, *goal.uv.shape)),
        "T_goal": np.broadcast_to(goal.T_camera_target, T.shape),
        "view": np.zeros(n),
        "own": np.full((n, 1), FOLLOWS),
    } | dict.fromkeys(("q", "qd", "ctrl"), np.zeros((n, 0)))


def _reason(scenario: Scenario, flight: Batch, i: int) -> str:
    """Why run i ended, in the words of the monitors."""
    stop = scenario.stop
    match flight.outcome[i]:
        case Outcome.converged:
            return converged_words(stop.converged)
        case Outcome.local_minimum:
            return at_rest_words(stop.converged, float(flight.error_px[i]))
        case Outcome.diverged:
            return FAR_WORDS
        case Outcome.target_lost:  # of a law that measures all markers
            return CROSSED_WORDS if flight.steps[i] else BEHIND_WORDS
        case Outcome.unstable:
            return str(flight.unstable[i])
        case _:
            return timed_out_words(stop.duration_s)


def _folder(recording: Recording, place: str | None) -> Files:
    """The folder of a run."""
    files = files_of(recording, {"batch": True})
    if not recording.outcome.success:
        with tempfile.TemporaryDirectory(prefix="vstestbed_", dir=place) as made:
            picture_of_the_end(recording.scenario, recording.rows, Path(made))
            files["end.png"] = (Path(made) / "end.png").read_bytes()
    return files


WINDOW = 1024
"""Runs among which those that fly together are found; their scenarios are in memory, some kB each."""
WRITERS = 8
"""Threads that write folders: the disk serves what several of them flush at once, in the time of one."""
Done = list[Files | None]
"""What a worker returns: the folder of each run; None for one that must be requested by itself."""
Work = tuple[Sequence[Job | None], Request[Done]]
"""A request with its jobs, None for those that are done."""
OnDone = Callable[[Job, dict[str, Any]], None]
"""Called after every finished run with the job and its summary."""


@dataclass
class Campaign:
    """The runs of a comparison.

    Args:
        folder: the comparison's folder. jobs: all runs.
        filmed: the seeds whose runs are filmed; empty for a comparison without films.
    """

    folder: Path
    jobs: Sequence[Job]
    filmed: tuple[int | None, ...] = ()

    @property
    def done(self) -> int:
        """Number of jobs with a stored result."""
        return len(self._done)

    @cached_property
    def _done(self) -> set[str]:
        """The folders of the jobs with a stored result: read once, then kept up to date."""
        return {job.folder for job in finished(self.folder, self.jobs)}

    def run(self, pool: Pool, on_done: OnDone = lambda job, summary: None) -> None:
        """Do the missing runs.

        Raises:
            EnvironmentLackError, OutputError: no OpenGL, or nothing can be written; finished runs are kept.
        """
        again = list[Work]()
        with ThreadPoolExecutor(WRITERS) as writers:
            for jobs, request, future in completed(pool, self._requests(), again):
                again += self._keep((jobs, request), future, pool, on_done, writers)

    def _keep(self, work: Work, future: Future[Done], pool: Pool, on_done: OnDone, writers: ThreadPoolExecutor) -> list[Work]:
        """Store the folders of a request's runs; returns those that are to be done by themselves, or again."""
        jobs, request = work
        found = [(job, files) for job, files in zip(jobs, self._files(future, request, len(jobs), pool), strict=True) if job]
        store_one = partial(self._store, attempts=max(1, pool.tries(request)))
        for job, summary in writers.map(store_one, [(job, files) for job, files in found if files is not None]):
            on_done(job, summary)
        return [self._alone(job) for job, files in found if files is None]

    def _store(self, found: tuple[Job, Files], attempts: int) -> tuple[Job, dict[str, Any]]:
        job, files = found
        summary = store(self.folder, job, files, attempts)
        self._done.add(job.folder)
        return job, summary

    def _requests(self) -> Iterator[Work]:
        """All missing jobs with their requests, drawn when their turn comes; a job whose start cannot be drawn is stored as crashed."""
        done, every = set(self._done), iter(self.jobs)
        # Batches are drawn from all jobs, done or not: what flies together, and with it the last digits of the logs, depends on the
        # plan alone, not on when a comparison was cut off.
        while window := list(itertools.islice(every, WINDOW)):
            if any(job.folder not in done for job in window):
                yield from self._window(window, done)

    def _window(self, window: list[Job], done: set[str]) -> Iterator[Work]:
        """The missing jobs of a window, batches first."""
        scenarios = [_drawn(job) for job in window]
        alone = set(range(len(window)))
        for places in batches(scenarios):
            alone.difference_update(places)
            jobs = [None if window[i].folder in done else window[i] for i in places]
            if any(jobs):
                yield jobs, BatchRequest.of(window[places[0]].folder, [s for i in places if (s := scenarios[i])])
        for i in sorted(alone):
            if window[i].folder not in done:
                with contextlib.suppress(VstestbedError):
                    yield self._alone(window[i])

    def _alone(self, job: Job) -> Work:
        """A job by itself.

        Raises:
            VstestbedError: its start cannot be drawn; it is stored as crashed.
        """
        try:
            return [job], request_of(job.folder, job.scenario(), job.seed in self.filmed)
        except VstestbedError as error:
            # the scenario with the run's seed, but without its draw: there is no drawn one
            given = job.controller.scenario
            text = request_of(job.folder, given if job.seed is None else replace(given, seed=job.seed), False).text
            unreachable = isinstance(error, UnreachableError)
            files = crashed(text, error.problem, outcome=Outcome.unreachable) if unreachable else crashed(text, str(error))
            store(self.folder, job, files, attempts=1)
            self._done.add(job.folder)
            raise

    def _files(self, future: Future[Done], request: Request[Done], runs: int, pool: Pool) -> Done:
        """Content of the runs' folders; None for a run that is to be done by itself, or again."""
        try:
            return future.result()
        except WorkerLostError as error:
            if isinstance(request, RunRequest) and pool.tries(request) >= MOST_TRIES:
                return [crashed(request.text, f"{error}, and the one that tried again, too")]
            return [None] * runs


def _drawn(job: Job) -> Scenario | None:
    """The scenario of a job that may fly in a batch; None for one that flies by itself in any case."""
    # The first start of a comparison without tasks, which may be filmed: with and without films, batches are the same.
    if job.seed is None or (job.seed == 0 and job.controller.runs is None) or not flies_in_batch(job.controller.scenario):
        return None
    with contextlib.suppress(VstestbedError):
        return job.scenario()
    return None
