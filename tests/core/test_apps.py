"""Apps of this package and of others: what they add, what is refused; former names of modules."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from importlib import import_module
from pathlib import Path

import pytest

from tests.conftest import REPOSITORY, Ended
from vstestbed.core import apps
from vstestbed.core.errors import ParameterError, PluginError
from vstestbed.core.former_modules import FORMER
from vstestbed.studies.pools import must_be_known

pytestmark = pytest.mark.app()
LAMP = """\
from vstestbed.core.apps import App

APP = App(
    commands=dict.fromkeys(("shine", "compare", "tune"), "lamp.parts:shine"),
    executors={"lamp": "lamp.parts:pool", "warp": "lamp.parts:pool"},
    exports={"light": "lamp.parts:LIGHT"},
    reports={"lamp.yaml": "lamp.parts:write_page"},
)
"""
PARTS = """\
from vstestbed.core.shares import at_once
from vstestbed.report.recorded_run import ExportFormat


def shine(times: int = 1) -> None:
    '''Shine so many times.'''
    print("shines", times)


class Pool:
    room, films = 1, True

    def __init__(self, folder):
        (folder / "by_lamp").touch()

    def submit(self, request):
        return at_once(request.perform)

    def call(self, function, *arguments):
        return at_once(function, *arguments)

    def tries(self, request):
        return 1

    def dispatch(self):
        pass

    close = dispatch


def pool(workers, folder, flown):
    return Pool(folder)


LIGHT = ExportFormat(lambda asked: asked.out.write_text(f"{len(list(asked.runs))} run"), ".light")


def write_page(folder, plugins):
    page = folder / "report.html"
    page.write_text("of a lamp")
    return page
