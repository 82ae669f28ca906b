"""Distributions of the block `randomise`: fields of a scenario that are drawn anew for each seed."""

from __future__ import annotations

import math
from abc import abstractmethod
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from annotated_types import Ge, Gt, Le, Len

from vstestbed.core.errors import ParameterError
from vstestbed.core.quantity import check_range
from vstestbed.core.registry import Contract, Registry
from vstestbed.core.spec import spec

NOT_DRAWN = "name", "description", "plugins", "seed", "randomise"
"""Blocks that no distribution may change: the seed decides what is drawn, and the others describe the experiment."""
TRIES = 1000  # largest number of draws until one lies within its bounds
Finite = Annotated[float, Ge(-1e9), Le(1e9)]
Whole = Annotated[int, Ge(-(10**9)), Le(10**9)]
Pair = Annotated[tuple[Finite, ...], Len(2, 2)]


class Distribution:
    """How one field is drawn; of your own, call `__post_init__` from that of the class, if it has one.

    Attributes:
        field: dotted path of the field that is drawn, as `--set` takes it.
    """

    kind: Any  # the word in a scenario, a field of each distribution
    field: str
    _bounds: ClassVar[str] = ""  # the name of the field that holds the smallest and the largest value

    def __post_init__(self) -> None:
        if self.field.split(".")[0] in NOT_DRAWN:
            raise ParameterError.excluded("field", f"in {', '.join(NOT_DRAWN)}", self.field, works="world.light.brightness")
        if self._bounds and getattr(self, self._bounds) is not None:
            check_range(self, self._bounds, equal=False)

    @abstractmethod
    def draw(self, rng: np.random.Generator) -> Any:
        """A value: a number, a word, a truth value."""
        ...


@spec
class Uniform(Distribution):
    """Uniform between two bounds: x = a + (b - a) U(0, 1).

    Args:
        field: dotted path of the field that is drawn; e.g. `world.light.brightness`.
        uniform: smallest and largest value, a and b [unit of the field]; e.g. `[0.5, 1.5]`.
    """

    kind: Literal["uniform"] = "uniform"
    field: str
    uniform: Pair
    _bounds: ClassVar[str] = "uniform"

    def draw(self, rng: np.random.Generator) -> float:
        return float(rng.uniform(self.uniform[0], self.uniform[1]))


@spec
class Gaussian(Distribution):
    """Gaussian, x = mean + sigma N(0, 1), drawn again until it lies within its bounds.

    Args:
        field: dotted path of the field that is drawn; e.g. `camera.latency_s`.
        normal: mean and standard deviation [unit of the field]; e.g. `[0.04, 0.005]`.
        within: smallest and largest value: the distribution is cut off there, and not heaped up at its bounds; none: unbounded
            [unit of the field]; e.g. `[0.02, 0.06]`.
    """

    kind: Literal["normal"] = "normal"
    field: str
    normal: Pair
    within: Pair | None = None
    _bounds: ClassVar[str] = "within"

    def __post_init__(self) -> None:
        super().__post_init__()
        mean, sigma = self.normal
        if sigma < 0:
            raise ParameterError.form("normal", "[mean, standard deviation of 0 or more]", list(self.normal))
        if self.within is not None and not (self.within[0] <= mean + 3 * sigma and self.within[1] >= mean - 3 * sigma):
            words = f"must reach into three standard deviations about the mean, {mean - 3 * sigma:g} to {mean + 3 * sigma:g}"
            raise ParameterError("within", words, list(self.within))

    def draw(self, rng: np.random.Generator) -> float:
        (mean, sigma), (low, high) = self.normal, self.within or (-math.inf, math.inf)
        for _ in range(TRIES):
            if low <= (x := mean + sigma * float(rng.standard_normal())) <= high:  # `normal` refuses a sigma of -0.0
                return x
        raise ParameterError("within", f"held none of {TRIES} draws; make it wider", [low, high])


@spec
class LogUniform(Distribution):
    """Uniform of the logarithm, x = a (b/a)^U(0, 1): as many between 0.1 and 1 as between 1 and 10.

    Args:
        field: dotted path of the field that is drawn; e.g. `target.marker.albedo`.
        log_uniform: smallest and largest value, both over 0 [unit of the field]; e.g. `[0.1, 1]`.
    """

    kind: Literal["log_uniform"] = "log_uniform"
    field: str
    log_uniform: Annotated[tuple[Annotated[float, Gt(0), Le(1e9)], ...], Len(2, 2)]
    _bounds: ClassVar[str] = "log_uniform"

    def draw(self, rng: np.random.Generator) -> float:
        low, high = self.log_uniform
        return min(max(low * (high / low) ** float(rng.random()), low), high)


@spec
class Integer(Distribution):
    """A whole number, each of a to b with the same probability.

    Args:
        field: dotted path of the field that is drawn; e.g. `world.clutter.count`.
        integer: smallest and largest number, both included [1]; e.g. `[0, 20]`.
    """

    kind: Literal["integer"] = "integer"
    field: str
    integer: Annotated[tuple[Whole, ...], Len(2, 2)]
    _bounds: ClassVar[str] = "integer"

    def draw(self, rng: np.random.Generator) -> int:
        return int(rng.integers(self.integer[0], self.integer[1], endpoint=True))


@spec
class Chosen(Distribution):
    """One of several values, each with the same probability.

    Args:
        field: dotted path of the field that is drawn; e.g. `world.floor.texture`.
        choice: the values: numbers, words, or lists of numbers [unit of the field]; e.g. `["texture:brick", "texture:leaves"]`.
    """

    kind: Literal["choice"] = "choice"
    field: str
    choice: Annotated[tuple[bool | Whole | Finite | str | tuple[Finite, ...], ...], Len(1, 1000)]

    def draw(self, rng: np.random.Generator) -> Any:
        value = self.choice[int(rng.integers(len(self.choice)))]
        return list(value) if isinstance(value, tuple) else value


KINDS = Uniform, Gaussian, LogUniform, Integer, Chosen
DISTRIBUTIONS = Registry(
    "distribution",
    *KINDS,
    fields={kind: kind for kind in ("uniform", "normal", "log_uniform", "integer", "choice")},
    contract=Contract(Distribution, base=Distribution),
)
