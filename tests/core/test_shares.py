"""Waiting for shares of work that other processes do."""

import subprocess
import sys

import pytest

WAITS = """\
import os, signal, threading, time
signal.signal(signal.SIGINT, signal.default_int_handler)
# polars gives SIGINT the flag SA_RESTART, with which a lock that is waited for without an end does
# not hear of it.
import polars
from concurrent.futures import Future
from vstestbed.core.shares import result_of

future = Future()
threading.Timer(0.3, os.kill, (os.getpid(), signal.SIGINT)).start()
threading.Timer(4.0, future.set_result, (None,)).start()
try:
    result_of(future)
except KeyboardInterrupt:
    print("interrupted", "late" if future.done() else "at once", flush=True)
os._exit(0)  # not after the second timer
"""


@pytest.mark.process
def test_ctrl_c_is_heard_while_a_result_is_waited_for():
    done = subprocess.run(
        [sys.executable, "-c", WAITS], capture_output=True, text=True, timeout=60, check=True
    )
    assert done.stdout == "interrupted at once\n"
