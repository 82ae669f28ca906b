"""A law in a process of its own, for judges: observations go in, commands come out as plain
numbers, and nothing else.

What judges a run (simulation, metrics, marks) never loads the law. The law's process is a fresh
Python, `testing/child.py`, whose words, environment and folder hold neither seeds nor plans. To it
go pickled observations. From it comes JSON of a capped size, whose values are checked: what a
hostile process sends is at most a bad command. Its time and memory are limited, and it is killed
with its group.
"""

from __future__ import annotations

import atexit
import json
import os
import pickle
import secrets
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import field, replace
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import numpy as np

from vstestbed.core.errors import ParameterError, VstestbedError
from vstestbed.core.foreign import reason
from vstestbed.core.geometry import Array
from vstestbed.core.quantity import PositiveTime
from vstestbed.core.spec import spec
from vstestbed.features.depth import Depth
from vstestbed.features.observation import Goal, Observation
from vstestbed.laws import LAWS, Command, Law
from vstestbed.laws.base import LawFailedError, TwistLimits
from vstestbed.laws.feedforward import Feedforward
from vstestbed.laws.points import Visibility
from vstestbed.loop.columns import check_own

__all__ = ["JACOBIAN", "MODULE", "Child", "Declared", "Isolated", "honest", "offered", "shown"]

Answer = TypeVar("Answer")
MODULE = f"{__name__}_kind"  # the plugin that adds it
START_S = 60.0  # time for Python and the package, and most for the law's files [s]
GONE_S = 5.0  # until it is gone once it is killed
ANSWER_S = 10.0  # for one answer [s]
MOST_BYTES = 1 << 16  # of an answer
JACOBIAN = "jacobian"  # in place of an answer: it is asked for at the positions that follow
LARGEST = 1e9  # number of a command, in any unit: the loop computes with its square
MOST_MODES = 1000  # those of a law; which it has, the loop checks
SHOWN = 2000  # bytes of what the process printed, and of its sentences
ARITHMETIC = "OPENBLAS_CORETYPE", "NPY_DISABLE_CPU_FEATURES", "MKL_CBWR"
"""What chooses the kernels of linear algebra: with others the child rounds otherwise than the
loop's process.
"""
# of the environment
INHERITED = "PATH", "PYTHONPATH", "LD_LIBRARY_PATH", "LANG", "SYSTEMROOT", *ARITHMETIC
ONE_CORE = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")


def shown(said: str) -> str:
    """What the law's process says, for a message or a table: one line of letters that neither a
    terminal, nor HTML, nor Markdown obeys.
    """
    line = " ".join(said[:SHOWN].split()).translate(str.maketrans("<>|`", "()/'"))
    return "".join(letter if letter.isprintable() else "?" for letter in line)


@spec
class LawBlock:
    """A law as a scenario has it.

    Args:
        law: its block.
    """

    law: Annotated[Law[Any], LAWS]


