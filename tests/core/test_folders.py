"""One writing process at a time: who comes second is refused and learns who is there; a dead
process holds nothing.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from vstestbed.core.errors import OutputError
from vstestbed.core.files import allowed, distinct, file_word, must_be_new, new_folder, only_writer

HOLD = """
import sys, time
from pathlib import Path
from vstestbed.core.files import only_writer
with only_writer(Path(sys.argv[1])):
    print("held", flush=True)
    time.sleep(600)
"""


@pytest.fixture
def other(tmp_path: Path) -> Iterator[subprocess.Popen[str]]:
    """Another process that holds the folder."""
    process = subprocess.Popen(
        [sys.executable, "-c", HOLD, str(tmp_path)], stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None and process.stdout.readline() == "held\n"
    yield process
    process.kill()
    process.communicate()


@pytest.mark.process
def test_the_second_process_is_refused_with_the_name_of_the_first(
    other: subprocess.Popen[str], tmp_path: Path
):
    words = rf"is in use by process {other.pid} \(.*python.*\); wait until it ends"
    with pytest.raises(OutputError, match=words) as refused, only_writer(tmp_path):
        pass
    assert refused.value.exit_code == 2
    (tmp_path / "a").touch()
    with pytest.raises(OutputError, match=f"is in use by process {other.pid}"):
        must_be_new(tmp_path, "give a new one")


@pytest.mark.process
def test_a_killed_process_holds_nothing_and_leaves_no_file(
    other: subprocess.Popen[str], tmp_path: Path
):
    other.kill()
    other.wait()
    with only_writer(tmp_path):
        assert list(tmp_path.iterdir()) == []


@pytest.mark.process
def test_holds_of_one_process_may_be_nested(tmp_path: Path):
    with only_writer(tmp_path):
        with only_writer(tmp_path):
            pass
        process = subprocess.run(
            [sys.executable, "-c", HOLD, str(tmp_path)], capture_output=True, text=True, check=False
        )
        # the inner hold has not released the outer one
        assert "is in use by process" in process.stderr
    with only_writer(tmp_path):
        pass


def test_a_place_that_holds_something_is_refused(tmp_path: Path):
    (tmp_path / "a").touch()
    with pytest.raises(OutputError, match="exists and is not an empty folder; give a new one"):
        new_folder(Path("runs"), tmp_path)


NAMES = [
    *(
        "../../../esc",
        "..",
        ".",
        "",
        "/etc/passwd",
        "a/b",
        "a\\b",
        "C:\\x",
        "a:b*?",
        "con",
        "CON.x",
        "nul",
        "Com1",
        "lpt9.field",
        "aux ",
    ),
    *(
        "trailing. ",
        " ",
        "\n",
        "\0",
        "~",
        "-rf",
        "a" * 300,
        "\u00e4" * 300,
        "\U0001f916" * 300,
        "\ud800",
        "e\u0301",
    ),
]


@pytest.mark.parametrize("name", NAMES)
def test_any_text_makes_a_name_that_every_system_allows(tmp_path: Path, name: str):
    word = file_word(name)
    assert word not in ("", ".", "..") and len(word.encode()) <= 61
    assert not set(word) & set('/\\:*?"<>|\0\n ') and not word.endswith(".")
    # of devices, on Windows
    assert word.partition(".")[0].casefold() not in ("con", "nul", "aux", "com1", "lpt9")
    (tmp_path / word).mkdir()
    assert [p.name for p in tmp_path.iterdir()] == [word]
    assert file_word(name + "x") != word or len(name.strip(" ./\\\n\0~")) < 2


def test_words_that_a_file_system_could_take_for_one_stay_distinct():
    words = distinct(
        [
            file_word(name)
            for name in (
                "a/b",
                "a_b",
                "A b",
                "a:b",
                "ﬁ",
                "fi",
                "x" * 200,
                "x" * 201,
                "con",
                "_con",
                "\u00e9",
                "e\u0301",
            )
        ]
    )
    assert words[:3] == ["a_b", "a_b_", "A_b__"]
    assert len({word.casefold() for word in words}) == len(words) == 12


def test_a_name_of_many_parts_is_cut_and_stays_distinct():
    one, other = (
        allowed(",".join([f"axis_{i}=0.123456789" for i in range(40)] + [last])) for last in "ab"
    )
    assert one != other and max(map(len, (one, other))) == 150
    assert allowed("law.gain=3,camera.latency_s=0.04") == "law.gain=3,camera.latency_s=0.04"
    assert allowed("con.x=3") == "_con.x=3"
