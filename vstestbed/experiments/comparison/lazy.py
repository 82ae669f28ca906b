"""Sequences whose items are made when they are asked for: controllers, runs, starts."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import TypeVar, overload

from vstestbed.scenario.scenario import Scenario

T = TypeVar("T")
STARTS_KEPT = 100
"""Scenarios of a task's runs that are kept in memory; of more, each is made again when its turn comes."""


class Lazy(Sequence[T]):
    """A sequence whose items are made when they are asked for."""

    def item(self, i: int) -> T:
        """Item i, 0 <= i < len."""
        raise NotImplementedError

    @overload
    def __getitem__(self, i: int) -> T: ...
    @overload
    def __getitem__(self, i: slice) -> list[T]: ...
    def __getitem__(self, i: int | slice) -> T | list[T]:
        """Item i, or a list of the items of a slice."""
        places = range(len(self))[i]
        return self.item(places) if isinstance(places, int) else [self.item(place) for place in places]


class Starts(Lazy[Scenario]):
    """The scenarios of a task's runs, each made when it is asked for.

    Args:
        make: the scenario of run i, and why the robot cannot stand where it begins, "" where it can.
        runs: how many there are.
    """

    def __init__(self, make: Callable[[int], tuple[Scenario, str]], runs: int):
        self._made, self._runs = functools.lru_cache(maxsize=STARTS_KEPT)(make), runs

    def __len__(self) -> int:
        return self._runs

    def item(self, i: int) -> Scenario:
        """The scenario of run i; one that cannot begin as it is without its displacement."""
        return self._made(i)[0]

    def why_not(self, i: int) -> str:
        """Why the robot cannot stand where run i begins; "" where it can."""
        return self._made(i)[1]
