"""Any file loads, or is refused with sentences that have their places: no other error, and soon."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings

from tests.scenario.fuzz import FAULT, cases, loading
from vstestbed.core.errors import Mistake, ScenarioError
from vstestbed.scenario import load as loader


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("fuzz") / "s.yaml"


# Always the same examples: a run of the tests says something about the change, not about luck.
# `-m study` has 10,000 others.
@given(raw=cases)
@settings(
    max_examples=120,
    derandomize=True,
    database=None,
    deadline=None,
    suppress_health_check=list(HealthCheck),
)
def test_any_file_loads_or_is_refused_with_places(raw: bytes, path: Path) -> None:
    found = loading(raw, path)
    assert not found.startswith(FAULT), found


def test_a_file_of_ten_megabytes_is_refused_unread(path: Path) -> None:
    path.write_bytes(b"a: 1\n" * 2_000_000)
    with pytest.raises(
        ScenarioError, match=r"s\.yaml:1:1: has more than 100 kB; a scenario needs far less"
    ):
        loader.load(path)


def test_the_check_finds_what_it_looks_for(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: object) -> None:
        raise ZeroDivisionError

    def has_no_place(*_: object) -> None:
        raise ScenarioError([Mistake("s.yaml", "law", "is wrong")])

    for wrong, words in (
        (fails, "ZeroDivisionError in "),
        (has_no_place, "no place: s.yaml: law: is wrong"),
    ):
        monkeypatch.setattr(loader, "parse", wrong)
        assert loading(b"a: 1", path).startswith(FAULT + words)
