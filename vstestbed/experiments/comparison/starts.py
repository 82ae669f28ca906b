"""Start tables: starts that form a task, such as rotations of 20 to 180 deg about the optical axis."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import field
from typing import Annotated, Any

from annotated_types import Ge, Le

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Pose
from vstestbed.core.spec import spec


@spec
class StartTable:
    """The starts of a task: run i has the i-th value of every list in `each`, the i-th displacement, or the start that seed i draws.

    Args:
        set: values by dotted path, for all runs of the task.
        each: lists of values by dotted path, all of the same length, one value per run.
        camera_from_goal: in place of `each`: poses of the camera in the frame of the camera at its goal, for any arm, whose joints
            follow by inverse kinematics (`Scenario.displaced`).
        target_from_goal: in place of `each`: poses of the target in its frame at the goal, as the camera is to see it.
        seeds: in place of `each`: number of random starts.
        amounts: label of each run [unit as in `unit`]: 20 (deg), 40, ...; by default 1, 2, ..., for random starts the seed.
        unit: unit of the amounts.
    """

    set: dict[str, Any] = field(default_factory=dict)
    each: dict[str, tuple[Any, ...]] = field(default_factory=dict)
    camera_from_goal: tuple[Pose, ...] = ()
    target_from_goal: tuple[Pose, ...] = ()
    seeds: Annotated[int, Ge(1), Le(1_000_000)] | None = None
    amounts: tuple[float, ...] = ()
    unit: str = ""

    def __post_init__(self) -> None:
        """Refuse lists of different lengths."""
        given = [bool(self.each), bool(self.camera_from_goal), bool(self.target_from_goal), self.seeds is not None]
        if sum(given) != 1:
            words = "or camera_from_goal, target_from_goal or seeds must say what the runs of a task are; give one of the four"
            raise ParameterError("each", words)
        lengths = {path: len(values) for path, values in self.each.items()}
        if 0 in lengths.values() or len(set(lengths.values())) > 1:
            raise ParameterError("each", "must have one value or more for each run in every list; their lengths are", lengths)
        if self.amounts and len(self.amounts) != self.runs:
            raise ParameterError("amounts", f"must name each of the {self.runs} runs", list(self.amounts))

    @property
    def runs(self) -> int:
        """Number of runs."""
        if self.seeds is not None:
            return self.seeds
        return len(self.displacements or next(iter(self.each.values())))

    @property
    def displacements(self) -> tuple[Pose, ...]:
        """Those of the camera or of the target."""
        return self.camera_from_goal or self.target_from_goal

    def settings(self) -> Iterator[dict[str, object]]:
        """The settings of each run by dotted path."""
        for i in range(self.runs):
            yield {path: values[i] for path, values in self.each.items()}

    def labels(self) -> tuple[str, ...]:
        """The label of each run; without amounts its number, for random starts the seed."""
        first = 0 if self.seeds is not None else 1  # seeds count from 0, runs for readers from 1
        return tuple(f"{amount:g} {self.unit}".strip() for amount in self.amounts or range(first, first + self.runs))
