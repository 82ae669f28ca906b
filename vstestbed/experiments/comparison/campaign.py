"""Run what is missing of a comparison: submit, collect, write, try again where a worker died."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from vstestbed.core.errors import VstestbedError
from vstestbed.experiments.comparison.folder import is_done, store
from vstestbed.experiments.comparison.plan import Job
from vstestbed.experiments.comparison.pools import Pool, WorkerLostError
from vstestbed.experiments.comparison.worker import Files, RunRequest, crashed, request_of

MOST_TRIES = 2
"""A run whose worker died is begun once more."""
Told = Callable[[Job, dict[str, Any]], None]
"""Hears of every finished run: the job and its summary."""


@dataclass
class Campaign:
    """The runs of a comparison.

    Args:
        folder: where they go. jobs: all of them. plugins: modules that workers import first.
        filmed: the seed whose runs are filmed; a comparison without films has none.
    """

    folder: Path
    jobs: Sequence[Job]
    plugins: tuple[str, ...] = ()
    filmed: tuple[int | None, ...] = ()

    @property
    def missing(self) -> list[Job]:
        """The jobs that are not done yet."""
        return [job for job in self.jobs if not is_done(self.folder, job)]

    def run(self, pool: Pool, told: Told = lambda job, summary: None) -> None:
        """Do what is missing.

        Raises:
            EnvironmentLackError, OutputError: nothing can be drawn or written here; what is done so far stays.
        """
        waiting = self._requests()
        going: dict[Future[Files], tuple[Job, RunRequest]] = {}
        again: list[tuple[Job, RunRequest]] = []
        while True:
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
                    told(job, store(self.folder, job, files, max(1, pool.tries(request))))

    def _requests(self) -> Iterator[tuple[Job, RunRequest]]:
        """Each job with its request, drawn when its turn comes; a start that cannot be drawn is a run that crashed."""
        for job in self.missing:
            try:
                yield job, request_of(job.folder, job.scenario(), job.seed in self.filmed, self.plugins)
            except VstestbedError as error:
                text = request_of(job.folder, job.controller.scenario, False, ()).text
                store(self.folder, job, crashed(text, str(error)), attempts=1)

    def _files(self, future: Future[Files], request: RunRequest, pool: Pool) -> Files | None:
        """A run's folder; None where it is to be begun again."""
        try:
            return future.result()
        except WorkerLostError as error:
            if pool.tries(request) < MOST_TRIES:
                return None
            return crashed(request.text, f"{error}, and the one that tried again, too")
