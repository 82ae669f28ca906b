"""One run in a worker process, whose folder is returned as bytes. Independent of the number of workers and of their machines."""

from __future__ import annotations

import json
import multiprocessing
import os
import signal
import tempfile
import threading
import traceback
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol, TypeVar

from vstestbed.core.errors import EnvironmentLackError, UnreachableError
from vstestbed.core.outcome import Outcome
from vstestbed.core.shares import STOPS
from vstestbed.experiments.run_folder import run_into
from vstestbed.loop.recording import Rows
from vstestbed.scenario.dump import dump
from vstestbed.scenario.load import parse
from vstestbed.scenario.scenario import Scenario

Files = dict[str, bytes]
"""Content of a run's folder by file name."""
Done_co = TypeVar("Done_co", covariant=True)
TILE_PX = (480, 270)
"""Size of the films from outside [px]: as wide as their column in the side-by-side film; a sixth of the work of the full size."""


@dataclass(frozen=True)
class RunRequest:
    """A run as it is sent to a worker, which needs no file of the sender's machine.

    Attributes:
        folder: path of the run below the comparison's folder, which identifies it. text: the scenario with start and noise drawn.
        filmed: whether to make films.
    """

    folder: str
    text: str
    filmed: bool

    def perform(self, place: str | None = None) -> list[Files | None]:
        """The folder of the run (`execute`)."""
        return [execute(self, place)]


class Request(Protocol[Done_co]):
    """One run or several, as they are sent to a worker."""

    @property
    def folder(self) -> str:
        """Identifies it: of a single run of a comparison its path below the comparison's folder."""
        ...

    def perform(self, place: str | None = None) -> Done_co:
        """Do it; `place`: of temporary files, None where TMPDIR says."""
        ...


def perform(request: Request[Done_co], place: str | None = None) -> Done_co:
    """Do what a request asks for: a function, as pools need it."""
    return request.perform(place)


def execute(request: RunRequest, place: str | None = None) -> Files:
    """Run a scenario and return its folder. An exception in a law, a detector or a plugin gives the outcome `crashed` and a traceback,
    a start at which an arm falls `unreachable`.

    Args:
        request: the run. place: where its folder is made; None: where TMPDIR says.

    Raises:
        EnvironmentLackError: this machine has no OpenGL or no space, so that every other run would fail as well.
        PluginError: a plugin of the scenario is not there on this machine.
    """
    scenario = parse(request.text, "scenario.yaml")
    # the run's folder is local: the worker may be on a machine without access to the comparison's folder
    with tempfile.TemporaryDirectory(prefix="vstestbed_", dir=place) as made:
        folder = Path(made) / "run"
        folder.mkdir()
        try:
            recording = run_into(folder, scenario, "both" if request.filmed else "none", report=False, tile_px=TILE_PX)
            # a picture of every failure for the report's gallery; films are made of the first seed only
            if not recording.outcome.success and len(recording.rows):
                picture_of_the_end(scenario, recording.rows, folder)
        except EnvironmentLackError:  # no fault of the run: the comparison stops
            raise
        except UnreachableError as error:  # its motors cannot hold it there
            return crashed(request.text, error.problem, outcome=Outcome.unreachable)
        except (Exception, SystemExit) as error:  # a plugin that calls sys.exit ends its run, not the worker
            return crashed(request.text, f"{type(error).__name__}: {error}", traceback.format_exc(), _files(folder))
        return _files(folder)


def _files(folder: Path) -> Files:
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in folder.rglob("*") if p.is_file()} if folder.is_dir() else {}


def crashed(text: str, reason: str, trace: str = "", rest: Files | None = None, outcome: Outcome = Outcome.crashed) -> Files:
    """The folder of a crashed run, or of one that could not begin: scenario, summary, traceback, and `rest`, the files that it has left."""
    scenario = parse(text, "scenario.yaml")
    summary = {"scenario": scenario.name, "outcome": outcome.name, "success": False, "reason": reason, "seed": scenario.seed}
    own = {"scenario.yaml": text.encode(), "summary.json": (json.dumps(summary, indent=1) + "\n").encode()}
    return (rest or {}) | own | ({"error.txt": trace.encode()} if trace else {})


def picture_of_the_end(scenario: Scenario, rows: Rows, folder: Path) -> None:
    """Write `end.png`: the scene from outside at the end of a failed run."""
    from vstestbed.report.video import film
    from vstestbed.report.video.quality import FINE

    film.picture_of_the_end(scenario, rows, folder / "end.png", replace(FINE, size=TILE_PX))


def request_of(folder: str, scenario: Scenario, filmed: bool) -> RunRequest:
    """The request for a run of a scenario."""
    return RunRequest(folder, dump(scenario, defaults=True), filmed)


def begin(place: str) -> None:
    """Initialise a worker process: leave signals for the whole group to its parent, and exit when the parent is gone.

    Args:
        place: folder of its temporary files; by TMPDIR alone, Python takes another one where the disk is full, and runs are done in vain.
    """
    tempfile.tempdir = place
    for number in STOPS:
        signal.signal(number, signal.SIG_IGN)
    if hasattr(signal, "pthread_sigmask"):  # held back while it started
        signal.pthread_sigmask(signal.SIG_UNBLOCK, STOPS)

    def follow() -> None:  # a killed parent cannot end its workers
        parent = multiprocessing.parent_process()
        if parent is not None:
            parent.join()
            os._exit(1)  # not sys.exit, which in a thread ends only the thread

    threading.Thread(target=follow, daemon=True).start()


def process_id() -> int:
    """Process id of the worker, with which the pool can kill it."""
    return os.getpid()
