"""`vstestbed new`: each file that it writes runs as it is, by its own commands, and passes its own
test.
"""

from __future__ import annotations

import ast
import json
import shlex
import subprocess
import sys
from pathlib import Path
from typing import get_args

import pytest

import vstestbed as vs
from tests.shortcuts import one_quick
from vstestbed.cli.new import REGISTRY_OF, commands_of, text_of
from vstestbed.cli.options import settings_of
from vstestbed.cli.tools import NewKind
from vstestbed.core.fields import class_text
from vstestbed.scenario.plugins import registries

KINDS = list(get_args(NewKind))
SUCCESS = {"motion": "completed"}
"""The outcome of a file's own run, where it is not `converged`."""
LINES = 80


def own_run(text: str) -> list[str]:
    """The words of the command in a file that runs it."""
    test, run = commands_of(text)
    assert test.startswith("pytest ") and run.startswith("vstestbed run ")
    return shlex.split(run)[1:]


@pytest.mark.process
def test_all_pass_their_own_tests(command, tmp_path: Path, vstestbed_process):
    for kind in KINDS:
        ended = command("new", kind, f"own_{kind}")
        assert ended.code == 0, ended.err
        assert ended.out.splitlines() == [
            f"own_{kind}.py runs as it is. Next:",
            *(f"  {c}" for c in commands_of(read(tmp_path, kind))),
        ]
    files = [f"own_{kind}.py" for kind in KINDS]
    words = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *files]
    done = subprocess.run(
        words, env=vstestbed_process[1], cwd=tmp_path, capture_output=True, text=True
    )
    assert done.returncode == 0 and f"{len(KINDS)} passed" in done.stdout, done.stdout[-3000:]


def read(folder: Path, kind: str) -> str:
    return (folder / f"own_{kind}.py").read_text(encoding="utf-8")


@pytest.mark.usefixtures("own_kinds")
@pytest.mark.parametrize("kind", one_quick(*KINDS))
def test_each_runs_to_a_good_end(
    command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str
):
    """With the settings of its own command; by the oracle where the file is not about pictures,
    which takes a tenth of the time.
    """
    command("new", kind, f"own_{kind}")
    words = own_run(read(tmp_path, kind))
    assert words[2:4] == ["--plugin", f"own_{kind}.py"] and words[4] == "--set" and len(words) == 6
    fast = {} if kind in ("detector", "keypoints", "noise") else {"detector": {"kind": "oracle"}}
    if kind == "noise":
        fast = {"stop.converged.error_px": 1.0}
    if kind == "keypoints":
        fast = {
            "camera.width": 320,
            "camera.height": 240,
            "robot.start.nominal": {"xyz": [0.03, 0, -0.63]},
        }
        fast |= {"law.gain": 3, "stop.converged": {"error_px": 6.0, "hold_s": 0.1}}
    if kind == "detector":
        fast = {"camera.width": 400, "camera.height": 400, "camera.pixel_size_m": 2.5e-5}
    scenario = vs.load(words[1], settings_of([words[5]]) | fast, plugins=[words[3]])
    recording = vs.run(scenario)
    assert recording.outcome.name == SUCCESS.get(kind, "converged"), recording.reason
    assert f"own_{kind}" in json.dumps(vs_plain(scenario))
    check_words(kind)


def check_words(kind: str) -> None:
    """`describe` has words for each field of the file's own, and a unit for each number; the blocks
    of others have theirs.
    """
    cls = registries()[REGISTRY_OF.get(kind, f"{kind}s")].members[f"own_{kind}"]
    own = {
        name: text
        for name, text in class_text(cls).fields.items()
        if name in cls.__annotations__ and name != "kind"
    }
    assert own.pop("depth", None) is None or kind == "law"
    assert all(text.description and text.unit for text in own.values()), own


def vs_plain(scenario: vs.Scenario):
    from vstestbed.core.registry import to_mapping

    plain = to_mapping(scenario)
    return {name: value for name, value in plain.items() if name != "plugins"}


