"""Do the missing runs of a comparison: submit, collect, store, repeat a run whose worker died."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from vstestbed.core.errors import UnreachableError, VstestbedError
from vstestbed.core.outcome import Outcome
from vstestbed.studies.comparison.folder import finished, store
from vstestbed.studies.comparison.pools import MOST_TRIES, Files, Pool, RunRequest, WorkerLostError, completed, crashed, request_of
from vstestbed.studies.comparison.runs import Job

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
        again = list[tuple[Job, RunRequest]]()
        for job, request, future in completed(pool, self._requests(on_done), again):
            try:
                files = future.result()
            except WorkerLostError as error:
                if pool.tries(request) < MOST_TRIES:
                    again.append((job, request))
                    continue
                files = crashed(request.text, f"{error}, and the one that tried again, too")
            self._store(job, files, max(1, pool.tries(request)), on_done)

    def _store(self, job: Job, files: Files, attempts: int, on_done: OnDone) -> None:
        summary = store(self.folder, job, files, attempts)
        self._done.add(job.folder)
        on_done(job, summary)

    def _requests(self, on_done: OnDone) -> Iterator[tuple[Job, RunRequest]]:
        """All missing jobs with their requests, drawn when their turn comes; a job whose start cannot be drawn is stored at once."""
        for job in self.jobs:
            if job.folder in self._done:
                continue
            try:
                scenario = job.scenario()
            except VstestbedError as error:
                self._store(job, _without_start(job, error), 1, on_done)
            else:
                yield job, request_of(job.folder, scenario, job.seed in self.filmed)


def _without_start(job: Job, error: VstestbedError) -> Files:
    """The folder of a run whose start cannot be drawn: with the scenario as it was given, and the run's seed."""
    given = job.controller.scenario
    text = request_of(job.folder, given if job.seed is None else replace(given, seed=job.seed), False).text
    if isinstance(error, UnreachableError):
        return crashed(text, error.problem, outcome=Outcome.unreachable)
    return crashed(text, str(error))
