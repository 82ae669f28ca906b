"""What all tests share: which OpenGL, and the command line as a function that runs in an empty
folder.
"""

from __future__ import annotations

import gc
import logging
import os
import signal
import sys
import threading
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest

import vstestbed.sim  # noqa: F401 - chooses MUJOCO_GL before any test imports mujoco
from vstestbed.core.apps import bundled
from vstestbed.core.errors import EnvironmentLackError
from vstestbed.sim.gl_probe import require

if "PYTEST_XDIST_WORKER" in os.environ:  # tests side by side: Mesa draws with a core each
    os.environ.setdefault("LP_NUM_THREADS", "0")

if (
    signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    and threading.current_thread() is threading.main_thread()
):
    # as in a shell's background: processes that tests start and interrupt would inherit it
    signal.signal(signal.SIGINT, signal.default_int_handler)

REPOSITORY = Path(__file__).resolve().parent.parent
APPS = Path(__file__).parent / "apps"
"""A folder of tests for each app, and files of tests that need them all."""


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """What is collected stays until the end: Python's collector of cycles looks for garbage in it
    neither meanwhile nor later.
    """
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_setup() -> Generator[None]:
    """Fixtures that draw; see `_skip_without_opengl`."""
    with _skip_without_opengl():
        yield


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call() -> Generator[None]:
    """Tests that draw; see `_skip_without_opengl`."""
    with _skip_without_opengl():
        yield


@contextmanager
def _skip_without_opengl() -> Iterator[None]:
    """On a machine without OpenGL, tests of what only OpenGL can draw are skipped, with the
    sentence that a user gets; not in CI.
    """
    try:
        yield
    except (EnvironmentLackError, RuntimeError) as error:
        # RuntimeError: dm_control's, where a test draws by itself
        if not str(error).lower().startswith("no opengl") or not (lack := _no_opengl()):
            raise
        pytest.skip(lack)


def _no_opengl() -> str:
    """Why OpenGL does not work here, in the sentence that a user gets; "" where it does, and in CI,
    where it must.
    """
    try:
        require()
    except EnvironmentLackError as lack:
        return "" if "CI" in os.environ else str(lack)
    return ""


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the tests of apps. Skip tests of apps that are not there, and of OpenGL where there is
    none.
    """
    if lack := _no_opengl():
        for item in items:
            if item.get_closest_marker("opengl"):
                item.add_marker(pytest.mark.skip(reason=lack))
    for item in items:
        if APPS in item.path.parents:
            folder = item.path.relative_to(APPS).parts[0]
            item.add_marker(pytest.mark.app(*([folder] if (APPS / folder).is_dir() else [])))
        for marker in item.iter_markers("app"):
            if not set(marker.args) <= set(bundled()):
                reason = f"needs the apps {', '.join(marker.args)}"
                item.add_marker(pytest.mark.skip(reason=reason))


@dataclass(frozen=True)
class Ended:
    """How a command ended."""

    code: int
    out: str
    err: str


@pytest.fixture
def command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Callable[..., Ended]:
    """`vstestbed WORDS` in this process, in an empty current folder."""
    from vstestbed.cli.app import main

    monkeypatch.chdir(tmp_path)
    logger = logging.getLogger("vstestbed")  # the command line sets it up for its own process
    monkeypatch.setattr(logger, "propagate", logger.propagate)
    monkeypatch.setattr(logger, "handlers", list(logger.handlers))
    level = logger.level

    def call(*words: object) -> Ended:
        with pytest.raises(SystemExit) as end:
            main([str(word) for word in words])
        logger.setLevel(level)
        out, err = capsys.readouterr()
        assert isinstance(end.value.code, int)
        return Ended(end.value.code, out, err)

    return call


@pytest.fixture
def vstestbed_process() -> tuple[list[str], dict[str, str]]:
    """The words and the environment that start vstestbed as a process of its own."""
    paths = [str(REPOSITORY), os.environ.get("PYTHONPATH", "")]
    environment = {
        k: v for k, v in os.environ.items() if k not in ("MUJOCO_GL", "PYOPENGL_PLATFORM")
    }
    return [sys.executable, "-m", "vstestbed"], environment | {
        "PYTHONPATH": os.pathsep.join(filter(None, paths))
    }


@pytest.fixture
def here(monkeypatch: pytest.MonkeyPatch) -> None:
    """Comparisons and searches run in this process, where a test is not about their workers."""
    from tests.shortcuts import run_here

    run_here(monkeypatch)


@pytest.fixture
def one_figure(monkeypatch: pytest.MonkeyPatch) -> None:
    """Reports of comparisons have one figure, where a test is not about the figures."""
    from tests.shortcuts import draw_one_figure

    draw_one_figure(monkeypatch)


@pytest.fixture
def own_kinds() -> Iterator[None]:
    """Lets a test add kinds to the rooms' lists, and takes them out again."""
    from vstestbed.core.registry import SPECS
    from vstestbed.scenario.plugins import registries

    before, modules = (
        {room: dict(kinds.members) for room, kinds in registries().items()},
        set(sys.modules),
    )
    path = list(sys.path)
    yield
    sys.path[:] = path
    places = ("pytest-of-", "examples")
    gone = {
        n
        for n in set(sys.modules) - modules
        if any(p in str(getattr(sys.modules[n], "__file__", "")) for p in places)
    }
    for name in gone:  # plugins, else a later test that names one finds it loaded and its kind gone
        del sys.modules[name]
    SPECS[:] = [cls for cls in SPECS if cls.__module__ not in gone]
    for room, members in before.items():
        registries()[room].members.clear()
        registries()[room].members.update(members)


QUICK = """\
description: The ideal camera with the oracle, there and at rest within a second of simulated time.
robot: {kind: free, start: {nominal: {xyz: [0.1, -0.05, 0]}, \
random: {xyz: [0.1, 0.1, 0.1], rpy_deg: [2, 2, 10]}}}
camera: {width: 320, height: 240}
target: {kind: square, side: 0.4, pose: {xyz: [0, 0, 1.2]}}
detector: oracle
law: {kind: ibvs, gain: 6}
goal: {T_camera_target: {xyz: [0, 0, 1]}}
stop: {duration_s: 8}
"""


@pytest.fixture
def quick(tmp_path: Path) -> Path:
    """A scenario that needs neither OpenGL nor a second of wall time."""
    path = tmp_path / "quick.yaml"
    path.write_text(QUICK, encoding="utf-8")
    return path
