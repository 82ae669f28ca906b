"""`describe`: every kind and block can be shown in 80 columns, and a word that is none is answered with the nearest."""

from __future__ import annotations

import io

import pytest
from rich.console import Console

from vstestbed.cli.describe import describe_entry
from vstestbed.core.errors import ParameterError
from vstestbed.experiments.comparison import Comparison
from vstestbed.scenario.catalogue import catalogue, entry_of
from vstestbed.scenario.scenario import Scenario
from vstestbed.scenario.validation import KINDS

ENTRIES = catalogue(scenario=Scenario, comparison=Comparison)


def shown(name: str, width: int = 80, **style: bool) -> str:
    out = io.StringIO()
    describe_entry(ENTRIES[name], ENTRIES, Console(file=out, width=width, highlight=False, **style))
    return out.getvalue()


@pytest.mark.parametrize("name", ENTRIES)
def test_everything_can_be_shown_in_80_columns(name: str) -> None:
    text = shown(name)
    example = text.partition("Example")[2]
    words = [line for line in text.removesuffix(example).splitlines() if " " in line.strip()]
    assert words and max(map(len, words)) <= 80
    assert "\x1b" not in text


def test_every_kind_has_an_entry() -> None:
    for room in KINDS.values():
        assert {f"{room.what}.{kind}" for kind in room.members} <= set(ENTRIES)


def test_a_law(command) -> None:
    ended = command("describe", "pbvs")
    lines = [" ".join(line.split()) for line in ended.out.splitlines()]
    assert (ended.code, ended.err) == (0, "")
    assert lines[0] == "law.pbvs"
    assert lines[2].startswith("u = -lambda pinv(L B) e")
    assert "Source: Chaumette & Hutchinson 2006, eqs 15-20, doi:10.1109/MRA.2006.250573." in lines
    assert "gain 0.5 1/s lambda. See gain." in lines
    assert any(line.startswith("Used in: arm_pbvs, ") for line in lines)
    assert lines[-1] == "law: {kind: pbvs, gain: 0.5, translation: cdMc}"


def test_a_block_that_no_bundled_file_has_still_has_an_example() -> None:
    lines = [line.rstrip() for line in shown("motion.lissajous").splitlines()]
    example = ["Example:", "  motion:", "    kind: lissajous", "    amplitude_m: [0.2, 0.1, 0]", "    frequency_hz: [0.1, 0.2, 0]"]
    assert lines[-5:] == example
    assert any(line.startswith("amplitude_m   required") for line in lines)


@pytest.mark.parametrize(
    ("name", "example"),
    [
        ("monitor.keep_out", ["monitors:", "- kind: keep_out", "  corner: [0.4, -0.3, 0.5]", "  opposite: [0.8, 0.3, 1.2]"]),
        ("perturbation.erasing", ["perturb:", "- {kind: erasing}"]),
        ("world.scenery", ["scenery: scenery/workshop.xml"]),
    ],
)
def test_an_example_has_the_field_that_holds_it(name: str, example: list[str]) -> None:
    lines = shown(name).splitlines()
    assert [line.rstrip().removeprefix("  ") for line in lines[-len(example) :]] == example


def test_the_kinds_of_a_field_of_another_name_say_its_name() -> None:
    words = " ".join(shown("keypoint").split())
    assert words.endswith("vstestbed describe keypoint.sift shows one of them. In a scenario the field is called features.")
    assert "is called" not in shown("law")


def test_colours_only_where_they_are_wanted() -> None:
    assert "\x1b[" in shown("law.pbvs", force_terminal=True)
    assert "\x1b[3" not in shown("law.pbvs", force_terminal=True, no_color=True)


@pytest.mark.parametrize(
    ("word", "name"),
    [
        ("pbvs", "law.pbvs"),
        ("law.pbvs", "law.pbvs"),
        ("law", "law"),
        ("stop", "stop"),
        ("solve", "law.solve"),
        ("goal", "goal"),
        ("law.depth", "depth"),
        ("law.depth.pnp", "depth.pnp"),
        ("detector.features.sift", "keypoint.sift"),
    ],
)
def test_the_words_for_an_entry(word: str, name: str) -> None:
    assert entry_of(word, ENTRIES).name == name


@pytest.mark.parametrize(
    ("word", "words"),
    [
        ("lines", "lines is detector.lines and target.lines; give one of these names"),
        ("pbv", "pbv is no kind and no block of a scenario; did you mean 'pbvs'?"),
        ("xyz", "xyz is no kind and no block of a scenario; there are scenario, comparison, camera, depth,"),
    ],
)
def test_words_that_are_not_one(word: str, words: str) -> None:
    with pytest.raises(ParameterError) as refused:
        entry_of(word, ENTRIES)
    assert str(refused.value).startswith(words)


def test_starts_of_different_robots_have_different_names() -> None:
    names = {entry.cls.__name__: entry.name for entry in ENTRIES.values() if entry.cls and entry.name.endswith(".start")}
    assert {"FreeStart", "PumaStart", "GroundStart", "FlightStart", "ArmStart"} <= set(names)
