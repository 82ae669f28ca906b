"""What was changed in a bundled scenario: the fields in which one differs from the bundled one of its name."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from vstestbed.core.assets import bundled_scenarios
from vstestbed.core.mapping import to_mapping
from vstestbed.core.named_files import kept_at
from vstestbed.scenario.dump import flow_text
from vstestbed.scenario.load import load
from vstestbed.scenario.scenario import Scenario

OF_THE_RUN = ("name", "description", "plugins", "seed")
"""Fields that name a run or are shown elsewhere."""
NOT_GIVEN = ("drawn_about",)
"""Fields of a block that a run fills."""


def changes(scenario: Scenario) -> tuple[str, ...]:
    """The changed fields with their values, as `--set` takes them: `("derotation=none",)`; () for one that has no bundled namesake.

    A block whose kind was changed is one field with its whole value.
    """
    if scenario.name not in bundled_scenarios():
        return ()
    original = load(scenario.name)
    bundled = to_mapping(original)
    given = {key: value for key, value in to_mapping(scenario).items() if key not in OF_THE_RUN}
    # What a preset has filled is told by the preset's name.
    own, bundled["robot"] = scenario.robot.own_block(given["robot"]), original.robot.own_block(bundled["robot"])
    given["robot"] = {key: own.get(key, value) for key, value in given["robot"].items() if key in own or key in bundled["robot"]}
    return tuple(f"{path}={flow_text(value)}" for path, value in _different(given, bundled))


def _different(given: Mapping[str, Any], bundled: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Dotted paths and values of what is not the same in the bundled mapping."""
    for key, value in given.items():
        if key in NOT_GIVEN:
            continue
        other = bundled.get(key)
        if isinstance(value, dict) and isinstance(other, dict) and value.get("kind") == other.get("kind"):
            yield from _different(value, other, f"{prefix}{key}.")
        elif (value != other or key not in bundled) and not _is_copy(value, other):
            yield prefix + key, value


def _is_copy(value: Any, other: Any) -> bool:
    """Whether a value names the copy of the target's file, or of a goal's picture, in a run's folder."""
    if not (isinstance(value, str) and isinstance(other, str)):
        return False
    path = Path(value)
    return path.as_posix().endswith(kept_at(Path(other), path.parent.name)) and path.parent.parent.name == "assets"
