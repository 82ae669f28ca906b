"""`describe`: every kind and block can be shown in 80 columns, and a word that is none is answered
with the nearest.
"""

from __future__ import annotations

import functools
import io
from collections.abc import Iterator
from typing import Any, Literal

import pytest
from rich.console import Console

import vstestbed as vs
from tests.scenario.schemas import whole_schema
from vstestbed.cli.describe import describe_entry, describe_field
from vstestbed.core.errors import ParameterError
from vstestbed.core.fields import class_text
from vstestbed.core.registry import SPECS
from vstestbed.scenario.catalogue import Entry, FieldPlace, catalogue, looked_up
from vstestbed.scenario.plugins import registries
from vstestbed.scenario.scenario import Scenario
from vstestbed.studies.comparison import Comparison
from vstestbed.targets.markers import MARKERS


@functools.cache
def entries() -> dict[str, Entry]:
    """The catalogue of all kinds and blocks, made when the first test asks for it."""
    return catalogue(scenario=Scenario, comparison=Comparison)


def shown(name: str, width: int = 80, **style: bool) -> str:
    out = io.StringIO()
    describe_entry(
        entries()[name], entries(), Console(file=out, width=width, highlight=False, **style)
    )
    return out.getvalue()


def test_everything_can_be_shown_in_80_columns() -> None:
    for name in entries():
        text = shown(name)
        example = text.partition("Example")[2]
        words = [line for line in text.removesuffix(example).splitlines() if " " in line.strip()]
        assert words and max(map(len, words)) <= 80, name
        assert "\x1b" not in text, name


def test_every_kind_has_an_entry() -> None:
    for room in registries().values():
        assert {f"{room.what}.{kind}" for kind in room.members} <= set(entries())


def test_the_summary_has_its_metrics(command) -> None:
    lines = [" ".join(line.split()) for line in command("describe", "summary").out.splitlines()]
    assert "final_position_error_m mm less True position error." in lines
    assert any(line.startswith("min_border_margin_px px more Smallest margin") for line in lines)
    assert any(line.startswith("law_switches less Switches of the law; only") for line in lines)


def test_a_law(command) -> None:
    ended = command("describe", "pbvs")
    lines = [" ".join(line.split()) for line in ended.out.splitlines()]
    assert (ended.code, ended.err) == (0, "")
    assert lines[0] == "law.pbvs"
    assert lines[2].startswith("u = -lambda pinv(L B) e")
    assert "Source: Chaumette & Hutchinson 2006, eqs 15-20, doi:10.1109/MRA.2006.250573." in lines
    shown = [line.split(" ")[0] for line in lines[lines.index("field default unit what it is") :]]
    # its own field before those of all laws of an error
    assert shown.index("translation") < shown.index("gain") < shown.index("solve")
    assert any(
        line.startswith("gain 0.5 1/s lambda, a number or an adaptive gain") for line in lines
    )
    assert any(line.startswith("Used in: arm_calibrate, arm_insert, arm_pbvs, ") for line in lines)
    assert lines[-1] == "law: {kind: pbvs, gain: 1.5, translation: cdMc}"


def test_items_of_lists_and_rows_of_definitions_stay_apart() -> None:
    lines = shown("feature.ellipse", 100).splitlines()
    rows = [
        i
        for i, line in enumerate(lines)
        if line.startswith(("xg, yg   ", "n20, n11, n02  ", "xn, yn, an   "))
    ]
    assert len(rows) == 3 and all(line.startswith("  ") for line in lines[rows[1] + 1 : rows[2]])
    # a source's indentation is not in the middle of a line
    assert not any("  " in line.strip() for line in lines[rows[1] + 1 : rows[2]])
    lines = shown("detector.keypoints").splitlines()
    assert sum(line.startswith("- ") for line in lines) == 4
    assert not any(" - With" in line for line in lines)
    assert "  nearest." in shown("detector.keypoints", 100).splitlines()


