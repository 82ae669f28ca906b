"""The nominal start round which a seed has drawn another one: a run states both, and a further seed draws round the first."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, TypeVar

from vstestbed.robots.base import Robot

R = TypeVar("R", bound=Robot)
WHERE = "drawn_about"
"""The field of a start block that states it; robots of a user's own may lack it."""


def undrawn(robot: R) -> R:
    """The robot at the nominal start round which its own one was drawn; itself where none was."""
    about = getattr(robot.start, WHERE, None)
    return robot if about is None else _started(robot, nominal=about, drawn_about=None)


def stated(robot: R, given: Robot) -> R:
    """The robot, which states that its start was drawn round that of `given`."""
    return _started(robot, drawn_about=given.start.nominal) if hasattr(robot.start, WHERE) else robot


def without_drawn(block: Mapping[str, Any], changes: Mapping[str, object]) -> dict[str, Any]:
    """A robot's block in a file, before `changes` are put over it: another nominal start is also the one to draw round."""
    start = block.get("start")
    if isinstance(start, Mapping) and any(path == "start.nominal" or path.startswith("start.nominal.") for path in changes):
        return {**block, "start": {name: value for name, value in start.items() if name != WHERE}}
    return dict(block)


def _started(robot: R, **changes: object) -> R:
    any_robot: Any = robot  # a dataclass, which a protocol cannot say
    return replace(any_robot, start=replace(robot.start, **changes))
