"""Shares of a piece of work that may be done in other processes, at the same time."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from typing import Any

Call = Callable[..., "Future[Any]"]
"""Calls a function with arguments, perhaps in another process: `call(function, *arguments)`."""


def at_once(function: Callable[..., Any], *arguments: Any) -> Future[Any]:
    """Call it now, in this process."""
    future: Future[Any] = Future()
    future.set_result(function(*arguments))
    return future
