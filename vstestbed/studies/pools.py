"""Pools of workers for all studies: processes of this machine, or of a dask cluster. Both take
requests and return futures.
"""

from __future__ import annotations

import logging
import multiprocessing
import os
import re
import shutil
import signal
import tempfile
import threading
import time
import uuid
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import CancelledError, Future, ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import get_context, resource_tracker
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from vstestbed.core import apps
from vstestbed.core.errors import EnvironmentLackError, ParameterError
from vstestbed.core.files import writing
from vstestbed.core.shares import STOPS, at_once, some_done

if TYPE_CHECKING:
    from vstestbed.scenario.scenario import Scenario

__all__ = [
    "MOST_TRIES",
    "Done",
    "LocalPool",
    "Pool",
    "Request",
    "WorkerLostError",
    "clear",
    "completed",
    "must_be_known",
    "must_not_be_worker",
    "pool_of",
    "workers",
]

Done_co = TypeVar("Done_co", covariant=True)


@dataclass(frozen=True)
class Request(Generic[Done_co]):
    """One run or several, as they are sent to a worker: a function of a module, its arguments, and
    `place` of temporary files. folder: identifies it, of a single run of a comparison its path
    below the comparison's folder. light: it may be done in the study's own process, in some
    hundredths of a second and by code of this package alone.
    """

    folder: str
    function: Callable[..., Done_co]
    arguments: tuple[Any, ...]
    light: bool = False

    def perform(self, place: str | None = None) -> Done_co:
        """Do it; place: None where TMPDIR says."""
        return self.function(*self.arguments, place=place)


