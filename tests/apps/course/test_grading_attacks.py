"""Attacks of a student's file on its marks: none changes what the process that marks concludes, and
each ends.

The world: the ideal camera with the oracle, one start, two points for reaching the goal. The
student's law rests, which is worth nothing, and its file attacks beside. A file that leaves no
result at all ends the command with 3, even where no mark is asked for.
"""

from __future__ import annotations

import json
import os
import random
import socket
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import yaml

from vstestbed.apps.course.grading import Lab, Mark, Result, grade, read_lab
from vstestbed.core.errors import ParameterError, ScenarioError
from vstestbed.laws import LAWS
from vstestbed.laws.base import LawFailedError
from vstestbed.loop import isolated
from vstestbed.testing import child

SEED = 52317
REFUSES = (
    sys.platform == "linux"
    and os.uname().machine in child.CALLS
    and Path("/proc/sys/kernel/seccomp").exists()
)
RESTING = """\
import atexit, builtins, gc, json, os, socket, sys, threading, time
from typing import Literal

import numpy as np

import vstestbed as vs


@vs.LAWS.add
@vs.spec
class Student(vs.LawBase):
    kind: Literal["student"] = "student"

    def step(self, state, observation, goal, basis):
        return state, attack(basis)


def attack(basis):
    return vs.Command.rest(basis, "it rests")


"""
OF_COMMANDS = """
def attack(basis):
    n = basis.shape[1]
    return vs.Command({values})
"""
FORGED_COMMAND = """
import vstestbed.testing.child as child
dumps = json.dumps
def forged(answer, **how):
    told = answer[1]
    if isinstance(told, tuple) and isinstance(told[-1], dict): told[-1]["{key}"] = {value}
    return dumps(answer, **how)
json.dumps = forged
"""
FORGED = """
import vstestbed.testing.child as child
dumps, asked = json.dumps, []
def forged(answer, **how):
    asked.append(1)
    return dumps({answer} if len(asked) > {first} else answer, **how)
json.dumps = forged
"""
LEAVES_NOTHING = {
    "ends its process as it is loaded": "os._exit(0)",
    "ends Python as it is loaded": "sys.exit(0)",
    "ends its process in a step": "def attack(basis): os._exit(0)",
    "ends its process by a thread": (
        "threading.Timer(0.3, os._exit, [0]).start()\ndef attack(basis): time.sleep(9)"
    ),
    "never ends": "def attack(basis):\n    while True: pass",
    "sleeps": "def attack(basis): time.sleep(1e6)",
    "stops itself": "import signal\ndef attack(basis): os.kill(os.getpid(), signal.SIGSTOP)",
    "crashes the interpreter": "import ctypes\ndef attack(basis): ctypes.string_at(0)",
    "writes on every open file": (
        """
for number in range(3, 30):
    try: os.write(number, b'\\0' * 7 + b'\\x30' + b'[false, [1, {"u": [0,0,0,0,0,0]}]]' * 9)
    except OSError: pass
"""
    ),
    "closes every open file": "def attack(basis): os.closerange(0, 99)",
    "answers without an end": FORGED.format(answer='"x" * (1 << 22)', first=4),
    "answers a deep list": (
        FORGED.format(answer="1", first=4) + "json.dumps = lambda *a, **k: '[' * 60000"
    ),
    "answers a number of 5,000 digits": (
        FORGED.format(answer="1", first=4) + "json.dumps = lambda *a, **k: '9' * 5000"
    ),
    "answers that it is reached": FORGED.format(answer='[False, "converged"]', first=5),
    "declares columns of the truth and no tasks": FORGED.format(
        answer='[False, {"columns": ["position_error_m"], "tasks": []}]', first=0
    ),
    "asks for the robot's Jacobian without end": (
        """
import vstestbed.testing.child as child
def attack(basis):
    held = next(x for x in gc.get_objects() if type(x).__name__ == "_Held")
    while True:
        held.send(child.JACOBIAN, np.zeros(6))
        held.receive()
Student.inputs = ("robot",)
"""
    ),
    "asks for a Jacobian that there is none of": (
        """
import vstestbed.testing.child as child
def attack(basis):
    held = next(x for x in gc.get_objects() if type(x).__name__ == "_Held")
    held.send(child.JACOBIAN, ["q"])
    held.receive()
"""
    ),
    "leaves processes that outlive it, with its files open": (
        """
if os.fork() == 0:
    os.setsid()
    time.sleep(2)
    os._exit(0)
os._exit(0)
"""
    ),
}
LEAVES_NOTHING["has a column of the log that judges"] = "Student.columns = ('level_error_px',)"
LEAVES_NOTHING["loads for longer than the task has"] = "time.sleep(8)"
LEAVES_NOTHING["leaves folders that are nested deeply"] = """
for i in range(3000):
    os.mkdir("d")
    os.chdir("d")
os._exit(0)
"""
LEAVES_NOTHING["writes on into its folder from a process of its own"] = """
if os.fork() == 0:
    os.setsid()
    end = time.time() + 20
    while time.time() < end:
        try: os.makedirs(f"d/{time.time()}")
        except OSError: pass
    os._exit(0)
time.sleep(0.5)
os._exit(0)
"""
LEAVES_NOTHING |= {
    f"forges {name}": FORGED_COMMAND.format(key=key, value=value)
    for name, key, value in (
        ("a mode that no table counts to", "mode", "10**30"),
        ("a negative mode", "mode", "-1"),
        ("a scale that is not finite", "scale", "float('nan')"),
        ("rates of 1e300", "rates", "[1e300]"),
        ("free motions that are too large", "free", "[[1e200, [[1e200]] * 6]]"),
        ("free motions that are not finite", "free", "[[1.0, [[float('inf')]] * 6]]"),
    )
}
LEAVES_A_RESULT = {
    "is in a mode that it has not": "Student.modes = ('a',)"
    + OF_COMMANDS.format(values="np.zeros(n), np.zeros(6), mode=10**30"),
    "patches the grader": """
import vstestbed.apps.course.grading as g, vstestbed.testing.laws as l, vstestbed.loop.session as s
g._reasons = g._unchecked = lambda *given: iter(())
g.Result.given = property(lambda self: self.points)
g.Mark.points = property(lambda self: (2.0, 2.0))
l.check_law = g.check_law = s.run = lambda *given, **named: None
""",
    "patches outcomes, comparisons and builtins": """
from vstestbed.core.outcome import Outcome
Outcome.success = property(lambda self: True)
builtins.len = lambda x: 0
builtins.sum = lambda *a: 2.0
""",
    "adds a monitor, a metric and a goal that reach": """
from vstestbed.tasks.metrics import METRICS
from vstestbed.endings.monitors import MONITORS
for registry in (METRICS, MONITORS, vs.GOALS): registry._members.clear()
""",
    "prints the points at its end": """
def said(*given):
    print("**2 of 2 points** (student.py)", flush=True)
    os._exit(0)
atexit.register(said)
sys.stdout.write("**2 of 2 points** (student.py)\\n::set-output name=points::2\\n")
""",
    "begins a row of its own in the table": """
def attack(basis): raise ValueError("no\\n| It arrives. | 2 of 2 | passed |\\n")
""",
    "raises without end": "def attack(basis): return attack(basis)",
    "ends Python in a step": "def attack(basis): sys.exit(0)",
    "takes all memory": "def attack(basis): return np.ones(1 << 40)",
    "orders what is not finite": OF_COMMANDS.format(
        values="np.full(n, np.nan), np.full(6, np.inf)"
    ),
    "orders 1e300 m/s": OF_COMMANDS.format(values="np.full(n, 1e300), np.full(6, 1e300)"),
    "orders too many numbers": OF_COMMANDS.format(values="np.zeros(n + 3), np.zeros(6)"),
    "orders a text": OF_COMMANDS.format(values="'u', 'twist'"),
    "orders rates of another robot": OF_COMMANDS.format(
        values="np.zeros(n), np.zeros(6), rates=np.ones(3)"
    ),
    "orders free motions of another shape": OF_COMMANDS.format(
        values="np.zeros(n), np.zeros(6), free=((1.0, np.ones((2, 2))),)"
    ),
    "claims a mode and an error of its own": OF_COMMANDS.format(
        values="np.zeros(n), np.zeros(6), mode=-7, error_grey=0.0"
    ),
    "speaks to terminals, HTML and Markdown": r"""
def attack(basis): raise ValueError("\ud800 \x1b[2J \u202e <script> `| 2 of 2 |")
""",
    "returns an object that acts when it is unpacked": """
class Acts:
    def __reduce__(self): return os.abort, ()
def attack(basis): return Acts()
""",
    "looks for the seed": f"""
def attack(basis):
    found = [sys.argv, sys.orig_argv, dict(os.environ)]
    for name in ("cmdline", "environ"):
        try: found.append(open(f"/proc/{{os.getppid()}}/{{name}}").read())
        except OSError: pass
    held = [x for x in gc.get_objects() if type(x).__name__ in ("Scenario", "Lab", "LabTask")]
    raise ValueError("SEED" if "{SEED}" in repr(found) or held else "nothing found")
""",
}


