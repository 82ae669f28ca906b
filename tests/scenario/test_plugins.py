"""Plugins by file and by module: found, remembered in a run's scenario.yaml, loaded again from
anywhere, refused with a place.
"""

from __future__ import annotations

import json
import pickle
import re
import shutil
import subprocess
from pathlib import Path

import pytest

import vstestbed as vs
from vstestbed.core.errors import ParameterError, PluginError, ScenarioError
from vstestbed.laws.switched import Stage
from vstestbed.scenario.catalogue import schema_of
from vstestbed.scenario.plugins import load_plugins, registries

pytestmark = pytest.mark.usefixtures("own_kinds")
EXAMPLES = Path(__file__).parent.parent / "examples"
NO_FILM = ("--video", "none", "--quiet")
LAW = """\
from typing import Literal
import vstestbed as vs
from vstestbed.laws import IBVS

@vs.LAWS.add
@vs.spec
class Mine(IBVS):
    kind: Literal["KIND"] = "KIND"
"""


IN_TURN = """\
import json, sys
from vstestbed.cli.app import main
codes = []
for words in json.loads(sys.argv[1]):
    try: main(words)
    except SystemExit as end: codes.append(end.code)
print(*codes)
"""
"""Several commands `vstestbed` in one process; prints their exit codes."""
ONE_FIGURE = """\
from vstestbed.cli.app import main
from vstestbed.report.comparison import page
page.PLOTS = page.PLOTS[:1]
main()
"""
"""The command `vstestbed`, whose reports of comparisons have one figure."""


def plugin(path: Path, kind: str = "mine", more: str = "") -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(LAW.replace("KIND", kind) + more, encoding="utf-8")
    return path


@pytest.mark.process
def test_the_folder_of_a_run_remembers_its_plugin(
    command, quick: Path, tmp_path: Path, vstestbed_process
) -> None:
    """By its absolute file: reported and run again by another process, from another folder."""
    shutil.copy(EXAMPLES / "broyden.py", tmp_path / "broyden.py")
    ended = command(
        "run",
        "quick.yaml",
        "--plugin",
        "./broyden.py",
        "--set",
        "law={kind: broyden, gain: 3}",
        "--out",
        "run",
        *NO_FILM,
    )
    assert ended.code == 0, ended.err
    assert vs.load("run/scenario.yaml").plugins == (str(tmp_path / "broyden.py"),)
    words, environment = vstestbed_process
    (tmp_path / "far").mkdir()
    lines = (["report", "../run"], ["run", "../run/scenario.yaml", "--out", "again", *NO_FILM])
    both = [words[0], "-c", IN_TURN, json.dumps(lines)]
    done = subprocess.run(
        both, cwd=tmp_path / "far", env=environment, capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stdout.splitlines()[-1:]) == (0, ["0 0"]), done.stderr
    assert (tmp_path / "far/again/log.parquet").read_bytes() == (
        tmp_path / "run/log.parquet"
    ).read_bytes()


