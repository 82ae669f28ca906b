"""The process of a law that is judged: it holds the law alone. `loop/isolated.py` starts it, and
says what for.

python -m vstestbed.testing.child NUMBER_OF_A_SOCKET
"""

from __future__ import annotations

import ctypes
import json
import os
import pickle
import re
import signal
import socket
import struct
import sys
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

from vstestbed.core.errors import ParameterError, PluginError, VstestbedError
from vstestbed.core.geometry import Array
from vstestbed.core.registry import to_mapping
from vstestbed.features.observation import Goal, Observation
from vstestbed.laws import LAWS, Law
from vstestbed.laws.base import LawFailedError
from vstestbed.loop.controller import GuardedLaw
from vstestbed.loop.isolated import JACOBIAN, Declared, LawBlock
from vstestbed.scenario.plugins import load_plugins, registries
from vstestbed.testing.laws import unnamed_in_source

# most bytes of memory and of a file; most processor time [s]
MEMORY, FILE, CPU_S = 8 << 30, 64 << 20, 3600
KEPT = 64  # states: a judge asks for one again only soon
# what is told of one
COMMAND = "u", "twist", "rates", "wrench", "rest_reason", "scale", "free", "mode", "row"


class _Held:
    """The law, its last states by number, and the goal that was sent last."""

    law: Law[Any]
    goal: Any = None

    def __init__(self, channel: Any):
        self.channel = channel
        self.states: dict[int, Any] = {}
        self.last = 0

    def send(self, *answer: Any) -> None:
        """Answer the parent."""
        said = json.dumps(answer, default=_plain).encode()
        self.channel.write(len(said).to_bytes(8, "big") + said)
        self.channel.flush()

    def receive(self) -> Any:
        """What the parent sends; ends the process with it."""
        size = self.channel.read(8)
        if not size:
            os._exit(0)
        return pickle.loads(self.channel.read(int.from_bytes(size, "big")))

    def jacobian(self, q: Array) -> Array:
        """The robot's, at other positions: the parent computes it."""
        self.send(JACOBIAN, q)
        return self.receive()

    def ready(self) -> bool:
        """Nothing of the law is loaded so far: the time until this is not its own."""
        return True

    def make(
        self, files: list[str], adds: str, block: dict[str, Any], reads: str
    ) -> dict[str, Any]:
        """Load the law's files, and make it: what it declares."""
        confine(reads)
        own = _laws_of(files, adds)
        if not block and len(own) != 1:
            raise ParameterError(
                "files",
                "must add one law; of several, name one in a YAML file with law and plugins",
                own,
            )
        self.law = LawBlock(law=block or {"kind": own[0]}).law  # pyright: ignore[reportArgumentType] - a block
        self.law.prepare()
        return {name: to_mapping(getattr(self.law, name)) for name in Declared.__annotations__}

    def step(self, state: int, seen: Observation, goal: Goal | None, basis: Array) -> Any:
        """One frame, by a guard of its own: a law is asked again after a failure, for another
        state.
        """
        self.goal = goal or self.goal
        if seen.robot is not None:
            seen = replace(seen, robot=replace(seen.robot, jacobian=self.jacobian))
        guarded = GuardedLaw(self.law)
        following, command = guarded.step(self.states[state], seen, self.goal, basis)
        if guarded.failure:
            raise LawFailedError(guarded.failure + unnamed_in_source(self.law))
        return self.kept(following), {name: getattr(command, name) for name in COMMAND}

    def init(self, goal: Goal) -> int:
        return self.kept(self.law.init(goal))

    def kept(self, state: Any) -> int:
        """The number of a state."""
        self.last += 1
        self.states[self.last] = state
        self.states.pop(self.last - KEPT, None)
        return self.last

    def answer(self, method: str, given: Any) -> tuple[bool, Any]:
        """Whether the law refuses it, and what it says: of a refusal the field, which is "" of a
        failure, and the sentence.
        """
        asked = self if hasattr(self, method) else self.law
        try:
            return False, getattr(asked, method)(*given)
        except BaseException as error:  # whatever a law raises; also sys.exit
            field = error.field if isinstance(error, ParameterError) else ""
            what = "" if isinstance(error, VstestbedError) else f"{type(error).__name__}: "
            words = what + str(error).removeprefix(f"{field} ")
            return True, (field.removeprefix("LawBlock.law."), words)


