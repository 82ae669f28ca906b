"""Where runs are done: worker processes of this machine, or those of a dask cluster. Both take a task and give a future."""

from __future__ import annotations

import contextlib
import os
import re
import signal
from collections.abc import Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import get_context
from typing import Any, Protocol

from vstestbed.comparing.worker import Files, Task, begin, do, process_id
from vstestbed.errors import EnvironmentLackError, ParameterError

ONE_CORE = {"LP_NUM_THREADS": "0", "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
"""A worker has one core: Mesa draws in its own thread, BLAS takes no others."""
DASK = "dask://"


class Pool(Protocol):
    """Takes tasks, at most `room` at a time, and gives futures of their folders.

    A future whose worker died raises WorkerLostError; the pool has replaced the worker by then.
    """

    room: int

    def submit(self, task: Task) -> Future[Files]:
        """Do this run."""
        ...

    def tries(self, task: Task) -> int:
        """How often a run has been begun."""
        ...

    def close(self) -> None:
        """End all workers now."""
        ...


class WorkerLostError(Exception):
    """The process that did a run is gone: killed, out of memory, or a crash in a library."""


@contextmanager
def _environment(values: dict[str, str]) -> Iterator[None]:
    """Environment variables for processes that are started meanwhile; what the user has set stays."""
    added = {k: v for k, v in values.items() if k not in os.environ}
    os.environ.update(added)
    try:
        yield
    finally:
        for name in added:
            del os.environ[name]


class _Slot:
    """One worker process, started anew when it has died. (One executor each: a death breaks an executor as a whole.)"""

    def __init__(self) -> None:
        self.start()

    def start(self) -> None:
        """Start the process."""
        self.executor = ProcessPoolExecutor(1, mp_context=get_context("spawn"), initializer=begin, initargs=(True,))
        with _environment(ONE_CORE):
            self.pid = self.executor.submit(process_id)

    def end(self) -> None:
        """Kill the process."""
        with contextlib.suppress(Exception):
            os.kill(self.pid.result(timeout=0), signal.SIGKILL)
        self.executor.shutdown(wait=False, cancel_futures=True)


class LocalPool:
    """Processes of this machine, each with one OpenGL context and one core.

    Args:
        jobs: how many.
    """

    def __init__(self, jobs: int):
        self.room = jobs
        self._free = [_Slot() for _ in range(jobs)]
        self._busy: dict[Future[Files], _Slot] = {}
        self._tries: dict[str, int] = {}

    def submit(self, task: Task) -> Future[Files]:
        """Do this run in a free worker."""
        slot = self._free.pop()
        self._tries[task.folder] = self._tries.get(task.folder, 0) + 1
        outer: Future[Files] = Future()
        outer.set_running_or_notify_cancel()
        self._busy[outer] = slot
        slot.executor.submit(do, task).add_done_callback(lambda inner: self._hand_over(inner, outer))
        return outer

    def _hand_over(self, inner: Future[Files], outer: Future[Files]) -> None:
        slot = self._busy.pop(outer)
        error = inner.exception()
        if isinstance(error, BrokenProcessPool):
            slot.end()
            slot.start()
            error = WorkerLostError("its worker process died")
        self._free.append(slot)
        if error is not None:
            outer.set_exception(error)
        else:
            outer.set_result(inner.result())

    def tries(self, task: Task) -> int:
        """How often a run has been begun."""
        return self._tries.get(task.folder, 0)

    def close(self) -> None:
        """Kill all workers."""
        for slot in [*self._free, *self._busy.values()]:
            slot.end()


class DaskPool:
    """Workers of a dask cluster, wherever they are; they need this package, and no files of this machine.

    Args:
        address: of the scheduler, HOST:PORT.

    Raises:
        EnvironmentLackError: dask.distributed is not installed, or there is nobody at the address.
    """

    def __init__(self, address: str):
        try:
            from distributed import Client
        except ImportError:
            raise EnvironmentLackError("dask.distributed is not installed", "pip install 'vstestbed[cluster]'") from None
        try:
            self._client = Client(f"tcp://{address}", timeout="5s", set_as_default=False)
        except (OSError, ValueError) as error:
            words = "start a scheduler (`dask scheduler`) and workers (`dask worker HOST:PORT --nthreads 1`) first"
            raise EnvironmentLackError(f"no dask scheduler answers at {address} ({error})", words) from None
        threads: Any = self._client.nthreads()
        self.room = 2 * max(1, sum(threads.values()))  # the next one is there when a worker is free

    def submit(self, task: Task) -> Future[Files]:
        """Do this run on some worker; the scheduler gives it to another one when that dies."""
        future = self._client.submit(_begun, task, key=f"vstestbed-{task.folder}-{id(task)}", retries=0, pure=False)
        outer: Future[Files] = Future()
        outer.set_running_or_notify_cancel()
        future.add_done_callback(lambda inner: _hand_over_from_dask(inner, outer))
        return outer

    def tries(self, task: Task) -> int:
        """How often a run has been begun."""
        return sum(folder == task.folder for _, folder in self._client.get_events(TOPIC))  # type: ignore[misc]

    def close(self) -> None:
        """Leave the cluster, which goes on; runs that nobody waits for are cancelled."""
        self._client.close()


TOPIC = "vstestbed-runs-begun"


def _begun(task: Task) -> Files:
    from distributed import get_worker

    get_worker().log_event(TOPIC, task.folder)
    return do(task)


def _hand_over_from_dask(inner: Any, outer: Future[Files]) -> None:
    from distributed.scheduler import KilledWorker

    error = inner.exception()
    if error is None:
        outer.set_result(inner.result())
    else:
        outer.set_exception(WorkerLostError("its worker died") if isinstance(error, KilledWorker) else error)


def pool_of(executor: str, workers: int) -> Pool:
    """The pool that `--executor` asks for: `local`, or `dask://HOST:PORT`.

    Raises:
        ParameterError: another word. EnvironmentLackError: see DaskPool.
    """
    must_be_known(executor)
    return LocalPool(workers) if executor == "local" else DaskPool(executor.removeprefix(DASK))


def must_be_known(executor: str) -> None:
    """Refuse what is no executor."""
    if executor != "local" and not re.fullmatch(DASK + r"[^/\s]+:\d+", executor):
        raise ParameterError("--executor", "must be local or dask://HOST:PORT", executor)