def test_a_scenario_names_its_plugins_relative_to_itself(
    quick: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plugin(tmp_path / "lab" / "mine.py")
    text = quick.read_text().replace("kind: ibvs", "kind: mine") + "plugins: [lab/mine.py]\n"
    quick.write_text(text)
    monkeypatch.chdir("/")
    scenario = vs.load(quick, {"law.gain": 2})
    assert (scenario.law.kind, scenario.plugins) == ("mine", (str(tmp_path / "lab" / "mine.py"),))


def test_a_robot_finds_its_body_beside_its_file(command, tmp_path: Path) -> None:
    text = (EXAMPLES / "two_link.py").read_text()
    (tmp_path / "arm").mkdir()
    (tmp_path / "arm/two_link.py").write_text(
        text + "\n\nfrom vstestbed.robots import ROBOTS\n\nROBOTS.add(TwoLink)\n"
    )
    shutil.copy(EXAMPLES / "two_link.xml", tmp_path / "arm")
    (tmp_path / "s.yaml").write_text("""\
plugins: [arm/two_link.py]
robot: two_link
camera: {mount: {xyz: [0, 0, -0.06], rpy_deg: [180, 0, 0]}}
target: {kind: points, at: [[0, 0, 0]], pose: {xyz: [0.45, 0.45, 0.1], rpy_deg: [180, 0, 0]}}
detector: oracle
law: {kind: ibvs, gain: 1.5, depth: goal}
goal: {T_camera_target: {xyz: [0, 0, 0.84]}}
stop: {duration_s: 10, converged: {error_px: 0.5}}
""")
    ended = command("run", "s.yaml", "--json", "--video", "none")
    assert json.loads(ended.out)["outcome"] == "converged", ended.err


def test_two_files_of_one_name_and_one_file_by_two_names(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    a, b = plugin(tmp_path / "a/mine.py", "one"), plugin(tmp_path / "b/mine.py", "two")
    (tmp_path / "link.py").symlink_to(a)
    assert load_plugins(
        [str(a), str(b), str(tmp_path / "a/../a/mine.py"), str(tmp_path / "link.py")]
    )
    assert {"one", "two"} <= set(registries()["laws"].members)
    monkeypatch.syspath_prepend(str(tmp_path / "a"))
    assert load_plugins(["mine"]) == ("mine",)  # the same file once more, as a module
    with pytest.raises(
        PluginError,
        match=(
            r"c\.py:\d+: cannot be imported \(ParameterError:"
            r" kind 'one' is already a law \(.*a/mine\.py\)"
        ),
    ):
        load_plugins([str(plugin(tmp_path / "c.py", "one"))])


def test_a_module_in_the_current_folder_is_remembered_by_its_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(plugin(tmp_path / "here_only.py").parent)
    assert load_plugins(["here_only"]) == (str(tmp_path / "here_only.py"),)
    from here_only import Mine  # pyright: ignore[reportMissingImports] - not loaded a second time

    assert registries()["laws"].members["mine"] is Mine


@pytest.mark.parametrize(
    ("code", "words"),
    [
        (
            "1 / 0",
            (
                r"bad\.py:9: cannot be imported \(ZeroDivisionError: division by zero\);"
                r" correct the plugin, or leave it out"
            ),
        ),
        ("def (", r"bad\.py:9: cannot be imported \(SyntaxError: .*"),
        (
            "import sys; sys.exit(3)",
            r"bad\.py:9: ends Python with sys\.exit\(3\) when it is imported; .*",
        ),
        (
            "import no_such_thing",
            (
                r"bad\.py:9: cannot be imported \(ModuleNotFoundError:"
                r" No module named 'no_such_thing'\).*"
            ),
        ),
    ],
)
def test_a_plugin_that_fails_is_named_with_its_line_and_leaves_nothing(
    command, quick: Path, tmp_path: Path, code: str, words: str
) -> None:
    plugin(tmp_path / "bad.py", more=code + "\n")
    before = set(registries()["laws"].members)
    ended = command("run", "quick.yaml", "--plugin", "bad.py", *NO_FILM)
    assert ended.code == 2
    assert re.fullmatch(f"{re.escape(str(tmp_path))}/{words}", ended.err.strip()), ended.err
    assert set(registries()["laws"].members) == before
    assert (
        "Traceback" in command("--debug", "run", "quick.yaml", "--plugin", "bad.py", *NO_FILM).err
    )
    plugin(tmp_path / "bad.py")  # mended, in the same process
    assert load_plugins([str(tmp_path / "bad.py")])


def test_a_plugin_that_adds_no_kind_is_told_until_it_adds_one(tmp_path: Path) -> None:
    path = tmp_path / "forgot.py"
    path.write_text("class Forgotten: ...\n", encoding="utf-8")
    for _ in range(2):
        with pytest.raises(
            PluginError,
            match=(
                r"forgot\.py: adds no kind;"
                r" write @vs\.LAWS\.add .* and @vs\.spec above its class Forgotten"
            ),
        ):
            load_plugins([str(path)])
    plugin(path, "remembered")
    assert load_plugins([str(path)]) == (str(path),)


@pytest.mark.process
def test_a_plugin_that_is_gone_and_its_new_place(
    command, quick: Path, tmp_path: Path, vstestbed_process
) -> None:
    law = plugin(tmp_path / "old/mine.py")
    assert (
        command(
            "run", "quick.yaml", "--plugin", law, "--set", "law.kind=mine", "--out", "run", *NO_FILM
        ).code
        == 0
    )
    shutil.move(tmp_path / "old", tmp_path / "new")
    for name in ("report", "render"):
        ended = command(name, "run")
        assert ended.code == 2
        line = (
            rf"run/scenario.yaml:\d+:\d+: plugins.0: {law} is not there;"
            r" put it there, or give its place with --plugin PLACE/mine.py\n"
        )
        assert re.fullmatch(line, ended.err), ended.err
    words, environment = vstestbed_process  # this process has the old one loaded
    line = [
        *words,
        "run",
        "run/scenario.yaml",
        "--plugin",
        "new/mine.py",
        "--out",
        "again",
        *NO_FILM,
    ]
    done = subprocess.run(
        line, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert (
        f"plugins: [{tmp_path / 'new/mine.py'}]" in (tmp_path / "again/scenario.yaml").read_text()
    )


@pytest.mark.process
def test_a_comparison_remembers_plugins_for_workers_resume_and_report(
    quick: Path, tmp_path: Path, here: None, vstestbed_process
) -> None:
    """One in the scenario, one beside it; the resumed comparison has a worker and writes its
    report.
    """
    plugin(tmp_path / "a/mine.py", "one"), plugin(tmp_path / "b/mine.py", "two")
    quick.write_text(quick.read_text() + "plugins: [a/mine.py]  # beside\n")
    laws = {"law.kind": ["one", "two"]}
    vs.compare(
        [quick],
        laws,
        seeds=1,
        jobs=1,
        plugins=[str(tmp_path / "b/mine.py")],
        out=tmp_path / "c",
        film=False,
        report=False,
    )
    shutil.rmtree(tmp_path / "c/runs/quick/law.kind=two")
    words, environment = vstestbed_process
    line = [
        words[0],
        "-c",
        ONE_FIGURE,
        "compare",
        "--resume",
        "--out",
        "../c",
        "--jobs",
        "1",
        "--no-film",
        "--quiet",
    ]
    done = subprocess.run(
        line, cwd=tmp_path / "a", env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert len((tmp_path / "c/comparison.csv").read_text().splitlines()) == 3
    assert (tmp_path / "c/report.html").is_file()
    assert "# beside" in (tmp_path / "c/scenarios/quick.yaml").read_text()


def test_schema_and_validators_know_what_a_plugin_adds(tmp_path: Path) -> None:
    load_plugins([str(plugin(tmp_path / "mine.py", "newest"))])
    assert '"newest"' in json.dumps(schema_of(Stage))  # a block that holds a law


@pytest.mark.parametrize("value", ["mine.py", "[1]", "{a: b}", "[[mine.py]]"])
def test_a_list_that_is_none(quick: Path, value: str) -> None:
    quick.write_text(quick.read_text() + f"plugins: {value}\n")
    with pytest.raises(ScenarioError, match=r"plugins.*must be"):
        vs.load(quick)


@pytest.mark.parametrize("name", ["", ".", "..x", "a..b", "x y", "no/where", "\0.py", "/", "é"])
def test_names_of_nothing(name: str) -> None:
    with pytest.raises(PluginError):
        load_plugins([name])


def test_errors_come_whole_out_of_worker_processes() -> None:
    for error in (
        ParameterError("law.gain", "must be > 0", -1),
        PluginError("a.py:3", "is odd"),
        ScenarioError([]),
    ):
        again = pickle.loads(pickle.dumps(error))
        assert (
            type(again) is type(error) and str(again) == str(error) and vars(again) == vars(error)
        )