def _laws_of(files: list[str], adds: str) -> list[str]:
    """Load the law's files: the kinds of laws that they add. ParameterError: they cannot be, or do
    not add the kind that is asked for.
    """
    before = set(LAWS.members)
    try:
        load_plugins(files)
    except PluginError as error:
        raise ParameterError("files", f"cannot be loaded: {error}") from error
    if adds and not any(adds in registry.members for registry in registries().values()):
        raise ParameterError("files", f"adds no kind {adds!r}.")
    return [kind for kind in LAWS.members if kind not in before]


def _plain(value: Any) -> Any:
    return dict(value) if hasattr(value, "keys") else value.tolist()


# Landlock, by which a process gives up rights for good, root's too: to files, to connect, to signal
# and trace other processes.
CREATE, ADD, RESTRICT = 444, 445, 446  # its system calls, on all architectures
RIGHTS = 13, 14, 15, 15, 16  # how many rights to files its versions know
READ_FILE, READ = 0b101, 0b1101  # read and execute; of a folder list it, too
SPECIAL = 1 << 6 | 1 << 9 | 1 << 10 | 1 << 11  # make devices, sockets and pipes with a path
SYSTEM = (
    "/usr",
    "/lib",
    "/lib64",
    "/etc/ld.so.cache",
    "/dev/null",
    "/dev/urandom",
    "/proc/cpuinfo",
    "/sys/devices/system/cpu",
)


def landlock() -> int:
    """Its version here; under 1 where there is none."""
    return ctypes.CDLL(None).syscall(CREATE, None, 0, 1) if sys.platform == "linux" else 0


def confine(reads: str) -> None:
    """Limit this process: its memory, files and time; on Linux 5.13 and newer also to reading
    Python, this package and `reads`, and to writing into its own empty folder; on Linux on the
    machines of `CALLS` also to one process, and to system calls that change nothing of others.
    """
    with suppress(ImportError, ValueError):  # Windows; a lower limit is in force
        import resource

        # the address space has shared memory, too
        limits = (
            (resource.RLIMIT_CPU, CPU_S),
            (resource.RLIMIT_FSIZE, FILE),
            (resource.RLIMIT_AS, MEMORY),
        )
        for kind, most in limits:
            resource.setrlimit(kind, (most, most))
    if sys.platform != "linux":
        return
    libc = ctypes.CDLL(None)
    libc.prctl(1, signal.SIGKILL)  # end with the parent
    libc.prctl(38, 1, 0, 0, 0)  # no new privileges, which those that follow ask for
    _drop_capabilities(libc)
    if (version := landlock()) >= 1:
        _restrict_files(libc, version, reads)
    _refuse_calls(libc)


def _drop_capabilities(libc: ctypes.CDLL) -> None:
    """Those of root, for good: out of the bounding set, then out of the process;
    capabilities(7).
    """
    for capability in range(64):
        libc.prctl(24, capability, 0, 0, 0)
    libc.prctl(47, 4, 0, 0, 0)  # the ambient ones
    libc.capset(struct.pack("=Ii", 0x20080522, 0), bytes(24))