@spec
class Declared:
    """What the loop reads of a law (`Law`); its feature stays in its process.

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
    inputs: tuple[str, ...]
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

    def __post_init__(self) -> None:
        check_own(self.columns)
        if words := [word for word in (*self.modes, *self.columns) if shown(word) != word]:
            raise ParameterError("modes and columns", "must be plain words", words[0])


def honest(depth: Depth) -> None:
    """Refuse a source of depth that is the truth, to a law that is judged.
    Raises ParameterError.
    """
    if depth.true:
        works = "another source, such as pnp or estimate"
        raise ParameterError.excluded(
            "depth", f"{depth.kind}, the truth, for a law that is judged", works=works
        )


class Child:
    """The process of one law.

    Class attributes: lost: how many ended, or were ended, before they had answered. watch: is told
    of the runs (`testing/likeness.py`).
    """

    lost = 0
    watch: Any = None

    def __init__(self, *law: Any, load_s: float):
        self.ended = False
        self.spent_s = 0.0
        self._goal: Goal | None = None
        self._jacobian: Callable[[Array], Array]
        self._place = tempfile.TemporaryDirectory(prefix="law_", ignore_cleanup_errors=True)
        self._printed = tempfile.TemporaryFile()  # noqa: SIM115 - until the process ends
        self._channel, theirs = socket.socketpair()
        theirs.set_inheritable(True)
        place = self._place.name
        number = theirs.fileno()
        passed: Any = {"pass_fds": [number]} if os.name == "posix" else {"close_fds": False}
        inherited = {name: os.environ[name] for name in INHERITED if name in os.environ}
        self._process = subprocess.Popen(
            [sys.executable, "-Pu", "-m", "vstestbed.testing.child", str(number)],
            cwd=place,
            env=inherited | ONE_CORE | {"HOME": place, "TMPDIR": place},
            stdin=subprocess.DEVNULL,
            stdout=self._printed,
            stderr=self._printed,
            start_new_session=True,
            **passed,
        )
        theirs.close()
        self.ask(bool, START_S, "ready")
        self.spent_s = 0.0  # that was Python and this package, and no line of the law
        try:
            self.declared = self.ask(lambda said: Declared(**said), load_s, "make", *law)
        except VstestbedError:  # of a law that cannot be made nobody has the process, to end it
            self.close()
            raise
        self.loaded_s = self.spent_s  # counts as time of its first run

    def ask(self, of: Callable[[Any], Answer], seconds: float, method: str, *given: Any) -> Answer:
        """What the process answers within some seconds. of: makes it of plain values, and may raise
        whatever it wants to.
        Raises ParameterError: the law refuses what it is given. LawFailedError: it failed, or its
        process gave no answer.
        """
        began = time.monotonic()
        until = began + seconds
        try:
            self._send((method, given), until)
            while (answer := self._received(until))[0] == JACOBIAN:
                self._send(self._jacobian(np.array(answer[1], float)), until)
            refused, said = answer
            if not refused:
                return of(said)
            name, problem = map(str, said)
        except Exception as error:
            # a process that is gone, and whatever a forged answer brings about
            self.close()
            Child.lost += 1
            late = isinstance(error, TimeoutError)
            why = f"none within {seconds:.3g} s" if late else reason(error)
            raise LawFailedError(f"the law's process gave no answer ({why})") from error
        finally:
            self.spent_s += time.monotonic() - began
        name = shown(name)
        problem = shown(problem)
        raise ParameterError(name, problem) if name else LawFailedError(problem)

    def _wait(self, until: float) -> None:
        """Let the next transfer last until then at most. Raises TimeoutError: it is later."""
        left = until - time.monotonic()
        if left <= 0:
            raise TimeoutError
        self._channel.settimeout(left)

    def _send(self, message: Any, until: float) -> None:
        packed = pickle.dumps(message)
        self._wait(until)
        self._channel.sendall(len(packed).to_bytes(8, "big") + packed)

    def _received(self, until: float) -> Any:
        size = int.from_bytes(self._read(8, until), "big")
        if size > MOST_BYTES:
            raise ValueError("it is too long")
        return json.loads(self._read(size, until))

    def _read(self, size: int, until: float) -> bytes:
        found = b""
        while len(found) < size:
            self._wait(until)
            more = self._channel.recv(size - len(found))
            if not more:
                raise EOFError
            found += more
        return found

    def step(
        self, seconds: float, state: int, seen: Observation, goal: Goal, basis: Array
    ) -> tuple[int, Command]:
        """Number of the next state, and the command. A goal is sent once. The Jacobian at other
        positions is computed here, on request: it is made with the whole robot.
        """
        sent = None if goal is self._goal else goal
        self._goal = goal
        if seen.robot is not None:
            self._jacobian = seen.robot.jacobian
            seen = replace(seen, robot=replace(seen.robot, jacobian=None))  # pyright: ignore[reportArgumentType] - the process has its own
        return self.ask(
            lambda said: (int(said[0]), command_of(said[1], basis.shape[1])),
            seconds,
            "step",
            state,
            seen,
            sent,
            basis,
        )

    def close(self) -> None:
        """Kill the process and its group, and print the end of what it printed, each line marked as
        its own.
        """
        if self.ended:
            return
        self.ended = True
        with suppress(ProcessLookupError):
            if os.name == "posix":
                os.killpg(self._process.pid, signal.SIGKILL)
            else:
                self._process.kill()
        # one that a process of another session traces is not gone before that one lets it
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(GONE_S)
        self._channel.close()
        with self._printed as printed:
            printed.seek(max(0, printed.seek(0, os.SEEK_END) - SHOWN))
            for line in printed.read(SHOWN).decode(errors="replace").splitlines():
                print("  law |", "".join(filter(str.isprintable, line)), file=sys.stderr)
        place = self._place.name
        with suppress(OSError):
            _flatten(place)
        self._place.cleanup()
        if os.path.lexists(place):
            print(
                f"  law | its folder {place} is still there, and should be removed", file=sys.stderr
            )


def _flatten(place: str) -> None:
    """Move all folders of a folder up into it, so that it can be removed however deeply they are
    nested.
    """
    top = Path(place)
    below = [path for path in top.iterdir() if path.is_dir() and not path.is_symlink()]
    while below:
        folder = below.pop()
        folder.chmod(0o700)
        for path in [*folder.iterdir()]:
            if path.is_dir() and not path.is_symlink():
                path.chmod(0o700)  # a folder that may not be written cannot be moved
                below.append(path.rename(top / secrets.token_hex(8)))


_live = dict[str, Child]()  # the one that was used last, by what was asked for


@atexit.register
def close() -> None:
    """End the law's process."""
    while _live:
        _live.popitem()[1].close()


