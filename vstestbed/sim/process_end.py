"""Where daemon threads that simulate or draw wait while the process ends.

Python ends a daemon thread where it next takes the interpreter's lock. Within a step of the physics, or a cast of rays, whose C++ code
cannot be left like that, the process would crash.
"""

from __future__ import annotations

import atexit
import threading
import time
import weakref

REST_S = 1.0
"""Longest wait for daemon threads at the end of the process [s]."""
_daemons: weakref.WeakSet[threading.Thread] = weakref.WeakSet()
_ending = threading.Event()


def may_end_here(ending: bool = False) -> None:
    """A daemon thread waits here for ever once the process ends, or where `ending` says so; others go on."""
    thread = threading.current_thread()
    if not thread.daemon:
        return
    if ending or _ending.is_set():
        _daemons.discard(thread)
        threading.Event().wait()  # it ends with the process, without a word
    _daemons.add(thread)


@atexit.register
def _let_daemons_rest() -> None:
    """Give the threads that have called `may_end_here` the time to come there again."""
    _ending.set()
    until = time.monotonic() + REST_S
    while time.monotonic() < until and any(thread.is_alive() for thread in tuple(_daemons)):
        time.sleep(0.002)  # gives them the interpreter's lock