def _restrict_files(libc: ctypes.CDLL, version: int, reads: str) -> None:
    """Landlock, of a version."""
    every = (1 << RIGHTS[min(version, 5) - 1]) - 1
    handled = struct.pack("QQQ", every, 3 * (version >= 4), 3 * (version >= 6))
    rules = libc.syscall(CREATE, handled, len(handled), 0)
    own = Path.cwd()
    libraries = [path for path in sys.path if path.endswith("-packages")]
    package = Path(__file__).parents[1]
    read = package, sys.prefix, sys.base_prefix, *libraries, *SYSTEM, reads, own
    for path in map(Path, read):
        if path.exists():
            place = os.open(path, os.O_PATH)
            rights = READ if path.is_dir() else READ_FILE
            if path == own:
                rights = every & ~SPECIAL
            libc.syscall(ADD, rules, 1, struct.pack("=Qi", rights, place), 0)
            os.close(place)
    libc.syscall(RESTRICT, rules, 0)


# System calls that Landlock leaves open, by machine, each with its number; seccomp(2), bpf(2). A
# connected pair of sockets of its own is none of them: it sends to no other address.
# On all machines: io_uring, mounts, pidfd_getfd, quotactl_fd, memfd_secret, modes and attributes.
ALSO = "425 428 429 430 431 432 433 438 442 443 447 452 463 466 467 469"
CALLS = {
    "x86_64": """
    fork, vfork: 57 58
    socket, connect: 41 42
    chmod, chown, utime and their kind: 90 91 268 92 93 94 260 132 235 261 280
    setxattr, removexattr and their kind: 188 189 190 197 198 199
    ptrace, process_vm_readv and writev, kcmp, perf_event_open: 101 310 311 312 298
    sched_setparam, -scheduler, -affinity, -attr, setpriority, ioprio_set: 142 144 203 314 141 251
    unshare, setns, mount, umount2, pivot_root, chroot: 272 308 165 166 155 161
    bpf, userfaultfd, add_key, request_key, keyctl: 321 323 248 249 250
    migrate_pages, move_pages: 256 279
    shmget, shmat, semget, msgget, mq_open, memfd_create: 29 30 64 68 240 319
    reboot, kexec_load, kexec_file_load: 169 246 320
    init_module, finit_module, delete_module: 175 313 176
    sethostname, setdomainname, swapon, swapoff, acct, quotactl, syslog: 170 171 167 168 163 179 103
    settimeofday, adjtimex, clock_settime, clock_adjtime: 164 159 227 305
    mknod, mknodat, name_to_handle_at, open_by_handle_at, fanotify_init: 133 259 303 304 300
    iopl, ioperm, modify_ldt, lookup_dcookie: 172 173 154 212
    """,
    "aarch64": """
    socket, connect: 198 203
    chmod, chown, utime and their kind: 52 53 54 55 88
    setxattr, removexattr and their kind: 5 6 7 14 15 16
    ptrace, process_vm_readv and writev, kcmp, perf_event_open: 117 270 271 272 241
    sched_setparam, -scheduler, -affinity, -attr, setpriority, ioprio_set: 118 119 122 274 140 30
    unshare, setns, mount, umount2, pivot_root, chroot: 97 268 40 39 41 51
    bpf, userfaultfd, add_key, request_key, keyctl: 280 282 217 218 219
    migrate_pages, move_pages: 238 239
    shmget, shmat, semget, msgget, mq_open, memfd_create: 194 196 190 186 180 279
    reboot, kexec_load, kexec_file_load: 142 104 294
    init_module, finit_module, delete_module: 105 273 106
    sethostname, setdomainname, swapon, swapoff, acct, quotactl, syslog: 161 162 224 225 89 60 116
    settimeofday, adjtimex, clock_settime, clock_adjtime: 170 171 112 266
    mknodat, name_to_handle_at, open_by_handle_at, fanotify_init: 33 264 265 262
    lookup_dcookie: 18
    """,
}
SOME = {
    "x86_64": (0xC000003E, 317, 302, 56, 72, 16, 53),
    "aarch64": (0xC00000B7, 277, 261, 220, 25, 29, 199),
}
"""What each machine is audited as, and the calls of which some are refused: seccomp, prlimit64,
clone, fcntl, ioctl, socketpair.
"""


