"""Values by dotted path put over a scenario's mapping: `--set`, `overrides` in Python, a comparison's settings, what a seed draws."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from vstestbed.core.registry import ROOMS
from vstestbed.scenario.validation import KINDS
from vstestbed.scenario.yaml_marks import FROM_PYTHON, Marks, override


def put_over(plain: dict[str, Any], values: Mapping[str, object], marks: Marks, places: Mapping[str, Marks]) -> None:
    """Put values over a mapping, in place and in their order; the robot first loses what they take the place of as a whole.

    Args:
        plain: the scenario, which is changed. values: by dotted path, such as `law.gain`. marks: positions of its keys, which are changed,
            too. places: positions of the values, and of the keys in them, by dotted path.

    Raises:
        ScenarioError: a path goes through a value, or to an item that a list does not have.
    """
    robot = plain.get("robot")
    changes = {path.removeprefix("robot."): value for path, value in values.items() if path.startswith("robot.")}
    kind: Any = KINDS["robots"].members.get(str(robot.get("kind"))) if changes and isinstance(robot, dict) else None
    if kind is not None:
        plain["robot"] = kind.before_changes(robot, changes)
    for path, value in values.items():
        override(plain, path, value, marks, _is_kind, places.get(path, FROM_PYTHON))


def _is_kind(word: str) -> bool:
    return any(word in room.members for room in ROOMS)