def test_lines_that_a_docstring_filled_are_joined_and_others_are_not() -> None:
    """On a wide terminal; a line with room for the next word ends where its writer wanted it to."""
    lines = shown("law.pbvs", 1000).splitlines()
    three = next(i for i, line in enumerate(lines) if line.startswith("`cdMc`"))
    # prose of two lines before, and of two lines in the last item
    assert lines[three - 2].endswith("L are one of three:")
    assert lines[three + 5].endswith("its place at the goal, so that it stays in view.")
    # a line of an equation, and what stands in backquotes is one word
    assert "c = cos phi, s = sin phi" in shown("feature.spherical", 1000).splitlines()
    assert not any(
        line.endswith("With") for line in shown("law.pose_controller", 1000).splitlines()
    )


def test_a_table_of_kinds_has_whole_sentences() -> None:
    rooms = [entry.registry for entry in entries().values() if entry.cls is None]
    assert [
        cls
        for room in rooms
        for cls in room.members.values()
        if not class_text(cls).summary.endswith(".")
    ] == []


def test_kinds_of_one_model_are_shown_with_it(command) -> None:
    """What all depth cameras do to the true depth, and what all streams do to a picture; a kind
    says where that is.
    """
    text = " ".join(command("describe", "camera.depth_sensor").out.split())
    assert (
        "comes the measured one: 1. At an edge" in text
        and "is rounded to a multiple of `quantum_px`. 4. There are holes" in text
    )
    assert "4:2:0" in shown(
        "stream"
    ) and "vstestbed describe stream has what all kinds have in common." in shown("stream.jpeg")
    # what a base says to those who write a law
    assert "in common" not in shown("law.pbvs") + shown("law")


def test_a_block_that_no_bundled_file_has_still_has_an_example() -> None:
    lines = [line.rstrip() for line in shown("motion.lissajous").splitlines()]
    example = [
        "Example:",
        "  motion:",
        "    kind: lissajous",
        "    amplitude_m: [0.2, 0.1, 0]",
        "    frequency_hz: [0.1, 0.2, 0]",
    ]
    assert lines[-5:] == example
    assert any(line.startswith("amplitude_m   required") for line in lines)


def test_an_example_has_the_field_that_holds_it() -> None:
    for name, example in (
        (
            "monitor.keep_out",
            [
                "monitors:",
                "- kind: keep_out",
                "  corner: [0.4, -0.3, 0.5]",
                "  opposite: [0.8, 0.3, 1.2]",
            ],
        ),
        ("perturbation.erasing", ["perturb:", "- {kind: erasing}"]),
        ("world.scenery", ["scenery: scenery/workshop.xml"]),
    ):
        lines = shown(name).splitlines()
        assert [line.rstrip().removeprefix("  ") for line in lines[-len(example) :]] == example


def test_the_kinds_of_a_field_of_another_name_say_its_name() -> None:
    words = " ".join(shown("keypoint").split())
    assert words.endswith(
        "vstestbed describe keypoint.sift shows one of them."
        " In a scenario the field is called features."
    )
    assert "is called" not in shown("law")


def test_colours_only_where_they_are_wanted() -> None:
    assert "\x1b[" in shown("law.pbvs", force_terminal=True)
    assert "\x1b[3" not in shown("law.pbvs", force_terminal=True, no_color=True)


def test_the_words_for_an_entry() -> None:
    for word, name in (
        ("pbvs", "law.pbvs"),
        ("law.pbvs", "law.pbvs"),
        ("law", "law"),
        ("stop", "stop"),
        ("solve", "law.solve"),
        ("goal", "goal"),
        ("law.depth", "depth"),
        ("law.depth.pnp", "depth.pnp"),
        ("detector.features.sift", "keypoint.sift"),
        ("stripe", "lines.marker"),
    ):
        found = looked_up(word, entries())
        assert isinstance(found, Entry) and found.name == name