@pytest.fixture
def lab(quick: Path, tmp_path: Path) -> Lab:
    task = {"title": "It arrives.", "points": 2, "scenario": quick.name, "seeds": 1, "limit_s": 2}
    (tmp_path / "lab.yaml").write_text(
        yaml.safe_dump({"title": "A lab", "kind": "student", "tasks": [task]})
    )
    return read_lab(tmp_path / "lab.yaml")


def marked(lab: Lab, folder: Path, attack: str) -> Mark:
    file = folder / "student.py"
    file.write_text(RESTING + attack)
    return grade(lab, file, first_seed=SEED, beside=folder)


@pytest.mark.process
@pytest.mark.parametrize("attack", LEAVES_NOTHING.values(), ids=LEAVES_NOTHING)
def test_a_file_that_leaves_no_result_has_no_point_and_is_told_of(
    attack: str, lab: Lab, own_kinds, tmp_path: Path, monkeypatch
) -> None:
    own = tmp_path / "own"
    own.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(own))
    began = time.monotonic()
    mark = marked(lab, tmp_path, attack)
    left = [path.name for path in own.iterdir()]
    # Python cannot, of folders that are nested deeply
    subprocess.run(["rm", "-rf", own], check=True)
    assert mark.points == (0, 2) and mark.missing, mark.markdown()
    assert not [name for name in left if name.startswith("law_")]
    # s: the task has 2, Python and the package take some to start on a loaded machine
    assert time.monotonic() - began < 60


