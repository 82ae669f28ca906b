"""Each app deleted alone: the kernel and the others go on without it."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.conftest import REPOSITORY
from vstestbed.core.apps import bundled

pytestmark = pytest.mark.study
QUICK = "not study and not process"


@pytest.fixture(scope="module")
def copy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The repository, whose tests of all apps are not there."""
    place = tmp_path_factory.mktemp("copy")
    for name in ("vstestbed", "tests", "docs", "models", "scenarios", ".github"):
        ignored = shutil.ignore_patterns("__pycache__")
        shutil.copytree(REPOSITORY / name, place / name, ignore=ignored)
    for file in REPOSITORY.iterdir():
        if file.is_file():
            shutil.copy(file, place)
    for file in (place / "tests" / "apps").glob("*.py"):
        file.unlink()
    return place


def done(copy: Path, *words: str) -> str:
    """What Python says to these words in the copy."""
    environment = os.environ | {"PYTHONPATH": str(copy)}
    line = [sys.executable, *words]
    ended = subprocess.run(line, cwd=copy, env=environment, capture_output=True, text=True)
    assert ended.returncode == 0, ended.stdout + ended.stderr
    return ended.stdout


def first_tests(collected: str) -> list[str]:
    """The first test of each file of another app, and those of the mechanism."""
    found: dict[str, str] = {}
    for line in collected.splitlines():
        file, colons, _ = line.partition("::")
        if colons and file.startswith("tests/apps/"):
            found.setdefault(file, line)
    return [*found.values(), "tests/core/test_apps.py"]


@pytest.mark.parametrize("name", bundled())
def test_the_kernel_and_the_others_go_on_without(name: str, copy: Path, tmp_path: Path):
    parts = {
        copy / "vstestbed" / "apps" / name: tmp_path / "app",
        copy / "tests" / "apps" / name: tmp_path / "tests",
    }
    for part, aside in parts.items():
        shutil.move(part, aside)
    try:
        here = "import vstestbed.core.apps as a; print(a.__file__, *a.bundled())"
        place, *others = done(copy, "-c", here).split()
        assert Path(place).is_relative_to(copy)
        assert set(others) == set(bundled()) - {name}
        helped = done(copy, "-m", "vstestbed", "--help")
        shown = {line.split()[0] for line in helped.splitlines() if line.startswith("  ")}
        assert not shown & set(bundled()[name].commands)
        assert shown >= {word for other in others for word in bundled()[other].commands}
        tests = ("-m", "pytest", "-n", "0", "-m", QUICK)
        collected = done(copy, *tests, "--co", "tests")
        done(copy, *tests, *first_tests(collected))
    finally:
        for part, aside in parts.items():
            shutil.move(aside, part)
