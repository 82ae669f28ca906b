"""Files of others: each exception is a sentence, each file plain and of a size, each key known."""

import os
import zipfile

import cv2
import numpy as np
import polars as pl
import pytest
import yaml

from vstestbed.core.errors import EnvironmentLackError, ParameterError, RunFolderError
from vstestbed.core.foreign import foreign, only_known, plain_file


def test_what_libraries_raise_is_one_sentence_with_the_file(tmp_path):
    """Each of a class of its own: cv2.error, SystemError, BadZipFile, polars' errors,
    RecursionError, LinAlgError.
    """
    file = tmp_path / "theirs.xml"
    file.write_text("<a><b/></a>", encoding="utf-8")
    calls = [
        lambda: cv2.cvtColor(np.zeros((2, 2), np.uint8), cv2.COLOR_BGR2GRAY),
        lambda: cv2.FileStorage(str(file), cv2.FILE_STORAGE_READ),
        lambda: zipfile.ZipFile(file),
        lambda: pl.read_parquet(file),
        lambda: yaml.safe_load("[" * 3000),
        lambda: np.linalg.inv(np.zeros((2, 2))),
    ]
    for call in calls:
        with pytest.raises(ParameterError) as found, foreign(file, "a calibration"):
            call()
        sentence = str(found.value)
        assert str(file) in sentence, sentence
        assert "works: a calibration" in sentence, sentence
        assert "\n" not in sentence, sentence


def test_a_panic_is_no_exception_of_python_and_is_told_too():
    class PanicException(BaseException):
        """As pyo3 has it, by which polars ends."""

    with (
        pytest.raises(RunFolderError, match="log: cannot"),
        foreign("log", "a log", RunFolderError),
    ):
        raise PanicException("cannot")


def test_errors_of_this_program_lacks_and_ctrl_c_pass():
    with pytest.raises(ParameterError, match=r"^gain must be > 0"), foreign("file", "another"):
        raise ParameterError("gain", "must be > 0")
    with pytest.raises(EnvironmentLackError, match="not enough memory"), foreign("file", "another"):
        raise MemoryError
    with pytest.raises(KeyboardInterrupt), foreign("file", "another"):
        raise KeyboardInterrupt


def test_pipes_folders_and_huge_files_are_refused_before_they_are_read(tmp_path):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    huge = tmp_path / "huge"
    with huge.open("wb") as file:
        file.truncate(65 << 20)  # a hole: it takes no disk
    for path, words in (
        (pipe, "not a regular file"),
        (tmp_path, "not a regular file"),
        (huge, "65 MiB"),
        (tmp_path / "none", "No such"),
    ):
        with pytest.raises(ParameterError, match=words):
            plain_file(path, "a calibration")
    small = tmp_path / "small"
    small.write_bytes(b"1")
    assert plain_file(small, "a calibration") == small


def test_a_key_that_nobody_reads_is_refused_by_its_name():
    only_known({"K": 1, "seq": 2}, used=["K"], harmless=["seq"])
    with pytest.raises(ParameterError, match=r"camera\.k1 is not read here.*K1, got 0\.5$"):
        only_known({"k1": 0.5}, used=["K1"], field="camera")


def test_a_pipe_that_a_scenario_names_is_told_as_one(tmp_path):
    from vstestbed.core.named_files import place_of_file

    os.mkfifo(tmp_path / "arm.xml")
    with pytest.raises(ParameterError, match="it is not a regular file"):
        place_of_file(str(tmp_path / "arm.xml"))
