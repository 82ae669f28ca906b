"""A law in a process of its own, for judges: observations go in, commands come out as plain numbers, and nothing else.

What judges a run (simulation, metrics, marks) never loads the law. The law's process is a fresh Python, `testing/child.py`, whose words,
environment and folder hold neither seeds nor plans. To it go pickled observations; from it comes JSON of a capped size, whose every value is
checked: what a hostile process sends is at most a bad command. It has limits of time and memory, and is killed with its group.
"""

from __future__ import annotations

import atexit
import json
import os
import pickle
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import field
from typing import Annotated, Any, Literal

import numpy as np
from annotated_types import Ge, Le

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array
from vstestbed.core.quantity import PositiveTime
from vstestbed.core.spec import spec
from vstestbed.features.depth import Depth
from vstestbed.features.observation import Goal, Observation
from vstestbed.laws import LAWS, Command, Law
from vstestbed.laws.base import OBSERVATION_FIELDS, LawFailedError, TwistLimits
from vstestbed.laws.feedforward import Feedforward
from vstestbed.laws.points import Visibility

MODULE = __name__  # the plugin that adds this kind
START_S = 60.0  # for Python, the package and the law's file
MOST_BYTES = 1 << 20  # of an answer
MOST_NUMBERS = 10_000  # of an array in it
LAST_WORDS = 2000  # bytes of what the process printed that are shown
INHERITED = "PATH", "PYTHONPATH", "LD_LIBRARY_PATH", "LANG", "SYSTEMROOT"  # of the environment
ONE_CORE = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")


@spec
class Declared:
    """What a law says of itself, as far as the loop reads it (`Law`); its feature stays in its process.

    Args:
        tasks: the kinds of goals that it takes.
        inputs: the fields of an observation that it reads.
        depth: the source of the markers' depth.
        limits: of its twist.
        visibility: its field at the border.
        feedforward: its term for a moving target.
        cruise_mps: its speed along a line [m/s].
        rest_m: distance under which it stands still [m].
        modes: words for what it may do.
        columns: its own in the log.
        cameras: further ones that it stacks.
        stacks: whether it can.
        needs_same_markers: whether rows keep their markers.
    """

    tasks: tuple[str, ...]
    inputs: tuple[Literal[(*OBSERVATION_FIELDS, "xyw")], ...]  # pyright: ignore[reportInvalidTypeForm] - of names that are known here alone
    depth: Depth
    limits: TwistLimits
    visibility: Visibility
    feedforward: Feedforward
    cruise_mps: float | None
    rest_m: float
    modes: tuple[str, ...]
    columns: tuple[str, ...]
    cameras: dict[str, float]
    stacks: bool
    needs_same_markers: bool


class Child:
    """The process of one law.

    Class attributes, of all in this process: waited: time for which answers were waited for [s]. lost: how many ended, or were ended, before
    they had answered.
    """

    waited = 0.0
    lost = 0

    def __init__(self, *law: Any):
        self.ended, self.run_s, self.forgotten = False, 0.0, list[int]()
        self._goal: Goal | None = None
        self._place = tempfile.TemporaryDirectory(prefix="law_", ignore_cleanup_errors=True)
        self._said = tempfile.TemporaryFile()
        self._channel, theirs = socket.socketpair()
        theirs.set_inheritable(True)
        place, number = self._place.name, theirs.fileno()
        known = {name: os.environ[name] for name in INHERITED if name in os.environ}
        self._process = subprocess.Popen(
            [sys.executable, "-Pu", "-m", "vstestbed.testing.child", str(number)],
            cwd=place,
            env=known | ONE_CORE | {"HOME": place, "TMPDIR": place},
            stdin=subprocess.DEVNULL,
            stdout=self._said,
            stderr=self._said,
            start_new_session=True,
            **({"pass_fds": (number,)} if os.name == "posix" else {"close_fds": False}),
        )
        theirs.close()
        self.declared = Declared(**self.ask("declared", START_S, "make", *law))

    def ask(self, wanted: str, seconds: float, method: str, *given: Any) -> Any:
        """What the law's process answers, within some seconds.
        Raises ParameterError: the law refuses what it is given. LawFailedError: it failed, or gave no answer of the form that is wanted.
        """
        began, forgotten = time.monotonic(), self.forgotten
        self.forgotten = []
        try:
            message = pickle.dumps((forgotten, method, given))
            answer = self._answer(len(message).to_bytes(8, "big") + message, began + seconds)
            ((word, said),) = answer.items()
            if word == "refused":
                name, problem = map(str, said)
        except Exception as error:  # the system's, of a process that is gone, and whatever a forged answer brings about
            self.close()
            Child.lost += 1
            late = isinstance(error, TimeoutError)
            why = f"gave no answer within {seconds:.3g} s" if late else f"ended without an answer ({type(error).__name__})"
            raise LawFailedError(f"the law's process {why}") from error
        finally:
            Child.waited += time.monotonic() - began
            self.run_s += time.monotonic() - began
        if word == "refused":
            raise ParameterError(name, problem)
        if word != wanted:
            raise LawFailedError(str(said)[:LAST_WORDS])
        return said

    def step(self, seconds: float, state: int, seen: Observation, goal: Goal, basis: Array) -> tuple[int, dict[str, Any]]:
        """Number of the next state, and the command as it came. The goal is sent when it is another one."""
        sent = None if goal is self._goal else goal
        self._goal = goal
        number, command = self.ask("step", seconds, "step", state, seen, sent, basis)
        return int(number), command

    def _answer(self, message: bytes, until: float) -> dict[str, Any]:
        self._channel.settimeout(max(until - time.monotonic(), 1e-3))
        self._channel.sendall(message)
        size = int.from_bytes(self._read(8, until), "big")
        if size > MOST_BYTES:
            raise ValueError("too long")
        return json.loads(self._read(size, until))

    def _read(self, size: int, until: float) -> bytes:
        found = b""
        while len(found) < size:
            self._channel.settimeout(max(until - time.monotonic(), 1e-3))
            more = self._channel.recv(size - len(found))
            if not more:
                raise EOFError
            found += more
        return found

    def close(self) -> None:
        """Kill the process and its group; print the end of what it printed, each line marked as its own."""
        if self.ended:
            return
        self.ended = True
        with suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL) if os.name == "posix" else self._process.kill()
        self._process.wait()
        self._channel.close()
        self._said.seek(max(0, self._said.seek(0, os.SEEK_END) - LAST_WORDS))
        for line in self._said.read(LAST_WORDS).decode(errors="replace").splitlines():
            print("  law |", "".join(filter(str.isprintable, line)), file=sys.stderr)
        self._said.close()
        self._place.cleanup()


