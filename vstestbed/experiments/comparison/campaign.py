"""Do the missing runs of a comparison: submit, collect, store, repeat a run whose worker died."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from vstestbed.core.errors import VstestbedError
from vstestbed.experiments.comparison.folder import finished, store
from vstestbed.experiments.comparison.pools import Pool, WorkerLostError
from vstestbed.experiments.comparison.runs import Job
from vstestbed.experiments.comparison.worker import Files, RunRequest, crashed, request_of

MOST_TRIES = 2
"""Attempts at a run: one that kills its worker (out of memory, a crash in a library) would do so for ever."""
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
        return sum(1 for _ in finished(self.folder, self.jobs))

    @property
    def missing(self) -> Iterator[Job]:
        """The jobs without a stored result."""
        done = {job.folder for job in finished(self.folder, self.jobs)}
        return (job for job in self.jobs if job.folder not in done)

    def run(self, pool: Pool, on_done: OnDone = lambda job, summary: None) -> None:
        """Do the missing runs.

        Raises:
            EnvironmentLackError, OutputError: no OpenGL, or nothing can be written; finished runs are kept.
        """
        waiting = self._requests()
        going: dict[Future[Files], tuple[Job, RunRequest]] = {}
        again: list[tuple[Job, RunRequest]] = []
        while True:
            # lost runs first; the pool is kept full, but never gets more than it has room for: scenarios are drawn only when needed
            while len(going) < pool.room and (next_ := again.pop() if again else next(waiting, None)):
                going[pool.submit(next_[1])] = next_
            if not going:
                return
            for future in wait(going, return_when=FIRST_COMPLETED).done:
                job, request = going.pop(future)
                files = self._files(future, request, pool)
                if files is None:
                    again.append((job, request))
                else:
                    on_done(job, store(self.folder, job, files, max(1, pool.tries(request))))

    def _requests(self) -> Iterator[tuple[Job, RunRequest]]:
        """Each job with its request, drawn when its turn comes; a job whose start cannot be drawn is stored as crashed."""
        for job in self.missing:
            try:
                yield job, request_of(job.folder, job.scenario(), job.seed in self.filmed)
            except VstestbedError as error:
                # the scenario without the seed's draw: there is no drawn one
                text = request_of(job.folder, job.controller.scenario, False).text
                store(self.folder, job, crashed(text, str(error)), attempts=1)

    def _files(self, future: Future[Files], request: RunRequest, pool: Pool) -> Files | None:
        """Content of a run's folder; None if the run is to be repeated."""
        try:
            return future.result()
        except WorkerLostError as error:
            if pool.tries(request) < MOST_TRIES:
                return None
            return crashed(request.text, f"{error}, and the one that tried again, too")
