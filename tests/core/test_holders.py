"""Which classes hold blocks of a room: those into whose validators pydantic has compiled the room."""

from __future__ import annotations

from typing import Any

from vstestbed.core.registry import ROOMS, SPECS, Room
from vstestbed.core.spec import holders
from vstestbed.scenario.scenario import Scenario
from vstestbed.scenario.validation import KINDS


def compiled(part: Any) -> set[str]:
    """The rooms in a schema of pydantic's, by the method with which each expands its blocks."""
    if isinstance(part, dict):
        return set().union(*map(compiled, part.values())) if part else set()
    if isinstance(part, list | tuple):
        return set().union(*map(compiled, part)) if part else set()
    return {part.__self__.what} if isinstance(getattr(part, "__self__", None), Room) else set()


def test_they_are_those_that_pydantic_has_compiled_them_into() -> None:
    by_hints = {room.what: set(holders([room.what])) for room in ROOMS}
    empty = {room.what for room in ROOMS if not room.members}  # whose first kind is still to come
    with_fields = [cls for cls in SPECS if cls.__module__.startswith("vstestbed.") and cls.__annotations__]
    for cls in with_fields:
        inside = compiled(cls.__pydantic_core_schema__) - empty  # pyright: ignore[reportAttributeAccessIssue] - pydantic's
        assert inside == {what for what, found in by_hints.items() if cls in found}, cls
    assert Scenario in by_hints["law"] and len(by_hints["law"]) < 10 < len(with_fields)
    assert {room.what for room in KINDS.values()} <= set(by_hints)