def begin(place: str) -> None:
    """Initialise a worker process: leave signals for the whole group to its parent, and exit when
    the parent is gone. place: folder of its temporary files; by TMPDIR alone, Python takes another
    one where the disk is full, and runs are done in vain.
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


ONE_CORE = {
    "LP_NUM_THREADS": "0",
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
}
"""Environment of a worker, which has one core: no extra threads of Mesa's software renderer (LP) or
of BLAS.
"""
KEEP_MEMORY = {
    "MALLOC_MMAP_THRESHOLD_": str(1 << 25),
    "MALLOC_TRIM_THRESHOLD_": str(1 << 28),
    "MALLOC_TOP_PAD_": str(1 << 26),
}
"""The same for glibc: freed memory stays with the process, since SIFT's pyramids, 5 MB an image,
otherwise cost a page fault for each page of each picture: an eighth of the time of a run with SIFT
in every picture.
"""
DASK = "dask://"
Done = TypeVar("Done")
Of = TypeVar("Of")
Asked = TypeVar("Asked", bound=Request[Any])
# attempts at a run: one that kills its worker (out of memory, a crash in a library) would do so for
# ever
MOST_TRIES = 2
HERE_S = 5.0
"""Processor time of light runs after which workers are started for the rest: on a loaded machine
two need about as much to start [s].
"""
RUNNING = ".running"  # folder of the workers' temporary files in a study's folder


class WorkerLostError(Exception):
    """The worker process of a run has died: killed, out of memory, or a crash in a library."""


def completed(
    pool: Pool, work: Iterable[tuple[Of, Asked]], again: list[tuple[Of, Asked]]
) -> Iterator[tuple[Of, Asked, Future[Any]]]:
    """Do requests; each is given back with its future as it is done, in any order, those with a
    result before those with an error.

    pool: is kept full, but never gets more than it has room for. work: requests, each with what it
    is of; made when they are asked for, one of them ahead, while the workers are busy. again: work
    that the caller adds while this goes on, which comes first.
    """
    rest, going, ended = (
        iter(work),
        dict[Future[Any], tuple[Of, Asked]](),
        list[tuple[Of, Asked, Future[Any]]](),
    )
    following = next(rest, None)
    while True:
        while len(going) < pool.room and (now := again.pop() if again else following):
            going[pool.submit(now[1])] = now
            if now is following:
                following = next(rest, None)
        pool.dispatch()
        # after the pool has been filled, which goes on while the caller keeps what is done
        yield from ended
        if not (going or again or following):
            return
        done = sorted(some_done(going), key=lambda future: future.exception() is not None)
        ended = [(*going.pop(future), future) for future in done]


@contextmanager
def _environment(defaults: dict[str, str], overrides: dict[str, str]) -> Iterator[None]:
    """Environment variables for a process that is started meanwhile: defaults where the user has
    set none, and overrides.
    """
    changed = {k: v for k, v in defaults.items() if k not in os.environ} | overrides
    before = {name: os.environ.get(name) for name in changed}
    os.environ.update(changed)
    try:
        yield
    finally:
        # the changed ones alone: another thread may have changed others meanwhile
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


@contextmanager
def _signals_held_back() -> Iterator[None]:
    """A process that is started meanwhile receives no Ctrl-C before `begin` ignores it: its imports
    would end with a traceback.
    """
    # Windows, where console processes cannot hold it back
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    resource_tracker.ensure_running()  # here, since it lets the signals pass again when it starts
    before = signal.pthread_sigmask(signal.SIG_BLOCK, STOPS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


class _Slot:
    """One worker process, restarted after it has died.

    Each has an executor of its own: the death of one process breaks its executor as a whole, and
    all other runs in it.
    """

    def __init__(self, place: str):
        self._place = place
        self.broken = False
        self.start()

    def start(self) -> None:
        """Start the process; its temporary files go to the pool's folder, which is removed also if
        the process is killed.
        """
        self.executor = ProcessPoolExecutor(
            1, mp_context=get_context("spawn"), initializer=begin, initargs=(self._place,)
        )
        self.broken = False
        # the process starts with the first submission, so that it inherits these variables, and
        # what is held back
        with _environment(ONE_CORE | KEEP_MEMORY, {"TMPDIR": self._place}), _signals_held_back():
            self.pid = self.executor.submit(os.getpid)

    def run(self, request: Request[Done]) -> Future[Done]:
        """Start a run, in a new process if the last one has died."""
        try:
            if not self.broken:
                return self.executor.submit(request.perform)
        except BrokenProcessPool:  # killed while it was idle
            pass
        self.kill()
        self.executor.shutdown(wait=False, cancel_futures=True)
        self.start()
        return self.executor.submit(request.perform)

    @property
    def answered(self) -> bool:
        """Whether the process has ever answered: one that never did cannot start at all."""
        return self.pid.done() and self.pid.exception() is None

    def kill(self) -> None:
        """Kill the process, also one that is still starting: its run would otherwise go on, and
        hold this process at its end.
        """
        # public only from Python 3.14 on (kill_workers)
        for process in list((self.executor._processes or {}).values()):
            process.kill()


def clear(folder: Path) -> Path:
    """Remove what a killed process has left of its temporary files in a study's folder; returns
    their place.
    """
    place = folder.absolute() / RUNNING
    shutil.rmtree(place, ignore_errors=True)
    return place


class LocalPool:
    """Processes of this machine, each with one OpenGL context and one core, which start when this
    process has enough work for them.

    Attribute films: it makes films where they are asked for.

    Args:
        jobs: number of processes.
        folder: the study's folder, held by this process. Temporary files stand in `.running` in it,
            where the next process that holds the folder removes what a killed one has left.
    """

    films = True

    def __init__(self, jobs: int, folder: Path):
        self.room, self._here_s = jobs, 0.0
        place = clear(folder)
        with writing(folder):
            place.mkdir(exist_ok=True)
            # another one each time: a worker of a killed process may live a moment longer
            self._place = tempfile.mkdtemp(dir=place)
        self._slots: list[_Slot] = []
        self._free: list[_Slot] = []
        self._tries: dict[str, int] = {}
        self._callers = ThreadPoolExecutor(jobs)
        self._closed = False

    def _start(self) -> None:
        """Start the workers, unless they are there."""
        while len(self._slots) < self.room:
            self._slots.append(slot := _Slot(self._place))
            self._free.append(slot)

    def submit(self, request: Request[Done]) -> Future[Done]:
        """Start a run in a free worker; do a light one in this process, while they have not taken
        HERE_S together.
        """
        self._tries[request.folder] = self._tries.get(request.folder, 0) + 1
        if request.light and self._here_s < HERE_S:
            began = time.process_time()
            done = at_once(request.perform, self._place)
            self._here_s += time.process_time() - began
            return done
        self._start()
        slot = self._free.pop()
        # not the executor's own: the slot must be free before the future is done
        outer: Future[Done] = Future()
        outer.set_running_or_notify_cancel()
        slot.run(request).add_done_callback(lambda inner: self._hand_over(inner, slot, outer))
        return outer

    def dispatch(self) -> None:
        """Send what was submitted and waits for others to be sent with it: nothing here."""

    def _hand_over(self, inner: Future[Done], slot: _Slot, outer: Future[Done]) -> None:
        """Free the slot, then complete the future with the result of the run or its error."""
        error = WorkerLostError("the pool is closed") if inner.cancelled() else inner.exception()
        if isinstance(error, BrokenProcessPool):
            slot.broken = True
            remedy = "in a script, call it under `if __name__ == '__main__':`"
            never = EnvironmentLackError("worker processes cannot start", remedy)
            error = WorkerLostError("its worker process died") if slot.answered else never
        self._free.append(slot)
        if error is not None:
            outer.set_exception(error)
        else:
            outer.set_result(inner.result())

    def tries(self, request: Request[Any]) -> int:
        """How often a run has been started."""
        return self._tries.get(request.folder, 0)

    def call(self, function: Callable[..., Any], *arguments: Any) -> Future[Any]:
        """Call it in a worker as soon as one is free; in this process, which has loaded more of the
        package, if there is one at most.
        """
        return (
            at_once(function, *arguments)
            if len(self._slots) < 2
            else self._callers.submit(self._called, function, arguments)
        )

    def _called(self, function: Callable[..., Any], arguments: tuple[Any, ...]) -> Any:
        slot = self._free.pop()  # there is one: as many threads as slots call
        try:
            return slot.executor.submit(function, *arguments).result()
        except (BrokenProcessPool, CancelledError):  # killed, after its last run or now
            slot.broken = True
            # what is interrupted would go on in this process, which could not end
            if self._closed:
                raise WorkerLostError("the pool is closed") from None
            return function(*arguments)
        finally:
            self._free.append(slot)

    def close(self) -> None:
        """Kill all workers and remove their temporary files."""
        self._closed = True
        self._callers.shutdown(wait=False, cancel_futures=True)
        for slot in self._slots:
            slot.kill()
        # waited for: Python wakes its threads at exit, and prints an error of one that closes just
        # then
        for slot in self._slots:
            slot.executor.shutdown(wait=True, cancel_futures=True)
        shutil.rmtree(Path(self._place).parent, ignore_errors=True)


SCHEDULER_GONE = "the dask scheduler is gone", "start it again, then go on with --resume"


class DaskPool:
    """Workers of a dask cluster; they need this package, but no files of this machine.

    Args:
        address: HOST:PORT of the scheduler.

    Raises EnvironmentLackError: dask.distributed is not installed, or no scheduler answers at the
    address.
    """

    films = True

    def __init__(self, address: str):
        try:
            from distributed import Client
        except ImportError:
            raise EnvironmentLackError(
                "dask.distributed is not installed", "pip install 'vstestbed[cluster]'"
            ) from None
        try:
            self._client = Client(f"tcp://{address}", timeout="5s", set_as_default=False)
        except (OSError, ValueError) as error:
            words = (
                "start a scheduler (`dask scheduler`)"
                " and workers (`dask worker HOST:PORT --nthreads 1`) first"
            )
            raise EnvironmentLackError(
                f"no dask scheduler answers at {address} ({error})", words
            ) from None
        # unique: a cluster keeps results by key, also those of earlier comparisons
        self._name = f"vstestbed-{uuid.uuid4().hex}"
        self._begun: dict[str, list[str]] = {}
        if not self._threads():
            logging.getLogger("vstestbed").warning(
                "no workers at %s yet; waiting for some", address
            )

    def _threads(self) -> int:
        with self._scheduler_there():
            threads: Any = self._client.nthreads()
        return sum(threads.values())

    @contextmanager
    def _scheduler_there(self) -> Iterator[None]:
        """Turn errors of a client whose scheduler does not answer any more into one with
        a remedy.
        """
        try:
            yield
        except OSError as error:
            raise EnvironmentLackError(*SCHEDULER_GONE) from error
        except Exception as error:
            if self._client.status == "running":
                raise
            raise EnvironmentLackError(*SCHEDULER_GONE) from error

    @property
    def room(self) -> int:
        """Two runs per worker of the cluster as it is now, so that a worker that becomes free has
        its next run at hand.
        """
        return 2 * max(1, self._threads())

    def submit(self, request: Request[Done]) -> Future[Done]:
        """Start a run on some worker; if that dies,
        the scheduler passes the run on to another one.
        """
        keys = self._begun.setdefault(request.folder, [])
        keys.append(f"{self._name}-{request.folder}-{len(keys)}")
        with self._scheduler_there():
            future = self._client.submit(
                _execute_on_dask, request, keys[-1], key=keys[-1], retries=0, pure=False
            )
        outer: Future[Done] = Future()
        outer.set_running_or_notify_cancel()
        future.add_done_callback(lambda inner: self._hand_over(inner, outer))
        return outer

    def dispatch(self) -> None:
        """Nothing waits."""

    def _hand_over(self, inner: Any, outer: Future[Done]) -> None:
        """Complete `outer` with the result or the error of `inner`, in every case: the runner waits
        for it.
        """
        from distributed.scheduler import KilledWorker

        try:
            if inner.status == "cancelled":
                raise EnvironmentLackError(*SCHEDULER_GONE)
            with self._scheduler_there():
                error: Any = None if inner.status == "finished" else inner.exception()
                result: Any = None if error is not None else inner.result()
            if error is not None:
                raise (
                    WorkerLostError("its worker died") if isinstance(error, KilledWorker) else error
                )
            outer.set_result(result)
        except BaseException as error:
            outer.set_exception(error)

    def tries(self, request: Request[Any]) -> int:
        """How often a run has been started: every worker that starts it logs an event under the
        run's key.

        Of a run whose result is there when the scheduler ends: how often it was submitted.
        """
        keys = self._begun.get(request.folder, [])
        try:
            with self._scheduler_there():
                # get_events is typed for asynchronous clients as well, where it is a coroutine
                return sum(len(self._client.get_events(key)) for key in keys)  # type: ignore[arg-type]
        except EnvironmentLackError:
            return len(keys)

    def call(self, function: Callable[..., Any], *arguments: Any) -> Future[Any]:
        """Call it in this process: the cluster's workers need not see its files."""
        return at_once(function, *arguments)

    def close(self) -> None:
        """Disconnect from the cluster; the scheduler cancels runs that no client waits for."""
        self._client.close()


