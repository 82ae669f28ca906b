"""One writing process at a time: who comes second is refused and learns who is there; a dead process holds nothing."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from vstestbed.core.errors import OutputError
from vstestbed.core.folders import must_be_new, new_folder, only_writer, study_folder

HOLD = """
import sys, time
from pathlib import Path
from vstestbed.core.folders import only_writer
with only_writer(Path(sys.argv[1])):
    print("held", flush=True)
    time.sleep(600)
"""


@pytest.fixture
def other(tmp_path: Path) -> Iterator[subprocess.Popen[str]]:
    """Another process that holds the folder."""
    process = subprocess.Popen([sys.executable, "-c", HOLD, str(tmp_path)], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None and process.stdout.readline() == "held\n"
    yield process
    process.kill()
    process.communicate()


def test_the_second_process_is_refused_with_the_name_of_the_first(other: subprocess.Popen[str], tmp_path: Path):
    words = rf"is in use by process {other.pid} \(.*python.*\); wait until it ends"
    with pytest.raises(OutputError, match=words) as refused, only_writer(tmp_path):
        pass
    assert refused.value.exit_code == 2
    (tmp_path / "a").touch()
    with pytest.raises(OutputError, match=f"is in use by process {other.pid}"):
        must_be_new(tmp_path, "give a new one")


def test_a_killed_process_holds_nothing_and_leaves_no_file(other: subprocess.Popen[str], tmp_path: Path):
    other.kill()
    other.wait()
    with only_writer(tmp_path):
        assert list(tmp_path.iterdir()) == []


def test_holds_of_one_process_may_be_nested(tmp_path: Path):
    with only_writer(tmp_path):
        with only_writer(tmp_path):
            pass
        process = subprocess.run([sys.executable, "-c", HOLD, str(tmp_path)], capture_output=True, text=True, check=False)
        assert "is in use by process" in process.stderr  # the inner hold has not released the outer one
    with only_writer(tmp_path):
        pass


def test_a_study_that_fails_leaves_no_empty_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ZeroDivisionError), study_folder("basin", None) as folder:
        assert folder == Path("runs/basin/001") and folder.is_dir()
        raise ZeroDivisionError
    assert not Path("runs").exists()
    with study_folder("basin", None), study_folder("basin", None) as second:
        assert second == Path("runs/basin/002")


def test_a_place_that_holds_something_is_refused(tmp_path: Path):
    (tmp_path / "a").touch()
    with pytest.raises(OutputError, match="exists and is not an empty folder; give a new one"):
        new_folder(Path("runs"), tmp_path)
