"""The process of a law that is judged: it holds the law alone. `loop/isolated.py` starts it, and says what for.

python -P -m vstestbed.testing.child NUMBER_OF_A_SOCKET
"""

from __future__ import annotations

import ctypes
import json
import os
import pickle
import signal
import socket
import struct
import sys
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any

import numpy as np

import vstestbed
from vstestbed.core.errors import ParameterError, PluginError, VstestbedError
from vstestbed.core.geometry import Array
from vstestbed.core.registry import to_mapping
from vstestbed.core.spec import spec
from vstestbed.features.observation import Goal, Observation
from vstestbed.laws import LAWS, Law
from vstestbed.loop.controller import GuardedLaw
from vstestbed.loop.isolated import Declared
from vstestbed.scenario.plugins import load_plugins, registries
from vstestbed.testing.laws import unnamed_in_source

MEMORY, FILES, CPU_S = 8 << 30, 64 << 20, 3600  # most bytes of memory and of a file, most processor time [s]


@spec
class _Holder:
    law: Annotated[Law[Any], LAWS]


class _Held:
    """The law, its states by number, and the goal that was sent last. Each method answers with a word and plain values."""

    law: Law[Any]

    def __init__(self) -> None:
        self.states, self.last, self.goal = dict[int, Any](), 0, None

    def make(self, files: list[str], adds: str, block: dict[str, Any], reads: str) -> tuple[str, Any]:
        """Load the law's files, and make it: what it declares."""
        confine(reads)
        before = set(LAWS.members)
        try:
            load_plugins(files)
        except PluginError as error:
            raise ParameterError("files", f"cannot be loaded: {error}") from error
        if adds and not any(adds in registry.members for registry in registries().values()):
            raise ParameterError("files", f"adds no kind {adds!r}.")
        own = [kind for kind in LAWS.members if kind not in before]
        if not block and len(own) != 1:
            raise ParameterError("files", f"must add one law; of several, name one in a YAML file with law and plugins, got {own}")
        self.law = _Holder(law=block or {"kind": own[0]}).law  # pyright: ignore[reportArgumentType] - a block
        self.law.prepare()
        return "declared", {name: to_mapping(_plain(getattr(self.law, name))) for name in Declared.__annotations__}

    def markers_needed(self, basis: Array) -> tuple[str, Any]:
        return "number", int(self.law.markers_needed(basis))

    def check(self, points: Array, goal: Goal) -> tuple[str, Any]:
        self.law.check(points, goal)
        return "done", None

    def check_view(self, goal: Goal, marker_radius_m: float) -> tuple[str, Any]:
        self.law.check_view(goal, marker_radius_m)
        return "done", None

    def init(self, goal: Goal) -> tuple[str, Any]:
        return "number", self._kept(self.law.init(goal))

    def step(self, state: int, seen: Observation, goal: Goal | None, basis: Array) -> tuple[str, Any]:
        """One frame, by a guard of its own: a state may be asked for once more."""
        self.goal = goal or self.goal
        guarded = GuardedLaw(self.law)
        following, command = guarded.step(self.states[state], seen, self.goal, basis)
        if guarded.failure:
            return "failed", guarded.failure + unnamed_in_source(self.law)
        plain = {name: _plain(getattr(command, name)) for name in ("u", "twist", "rates", "wrench", "rest_reason", "scale", "mode", "row")}
        free = [(share, _plain(twists)) for share, twists in command.free]
        return "step", (self._kept(following), plain | {"free": free})

    def _kept(self, state: Any) -> int:
        self.last += 1
        self.states[self.last] = state
        return self.last


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    return dict(value) if hasattr(value, "keys") else value


# Landlock, by which a process gives up rights for good, root's too: of files, connections, and signals and traces of other processes.
CREATE, ADD, RESTRICT = 444, 445, 446  # its system calls, on all architectures
RIGHTS = 13, 14, 15, 15, 16  # how many rights of files each of its first versions knows
READ_FILE, READ = 0b101, 0b1101  # read and execute; and list folders


def confine(reads: str) -> None:
    """Limit this process: its memory, files and time; on Linux 5.13 and newer also to reading Python, this package and `reads`, and to
    writing into its own empty folder.
    """
    with suppress(ImportError, ValueError, OSError):  # not on Windows; a lower limit is in force
        import resource

        for kind, most in ((resource.RLIMIT_AS, MEMORY), (resource.RLIMIT_FSIZE, FILES), (resource.RLIMIT_CPU, CPU_S)):
            resource.setrlimit(kind, (most, most))
    if sys.platform != "linux":
        return
    libc = ctypes.CDLL(None)
    libc.prctl(1, signal.SIGKILL)  # die with the parent
    version = libc.syscall(CREATE, None, 0, 1)
    if version < 1:
        return
    every = (1 << RIGHTS[min(version, 5) - 1]) - 1
    handled = struct.pack("QQQ", every, 3 if version >= 4 else 0, 3 if version >= 6 else 0)
    rules = libc.syscall(CREATE, handled, len(handled), 0)
    package = Path(vstestbed.__file__).parent
    libraries = [path for path in sys.path if path.endswith(("site-packages", "dist-packages"))]
    system = "/usr", "/lib", "/lib64", "/etc/ld.so.cache", "/dev/null", "/dev/urandom"
    for path in (package, sys.prefix, sys.base_prefix, *libraries, *system, reads, os.getcwd()):
        with suppress(OSError):  # not on this system
            place = os.open(path, os.O_PATH)
            rights = every if path == os.getcwd() else READ if os.path.isdir(path) else READ_FILE
            libc.syscall(ADD, rules, 1, struct.pack("=Qi", rights, place), 0)
            os.close(place)
    libc.prctl(38, 1, 0, 0, 0)  # no new privileges, which it asks for
    libc.syscall(RESTRICT, rules, 0)
    os.close(rules)


def main(number: int) -> None:
    """Answer until the parent is gone."""
    channel, held = socket.socket(fileno=number).makefile("rwb"), _Held()
    while size := channel.read(8):
        forgotten, method, given = pickle.loads(channel.read(int.from_bytes(size, "big")))
        for state in forgotten:
            held.states.pop(state, None)
        try:
            answer = getattr(held, method)(*given)
        except ParameterError as error:
            answer = "refused", (error.field, str(error).removeprefix(f"{error.field} "))
        except VstestbedError as error:
            answer = "failed", str(error)
        except BaseException as error:  # whatever a law raises; also sys.exit
            answer = "failed", f"the law raised {type(error).__name__}: {error}"
        said = json.dumps(dict([answer])).encode()
        channel.write(len(said).to_bytes(8, "big") + said)
        channel.flush()


if __name__ == "__main__":
    main(int(sys.argv[1]))
    os._exit(0)
