"""Do the missing runs of a comparison: submit, collect, store, repeat a run whose worker died."""

from __future__ import annotations

import contextlib
import itertools
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

from vstestbed.core.errors import UnreachableError, VstestbedError
from vstestbed.core.outcome import Outcome
from vstestbed.experiments.comparison.flights import BatchRequest, batches, flies_in_batch
from vstestbed.experiments.comparison.folder import finished, store
from vstestbed.experiments.comparison.pools import MOST_TRIES, Pool, WorkerLostError, completed
from vstestbed.experiments.comparison.runs import Job
from vstestbed.experiments.comparison.worker import Files, Request, RunRequest, crashed, request_of
from vstestbed.scenario.scenario import Scenario

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