@pytest.mark.process
@pytest.mark.parametrize("check", [0, 1])
def test_a_file_that_is_never_loaded_takes_no_longer_than_a_task_of_the_lab(
    check: int, lab: Lab, own_kinds, tmp_path: Path, monkeypatch
) -> None:
    """Nor does a law in the suite of the room: both had limits of their own, which are longer."""
    given = list[float]()
    ask = isolated.Child.ask

    def asked(self: Any, of: Any, seconds: float, method: str, *words: Any) -> Any:
        if method in ("make", "init", "step"):
            given.append(seconds)
        return ask(self, of, seconds, method, *words)

    monkeypatch.setattr(isolated.Child, "ask", asked)
    never = "time.sleep(1e6)" if not check else "def attack(basis): time.sleep(1e6)"
    mark = marked(replace(lab, check=check), tmp_path, never)
    assert not mark.points[0] and mark.missing and "none within" in mark.markdown()
    assert given and max(given) <= 2


@pytest.mark.process
@pytest.mark.parametrize("attack", LEAVES_A_RESULT.values(), ids=LEAVES_A_RESULT)
def test_no_attack_beside_a_law_that_rests_gives_a_point(
    attack: str, lab: Lab, own_kinds: None, tmp_path: Path
) -> None:
    mark = marked(lab, tmp_path, attack)
    assert mark.points == (0, 2), mark.markdown()
    mark.write(tmp_path)
    assert "SEED" not in mark.markdown() and mark.markdown().count("\n| It arrives.") == 1
    written = (tmp_path / "mark.md").read_text(encoding="utf-8").replace("\n", "")
    assert written.isprintable() and not set(written) & set("<`")
    assert Result.given.fget is not None and "isolated" not in LAWS.members