def _numbers(table: str) -> list[int]:
    """The numbers of calls in lines of their names and numbers."""
    return [int(number) for number in re.findall(r"\b\d+\b", table)]


# on all machines; told that there is none, the C library takes clone, whose flags a filter sees
CLONE3 = 435
LOAD, EQUAL, AT_LEAST, HAS, RETURN = 0x20, 0x15, 0x35, 0x45, 0x06  # instructions of the filter
ALLOW, REFUSE, NONE = 0x7FFF0000, 0x00050001, 0x00050026  # with EPERM, with ENOSYS
FIRST, SECOND = 16, 24  # where arguments of a call stand: the low half, on the machines above
A_THREAD, NAMESPACES = 0x10000, 0x7E020000  # flags of clone
OWNERS = 8, 10, 15  # of fcntl: whom the kernel signals
ASKS = 0x5412, 0x541C, 0x8901, 0x8902  # of ioctl: type into a terminal, whom the kernel signals
# of socketpair: its only family, and bits of its types. SOCK_STREAM (1) and SOCK_SEQPACKET (5) have
# the first and not the others; a pair of SOCK_DGRAM (2) or SOCK_RAW (3) sends to any path.
UNIX, CONNECTED, TO_ANY = 1, 0b1, 0b1010


def _refuse_calls(libc: ctypes.CDLL) -> bool:
    """Have the kernel refuse the calls above, of all threads; other processes' limits and new
    processes, too. Whether it does.
    """
    name = os.uname().machine
    if name not in CALLS:
        return False
    machine, seccomp, prlimit, clone, fcntl, ioctl, socketpair = SOME[name]
    refuse = RETURN, 0, 0, REFUSE
    lines = [
        (LOAD, 0, 0, 4),  # the machine: another one's calls have other numbers
        *((EQUAL, 1, 0, machine), refuse),
        (LOAD, 0, 0, 0),  # the call
        *((AT_LEAST, 0, 1, 1 << 30), refuse),  # those of x32
        *((EQUAL, 0, 1, CLONE3), (RETURN, 0, 0, NONE)),
    ]
    for number in _numbers(CALLS[name] + ALSO):
        lines += (EQUAL, 0, 1, number), refuse
    lines += _where(prlimit, FIRST, (EQUAL, 1, 0, 0))  # its process, 0: its own
    lines += _where(clone, FIRST, (HAS, 1, 0, A_THREAD), (HAS, 0, 1, NAMESPACES))
    lines += _where(fcntl, SECOND, *((EQUAL, 0, 1, number) for number in OWNERS))
    lines += _where(ioctl, SECOND, *((EQUAL, 0, 1, number) for number in ASKS))
    lines += _where(socketpair, FIRST, (EQUAL, 1, 0, UNIX))
    lines += _where(socketpair, SECOND, (HAS, 1, 0, CONNECTED), (HAS, 0, 1, TO_ANY))
    lines.append((RETURN, 0, 0, ALLOW))
    program = ctypes.create_string_buffer(b"".join(struct.pack("=HBBI", *line) for line in lines))
    pointer = struct.pack("@HP", len(lines), ctypes.addressof(program))
    return libc.syscall(seccomp, 1, 1, pointer) == 0


def _where(
    call: int, place: int, *tests: tuple[int, int, int, int]
) -> list[tuple[int, int, int, int]]:
    """Lines that refuse a call whose argument one of the tests finds: such a test jumps over the
    refusal behind it, or not. Those that follow find the number of the call loaded again.
    """
    lines = [(LOAD, 0, 0, place)]
    for test in tests:
        lines += test, (RETURN, 0, 0, REFUSE)
    lines.append((LOAD, 0, 0, 0))
    return [(EQUAL, 0, len(lines), call), *lines]


if __name__ == "__main__":
    held = _Held(socket.socket(fileno=int(sys.argv[1])).makefile("rwb"))
    while True:
        held.send(*held.answer(*held.receive()))
