"""What the record of a run states of the draws of its seed (`Robot.drawn_fields`) must be what the seed draws."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from vstestbed.core.errors import Mistake, ScenarioError, short
from vstestbed.core.mapping import to_mapping
from vstestbed.scenario.randomise import value_at
from vstestbed.scenario.scenario import Scenario
from vstestbed.scenario.validation import build
from vstestbed.scenario.yaml_marks import Marks, place_of


def refuse_stated(scenario: Scenario, plain: Any, marks: Marks, file: str, overrides: Mapping[str, object]) -> None:
    """Refuse a statement of what the seed has drawn that the seed does not draw, since it would be without effect.

    With other overrides, such as another seed, the record of a run may state what was drawn before: it is drawn again.

    Args:
        scenario: as built. plain, marks, file: what it was built from. overrides: by dotted path.

    Raises:
        ScenarioError: it names the field, and the block's own one for values that stay.
    """
    fields = [name for name in scenario.robot.drawn_fields if value_at(plain, f"robot.{name}")]
    if not fields:
        return
    given = to_mapping(build(type(scenario.robot), plain["robot"], {}, file))  # before anything is drawn
    for name in fields:
        field, stated, found = f"robot.{name}", value_at(given, name), value_at(to_mapping(scenario.robot), name)
        if stated and stated != found and _meant(field, overrides):
            words = f"states what the seed draws: seed {scenario.seed} draws {short(found) if found else 'nothing'}; leave it out, or list"
            words = f"{words} values that stay in {field.replace('drawn_', '')}"
            raise ScenarioError([Mistake(place_of(tuple(field.split(".")), marks, file), field, words)])


def _meant(field: str, overrides: Mapping[str, object]) -> bool:
    """Whether a field has its value on purpose: nothing else was changed, or it was given itself, or in its block."""
    return not overrides or any(f"{field}.".startswith(f"{dotted}.") or dotted.startswith(f"{field}.") for dotted in overrides)