@pytest.mark.process
def test_without_a_result_the_command_ends_with_3_and_nothing_of_it_is_on_standard_output(
    command, lab, own_kinds, tmp_path
) -> None:
    (tmp_path / "student.py").write_text(
        RESTING + "sys.stdout.write('2 of 2 points')\nsys.stdout.flush()\nos._exit(0)"
    )
    ended = command(
        "grade", tmp_path / "lab.yaml", tmp_path / "student.py", "--quiet", "--out", "marks"
    )
    assert (
        ended.code == 3
        and "**0 of 2 points**" in ended.out
        and "2 of 2 points" in ended.err
        and "2 of 2" not in ended.out
    )
    assert json.loads(Path("marks/mark.json").read_text())["points"] == 0


@pytest.mark.process
def test_a_seed_in_the_environment_is_taken_and_not_handed_on(
    command, lab, own_kinds, tmp_path, monkeypatch
) -> None:
    monkeypatch.setenv("VSTESTBED_FIRST_SEED", str(SEED))
    (tmp_path / "student.py").write_text(RESTING + LEAVES_A_RESULT["looks for the seed"])
    ended = command("grade", tmp_path / "lab.yaml", tmp_path / "student.py", "--quiet", "--pass", 1)
    assert ended.code == 3 and "nothing found" in ended.out and "SEED" not in ended.out


@pytest.mark.process
@pytest.mark.skipif(
    not child.landlock(),
    reason="this system has no Landlock, by which the process gives its rights up",
)
def test_where_linux_can_the_process_reads_writes_signals_and_connects_to_nothing_else(
    lab, own_kinds, tmp_path
) -> None:
    listening = socket.create_server(("127.0.0.1", 0))
    (tmp_path / "marks.json").write_text("{}")
    tries = f"""
import vstestbed
def tried(name, act):
    try: act()
    except OSError: return ""
    return name + ", "
raise ValueError("done: " + "".join([
    tried("package", lambda: open(vstestbed.__file__, "r+")),
    tried("marks", lambda: open({str(tmp_path / "marks.json")!r}, "r+")),
    tried("new file", lambda: open({str(tmp_path / "new.json")!r}, "w")),
    tried("memory", lambda: open(f"/proc/{{os.getppid()}}/mem", "rb")),
    tried("words", lambda: open(f"/proc/{{os.getppid()}}/cmdline")),
    tried("home", lambda: os.listdir({str(Path.home())!r})),
    tried("signal", lambda: os.kill(os.getppid(), 0)),
    tried("network", lambda: socket.create_connection(("127.0.0.1", {listening.getsockname()[1]}))),
]) + ".")
"""
    mark = marked(lab, tmp_path, tries)
    listening.close()
    assert "done: ." in mark.markdown(), mark.markdown()


def test_a_lab_marks_laws_alone_since_other_kinds_would_be_part_of_the_judge(quick: Path) -> None:
    task: Any = {"title": "It arrives.", "points": 2, "scenario": quick.name}
    for field, right in (
        ("law", True),
        ("law.feature", True),
        ("detector", False),
        ("lawn", False),
        ("robot", False),
    ):
        if right:
            assert Lab(title="A lab", kind="student", field=field, tasks=(task,)).field == field
        else:
            with pytest.raises(ParameterError, match="field must be law"):
                Lab(title="A lab", kind="student", field=field, tasks=(task,))


class _Wire:
    """The channel of a law's process that has been taken over:
    each answer is the next of a list.
    """

    def __init__(self, answers: list[bytes]):
        self.answers, self.left = answers, b""

    def settimeout(self, seconds: float) -> None: ...
    def close(self) -> None: ...

    def sendall(self, message: bytes) -> None:
        said = self.answers.pop(0)
        self.left = len(said).to_bytes(8, "big") + said

    def recv(self, size: int) -> bytes:
        given, self.left = self.left[:size], self.left[size:]
        return given


