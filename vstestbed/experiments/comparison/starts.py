"""Tasks: starts that belong together, such as turns of 20 to 180 degrees about the optical axis."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import field
from typing import Annotated, Any

from annotated_types import Ge

from vstestbed.core.errors import ParameterError
from vstestbed.core.spec import spec


@spec
class StartTable:
    """The runs of a task: run i has the i-th value of every list in `each`, or the start that seed i draws.

    Args:
        set: values by dotted path, for all runs of the task.
        each: lists of values by dotted path, all of one length: a run for each.
        seeds: in place of `each`: how many random starts.
        amounts: what each run is called, with `unit`: 20 (deg), 40, ...; none: 1, 2, ..., of random starts the seed.
        unit: of the amounts.
    """

    set: dict[str, Any] = field(default_factory=dict)
    each: dict[str, tuple[Any, ...]] = field(default_factory=dict)
    seeds: Annotated[int, Ge(1)] | None = None
    amounts: tuple[float, ...] = ()
    unit: str = ""

    def __post_init__(self) -> None:
        """Refuse lists that do not belong together."""
        if bool(self.each) == (self.seeds is not None):
            raise ParameterError("each", "or seeds must say what the runs of a task are; give one of the two")
        lengths = {path: len(values) for path, values in self.each.items()}
        if 0 in lengths.values() or len(set(lengths.values())) > 1:
            raise ParameterError("each", "must have one value or more for each run in every list; their lengths are", lengths)
        if self.amounts and len(self.amounts) != self.runs:
            raise ParameterError("amounts", f"must name each of the {self.runs} runs", list(self.amounts))

    @property
    def runs(self) -> int:
        """How many."""
        return self.seeds if self.seeds is not None else len(next(iter(self.each.values())))

    def settings(self) -> Iterator[dict[str, object]]:
        """The values by dotted path of each run."""
        for i in range(self.runs):
            yield {path: values[i] for path, values in self.each.items()}

    def words(self) -> tuple[str, ...]:
        """What each run is called; without amounts its number, of random starts the seed."""
        first = 0 if self.seeds is not None else 1
        return tuple(f"{amount:g} {self.unit}".strip() for amount in self.amounts or range(first, first + self.runs))
