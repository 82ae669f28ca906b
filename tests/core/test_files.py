"""Files are written whole."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from vstestbed.core.errors import EnvironmentLackError, ParameterError, RunFolderError
from vstestbed.core.files import PartFile, read_file, temporary, write_whole
from vstestbed.core.named_files import place_of_file
from vstestbed.report.video import VideoWriter


def test_names_are_different_each_time_and_not_too_long(tmp_path: Path) -> None:
    path = tmp_path / ("ä" * 120)
    assert len({temporary(path).name for _ in range(100)}) == 100
    assert write_whole(path, "x").read_text() == "x"


def test_the_rights_are_those_of_any_new_file(tmp_path: Path) -> None:
    """Not 0600, as tempfile has it: a colleague may read a report."""
    before = os.umask(0o022)
    try:
        assert write_whole(tmp_path / "a", "x").stat().st_mode & 0o777 == 0o644
    finally:
        os.umask(before)


def test_nothing_is_left_of_a_file_that_fails(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt), PartFile(tmp_path / "a") as part:
        part.file.write(b"half")
        raise KeyboardInterrupt
    assert list(tmp_path.iterdir()) == []


def test_what_is_no_plain_file_is_not_read(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")  # to open it would wait for a writer for ever
    (tmp_path / "loop").symlink_to("loop")
    (tmp_path / "folder").mkdir()
    for name, found in (
        ("pipe", "is not a plain file"),
        ("folder", "is not a plain file"),
        ("none", "is missing"),
        ("loop", "is missing"),
    ):
        with pytest.raises(RunFolderError, match=f"{name}: {found}; write it again$"):
            read_file(tmp_path / name, "write it again")
    with pytest.raises(RunFolderError, match=r"cannot be read \(File name too long\)"):
        read_file(tmp_path / ("x" * 300), "")


def test_a_full_disk_while_the_film_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(_: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with (
        pytest.raises(EnvironmentLackError, match="no room for"),
        VideoWriter(tmp_path / "a.mp4", 25) as writer,
    ):
        writer.write(np.zeros((48, 64, 3), np.uint8))
    assert list(tmp_path.iterdir()) == []


def test_a_file_in_a_package_that_is_named_as_its_distribution(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.syspath_prepend(tmp_path)
    inside = ["maker/arm_parts/__init__.py", "maker/arm_parts/models/arm.xml"]
    about = tmp_path / "maker_arm_parts-1.0.dist-info"
    for name in (*inside, f"{about.name}/METADATA"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(
            "Metadata-Version: 2.1\nName: maker-arm-parts\nVersion: 1.0\n"
            if "METADATA" in name
            else ""
        )
    (about / "RECORD").write_text("".join(f"{name},,\n" for name in inside))
    right = "package:maker.arm_parts/models/arm.xml"
    for wrong in ("package:maker_arm_parts/models/arm.xml", "package:maker-arm-parts/arm.xml"):
        with pytest.raises(
            ParameterError,
            match=f"is installed, and is imported as maker.arm_parts; write {right}, got",
        ):
            place_of_file(wrong)
    with pytest.raises(ParameterError, match=r"write package:maker.arm_parts/PATH"):
        place_of_file("package:maker-arm-parts/leg.xml")
    assert place_of_file(right) == tmp_path / inside[1]
    for wrong in ("package:/arm.xml", "package:maker.arm_parts"):
        with pytest.raises(ParameterError, match="needs the form package:NAME/path"):
            place_of_file(wrong)
    with pytest.raises(
        ParameterError,
        match=r"not installed; pip install --no-deps no_maker, if that is its name there",
    ):
        place_of_file("package:no_maker/arm.xml")
    (gone := tmp_path / "arm.xml").write_text("")
    gone.unlink()
    with pytest.raises(ParameterError) as told:
        place_of_file(str(gone))
    assert str(told.value).count(str(gone)) == 1