def test_whatever_bytes_answer_a_step_it_is_a_command_or_a_failure_of_the_law() -> None:
    right = {
        "u": [0.1] * 6,
        "twist": [0.1] * 6,
        "rates": None,
        "wrench": None,
        "rest_reason": "",
        "scale": 1.0,
        "free": [],
        "mode": 0,
    }
    whole = json.dumps([False, [1, right | {"row": []}]]).encode()
    rng, others = (
        random.Random(5),
        [
            b"",
            b"0",
            b'"x"',
            b"null",
            b"[]",
            b"{}",
            b"1e999",
            b"NaN",
            b"[[[[]]]]",
            b"9" * 400,
            b"\xff",
            b"true",
        ],
    )
    seen: Any = SimpleNamespace(robot=None)
    given = failed = 0
    for _ in range(2000):
        at, to = sorted(rng.sample(range(len(whole) + 1), 2))
        said = whole[:at] + rng.choice(others) + whole[min(to, at + rng.choice((1, 6, 40))) :]
        child = object.__new__(isolated.Child)
        child.ended, child.spent_s, child._goal, child._channel = True, 0.0, None, _Wire([said])  # pyright: ignore[reportAttributeAccessIssue] - in its place
        try:
            number, command = child.step(1.0, 1, seen, seen, np.eye(6))
        except (LawFailedError, ParameterError):
            failed += 1
        else:
            given += 1
            assert (
                isinstance(number, int) and command.u.shape == (6,) and np.isnan(command.error_grey)
            )
    assert given > 20 and failed > 1000  # of these seeds 5 % and more are still a command


def test_the_process_gets_neither_the_words_nor_the_environment_of_the_one_that_marks(
    own_kinds, monkeypatch
) -> None:
    started: dict[str, Any] = {}

    class NeverStartedError(Exception): ...

    def popen(words: list[str], **how: Any) -> None:
        started.update(how, words=words)
        raise NeverStartedError

    monkeypatch.setattr(isolated.subprocess, "Popen", popen)
    monkeypatch.setenv("TOKEN", "secret")
    with isolated.offered(), pytest.raises(NeverStartedError):
        isolated.Isolated(files=("mine.py",))
    assert set(started["env"]) <= {*isolated.INHERITED, *isolated.ONE_CORE, "HOME", "TMPDIR"}
    assert (
        started["words"][1:4] == ["-Pu", "-m", "vstestbed.testing.child"]
        and len(started["words"]) == 5
    )
    assert started["cwd"] == started["env"]["HOME"] == started["env"]["TMPDIR"] != str(Path.cwd())


@pytest.mark.process
def test_a_file_of_the_current_folder_takes_no_bundled_scenarios_place(
    own_kinds, tmp_path: Path, monkeypatch
) -> None:
    """A class marks in the student's repository: a scenario there, and the plugin that it names,
    are no part of what judges.
    """
    there, here = tmp_path / "lab", tmp_path / "student"
    there.mkdir()
    here.mkdir()
    task = {"title": "It arrives.", "points": 2, "scenario": "ibvs_book", "seeds": 1, "limit_s": 20}
    (there / "lab.yaml").write_text(
        yaml.safe_dump({"title": "A lab", "kind": "student", "tasks": [task]})
    )
    monkeypatch.chdir(here)
    (here / "evil.py").write_text("raise SystemExit('loaded')")
    for name in ("ibvs_book", "other.yaml"):
        (here / name).write_text("plugins: [evil.py]\nrobot: free\n")
    for beside in (there, None):
        read = read_lab(there / "lab.yaml")
        (here / "student.py").write_text(RESTING)
        mark = grade(read, here / "student.py", beside=beside)
        assert mark.points == (0, 2) and "0 of 1 run reached the goal" in mark.markdown()
    (there / "lab.yaml").write_text(
        yaml.safe_dump(
            {"title": "A lab", "kind": "student", "tasks": [task | {"scenario": "other.yaml"}]}
        )
    )
    with pytest.raises(ScenarioError, match="no such file, and no bundled scenario"):
        read_lab(there / "lab.yaml")