@pytest.mark.process
@pytest.mark.study
@pytest.mark.parametrize("kind", KINDS)
def test_each_runs_by_its_own_command(command, tmp_path: Path, vstestbed_process, kind: str):
    command("new", kind, f"own_{kind}")
    start, env = vstestbed_process
    words = own_run(read(tmp_path, kind))
    done = subprocess.run(
        [*start, *words, "--out", "made", "--json"],
        env=env,
        cwd=tmp_path,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    summary = json.loads(done.stdout)
    assert summary["outcome"] == SUCCESS.get(kind, "converged")
    assert (tmp_path / "made" / "report.html").stat().st_size > 10_000
    if kind == "metric":
        assert "Time over the limit" in (tmp_path / "made" / "report.html").read_text()


def test_the_name_is_everywhere_and_the_file_is_short():
    for kind in KINDS:
        text = text_of(kind, "two_words", "sub dir/file.py")
        assert (
            "my_" not in text.lower().replace(f"my_{kind}s", "")
            and f"My{kind.capitalize()}" not in text
        )
        tree = ast.parse(text)
        assert any(isinstance(node, ast.ClassDef) and node.name == "TwoWords" for node in tree.body)
        assert any(
            isinstance(node, ast.FunctionDef) and node.name == "test_two_words"
            for node in tree.body
        )
        assert commands_of(text)[0] == 'pytest "sub dir/file.py"'
        assert text.count("\n") <= LINES


class TestRefusals:
    def test_each_with_one_sentence(self, command, tmp_path: Path):
        for words, sentence in (
            (
                ("law", "My Law"),
                (
                    "NAME needs the form of a word in small letters, digits and _,"
                    " such as my_law, got 'My Law'"
                ),
            ),
            (("law", "class"), "NAME needs the form of a word in small letters"),
            (("law", "ibvs"), "NAME is bundled already (law); take another, such as my_ibvs"),
            (
                ("lens", "fisheye"),
                "NAME is bundled already (lens); take another, such as my_fisheye",
            ),
            (("keypoints", "sift"), "NAME is bundled already (keypoints)"),
            (("noise", "erasing"), "NAME is bundled already (noise)"),
            (
                ("law", "numpy"),
                (
                    "and pytest would import that in its place;"
                    " take another, such as my_numpy, got 'numpy'"
                ),
            ),
            (
                ("law", "mine", "--out", "random.py"),
                "--out is the name of a module that Python finds already (",
            ),
            (("law", "mine", "--out", "mine.txt"), "--out must be a Python file"),
            (("low", "mine"), "'law', 'feature', 'robot', 'detector'"),
        ):
            ended = command("new", *words)
            assert ended.code == 2
            assert sentence in ended.err
            assert list(tmp_path.iterdir()) == []

    def test_a_file_is_never_written_over(self, command, tmp_path: Path):
        assert command("new", "law", "written_once").code == 0
        (tmp_path / "written_once.py").write_text("# a day's work\n", encoding="utf-8")
        ended = command("new", "law", "written_once")
        assert (
            ended.code == 2
            and "written_once.py: is there already, and is not written over" in ended.err
        )
        assert (tmp_path / "written_once.py").read_text() == "# a day's work\n"
        assert command("new", "law", "written_once", "--out", "other.py").code == 0
        assert "pytest other.py" in (tmp_path / "other.py").read_text()


class TestByHand:
    """A class of a notebook or a script, without a file for a plugin."""

    CELL = """
from typing import Literal
import numpy as np
import vstestbed as vs

@vs.LAWS.add
@vs.spec
class Mine(vs.LawBase):
    kind: Literal["mine"] = "mine"
    gain: float = GAIN

    def step(self, state, observation, goal, basis):
        if not observation.seen.all():
            return state, vs.Command.rest(basis, "a marker is out of sight")
        L = vs.features.Point().interaction(observation.xy, observation.depth)
        u = -self.gain * np.linalg.pinv(L @ basis) @ (observation.xy - goal.xy).ravel()
        return state, self.limits.command(u, basis)

scenario = vs.load("ibvs_book", {"law": "mine", "detector": "oracle", "camera.rate_hz": 25.0})
recording = vs.run(scenario)
print(recording.outcome.name, recording.scenario.law.gain)
"""

    @pytest.mark.process
    def test_a_cell_that_is_run_again_replaces_its_class_and_another_class_of_that_word_is_refused(
        self, vstestbed_process
    ):
        code = self.CELL.replace("GAIN", "1.0") + self.CELL.replace("GAIN", "2.0")
        code += self.CELL.replace("GAIN", "3.0").replace("class Mine", "class Other")
        done = subprocess.run(
            [sys.executable, "-c", code], env=vstestbed_process[1], capture_output=True, text=True
        )
        assert done.stdout.splitlines() == ["converged 1.0", "converged 2.0"], done.stderr
        assert "'mine' is already a law" in done.stderr