_live = dict[str, Child]()  # the last one that was used; by what was asked for


@atexit.register
def close() -> None:
    """End the law's process."""
    while _live:
        _live.popitem()[1].close()


class State:
    """The state of a law, which is in its process under a number."""

    def __init__(self, child: Child, number: int):
        self.child, self.number = child, number

    def __del__(self) -> None:
        """The process need not keep it any more."""
        self.child.forgotten.append(self.number)


@LAWS.add
@spec
class Isolated(Law[State]):
    """Another law, in a process of its own.

    Args:
        files: plugins that are loaded there.
        adds: a kind that they must add; "": any.
        block: the law; {}: the only one that they add.
        reads: file or folder that the process may read, besides Python and this package.
        answer_s: time for one answer [s].
        run_s: time for all answers in a run [s].
    """

    kind: Literal["isolated"] = "isolated"
    files: tuple[str, ...] = ()
    adds: str = ""
    block: dict[str, Any] = field(default_factory=dict)
    reads: str = ""
    answer_s: PositiveTime = 10.0
    run_s: Annotated[float, Ge(0), Le(1e6)] = 300.0

    def __post_init__(self) -> None:
        """Start the process, and take over what the law declares."""
        for name, value in vars(self._child.declared).items():
            object.__setattr__(self, name, value)

    @property
    def _child(self) -> Child:
        law = self.files, self.adds, self.block, self.reads
        key = json.dumps(law)
        if key not in _live or _live[key].ended:
            close()
            try:
                _live[key] = Child(*law)
            except LawFailedError as error:
                raise ParameterError("files", str(error)) from error
        return _live[key]

    def prepare(self) -> None:
        """Nothing: the process has done so."""

    def markers_needed(self, basis: Array) -> int:
        return min(max(int(self._child.ask("number", self.answer_s, "markers_needed", basis)), 0), MOST_NUMBERS)

    def check(self, points: Array, goal: Goal) -> None:
        self._child.ask("done", self.answer_s, "check", points, goal)

    def check_view(self, goal: Goal, marker_radius_m: float, called: Callable[[int], str] = str) -> None:
        self._child.ask("done", self.answer_s, "check_view", goal, marker_radius_m)

    def init(self, goal: Goal) -> State:
        child = self._child
        child.run_s = 0.0
        return State(child, int(child.ask("number", self.answer_s, "init", goal)))

    def step(self, state: State, observation: Observation, goal: Goal, basis: Array) -> tuple[State, Command]:
        child, left = state.child, self.run_s - state.child.run_s
        if left <= 0:
            raise LawFailedError(f"the law took more than {self.run_s:.3g} s in a run")
        if child.ended:
            raise LawFailedError("the law's process has ended")
        number, plain = child.step(min(self.answer_s, left), state.number, observation, goal, basis)
        try:
            command = command_of(plain, basis.shape[1], len(self.modes))
        except Exception as error:  # of a forged answer whatever its types bring about
            raise LawFailedError(f"the law's process gave no command ({error})") from error
        return State(child, number), command


def command_of(plain: dict[str, Any], motions: int, modes: int) -> Command:
    """A command from plain values. Its error in grey levels is not taken over: it would judge the run.
    Raises whatever values of other types bring about; ValueError: there are too many numbers, or another number than the robot has motions.
    """
    array = {name: _array(plain[name]) for name in ("u", "twist", "rates", "wrench") if plain[name] is not None}
    if array["u"].shape != (motions,) or array["twist"].shape != (6,):
        raise ValueError("u or twist has another shape")
    mode = int(plain["mode"])
    if not 0 <= mode < max(modes, 1):
        raise ValueError("there is no such mode")
    free = tuple((float(share), _array(twists)) for share, twists in plain["free"])
    if any(twists.ndim != 2 or len(twists) != 6 for _, twists in free):
        raise ValueError("free motions have another shape")
    row = tuple(_array(plain["row"]).tolist())
    scale, why = float(plain["scale"]), str(plain["rest_reason"])[:LAST_WORDS]
    return Command(**array, rest_reason=why, scale=scale, free=free, mode=mode, row=row)


def _array(values: Any) -> Array:
    made = np.array(values, dtype=float)
    if made.size > MOST_NUMBERS or made.ndim > 2:
        raise ValueError("too many numbers")
    return made


@contextmanager
def offered() -> Iterator[None]:
    """The kind is there meanwhile, and no process of a law is left afterwards."""
    LAWS.add(Isolated)
    try:
        yield
    finally:
        close()
        LAWS.members.pop("isolated", None)