def test_who_kills_a_process_that_does_not_go_does_not_wait_for_ever(
    tmp_path: Path, monkeypatch
) -> None:
    """A process of another session that traces it keeps it."""
    waited: list[float | None] = []

    def never(timeout: float | None = None) -> None:
        waited.append(timeout)
        raise subprocess.TimeoutExpired("law", timeout or 0.0)

    gone = subprocess.Popen(["true"], start_new_session=True)
    gone.wait()
    child = object.__new__(isolated.Child)
    child.ended = False
    child._process = SimpleNamespace(pid=gone.pid, wait=never, kill=lambda: None)  # pyright: ignore[reportAttributeAccessIssue] - in its place
    child._channel, child._printed = _Wire([]), tempfile.TemporaryFile()  # pyright: ignore[reportAttributeAccessIssue]  # noqa: SIM115 - it is closed with the process
    child._place = tempfile.TemporaryDirectory()
    child.close()
    assert waited == [isolated.GONE_S]


@pytest.mark.process
@pytest.mark.skipif(
    not REFUSES, reason="this system has no seccomp, or is of a machine whose calls are not known"
)
def test_where_linux_can_the_process_changes_nothing_of_others_by_calls_that_no_file_guards(
    lab, own_kinds, tmp_path
) -> None:
    """What Landlock leaves open: sockets with a path and without, modes, owners, times and
    attributes of files, limits of the judge.
    """
    marks = tmp_path / "marks.json"
    marks.write_text("{}")
    before = marks.stat()
    listening = socket.socket(socket.AF_UNIX)
    place = tempfile.mkdtemp()
    listening.bind(f"{place}/s")
    listening.listen()
    box = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    box.bind(f"{place}/box")
    tries = f"""
import ctypes, resource
libc = ctypes.CDLL(None, use_errno=True)
above, marks = os.getppid(), {str(marks)!r}
def tried(name, act):
    try: found = act()
    except OSError: return ""
    return "" if found == -1 else name + ", "
def datagrams(kind):
    return socket.socketpair(socket.AF_UNIX, kind)[0].sendto(b"a secret", {place!r} + "/box")
def traced():
    return libc.ptrace(16, above, None, None)
raise ValueError("done: " + "".join([
    tried("Unix", lambda: socket.socket(socket.AF_UNIX).connect({place!r} + "/s")),
    tried("UDP", lambda: socket.socket(socket.AF_INET, socket.SOCK_DGRAM)),
    tried("mode", lambda: os.chmod(marks, 0o777)),
    tried("own mode", lambda: os.chmod(__file__, 0o777)),
    tried("owner", lambda: os.chown(marks, -1, -1)),
    tried("times", lambda: os.utime(marks, (0, 0))),
    tried("attribute", lambda: os.setxattr(marks, "user.a", b"1")),
    tried("limits", lambda: resource.prlimit(above, resource.RLIMIT_NOFILE)),
    tried("cores", lambda: os.sched_setaffinity(above, [0])),
    tried("priority", lambda: os.setpriority(os.PRIO_PROCESS, above, 5)),
    tried("trace", traced),
    tried("namespace", lambda: libc.unshare(0x10000000)),
    tried("own limits", lambda: resource.setrlimit(resource.RLIMIT_CORE, (0, 0)) or -1),
    tried("own pair", lambda: socket.socketpair() and -1),
    tried("own packets", lambda: socket.socketpair(type=socket.SOCK_SEQPACKET) and -1),
    tried("own pair that waits for nothing", lambda: socket.socketpair(type=1 | 0x800) and -1),
    tried("datagrams to a path", lambda: datagrams(socket.SOCK_DGRAM)),
    tried("raw ones", lambda: datagrams(socket.SOCK_RAW)),
    tried("by another family", lambda: socket.socketpair(socket.AF_INET)),
]) + ".")
"""
    mark = marked(lab, tmp_path, tries)
    listening.close()
    box.close()
    assert "done: ." in mark.markdown(), mark.markdown()
    assert (marks.stat().st_mode, marks.stat().st_mtime_ns) == (before.st_mode, before.st_mtime_ns)


