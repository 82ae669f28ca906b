"""The runs of a comparison: each in a worker process, which returns its folder as bytes; what is
missing is done, stored, repeated.
"""

from __future__ import annotations

import tempfile
import traceback
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from vstestbed.core.errors import EnvironmentLackError, UnreachableError, VstestbedError
from vstestbed.core.files import unflushed
from vstestbed.core.outcome import Outcome
from vstestbed.loop.log_file import Log
from vstestbed.loop.session import uninterrupted
from vstestbed.scenario.dump import given_text
from vstestbed.scenario.load import GIVEN, parse
from vstestbed.scenario.scenario import Scenario
from vstestbed.studies.comparison.folder import finished
from vstestbed.studies.comparison.plan import Job, Jobs
from vstestbed.studies.comparison.shards import Share
from vstestbed.studies.pools import MOST_TRIES, Pool, Request, WorkerLostError, completed
from vstestbed.studies.run_folder import ASSETS, Files, files_in, files_of_failure, run_into, store

__all__ = ["OnDone", "Runner", "is_light"]

TILE_PX = (480, 270)
"""Size of the films from outside [px]: as wide as their column in the side-by-side film; a sixth of
the work of the full size.
"""


def request_of(folder: str, scenario: Scenario, filmed: bool) -> Request[Files]:
    """The request for a run, which needs no file of the sender's machine. folder: below the
    comparison's. filmed: whether to make films.
    """
    return Request(
        folder, perform, (given_text(scenario), filmed), not filmed and is_light(scenario)
    )


def perform(text: str, filmed: bool, place: str | None = None) -> Files:
    """Run a scenario as given and return its folder, which is made in `place` (None: where TMPDIR
    says).

    An exception in a law, a detector or a plugin gives the outcome `crashed` and a traceback, a
    start at which an arm falls `unreachable`.
    Raises EnvironmentLackError: this machine has no OpenGL or no space, so that every other run
    would fail as well. PluginError: a plugin of the scenario is not there on this machine.
    """
    scenario = parse(text, GIVEN)
    # the run's folder is local: the worker may be on a machine without access to the comparison's
    # folder
    with tempfile.TemporaryDirectory(prefix="vstestbed_", dir=place) as made, unflushed():
        folder = Path(made) / "run"
        folder.mkdir()
        try:
            recording = uninterrupted(
                run_into(
                    folder, scenario, "both" if filmed else "none", report=False, tile_px=TILE_PX
                )
            )
            # a picture of every failure for the report's gallery; films are made of the first seed
            # only
            if not recording.outcome.success and len(recording.rows):
                picture_of_the_end(recording.scenario, recording.rows, folder)
        except EnvironmentLackError:  # no fault of the run: the comparison stops
            raise
        except UnreachableError as error:  # its motors cannot hold it there
            return files_of_failure(text, error.problem, outcome=Outcome.unreachable)
        except (Exception, SystemExit) as error:
            # a plugin that calls sys.exit ends its run, not the worker
            return files_of_failure(
                text, f"{type(error).__name__}: {error}", traceback.format_exc(), files_in(folder)
            )
        return files_in(folder)


MOST_FRAMES = 10_000  # of a light run, which then takes a second or two at most


def is_light(scenario: Scenario) -> bool:
    """Whether its runs take some hundredths of a second, by code of this package alone: of an ideal
    camera without pictures or plugins.
    """
    short = scenario.stop.duration_s * scenario.camera.rate_hz <= MOST_FRAMES
    package = (
        type(scenario.law).__module__.startswith("vstestbed.")
        and scenario.law.kind != "policy"
        and not scenario.plugins
    )
    return short and package and scenario.robot.body is None and not scenario.detector.needs_image


def picture_of_the_end(scenario: Scenario, rows: Log, folder: Path) -> None:
    """Write `end.png`: the scene from outside at the end of a failed run."""
    from vstestbed.report.video import film
    from vstestbed.report.video.film import FINE

    film.picture_of_the_end(scenario, rows, folder / "end.png", replace(FINE, size=TILE_PX))


# called after every finished run with the job and its summary
OnDone = Callable[[Job, dict[str, Any]], None]


@dataclass
class Runner:
    """The runs of a comparison.

    Args:
        folder: the comparison's folder. jobs: all runs. filmed: the seeds whose runs are filmed;
            empty for a comparison without films.
    """

    folder: Path
    jobs: Jobs | Share | Sequence[Job]
    filmed: tuple[int | None, ...] = ()

    def scenarios(self) -> Iterator[Scenario]:
        """What flies, without starts and seeds."""
        yield from {id(job.controller): job.controller.scenario for job in self.jobs}.values()

    @property
    def done(self) -> int:
        """Number of jobs with a stored result."""
        return len(self._done)

    @cached_property
    def _done(self) -> set[str]:
        """The folders of the jobs with a stored result: read once, then kept up to date; read again
        after Ctrl-C.
        """
        return {job.folder for job, _ in finished(self.folder, self.jobs)}

    def run(self, pool: Pool, on_done: OnDone = lambda job, summary: None) -> None:
        """Do the missing runs. Raises EnvironmentLackError, OutputError: no OpenGL, or nothing can
        be written; finished runs are kept.
        """
        again = list[tuple[Job, Request[Files]]]()
        try:
            for job, request, future in completed(pool, self._requests(pool, on_done), again):
                try:
                    files = future.result()
                except WorkerLostError as error:
                    if pool.tries(request) < MOST_TRIES:
                        again.append((job, request))
                        continue
                    files = files_of_failure(
                        request.arguments[0], f"{error}, and the one that tried again, too"
                    )
                self._store(job, files, max(1, pool.tries(request)), on_done)
        except KeyboardInterrupt:
            # it may have come after a run was stored and before it was counted
            vars(self).pop("_done", None)
            raise

    def _store(self, job: Job, files: Files, attempts: int, on_done: OnDone) -> None:
        summary = store(self.folder / job.folder, files, self.folder / ASSETS, attempts)
        self._done.add(job.folder)
        on_done(job, summary)

    def _requests(self, pool: Pool, on_done: OnDone) -> Iterator[tuple[Job, Request[Files]]]:
        """All missing jobs with their requests, drawn when their turn comes; a job whose start
        cannot be drawn is stored at once.
        """
        for job in self.jobs:
            if job.folder in self._done:
                continue
            try:
                scenario = job.scenario()
            except VstestbedError as error:
                given = job.controller.scenario  # with the run's seed, without its start
                text = given_text(given if job.seed is None else given.but(seed=job.seed))
                if isinstance(error, UnreachableError):
                    files = files_of_failure(text, error.problem, outcome=Outcome.unreachable)
                else:
                    files = files_of_failure(text, str(error))
                self._store(job, files, 1, on_done)
            else:
                yield job, request_of(job.folder, scenario, pool.films and job.seed in self.filmed)