def _execute_on_dask(request: Request[Done], key: str) -> Done:
    """What the request asks for, with an event that counts the attempt; dask itself removes the
    folder of a worker that was killed.
    """
    from distributed import get_worker

    worker = get_worker()
    worker.log_event(key, "begun")
    return request.perform(worker.local_directory)


def must_not_be_worker(function: str) -> None:
    """Refuse a function that starts workers in a worker that imports the caller's script: each
    would start workers of its own.
    """
    if getattr(multiprocessing.current_process(), "_inheriting", False):
        raise ParameterError(
            function,
            (
                "must stand under `if __name__ == '__main__':` in a script,"
                " which worker processes import"
            ),
        )


def workers(requested: int | None, runs: int) -> int:
    """Number of worker processes: as requested, else one per core;
    never more than there are runs.
    """
    if requested is not None and requested < 1:
        raise ParameterError.count("--jobs", "1", "or more", requested)
    # the cores that this process may use, which in a container can be fewer than the machine has
    cores = (
        len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    )
    return max(1, min(requested or cores, runs))


Pool = LocalPool | DaskPool
"""Takes requests, at most `room` at a time, and returns futures of their results; that of a request
whose worker died raises WorkerLostError, and by then the pool has replaced the worker.
"""


def pool_of(
    executor: str, workers: int, folder: Path, flown: Callable[[], Iterable[Scenario]] = tuple
) -> Pool:
    """The pool of `--executor`: `local`, `dask://HOST:PORT`, or one of an app; `folder` is the
    study's. flown: what it shall fly.
    Raises ParameterError: it cannot fly one of them. EnvironmentLackError: no scheduler, or a
    package that it needs.
    """
    must_be_known(executor)
    if executor == "local":
        return LocalPool(workers, folder)
    if executor.startswith(DASK):
        return DaskPool(executor.removeprefix(DASK))
    return apps.loaded("executors", executor)(workers, folder, flown)


def must_be_known(executor: str) -> None:
    """Refuse any other value of `--executor`."""
    if executor == "local" or re.fullmatch(DASK + r"[^/\s]+:\d+", executor):
        return
    if apps.loaded("executors", executor) is None:
        apps.must_be_complete()
        words = f"{', '.join(['local', *apps.offered('executors')])} or dask://HOST:PORT"
        raise ParameterError.fixed("--executor", words, executor)