@spec
class Isolated(Law[int]):
    """Another law, in a process of its own, which keeps its last states; here they are numbers.

    Args:
        files: plugins that are loaded there.
        adds: a kind that they must add; "": any.
        block: the law; {}: the only one that they add.
        reads: file or folder that the process may read, besides Python and this package.
        run_s: time for all answers in a run, and for loading the files before it [s].
        also: further fields of the observations, for who watches; the process does not get them.
    """

    kind: Literal["isolated"] = "isolated"
    files: tuple[str, ...] = ()
    adds: str = ""
    block: dict[str, Any] = field(default_factory=dict)
    reads: str = ""
    run_s: PositiveTime = 300.0
    also: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Start the process, and take over what the law declares."""
        for name, value in vars(self._child.declared).items():
            object.__setattr__(self, name, value)
        object.__setattr__(self, "inputs", (*self.inputs, *self.also))
        honest(self.depth)

    @property
    def _child(self) -> Child:
        law = self.files, self.adds, self.block, self.reads
        key = json.dumps(law)
        if key not in _live or _live[key].ended:
            close()
            try:
                _live[key] = Child(*law, load_s=min(START_S, self.run_s))
            except LawFailedError as error:
                raise ParameterError("files", f"cannot be loaded: {error}") from error
        return _live[key]

    def prepare(self) -> None:
        """Nothing: the process has done so."""

    def markers_needed(self, basis: Array) -> int:
        return self._child.ask(int, ANSWER_S, "markers_needed", basis)

    def check(self, points: Array, goal: Goal) -> None:
        self._child.ask(bool, ANSWER_S, "check", points, goal)

    def check_view(
        self, goal: Goal, marker_radius_m: float, called: Callable[[int], str] = str
    ) -> None:
        self._child.ask(bool, ANSWER_S, "check_view", goal, marker_radius_m)

    def init(self, goal: Goal) -> int:
        child = self._child
        child.spent_s = child.loaded_s
        child.loaded_s = 0.0
        if Child.watch:
            Child.watch.begin(goal)
        return child.ask(int, min(ANSWER_S, self.run_s), "init", goal)

    def step(
        self, state: int, observation: Observation, goal: Goal, basis: Array
    ) -> tuple[int, Command]:
        child = self._child
        left = self.run_s - child.spent_s
        if left <= 0:
            Child.lost += 1
            raise LawFailedError(f"the law took more than {self.run_s:.3g} s in a run")
        # what is there whether a law names it or not
        free = ("xy", "xyw", "depth", *["T_camera_target"] * self.depth.needs_pose)
        hidden = dict.fromkeys(name for name in self.also if name not in free)
        seen = replace(observation, **hidden) if hidden else observation
        following, command = child.step(min(ANSWER_S, left), state, seen, goal, basis)
        if Child.watch:
            Child.watch.step(observation, goal, basis, command)
        return following, command


def command_of(plain: dict[str, Any], motions: int) -> Command:
    """A command from plain values. Its error in grey levels is not taken over: it would judge the
    run.
    Raises whatever values of other types bring about; ValueError: it is not of the robot's motions,
    or the loop could not compute with it.
    """
    arrays: dict[str, Any] = {}
    for name in ("u", "twist", "rates", "wrench"):
        if plain[name] is not None:
            arrays[name] = _numbers(plain[name], 1)
    if arrays["u"].shape != (motions,):
        raise ValueError("u has another shape")
    free = []
    for share, plain_twists in plain["free"]:
        twists = _numbers(plain_twists, 2)
        if len(twists) != 6:
            raise ValueError("it has another shape")
        free.append((float(_numbers(share, 0)), twists))
    scale = float(plain["scale"])
    mode = int(plain["mode"])
    if not 0.0 <= scale <= 1.0 or not 0 <= mode < MOST_MODES:
        raise ValueError("its scale is not from 0 to 1, or its mode is none")
    return Command(
        **arrays,
        rest_reason=shown(str(plain["rest_reason"])),
        scale=scale,
        free=tuple(free),
        mode=mode,
        row=tuple(map(float, plain["row"])),
    )


def _numbers(plain: Any, ndim: int) -> Array:
    """An array of so many axes from plain values; ValueError where the loop could not compute with
    it.
    """
    array = np.array(plain, float)
    if array.ndim != ndim:
        raise ValueError("it has another shape")
    if not (np.abs(array) <= LARGEST).all():
        raise ValueError("it has numbers that are too large, or not finite")
    return array


@contextmanager
def offered() -> Iterator[None]:
    """The kind is there meanwhile, and no process of a law is left afterwards."""
    LAWS.add(Isolated)
    try:
        yield
    finally:
        close()
        LAWS.members.pop("isolated", None)
