"""Shares of a piece of work that may be done in other processes, at the same time; how it is waited
for, and what ends all of it.
"""

from __future__ import annotations

import signal
from collections.abc import Callable, Collection
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from concurrent.futures import Future

__all__ = ["STOPS", "Call", "at_once", "result_of", "some_done"]

# Calls a function with arguments, perhaps in another process: `call(function, *arguments)`
Call = Callable[..., "Future[Any]"]
STOPS = tuple(
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)
)
"""Signals that end a command as Ctrl-C does; its worker processes leave them to it. Windows has no
SIGHUP.
"""
HEARD_S = 0.2  # longest time that a wait for other processes does not hear of Ctrl-C [s]


def some_done(futures: Collection[Future[Any]]) -> set[Future[Any]]:
    """Wait until at least one of them is done; returns those that are. It looks up every HEARD_S:
    without an end, a lock does not hear of Ctrl-C on Windows, nor anywhere once polars has
    installed its handler of SIGINT with SA_RESTART (its issue 21739).
    """
    from concurrent.futures import FIRST_COMPLETED, wait  # here: `--help` imports this module

    done: set[Future[Any]] = set()
    while futures and not done:
        done = wait(futures, HEARD_S, FIRST_COMPLETED).done
    return done


def result_of(future: Future[Any]) -> Any:
    """The result of a future, or its error; it is waited for as by `some_done`."""
    some_done([future])
    return future.result()


def at_once(function: Callable[..., Any], *arguments: Any) -> Future[Any]:
    """Call it now, in this process."""
    from concurrent.futures import Future

    future: Future[Any] = Future()
    future.set_result(function(*arguments))
    return future
