"""The tree of errors: what each says, and the exit code it stands for."""

from __future__ import annotations

import pickle

import pytest

from vstestbed.core.errors import (
    EnvironmentLackError,
    Mistake,
    OutputError,
    ParameterError,
    RunFolderError,
    ScenarioError,
    SessionError,
    VstestbedError,
    nearest,
)


def test_every_error_of_the_tree_derives_from_one_base_and_is_drawn_in_the_docstring() -> None:
    import vstestbed.core.errors as module

    classes = [c for c in vars(module).values() if isinstance(c, type) and issubclass(c, Exception)]
    assert all(issubclass(c, VstestbedError) for c in classes)
    assert all(c.__name__ in (module.__doc__ or "") for c in classes)
    assert issubclass(ParameterError, ValueError)


def test_an_error_says_what_is_wrong_and_what_would_work() -> None:
    for error, code, words in (
        (ParameterError("gain", "must be > 0 [1/s]", -1), 2, "gain must be > 0 [1/s], got -1"),
        (ParameterError("gain", "is missing"), 2, "gain is missing"),
        (
            ScenarioError([Mistake("a.yaml:3:5", "law.gain", "must be > 0, got -1")]),
            2,
            "a.yaml:3:5: law.gain: must be > 0, got -1",
        ),
        (
            ScenarioError([Mistake("a.yaml", "", "x"), Mistake("a.yaml:1:1", "b", "y")]),
            2,
            "a.yaml: x\na.yaml:1:1: b: y",
        ),
        (OutputError("out", "exists", "give a new folder"), 2, "out: exists; give a new folder"),
        (
            RunFolderError("d", "no run here"),
            2,
            "d: no run here; a run's folder holds scenario.yaml and log.parquet (or log.part)",
        ),
        (
            EnvironmentLackError("no OpenGL", "apt-get install libegl1 libgl1"),
            4,
            "no OpenGL; apt-get install libegl1 libgl1",
        ),
    ):
        assert str(error) == words
        assert error.exit_code == code


def test_a_full_disk_is_an_output_error_of_the_environment() -> None:
    assert OutputError("out", "no space left", "free some", exit_code=4).exit_code == 4


def test_nearest_names_one_close_word_or_lists_them_all() -> None:
    assert nearest("gian", ["gain", "depth"]) == "did you mean 'gain'?"
    assert nearest("zebra", ["gain", "depth"]) == "valid: depth, gain"


def test_mistakes_of_a_scenario_are_kept_as_data() -> None:
    mistake = Mistake("a.yaml:1:1", "law", "is missing")
    assert ScenarioError([mistake]).mistakes == (mistake,)
    assert pickle.loads(pickle.dumps(mistake)) == mistake


@pytest.mark.parametrize(
    "error",
    [
        ParameterError("action", "must be finite", 3),
        SessionError("the run has ended", "call reset()"),
    ],
)
def test_an_error_raised_again_from_itself_says_the_same(error: VstestbedError) -> None:
    assert str(type(error)(error)) == str(error)
