"""The block `randomise`, fields of a scenario that are drawn anew for each seed, and the random
streams of a seed.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import numpy as np
from annotated_types import Ge, Gt, Le, Len

from vstestbed.core.errors import ParameterError, ScenarioError, short
from vstestbed.core.quantity import check_range
from vstestbed.core.registry import Contract, Registry, brief_mapping, to_mapping
from vstestbed.core.spec import spec
from vstestbed.scenario.yaml_marks import build, overlap, put_over

if TYPE_CHECKING:
    from vstestbed.scenario.scenario import Scenario

__all__ = [
    "BODY_STREAM",
    "DEPTH_STREAM",
    "DISTRIBUTIONS",
    "GOAL_STREAM",
    "IMAGE_STREAM",
    "IMAGING_STREAM",
    "LINK_STREAM",
    "MOTION_STREAM",
    "NOISE_STREAM",
    "PERTURB_STREAM",
    "RGBD_STREAM",
    "SENSOR_STREAM",
    "STAMP_STREAM",
    "START_STREAM",
    "TARGET_STREAM",
    "TIMING_STREAM",
    "Distribution",
    "check_randomise",
    "drawn",
    "values_of",
]


NOT_DRAWN = "name", "description", "plugins", "seed", "randomise"
"""Blocks that no distribution may change: the seed decides what is drawn, and the others describe
the experiment.
"""
TRIES = 1000  # largest number of draws until one lies within its bounds
Finite = Annotated[float, Ge(-1e9), Le(1e9)]
Whole = Annotated[int, Ge(-(10**9)), Le(10**9)]
Pair = Annotated[tuple[Finite, ...], Len(2, 2)]


class Distribution:
    """How one field is drawn; of your own, call `__post_init__` from that of the class, if it has
    one.

    Attributes:
        field: dotted path of the field that is drawn, as `--set` takes it.
    """

    kind: Any  # the word in a scenario, a field of each distribution
    field: str
    _bounds: ClassVar[str] = (
        ""  # the name of the field that holds the smallest and the largest value
    )

    def __post_init__(self) -> None:
        if self.field.split(".")[0] in NOT_DRAWN:
            raise ParameterError.excluded(
                "field", f"in {', '.join(NOT_DRAWN)}", self.field, works="world.light.brightness"
            )
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
        within: smallest and largest value: the distribution is cut off there, and not heaped up at
            its bounds; none: unbounded [unit of the field]; e.g. `[0.02, 0.06]`.
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
            form = "[mean, standard deviation of 0 or more]"
            raise ParameterError.form("normal", form, list(self.normal))
        if self.within is None:
            return
        low, high = self.within
        least = mean - 3 * sigma
        most = mean + 3 * sigma
        if low > most or high < least:
            words = (
                f"must reach into three standard deviations about the mean, {least:g} to {most:g}"
            )
            raise ParameterError("within", words, [low, high])

    def draw(self, rng: np.random.Generator) -> float:
        mean, sigma = self.normal
        low, high = self.within or (-math.inf, math.inf)
        for _ in range(TRIES):
            # `normal` refuses a sigma of -0.0
            x = mean + sigma * float(rng.standard_normal())
            if low <= x <= high:
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
        choice: the values: numbers, words, or lists of numbers [unit of the field]; e.g.
            `["texture:brick", "texture:leaves"]`.
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

# Domain randomisation: the block `randomise`, and clutter, drawn from a scenario's seed.
# Independent random streams of one seed. Their numbers enter the seed: a new one comes last, or all
# recorded runs change.
# In groups: the start, the noise of measured pixels, of pictures, of the robot's own sensors, of
# timing, of the calibration of depths, the target's random walk, perturbations;
# the depth camera, the goal's picture, what differs from one robot to the next of its kind, losses
# of the link, time stamps, the image sensor, the block `randomise`, clutter;
# changes of the target's own picture.
(
    START_STREAM,
    NOISE_STREAM,
    IMAGE_STREAM,
    SENSOR_STREAM,
    TIMING_STREAM,
    DEPTH_STREAM,
    MOTION_STREAM,
    PERTURB_STREAM,
    RGBD_STREAM,
    GOAL_STREAM,
    BODY_STREAM,
    LINK_STREAM,
    STAMP_STREAM,
    IMAGING_STREAM,
    RANDOMISE_STREAM,
    CLUTTER_STREAM,
    TARGET_STREAM,
) = range(17)


def drawn(scenario: Scenario) -> Scenario:
    """The scenario with the values of `randomise`, which is then empty, and the objects of
    `world.clutter` that its seed draws. Itself where it has them already.
    Raises ParameterError: a drawn value is refused; it names the distribution, `randomise.2`, the
    value and why.
    """
    if scenario.randomise:
        scenario = _with_values(scenario)
    clutter = scenario.world.clutter
    if clutter is None or clutter.placed or not clutter.count:
        return scenario
    rng = np.random.default_rng([scenario.seed, CLUTTER_STREAM])
    placed = clutter.draw(rng, scenario.target.hues_deg)
    return replace(scenario, world=replace(scenario.world, clutter=replace(clutter, placed=placed)))


def _with_values(scenario: Scenario) -> Scenario:
    """The scenario with what is drawn for the fields of `randomise`. Errors: see `drawn`."""
    plain = to_mapping(scenario) | {"randomise": []}
    found = values_of(scenario)
    if "robot.realism" in found:  # it fills what is not given
        plain["robot"] = brief_mapping(scenario.robot)
    try:
        put_over(plain, found, {}, {})
        return build(type(scenario), plain, {}, "")
    except ScenarioError as error:
        mistake = error.mistakes[0]
        fields = list(found)
        i = next((i for i, field in enumerate(fields) if overlap(field, mistake.field)), 0)
        words = (
            f"drew {short(found[fields[i]])} for {fields[i]} with seed {scenario.seed}:"
            f" {mistake.field} {mistake.sentence}"
        )
        raise ParameterError(f"randomise.{i}", words) from None


def values_of(scenario: Scenario) -> dict[str, Any]:
    """What the seed draws for the fields of `randomise`, by their paths."""
    values = {}
    for one in scenario.randomise:
        stream = [scenario.seed, RANDOMISE_STREAM, *one.field.encode()]
        values[one.field] = one.draw(np.random.default_rng(stream))
    return values


def check_randomise(randomise: Sequence[Distribution]) -> None:
    """Refuse two distributions of one field, or of a block and a field in it."""
    for i, one in enumerate(randomise):
        for j, other in enumerate(randomise[:i]):
            if overlap(one.field, other.field):
                what = f"randomise.{j}.field: {other.field}"
                raise ParameterError.conflict(f"randomise.{i}.field", what, one.field)