def test_words_that_are_not_one() -> None:
    for word, words in (
        ("lines", "lines is detector.lines and target.lines; give one of these names"),
        ("pbv", "pbv is no kind, block or field of a scenario; did you mean 'pbvs'?"),
        (
            "qqqq",
            (
                "qqqq is no kind, block or field of a scenario;"
                " a scenario has name, description, plugins, seed,"
            ),
        ),
        ("qqqq.gain", "qqqq is no kind and no block of a scenario; a scenario has name,"),
        ("xyz", "xyz is a field of 2"),
        (
            "camera.readout",
            (
                "camera.readout is no field of a scenario: camera has no readout;"
                " did you mean 'readout_s'?"
            ),
        ),
        (
            "law.ibvs.gane",
            "law.ibvs.gane is no field of a scenario: law.ibvs has no gane; did you mean 'gain'?",
        ),
        (
            "camera.optic.defocus",
            (
                "camera.optic.defocus is no field of a scenario: camera has no optic;"
                " did you mean 'optics'?"
            ),
        ),
        ("seed.x", "seed.x is no field of a scenario; seed is no block, and has no fields"),
        (
            "camera.readout_s.x",
            "camera.readout_s.x is no field of a scenario; camera.readout_s is no block",
        ),
    ):
        with pytest.raises(ParameterError) as refused:
            looked_up(word, entries())
        assert str(refused.value).startswith(words)


def paths_of(
    rule: dict[str, Any], bare: str = "", full: str = "", within: tuple[str, ...] = ()
) -> Iterator[tuple[str, str, str]]:
    """Every field below a rule of the schema: its path, the same with kinds and places in lists,
    and its description.
    """
    reference = rule.get("$ref", "").rpartition("/")[2]
    if reference in within:  # a block in itself, such as a law in `switched`: once is enough
        return
    if reference:
        rule, within = whole_schema(Scenario)["$defs"][reference], (*within, reference)
    for choice in rule.get("anyOf", []):
        yield from paths_of(choice, bare, full, within)
    if "items" in rule:
        yield from paths_of(rule["items"], bare, f"{full}.0", within)
    fields = rule.get("properties", {})
    if "kind" in fields:
        full = f"{full}.{fields['kind']['const']}"
    for name, inner in fields.items():
        if name != "kind":
            places = f"{bare}.{name}".strip("."), f"{full}.{name}".strip(".")
            yield (*places, inner["description"])
            yield from paths_of(inner, *places, within)


def test_every_path_of_a_scenario_is_known_with_its_sentence() -> None:
    paths = list(paths_of(whole_schema(Scenario)))
    assert len(paths) > 1500
    assert {
        "randomise",
        "robot.realism",
        "robot.gravity_error",
        "camera.readout_s",
    } <= {path for path, _, _ in paths}
    for path, sentence in {
        (path, sentence) for bare, full, sentence in paths for path in (bare, full)
    }:
        found = looked_up(path, entries())
        if isinstance(found, FieldPlace):
            texts = [
                class_text(cls).fields[found.name].description for cls in found.owners.values()
            ]
            assert any(sentence.startswith(text) for text in texts), path


def field_shown(path: str, width: int = 1000) -> list[str]:
    """What is shown of a field, by default so wide that no line is wrapped: where one is depends on
    the longest name of a kind.
    """
    out, place = io.StringIO(), looked_up(path, entries())
    assert isinstance(place, FieldPlace)
    describe_field(place, entries(), Console(file=out, width=width, highlight=False))
    return [" ".join(line.split()) for line in out.getvalue().splitlines()]


def test_a_field_has_default_unit_words_and_an_example() -> None:
    lines = field_shown("camera.readout_s")
    assert lines[0] == "camera.readout_s"
    assert lines[3].startswith(
        "readout_s 0.0 s time over which a rolling shutter exposes its H rows"
    )
    owners = next(line for line in lines if line.startswith("A field of camera."))
    assert "camera.spherical" in owners and lines[-1] == "Example: --set camera.readout_s=0.02"
    assert field_shown("robot.realism")[-1] == "Example: --set robot.realism=lab"


