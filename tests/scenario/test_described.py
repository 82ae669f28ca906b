"""Every field of every block has words, a unit where it is a number, and an example that the schema
itself accepts.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any, Literal

import pytest

from tests.scenario.schemas import whole_schema
from tests.scenario.test_load import conforms
from vstestbed.core.fields import class_text, unit_in
from vstestbed.core.named_files import bundled_comparisons, bundled_scenarios, folder
from vstestbed.core.spec import spec
from vstestbed.laws.error_law import ErrorLaw
from vstestbed.laws.pbvs import PBVS
from vstestbed.scenario.catalogue import bundled_uses, examples_of
from vstestbed.scenario.load import for_another_folder
from vstestbed.scenario.scenario import Scenario
from vstestbed.studies.comparison import Comparison
from vstestbed.tasks.landing import GoalLanding

CLASSES = (Scenario, Comparison)
ADVICE = "write a line for it under Args: in the docstring of the class: `name: words [unit].`"


def fields(whole: dict[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    """CLASS.field and the rule of each field in a schema."""
    for name, block in (*whole["$defs"].items(), (whole["title"], whole)):
        for field, rule in block["properties"].items():
            yield f"{name}.{field}", rule


def is_number(rule: dict[str, Any]) -> bool:
    """Whether a field takes numbers, or lists of them; a number that stands for a block has the
    unit of a field in it.
    """
    choices = [r for r in rule.get("anyOf", []) if r != {"type": "null"}]
    if any("$ref" in r for r in choices):
        return False
    inner = rule.get("items", {}) if rule.get("type") == "array" else {}
    return rule.get("type") in ("number", "integer") or any(
        map(is_number, [*choices, *filter(None, [inner])])
    )


@pytest.mark.parametrize("cls", CLASSES)
class TestEveryField:
    def test_is_described(self, cls: type) -> None:
        without = [name for name, rule in fields(whole_schema(cls)) if not rule.get("description")]
        assert not without, f"{', '.join(without)}: {ADVICE}"

    def test_that_is_a_number_has_a_unit(self, cls: type) -> None:
        without = [
            name
            for name, rule in fields(whole_schema(cls))
            if is_number(rule) and not rule.get("unit")
        ]
        assert not without, f"{', '.join(without)}: {ADVICE}, with [1] for a pure number"

    def test_has_an_example_that_is_valid(self, cls: type) -> None:
        without = [name for name, rule in fields(whole_schema(cls)) if not rule.get("examples")]
        assert not without, (
            f"{', '.join(without)}: no default, and set in no bundled file:"
            " end its line under Args: with `; e.g. `VALUE`.`"
        )
        wrong = [
            name
            for name, rule in fields(whole_schema(cls))
            if not conforms(rule["examples"][0], rule, whole_schema(cls))
        ]
        assert not wrong, f"{', '.join(wrong)}: the example is not valid"


SUFFIXES = {
    "_m": "m",
    "_s": "s",
    "_deg": "deg",
    "_px": "px",
    "_hz": "Hz",
    "_mps": "m/s",
    "_radps": "rad/s",
    "_rad": "rad",
    "_mps2": "m/s^2",
}


@pytest.mark.parametrize("cls", CLASSES)
def test_the_unit_in_a_name_is_the_unit(cls: type) -> None:
    for name, rule in fields(whole_schema(cls)):
        unit = SUFFIXES.get(f"_{name.rpartition('_')[2]}") if "_" in name else None
        assert unit is None or rule["unit"].startswith(unit), name


COMMITTED = {
    Scenario: ("scenario", bundled_scenarios),
    Comparison: ("comparison", bundled_comparisons),
}


@pytest.mark.parametrize("cls", COMMITTED)
def test_the_schema_beside_the_bundled_files_is_the_present_one(cls: type) -> None:
    name, files = COMMITTED[cls]
    option = " --comparison" if cls is Comparison else ""
    there = folder("scenarios") / f"{name}.schema.json"
    fresh = json.loads(there.read_text(encoding="utf-8")) == whole_schema(cls)
    assert fresh, f"make it again: vstestbed schema{option} > scenarios/{there.name}"
    for path in files().values():
        first = path.read_text(encoding="utf-8").splitlines()[0]
        assert first.startswith("# yaml-language-server: $schema="), path
        assert (path.parent / first.partition("=")[2]).resolve() == there.resolve()


def test_a_copy_elsewhere_names_no_schema() -> None:
    path = bundled_scenarios()["arm_ibvs"]
    assert for_another_folder(path) == "".join(
        path.read_text(encoding="utf-8").splitlines(keepends=True)[1:]
    )


def test_the_parts_of_a_docstring() -> None:
    words = class_text(PBVS)
    assert words.summary.startswith("u = -lambda pinv(L B) e")
    assert words.sources == (
        "Chaumette & Hutchinson 2006, eqs 15-20, doi:10.1109/MRA.2006.250573.",
    )
    assert "Errata." in words.text and "Args" not in words.text and "Reference" not in words.text
    assert words.fields["translation"].description == "`cdMc`, `cMcd` or `cMo`."
    assert list(words.fields) == [*class_text(ErrorLaw).fields, "kind", "translation"]


def test_a_class_without_a_docstring_has_no_words() -> None:
    @spec
    class Bare:
        kind: Literal["bare"] = "bare"
        gain: float = 0.5

    words = class_text(Bare)
    assert (words.summary, words.text, words.sources) == ("", "", ())
    assert words.fields["gain"].description == ""
    assert [*examples_of(Bare, "gain", bundled_uses())] == [0.5]


def test_one_line_for_two_fields_has_a_unit_for_each() -> None:
    found = class_text(GoalLanding).fields
    assert found["within_m"].description == found["within_deg"].description
    assert (found["within_m"].unit, found["within_deg"].unit) == ("m", "deg")


def test_the_unit_in_a_sentence() -> None:
    for words, unit in (
        ("largest speed [m/s].", "m/s"),
        ("the largest, as a share [1]; .05 is little.", "1"),
        ("bounds [low, high] of the angle [deg].", "deg"),
        ("the places, a list of [x, y, z].", ""),
        ("gain [1/s per m or rad].", "1/s per m or rad"),
        ("half widths [m, deg].", "m, deg"),
        ("positions [deg; m for a joint that slides].", "deg"),
        ("noise [grey levels].", "grey levels"),
        ("of the winding, above which it is derated [degC].", "degC"),
        ("thermal resistance of the housing [K/W].", "K/W"),
    ):
        assert unit_in(words) == unit