@pytest.mark.skipif(not REFUSES, reason="as above")
def test_the_filter_of_calls_is_in_force_and_jumps_to_nowhere_else() -> None:
    """Each call that is named is refused, and those that Python and numpy need are not."""
    words = (
        "import ctypes, os; from vstestbed.testing import child;"
        " libc = ctypes.CDLL(None, use_errno=True); libc.prctl(38, 1, 0, 0, 0); "
    )
    words += "child._drop_capabilities(libc); assert child._refuse_calls(libc); "
    words += "refused = child._numbers(child.CALLS[os.uname().machine] + child.ALSO); "
    words += "assert len(refused) > 80; allowed = ["
    words += (
        "n for n in refused if libc.syscall(n, -1, -1, -1, -1, -1)"
        " != -1 or ctypes.get_errno() != 1]; "
    )
    words += (
        "import threading, numpy; t = threading.Thread(target=numpy.ones, args=(9,)); t.start();"
        " t.join(); print(allowed)"
    )
    assert (
        subprocess.run(
            [sys.executable, "-c", words], capture_output=True, text=True, check=True
        ).stdout
        == "[]\n"
    )


@pytest.mark.process
@pytest.mark.skipif(not REFUSES or not child.landlock(), reason="as above")
def test_where_linux_can_the_process_has_no_power_of_root_no_other_process_and_no_more_memory(
    lab, own_kinds, tmp_path
) -> None:
    """Also for root, whose container this may be: nothing of the machine, no devices, no memory
    that outlives it. No call has arguments by which a kernel that allows it would do something.
    """
    tries = """
import ctypes, fcntl, mmap, subprocess
libc = ctypes.CDLL(None, use_errno=True)
def tried(name, act):
    try: found = act()
    except (OSError, MemoryError): return ""
    return "" if found == -1 else name + ", "
def allowed(call, *given):
    libc.syscall(call, *given)
    return ctypes.get_errno() != 1 or -1
def powers():
    held = ctypes.create_string_buffer(24)
    libc.capget(b"\\x22\\x05\\x08\\x20" + bytes(4), held)
    return -1 if held.raw == bytes(24) else 1
def bounding():
    return any(libc.prctl(23, n, 0, 0, 0) == 1 for n in range(41)) or -1
def new_thread_group():
    clone = 56 if os.uname().machine == "x86_64" else 220
    return libc.syscall(clone, 17, 0, 0, 0, 0) or os._exit(0)
ours, theirs = socket.socketpair()
raise ValueError("done: " + "".join([
    tried("capabilities", powers),
    tried("bounding set", bounding),
    tried("device", lambda: os.mknod("d", 0o20600, os.makedev(1, 3))),
    tried("socket with a path", lambda: socket.socket(socket.AF_UNIX).bind("s")),
    tried("fork", lambda: os.fork() or os._exit(0)),
    tried("clone", new_thread_group),
    tried("spawn", lambda: subprocess.run(["true"])),
    tried("shared memory", lambda: mmap.mmap(-1, 9 << 30)),
    tried("memory file", lambda: os.memfd_create("m")),
    tried("signals to others", lambda: fcntl.fcntl(ours, fcntl.F_SETOWN, os.getpid())),
    tried("signals by ioctl", lambda: fcntl.ioctl(ours, 0x8901, os.getpid().to_bytes(4, "little"))),
    tried("typing", lambda: allowed(16 if os.uname().machine == "x86_64" else 29, -1, 0x5412, 0)),
    tried("own flags", lambda: fcntl.fcntl(ours, fcntl.F_GETFL) and -1),
    tried("own thread", lambda: threading.Thread(target=np.ones, args=(9,)).start() or -1),
]) + ".")
"""
    mark = marked(lab, tmp_path, tries)
    assert "done: ." in mark.markdown(), mark.markdown()