def test_a_field_that_says_different_things_in_different_blocks_has_a_row_for_each() -> None:
    lines = field_shown("law.gain")
    assert lines[2] == "field of default unit what it is"
    assert lines[3].startswith("law.ibvs 0.5 1/s lambda, a number or an adaptive gain")
    assert any(line.startswith("law.line_following 3.0 1/s lambda.") for line in lines)


def test_a_field_that_holds_a_block_is_followed_by_it() -> None:
    lines = field_shown("randomise")
    assert lines[3].startswith("randomise [] fields that are drawn anew")
    assert "distribution" in lines
    assert any(line.startswith("uniform Uniform between two bounds") for line in lines)


def test_a_field_in_a_list_has_an_example_that_set_does_not_take() -> None:
    assert "Example: pose: {xyz: [1.15, 0, 0.7], rpy_deg: [0, 90, 0]}" in field_shown(
        "world.plates.0.pose"
    )


def test_a_field_that_holds_another_block_in_each_kind_is_shown_for_each() -> None:
    rows = {line.split()[0]: line for line in field_shown("target.marker")[3:] if line}
    assert rows["target.square"] == "target.square disc what marks each of its points. See marker."
    assert "See lines.marker." in " ".join(
        field_shown("target.marker")
    ) and "See shape.marker." in " ".join(field_shown("target.marker"))
    assert field_shown("target.lines.marker")[3].startswith("marker the stripe;")
    for path, kind in (
        ("robot.start", "robot.free"),
        ("robot.start", "robot.car"),
        ("robot.parameters", "robot.quadrotor"),
    ):
        assert any(line.startswith(f"{kind} ") for line in field_shown(path)), (path, kind)


def test_a_field_is_shown_in_80_columns_too() -> None:
    for path in ("camera.readout_s", "law.gain", "randomise", "target.marker"):
        lines = field_shown(path, 80)
        assert max(map(len, lines)) <= 80 and lines[0] == path


@pytest.fixture
def with_long_names(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A camera, a law and a marker more, with names longer than all that are bundled."""
    kinds = []
    for room, base in (
        (vs.CAMERAS, "perspective"),
        (vs.LAWS, "ibvs"),
        (vs.LAWS, "line_following"),
        (MARKERS, "disc"),
    ):
        word = f"{base}_under_a_name_that_is_longer_than_all_others"
        namespace = {
            "__annotations__": {"kind": Literal[word]},
            "kind": word,
            "__doc__": room.members[base].__doc__,
        }
        kinds.append(vs.spec(type(f"Long{base.title()}", (room.members[base],), namespace)))
        monkeypatch.setitem(room.members, word, kinds[-1])
    entries.cache_clear()
    yield
    entries.cache_clear()
    for kind in kinds:
        SPECS.remove(kind)


def test_a_kind_with_a_longer_name_changes_nothing_of_the_others(with_long_names: None) -> None:
    assert any(name.startswith("camera.perspective_under") for name in entries())
    test_everything_can_be_shown_in_80_columns()
    test_a_field_has_default_unit_words_and_an_example()
    test_a_field_that_says_different_things_in_different_blocks_has_a_row_for_each()
    test_a_field_that_holds_a_block_is_followed_by_it()
    test_a_field_that_holds_another_block_in_each_kind_is_shown_for_each()
    test_a_field_is_shown_in_80_columns_too()
    test_items_of_lists_and_rows_of_definitions_stay_apart()
    test_a_block_that_no_bundled_file_has_still_has_an_example()


def test_starts_of_different_robots_have_different_names() -> None:
    names = {
        entry.cls.__name__: entry.name
        for entry in entries().values()
        if entry.cls and entry.name.endswith(".start")
    }
    assert {"FreeStart", "PumaStart", "GroundStart", "FlightStart", "ArmStart"} <= set(names)
