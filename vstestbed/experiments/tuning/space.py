"""What a search varies: ranges of numbers and choices, each for one field of a scenario."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from vstestbed.core.errors import ParameterError, ScenarioError
from vstestbed.core.registry import rooms_of
from vstestbed.experiments.comparison.plan import Comparison, changed
from vstestbed.experiments.comparison.runs import controllers
from vstestbed.scenario.dump import flow_text
from vstestbed.scenario.scenario import Scenario

OPTION = "--vary"
FORM = "needs a.b=LOW:HIGH, a.b=LOW:HIGH:log, or a.b=v1,v2,..."
STEPS = 1000
"""Values of a range from which a search chooses: a recommendation of more digits than these would claim too much."""
EDGE = 0.02
"""Share of a range at each end that counts as its end."""


@dataclass(frozen=True)
class Range:
    """A range of numbers; log: equal factors are equally likely; whole: whole numbers alone."""

    path: str
    low: float
    high: float
    log: bool = False
    whole: bool = False

    @property
    def size(self) -> float:
        """Number of different values."""
        return self.high - self.low + 1 if self.whole else math.inf

    @property
    def ends(self) -> tuple[object, ...]:
        """Values that must all be valid."""
        return (self.low, self.high)

    def rounded(self, value: float) -> object:
        """A value as it is tried: of so many digits that neighbours are about a thousandth of the range apart."""
        if self.whole:
            return int(value)
        step = (abs(value) if self.log else self.high - self.low) / STEPS
        digits = -math.floor(math.log10(step)) if step else 0
        return min(max(round(value, digits), self.low), self.high)

    def at(self, place: float) -> float:
        """The value at a place between the ends, 0 to 1."""
        if self.whole:
            return math.floor(self.low + place * self.size)
        return self.low * (self.high / self.low) ** place if self.log else self.low + place * (self.high - self.low)

    def place(self, value: object) -> float:
        """Where a value lies between the ends, 0 to 1."""
        low, high, x = (math.log(v) if self.log else v for v in (self.low, self.high, float(str(value))))
        return (x - low) / (high - low)

    def current(self, scenario: Scenario, at_values: Sequence[Scenario]) -> object:
        """The value that a scenario has now; None where it has none in the range."""
        found = _value_at(scenario, self.path)
        inside = isinstance(found, int | float) and not isinstance(found, bool) and self.low <= found <= self.high
        return found if inside else None

    def __str__(self) -> str:
        """As on the command line."""
        return f"{self.low:.12g}:{self.high:.12g}{':log' if self.log else ''}"


@dataclass(frozen=True)
class Choice:
    """Values of any kind, one of which is chosen; a block such as `{kind: pbvs}` is one."""

    path: str
    values: tuple[object, ...]

    @property
    def size(self) -> float:
        """Number of different values."""
        return len(self.values)

    @property
    def ends(self) -> tuple[object, ...]:
        """Values that must all be valid."""
        return self.values

    @property
    def words(self) -> list[str]:
        """Each value as YAML on one line."""
        return [flow_text(value) for value in self.values]

    def chosen(self, word: str) -> object:
        """The value of one of `words`."""
        return self.values[self.words.index(word)]

    def current(self, scenario: Scenario, at_values: Sequence[Scenario]) -> object:
        """The value that a scenario has now; None where it is none of them."""
        return next((value for value, one in zip(self.values, at_values, strict=True) if one == scenario), None)

    def __str__(self) -> str:
        """As on the command line."""
        return ",".join(self.words)


Parameter = Range | Choice


def parameter(path: str, given: object) -> Parameter:
    """The range or the choice that is given for a field.

    Args:
        path: dotted path. given: `"0.2:2"`, `"10:80:log"`, or a sequence of values; a sequence of one such text is that range.

    Raises:
        ParameterError: it is neither.
    """
    if not isinstance(given, str):
        values = tuple(given) if isinstance(given, Sequence) else (given,)
        if len(values) > 1:
            return Choice(path, values)
        given = values[0] if values else ""
    if ":" not in str(given):
        raise ParameterError(OPTION, f"{path}: one value leaves nothing to choose; it {FORM}", given)
    low, high, scale = (*map(str.strip, str(given).split(":", 2)), "")[:3]
    ends = _number(low), _number(high)
    if ends[0] is None or ends[1] is None or scale not in ("", "log"):
        raise ParameterError(OPTION, f"{path}: is no range of numbers; it {FORM}", given)
    return _range(path, given, ends[0], ends[1], scale == "log")


def _range(path: str, given: object, low: float, high: float, log: bool) -> Range:
    if low >= high:
        raise ParameterError(OPTION, f"{path}: must have its low end first, and below the high one", given)
    if log and low <= 0:
        raise ParameterError(OPTION, f"{path}: must begin above 0 where it is logarithmic", given)
    return Range(path, low, high, log)


def _number(text: str) -> float | None:
    if not re.fullmatch(r"\s*[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?\s*", text):
        return None
    value = float(text)
    return value if math.isfinite(value) else None


@dataclass(frozen=True)
class SearchSpace:
    """All that a search varies, checked against the scenario.

    Attributes:
        parameters: ranges and choices. now: the values that the scenario has already; None where one of them is not in the space.
    """

    parameters: tuple[Parameter, ...]
    now: dict[str, object] | None

    @property
    def size(self) -> float:
        """Number of different settings; infinite where a range has real numbers."""
        return math.prod(p.size for p in self.parameters)

    def at_an_end(self, values: Mapping[str, object]) -> list[Range]:
        """The ranges at whose ends a setting lies."""
        ranges = [p for p in self.parameters if isinstance(p, Range)]
        return [p for p in ranges if not EDGE < p.place(values[p.path]) < 1 - EDGE]


def checked(plan: Comparison, parameters: Sequence[Parameter]) -> SearchSpace:
    """The space of a search; each end of each range and each choice is loaded, so that bad input is found before anything runs.

    Args:
        plan: the scenario with its settings, and the ends and choices as axes.

    Raises:
        ScenarioError, ParameterError: a value that a field does not take, in the words of a scenario's mistakes.
    """
    found, now = [], dict[str, object]()
    scenario = controllers(changed(plan, axes={}, seeds=None))[0].scenario
    for one in parameters:
        first = {p.path: p.ends[:1] for p in parameters}
        loaded = [c.scenario for c in controllers(changed(plan, axes={**first, one.path: one.ends}, seeds=None))]
        if isinstance(one, Range):
            one = replace(one, whole=_is_whole(plan, one, first))
        found.append(one)
        alone = loaded if len(parameters) == 1 else _alone(plan, one)
        if (value := one.current(scenario, alone)) is not None:
            now[one.path] = value
    return SearchSpace(tuple(found), now if len(now) == len(found) else None)


def _alone(plan: Comparison, one: Parameter) -> list[Scenario]:
    """The scenario with each choice alone changed; those of a range are not needed."""
    if isinstance(one, Range):
        return []
    try:
        return [c.scenario for c in controllers(changed(plan, axes={one.path: one.values}, seeds=None))]
    except (ScenarioError, ParameterError):  # valid only together with another choice: then it is not what the scenario has now
        return []


def _is_whole(plan: Comparison, one: Range, first: Mapping[str, tuple[object, ...]]) -> bool:
    """Whether the field takes whole numbers alone: one that is none, between the ends, is refused."""
    if not (one.low.is_integer() and one.high.is_integer()):
        return False
    try:
        controllers(changed(plan, axes={**first, one.path: (one.low + 0.5,)}, seeds=None))
    except ScenarioError:
        return True
    return False


def _value_at(scenario: Scenario, path: str) -> object:
    """The value of a field; of a block for which a number may stand, such as a constant gain, that number."""
    value: Any = scenario
    for part in path.split("."):
        value = getattr(value, part, None)
    numbers = [room.number for room in rooms_of(type(value)) if room.number]
    return next((getattr(value, name) for kind, name in numbers if value.kind == kind), value)