"""
Install = Callable[[str, str], None]


@pytest.fixture
def install(
    tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> Iterator[Install]:
    """Puts a package `lamp` with its APP and its parts among those that are installed."""
    site = tmp_path_factory.mktemp("site-packages")

    def put(app: str, parts: str) -> None:
        for name, text in {
            "lamp/__init__.py": app,
            "lamp/parts.py": parts,
            "lamp-1.0.dist-info/METADATA": "Metadata-Version: 2.1\nName: lamp\nVersion: 1.0\n",
            "lamp-1.0.dist-info/entry_points.txt": "[vstestbed.apps]\nlamp = lamp:APP\n",
        }.items():
            path = site / name
            path.parent.mkdir(exist_ok=True)
            path.write_text(text)
        monkeypatch.syspath_prepend(site)
        forget()

    def forget() -> None:
        apps._found.cache_clear()
        for name in ("lamp", "lamp.parts"):
            sys.modules.pop(name, None)

    yield put
    monkeypatch.undo()
    forget()


def test_an_app_of_another_package_adds_a_command(install: Install, command: Callable[..., Ended]):
    install(LAMP, PARTS)
    assert command("shine", "--times", 3) == Ended(0, "shines 3\n", "")
    listed = command("--help").out
    assert re.search(r"^Apps:\n(.*\n)*  shine +Shine so many times", listed, re.MULTILINE)
    assert "Left out" not in listed


@pytest.mark.usefixtures("one_figure")
def test_and_an_executor(install: Install, command: Callable[..., Ended], quick: Path):
    install(LAMP, PARTS)
    options = ("--executor", "lamp", "--out", "c", "--no-film", "--quiet")
    done = command("compare", quick, *options)
    assert done.code == 0, done.err
    assert Path("c/by_lamp").is_file()


def test_and_a_page(install: Install, command: Callable[..., Ended], tmp_path: Path):
    install(LAMP, PARTS)
    (tmp_path / "lamp.yaml").touch()
    assert command("report", tmp_path, "--quiet").code == 0
    assert (tmp_path / "report.html").read_text() == "of a lamp"


@pytest.mark.app("export")
def test_and_an_export(
    install: Install,
    command: Callable[..., Ended],
    quick: Path,
    monkeypatch: pytest.MonkeyPatch,
):
    install(LAMP, PARTS)
    package = import_module("vstestbed.apps.export")
    # its options are read when it is imported
    monkeypatch.delitem(sys.modules, "vstestbed.apps.export.commands", raising=False)
    monkeypatch.setattr(package, "commands", None, raising=False)
    assert command("run", quick, "--video", "none", "--out", "r", "--quiet").code == 0
    done = command("export", "r", "--to", "light", "--quiet")
    assert done.code == 0, done.err
    assert Path("r.light").read_text() == "1 run"


@pytest.mark.app("tune", "gpu")
def test_what_this_package_has_is_not_replaced(install: Install, command: Callable[..., Ended]):
    install(LAMP, PARTS)
    assert apps.offered("executors")["warp"] == "vstestbed.apps.gpu:pool"
    assert apps.loaded("executors", "warp") is import_module("vstestbed.apps.gpu").pool
    for words in (("compare", "--help"), ("tune", "--help")):
        assert "--times" not in command(*words).out
    listed = command("--help").out
    assert "The settings with which" in listed
    assert listed.count("Shine so many times") == 1


BROKEN = {
    "it cannot be imported": (
        "import a_module_that_is_not_there",
        "",
        "lamp:APP: cannot be imported: ModuleNotFoundError: No module named"
        " 'a_module_that_is_not_there'; mend the package that has it, or uninstall that",
    ),
    "it ends the process": (
        "raise SystemExit(3)",
        "",
        "lamp:APP: cannot be imported: SystemExit: 3",
    ),
    "it is no app": ("APP = 3", "", "lamp:APP: must be an App of vstestbed.core.apps, not int"),
    "its commands cannot be imported": (
        LAMP,
        "1 / 0",
        "lamp.parts:shine: cannot be imported: ZeroDivisionError",
    ),
    "it has no such function": (LAMP, "", "lamp.parts:shine: cannot be imported: AttributeError"),
    "its command has parameters that cannot be read": (
        LAMP,
        "def shine(at: int | str): pass",
        "lamp.parts:shine: cannot be a command",
    ),
}


@pytest.mark.parametrize("fault", BROKEN)
def test_a_broken_app_is_a_sentence_for_who_asks_for_it_and_nobody_else(
    fault: str, install: Install, command: Callable[..., Ended], quick: Path
):
    app, parts, sentence = BROKEN[fault]
    install(app, parts)
    asked = command("shine")
    assert asked.code == 2
    assert sentence in asked.err
    assert "Traceback" not in asked.err
    assert command("run", quick, "--video", "none", "--quiet").code == 0
    assert command("report", "runs/quick/001", "--quiet").code == 0
    helped = command("--help")
    assert helped.code == 0
    assert "lamp" in helped.out
    assert re.search("^  compare  ", helped.out, re.MULTILINE)
    assert "annot be" in helped.out or "must be an App" in " ".join(helped.out.split())


def test_an_executor_of_a_broken_app(install: Install):
    install("import a_module_that_is_not_there", "")
    with pytest.raises(PluginError, match="lamp:APP: cannot be imported"):
        must_be_known("lamp")
    must_be_known("local")


def test_a_word_that_no_app_has(command: Callable[..., Ended]):
    assert "No such command 'rnu'. Did you mean 'run'?" in command("rnu").err
    with pytest.raises(ParameterError, match=r"--executor must be local.* or dask://HOST:PORT"):
        must_be_known("ray")


@pytest.mark.app("ros")
def test_a_command_that_needs_another_app_names_it(
    command: Callable[..., Ended], monkeypatch: pytest.MonkeyPatch
):
    here = {name: app for name, app in apps.bundled().items() if name != "identify"}
    monkeypatch.setattr(apps, "bundled", lambda: here)
    ended = command("ros", "arm_ibvs", "--role", "excite")
    assert ended.code == 4
    assert "--role excite is of the app identify, which is not in this" in ended.err


def test_two_bundled_apps_have_no_word_in_common_and_each_stands_in_the_table_of_words():
    found = {
        sort: [(word, name) for name, app in apps.bundled().items() for word in getattr(app, sort)]
        for sort in apps.WORDS
    }
    for sort, words in found.items():
        assert len(dict(words)) == len(words)
        here = {word: app for word, app in apps.WORDS[sort].items() if app in apps.bundled()}
        assert dict(words) == here


def test_a_module_has_one_object_by_both_names():
    for former, now in FORMER.items():
        if now.startswith("vstestbed.apps.") and now.split(".")[2] not in apps.bundled():
            continue
        if now.startswith("vstestbed.apps.gpu"):  # its extra need not be installed
            continue
        if former.startswith("vstestbed.report.export") and "export" not in apps.bundled():
            continue  # its package was one
        module = import_module(former)
        assert module is import_module(now)
        assert module.__name__ == now
        assert module.__spec__ is not None
        assert module.__spec__.name == now


@pytest.mark.app("learn", "ros")
def test_the_parts_of_a_package_that_moved():
    import vstestbed.env.rollout
    from vstestbed.env import make, vector_env
    from vstestbed.env.rollout import Rollout
    from vstestbed.ros import messages

    from vstestbed.apps.learn import environments, rollout

    assert vstestbed.env is environments
    assert vstestbed.env.rollout is rollout
    assert Rollout is rollout.Rollout
    assert make is environments.make
    assert vector_env is environments.vector_env
    assert messages is import_module("vstestbed.apps.ros.messages")
    with pytest.raises(
        ModuleNotFoundError, match=r"No module named 'vstestbed\.apps\.learn\.maze'"
    ):
        import_module("vstestbed.env.maze")


@pytest.mark.app("learn")
def test_gymnasium_imports_the_ids_by_the_former_name():
    gymnasium = pytest.importorskip("gymnasium")
    env = gymnasium.make("vstestbed.env:vstestbed/arm_ibvs-v0")
    assert type(env.unwrapped) is import_module("vstestbed.env.gym_env").GymServo
    env.close()


WITHOUT = """\
import sys
from importlib import import_module
import vstestbed as vs
from vstestbed.core import apps

