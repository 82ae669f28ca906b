"""The exit code is that of the outcome, whatever happens to the streams; and a plugin that ends the
program is named.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from vstestbed.cli.ending import Stream

RUN = ("run", "quick.yaml", "--video", "none", "--json")
LATE = ("--set", "stop.duration_s=0.2")
LAW = '''
import sys
from typing import Literal
import vstestbed as vs

@vs.LAWS.add
@vs.spec
class {name}(vs.LawBase):
    """Ends badly."""
    kind: Literal["{kind}"] = "{kind}"
    def {method}:
        {body}
'''


def shell(
    process: tuple[list[str], dict[str, str]], folder: Path, words: tuple[str, ...], streams: str
) -> subprocess.CompletedProcess[str]:
    """A command line with redirections; what `head` or another reader gives back does not count."""
    line = " ".join(f"'{word}'" for word in (*process[0], *words))
    script = f"set -o pipefail; {line} {streams}"
    return subprocess.run(
        ["bash", "-c", script],
        cwd=folder,
        env=process[1],
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.mark.process
@pytest.mark.parametrize(
    ("words", "streams", "code"),
    [
        ((*RUN, *LATE), "| true", 3),
        pytest.param(RUN, ">/dev/full", 4, marks=pytest.mark.study),
        pytest.param((*RUN[:-1], *LATE), "2>/dev/full", 3, marks=pytest.mark.study),
        # a quick test of test_app has the like
        pytest.param(("list", "laws"), "| true", 0, marks=pytest.mark.study),
        (("list", "laws"), ">/dev/full", 4),
        pytest.param(("schema",), ">/dev/full", 4, marks=pytest.mark.study),
    ],
)
def test_streams_do_not_change_the_outcome(
    quick: Path,
    tmp_path: Path,
    vstestbed_process: Any,
    words: tuple[str, ...],
    streams: str,
    code: int,
):
    ended = shell(vstestbed_process, tmp_path, words, streams)
    assert ended.returncode == code, ended.stderr
    assert "Traceback" not in ended.stderr
    if ">/dev/full" in streams.split():
        assert ended.stderr.splitlines()[-1].startswith("standard output: ")
    if words[0] == "run":
        summary = json.loads((tmp_path / "runs/quick/001/summary.json").read_text(encoding="utf-8"))
        assert summary["outcome"] == (
            "timed_out" if "stop.duration_s=0.2" in words else "converged"
        )
        assert (tmp_path / "runs/quick/001/report.html").is_file()


def test_a_stream_drops_its_text_from_the_first_error_on(tmp_path: Path):
    reading, writing = os.pipe()
    os.close(reading)
    with open(writing, "w", encoding="utf-8") as pipe:  # noqa: PTH123 - a descriptor
        gone = Stream(pipe)
        gone.write("words")
        assert gone.failed == "" and gone.lack is not None  # its reader chose to go
        gone.write("more")
        gone.flush()
    with Path("/dev/full").open("w", encoding="utf-8") as full:
        lost = Stream(full)
        lost.write("words")
        assert lost.failed == "No space left on device"


def test_a_plugin_that_ends_a_run_is_named(command, quick: Path, own_kinds: None):
    text = LAW.format(name="Leaves", kind="leaves", method="init(self, goal)", body="sys.exit(0)")
    text += "    def step(self, memory, observation, goal, basis):\n        return memory\n"
    Path("leaves_law.py").write_text(text, encoding="utf-8")
    ended = command(*RUN, "--plugin", "leaves_law", "--set", "law=leaves")
    assert (ended.code, ended.out) == (1, "")
    assert (
        "leaves_law.py:12: Leaves.init of plugin leaves_law called sys.exit(0); mend it"
        in ended.err
    )
    assert ended.err.count("\n") == 1
    assert not Path("runs").exists()


@pytest.mark.parametrize(
    ("name", "body", "words"),
    [
        ("raises", "return 1 / 0", "ZeroDivisionError: division by zero (raises_law.py, line 12)"),
        (
            "deep",
            "import numpy; numpy.linalg.inv(numpy.zeros((2, 2)))",
            "LinAlgError: Singular matrix (deep_law.py, line 12)",
        ),
        ("exits", "sys.exit(0)", "SystemExit: 0 (exits_law.py, line 12)"),
    ],
)
def test_a_law_that_fails_stops_the_robot_and_is_named(
    command, quick: Path, own_kinds: None, name: str, body: str, words: str
):
    step = "step(self, memory, observation, goal, basis)"
    Path(f"{name}_law.py").write_text(
        LAW.format(name=name.title(), kind=name, method=step, body=body), encoding="utf-8"
    )
    ended = command(*RUN, "--plugin", f"{name}_law", "--set", f"law={name}")
    summary = json.loads(ended.out)
    assert (ended.code, ended.err, summary["outcome"]) == (3, "", "law_failed")
    assert words in summary["reason"]


def test_an_interrupt_before_the_first_frame_is_said(
    command, quick: Path, monkeypatch: pytest.MonkeyPatch
):
    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("vstestbed.scenario.load.load", interrupted)
    ended = command(*RUN)
    assert (ended.code, ended.err) == (130, "interrupted\n")


@pytest.mark.process
def test_an_interrupt_that_a_finaliser_swallows_comes_again(tmp_path: Path):
    code = (
        "import signal, time\nfrom vstestbed.cli.ending import exit_code\n"
        "class Ends:\n    def __del__(self): signal.raise_signal(signal.SIGTERM); sum(range(10))\n"
        "def work():\n    Ends()\n    time.sleep(5)\n"
        "raise SystemExit(exit_code(work))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (130, "interrupted\n")


def test_a_plugin_that_leaves_while_it_is_imported_is_bad_input(command, quick: Path):
    Path("leaves_at_once.py").write_text("import sys\nsys.exit(0)\n", encoding="utf-8")
    ended = command("list", "laws", "--plugin", "leaves_at_once")
    assert (ended.code, ended.out) == (2, "")
    assert ended.err.endswith(
        "leaves_at_once.py:2: ends Python with sys.exit(0) when it is imported; correct the plugin,"
        " or leave it out\n"
    )


@pytest.mark.process
@pytest.mark.parametrize(
    ("error", "code", "ignored"), [("MemoryError('x')", 4, 0), ("ValueError('x')", 1, 1)]
)
def test_finalisers_of_what_is_half_made_are_silent_for_want_of_memory_alone(
    tmp_path: Path, error: str, code: int, ignored: int
):
    script = (
        "from vstestbed.cli.ending import exit_code\n"
        "class Half:\n    def __init__(self): self.me = self; raise "
        + error
        + "\n    def __del__(self): self.context.free()\n"
        "raise SystemExit(exit_code(Half))"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr.count("Exception ignored")) == (code, ignored), done.stderr
    if code == 4:
        assert (
            done.stderr.startswith("not enough memory (x); close other")
            and done.stderr.count("\n") == 1
        )
