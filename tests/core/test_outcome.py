"""Whatever lists outcomes knows each of them: a new one fails here, by name, until every table,
letter and page has it.
"""

import pickle
import re
from pathlib import Path

import numpy as np
import pytest
from matplotlib.colors import to_hex

import vstestbed as vs
from vstestbed.core.errors import ParameterError
from vstestbed.report import studies as figures

TOP = Path(__file__).resolve().parents[2]
FAILED = {outcome.name for outcome in vs.Outcome if not outcome.success}
NAMES = {outcome.name for outcome in vs.Outcome}


def words_of(text: str) -> set[str]:
    return set(re.findall(r"`(\w+)`", text))


def test_every_outcome_has_a_sentence_of_its_own() -> None:
    assert len({outcome.value for outcome in vs.Outcome}) == len(vs.Outcome)
    for outcome in vs.Outcome:
        assert re.fullmatch(r"[a-z][^.]+", outcome.value), outcome.name


def test_the_guide_says_who_decides_each_outcome() -> None:
    text = (TOP / "docs/guides/running.md").read_text(encoding="utf-8")
    table = text.partition("| outcome | who decides |")[2].partition("\n\n")[0]
    listed = {
        word
        for row in table.splitlines()[2:]
        for word in words_of(row.split("|")[1].partition(" with ")[0])
    }
    assert listed == NAMES


def test_each_failure_has_a_letter_of_its_own_for_maps_of_convergence() -> None:
    letters = [vs.Outcome[name].letter for name in FAILED]
    assert all(letters) and len(set(letters)) == len(FAILED)


def test_the_letters_that_a_map_shows_are_those_that_its_caption_explains(tmp_path: Path) -> None:
    others = np.array([["joint_limit", ""]], dtype=object)
    maps = [("law", np.array([[0.5, 1.0]]), others, np.full((1, 2), np.nan))]
    sweep = figures.Sweep(maps, ("x", ["1", "2"]), ("y", ["1"]), 4, "")
    page = figures.write_sweep(tmp_path, sweep, "")
    assert "(J: joint limit)" in page.read_text(encoding="utf-8")


def test_a_map_of_basins_names_each_outcome_that_occurs() -> None:
    """Those without a colour of their own are black, with their name in the legend; so would be one
    that is not there yet.
    """
    occurring = sorted({*FAILED, figures.PLANE_CROSSED, "petrified"})
    endings = np.array([occurring], dtype=object)
    time_s = np.full(endings.shape, np.nan)
    drawn = figures.draw_basin([("law", endings, time_s)], ("x", "m", -1, 1), ("y", "m", -1, 1))
    patches = drawn.legends[0].get_patches()
    texts = drawn.legends[0].get_texts()
    shown = {
        text.get_text(): to_hex(patch.get_facecolor())
        for text, patch in zip(texts, patches, strict=True)
    }
    assert shown == {figures.label_of(word): figures.colour_of(word) for word in occurring}
    assert shown["unstable"] == "#4f7a1e" and shown["petrified"] == "#000000"


def test_an_outcome_of_a_plugin_is_one_of_them(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(type(vs.Outcome), "_known", dict(vs.Outcome.__members__))
    overheated = vs.Outcome("overheated", "a motor grew too hot", letter="V", colour="#c22f2f")
    assert vs.Outcome["overheated"] is vs.Outcome.overheated is overheated
    assert figures.colour_of("overheated") == "#c22f2f"
    assert overheated in list(vs.Outcome) and not overheated.success
    # of a plugin that is imported again, and in a worker's answer
    assert vs.Outcome("overheated", "a motor grew too hot", letter="V", colour="#c22f2f") is (
        overheated
    )
    assert pickle.loads(pickle.dumps(overheated)) is overheated
    for name, letter in (("overheated", "V"), ("melted", "V"), ("converged", "")):
        with pytest.raises(ParameterError, match=r"is that of '(overheated|converged)'"):
            vs.Outcome(name, "something else", letter=letter)
    with pytest.raises(AttributeError, match=r"overheat'; those known are converged, "):
        _ = vs.Outcome.overheat


@pytest.mark.app()
def test_an_outcome_is_a_word_of_the_package_where_one_is_written_as_text() -> None:
    """Outcomes that are compared as texts, as those of a table are: a word that is none would never
    be equal.
    """
    known = {*NAMES, "plane_crossed", "no outcome", "cut off", ""}
    found = {}
    for path in (TOP / "vstestbed").rglob("*.py"):
        for word in re.findall(
            r"""\boutcome(?:"\)|"\]|\b) ?[!=]= "(\w*)\"""", path.read_text(encoding="utf-8")
        ):
            found.setdefault(word, path.name)
    assert (
        "unstable" in found
        and {word: name for word, name in found.items() if word not in known} == {}
    )