assert not apps.bundled(), apps.bundled()
for name in ("vstestbed.env", "vstestbed.ros.link", "vstestbed.studies.tuning"):
    try:
        import_module(name)
    except ImportError as error:
        print(error)
try:
    vs.tune
except AttributeError as error:
    print(error)
print(hasattr(vs, "compare"), hasattr(vs, "tune"))
"""


@pytest.mark.process
def test_the_app_of_the_page_for_contributors_works_as_typed(tmp_path: Path):
    """In the package by links, so that the folder is made elsewhere."""
    page = (REPOSITORY / "CONTRIBUTING.md").read_text(encoding="utf-8")
    block = page.partition("## To add an app\n")[2].partition("\n    ")[2].partition("\n\n")[0]
    lines = [line.removeprefix("    ") for line in block.splitlines()]
    assert len(lines) <= 15
    for room in ("vstestbed", "vstestbed/apps"):
        (tmp_path / room).mkdir()
        for path in (REPOSITORY / room).iterdir():
            if path.name not in ("apps", "__pycache__"):
                (tmp_path / room / path.name).symlink_to(path)
    for name in ("models", "scenarios", "docs"):
        (tmp_path / name).symlink_to(REPOSITORY / name)
    command = f"vstestbed() {{ '{sys.executable}' -m vstestbed \"$@\"; }}"
    done = subprocess.run(
        ["bash", "-euc", "\n".join([command, *lines, "vstestbed --help"])],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(tmp_path)},
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("GoalView(")
    assert re.search("^  goal +The goal of a scenario", done.stdout, re.MULTILINE)


@pytest.mark.process
def test_without_the_folder_a_sentence_names_the_app(tmp_path: Path, quick: Path):
    """The package by links, but for its apps."""
    package = tmp_path / "vstestbed"
    package.mkdir()
    for path in (REPOSITORY / "vstestbed").iterdir():
        if path.name not in ("apps", "__pycache__"):
            (package / path.name).symlink_to(path)
    for name in ("models", "scenarios", "docs"):
        (tmp_path / name).symlink_to(REPOSITORY / name)

    def said(*words: object) -> tuple[int, str]:
        environment = os.environ | {"PYTHONPATH": str(tmp_path)}
        done = subprocess.run(
            [sys.executable, *map(str, words)],
            capture_output=True,
            text=True,
            cwd=tmp_path,
            env=environment,
        )
        return done.returncode, done.stdout + done.stderr

    missing = "is of the app {}, which is not in this installation of vstestbed"
    code, text = said("-c", WITHOUT)
    assert code == 0, text
    assert text.splitlines() == [
        f"vstestbed.env {missing.format('learn')}",
        f"vstestbed.ros {missing.format('ros')}",
        f"vstestbed.studies.tuning {missing.format('tune')}",
        f"vstestbed.tune {missing.format('tune')}",
        "True False",
    ]
    vstestbed = ("-m", "vstestbed")
    remedy = "install the whole of vstestbed"
    assert said(*vstestbed, "tune", quick) == (4, f"tune {missing.format('tune')}; {remedy}\n")
    flown = said(*vstestbed, "compare", quick, "--executor", "warp", "--out", "c")
    assert flown == (4, f"warp {missing.format('gpu')}; {remedy}\n")
    (tmp_path / "search").mkdir()
    (tmp_path / "search" / "tuning.yaml").touch()
    page = said(*vstestbed, "report", "search")
    assert page == (4, f"tuning.yaml {missing.format('tune')}; {remedy}\n")
    code, text = said(*vstestbed, "--help")
    assert code == 0
    assert "Experiments:" in text
    assert "Apps:" not in text
