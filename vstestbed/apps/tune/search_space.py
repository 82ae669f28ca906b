"""What a search varies: ranges of numbers and choices, each for one field of a scenario."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from vstestbed.core.errors import (
    EnvironmentLackError,
    ParameterError,
    RunFolderError,
    ScenarioError,
)
from vstestbed.core.files import read_file, write_json
from vstestbed.core.registry import registries_of
from vstestbed.scenario.dump import flow_text
from vstestbed.scenario.scenario import Scenario
from vstestbed.studies.comparison.plan import Comparison, changed, controllers
from vstestbed.tasks.metrics import Metric

if TYPE_CHECKING:
    import optuna

OPTION = "--vary"
FORM = "needs a.b=LOW:HIGH, a.b=LOW:HIGH:log, or a.b=v1,v2,..."
# values of a range from which a search chooses: a recommendation of more digits than these would
# claim too much
STEPS = 1000


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
        """A value as it is tried: of so many digits that neighbours are about a thousandth of the
        range apart.
        """
        if self.whole:
            return int(value)
        step = (abs(value) if self.log else self.high - self.low) / STEPS
        digits = -math.floor(math.log10(step)) if step else 0
        return min(max(round(value, digits), self.low), self.high)

    def at(self, place: float) -> float:
        """The value at a place between the ends, 0 to 1."""
        if self.whole:
            return math.floor(self.low + place * self.size)
        return (
            self.low * (self.high / self.low) ** place
            if self.log
            else self.low + place * (self.high - self.low)
        )

    def place(self, value: object) -> float:
        """Where a value lies between the ends, 0 to 1."""
        low, high, x = (
            math.log(v) if self.log else v for v in (self.low, self.high, float(str(value)))
        )
        return (x - low) / (high - low)

    def current(self, scenario: Scenario, at_values: Sequence[Scenario]) -> object:
        """The value that a scenario has now; None where it has none in the range."""
        found = _value_at(scenario, self.path)
        inside = (
            isinstance(found, int | float)
            and not isinstance(found, bool)
            and self.low <= found <= self.high
        )
        return found if inside else None

    def __str__(self) -> str:
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
        return next(
            (value for value, one in zip(self.values, at_values, strict=True) if one == scenario),
            None,
        )

    def __str__(self) -> str:
        return ",".join(self.words)


Parameter = Range | Choice


def parameter(path: str, given: object) -> Parameter:
    """The range `"0.2:2"` or `"10:80:log"` (also as the only item of a sequence) or the choice of
    several values, for a dotted path.
    """
    if isinstance(given, str) or not isinstance(given, Sequence):
        return _range(path, given)
    if len(given) > 1:
        return Choice(path, tuple(given))
    return _range(path, given[0] if given else "")


def _range(path: str, given: object) -> Range:
    if ":" not in str(given):
        raise ParameterError(
            OPTION, f"{path}: one value leaves nothing to choose; it {FORM}", given
        )
    low, high, scale = (*map(str.strip, str(given).split(":", 2)), "")[:3]
    least = _number(low)
    most = _number(high)
    if least is None or most is None or scale not in ("", "log"):
        raise ParameterError(OPTION, f"{path}: is no range of numbers; it {FORM}", given)
    if least >= most:
        raise ParameterError.form(f"{OPTION} {path}:", "LOW:HIGH with LOW < HIGH", given)
    if scale and least <= 0:
        raise ParameterError(OPTION, f"{path}: must begin above 0 where it is logarithmic", given)
    return Range(path, least, most, scale == "log")


def _number(text: str) -> float | None:
    if not re.fullmatch(r"\s*[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?\s*", text):
        return None
    value = float(text)
    return value if math.isfinite(value) else None


@dataclass(frozen=True)
class SearchSpace:
    """All that a search varies, checked against the scenario.

    Attributes:
        parameters: ranges and choices. now: the values that the scenario has already; None where
            one of them is not in the space.
    """

    parameters: tuple[Parameter, ...]
    now: dict[str, object] | None

    @property
    def size(self) -> float:
        """Number of different settings; infinite where a range has real numbers."""
        return math.prod(p.size for p in self.parameters)


def checked(plan: Comparison, parameters: Sequence[Parameter]) -> SearchSpace:
    """The space of a search; each end of each range and each choice is loaded, so that bad input is
    found before anything runs.

    plan: the scenario with its settings, and the ends and choices as axes. Raises ScenarioError,
    ParameterError: a value that a field does not take, in the words of a scenario's mistakes.
    """
    found, now = [], dict[str, object]()
    scenario = controllers(changed(plan, axes={}, seeds=None))[0].scenario
    for one in parameters:
        first = {p.path: p.ends[:1] for p in parameters}
        loaded = [
            c.scenario
            for c in controllers(changed(plan, axes={**first, one.path: one.ends}, seeds=None))
        ]
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
        return [
            c.scenario for c in controllers(changed(plan, axes={one.path: one.values}, seeds=None))
        ]
    except (ScenarioError, ParameterError):
        # valid only together with another choice: then it is not what the scenario has now
        return []


def _is_whole(plan: Comparison, one: Range, first: Mapping[str, tuple[object, ...]]) -> bool:
    """Whether the field takes whole numbers alone:
    one that is none, between the ends, is refused.
    """
    if not (one.low.is_integer() and one.high.is_integer()):
        return False
    try:
        controllers(changed(plan, axes={**first, one.path: (one.low + 0.5,)}, seeds=None))
    except ScenarioError:
        return True
    return False


def _value_at(scenario: Scenario, path: str) -> object:
    """The value of a field; of a block for which a number may stand, such as a constant gain, that
    number.
    """
    value: Any = scenario
    for part in path.split("."):
        value = getattr(value, part, None)
    numbers = [room.number for room in registries_of(type(value)) if room.number]
    return next((getattr(value, name) for kind, name in numbers if value.kind == kind), value)


# Trials of a search: their settings, what their runs gave, and which of two is better.
RECORD = "trials.json"


@dataclass(frozen=True)
class Trial:
    """A setting, and what its runs gave.

    Attributes:
        number: from 0 on; None for the scenario as it is, where that is no trial. values: by dotted
            path.
        outcomes: how each run ended. reached: whether it reached the goal.
        found: the metric of each run in its display unit, NaN where it has none.
        refused: why the scenario does not take the setting; "" where it does.
    """

    number: int | None
    values: dict[str, object]
    outcomes: tuple[str, ...] = ()
    reached: tuple[bool, ...] = ()
    found: tuple[float, ...] = ()
    refused: str = ""

    @classmethod
    def of(
        cls,
        number: int | None,
        values: Mapping[str, object],
        summaries: Sequence[Mapping[str, Any]],
        metric: Metric,
    ) -> Trial:
        """The trial with the summaries of its runs."""
        numbers = (one.get(metric.name) for one in summaries)
        found = tuple(
            math.nan if not isinstance(x, int | float) else x * metric.scale for x in numbers
        )
        return cls(
            number,
            dict(values),
            tuple(s["outcome"] for s in summaries),
            tuple(bool(s["success"]) for s in summaries),
            found,
        )

    @property
    def failed(self) -> int:
        """Runs that did not reach the goal."""
        return len(self.reached) - sum(self.reached)

    @property
    def mean(self) -> float:
        """Mean of the metric over the runs that reached the goal; NaN where none has it."""
        known = [
            x for x, good in zip(self.found, self.reached, strict=True) if good and math.isfinite(x)
        ]
        return sum(known) / len(known) if known else math.nan

    def rank(self, higher: bool) -> tuple[float, float]:
        """Less is better: first the failed runs, then the mean of the metric. A failure outweighs
        any number.
        """
        mean = -self.mean if higher else self.mean
        return (
            math.inf if self.refused else self.failed,
            mean if math.isfinite(mean) else math.inf,
        )

    def score(self, higher: bool, runs: int) -> float:
        """`rank` as one number, for a search that only orders them: the failed runs, and the mean
        squeezed into 0 to 1 by x / (1 + |x|).
        """
        failed, mean = self.rank(higher)
        squeezed = 1.0 if math.isinf(mean) else 0.5 + 0.5 * mean / (1 + abs(mean))
        return min(failed, runs + 1) + squeezed


def best_of(trials: Sequence[Trial], higher: bool) -> Trial | None:
    """The best trial, of equal ones the first; None where no run of any reached the goal."""
    ranked = min(trials, key=lambda trial: trial.rank(higher), default=None)
    return ranked if ranked is not None and any(ranked.reached) else None


def write_record(folder: Path, settings: Sequence[Mapping[str, object]]) -> None:
    """Write the settings of all trials so far: before their runs begin, so that an interrupted
    search goes on with the same.
    """
    write_json(
        folder / RECORD,
        [{"number": i, "values": dict(values)} for i, values in enumerate(settings)],
    )


def read_record(folder: Path, paths: Sequence[str]) -> list[dict[str, object]]:
    """The settings of the trials so far; none where there is no record. Raises RunFolderError: it
    is damaged.
    """
    path, works = folder / RECORD, "start again in a new folder"
    if not path.exists():
        return []
    try:
        found = [one["values"] for one in json.loads(read_file(path, works))]
    except (ValueError, TypeError, KeyError, RecursionError) as error:
        raise RunFolderError(path, f"is damaged ({error})", works) from None
    if any(set(values) != set(paths) for values in found):
        raise RunFolderError(path, "has settings of other fields than tuning.yaml varies", works)
    return found


# Which settings to try next: a tree-structured Parzen estimator (optuna).
#
# Reference: Bergstra et al. 2011, Algorithms for hyper-parameter optimization, NeurIPS.
STARTUP = 8  # trials that are drawn at random before the estimator has anything to go by
# attempts at a setting that was not tried yet: by the estimator, then at random as well
GUIDED, ATTEMPTS = 10, 200


def must_be_installed() -> Any:
    """Import optuna, and keep its log to itself.
    Raises EnvironmentLackError: it is not installed.
    """
    try:
        import optuna
    except ImportError:
        raise EnvironmentLackError(
            "optuna, which chooses the settings to try, is not installed",
            "pip install 'vstestbed[tune]'",
        ) from None
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    return optuna


def next_settings(
    space: SearchSpace, trials: Sequence[Trial], higher: bool, runs: int, size: int, seed: int
) -> list[dict[str, object]]:
    """Settings to try next, each different from all before; fewer than `size` where the space has
    no more.

    They depend on the finished trials and the seed alone, and not on how often a search was
    interrupted, or by how many workers it runs.

    space: what is varied. trials: the finished ones. higher: whether more of the metric is better.
    runs: of a trial. size: how many. seed: of the search.
    """
    settings: list[dict[str, object]] = []
    if not trials and space.now is not None:
        settings.append(space.now)
    study = _study(space, trials, higher, runs, seed, len(trials))
    tried = {_key(space, trial.values) for trial in trials} | {
        _key(space, values) for values in settings
    }
    random = np.random.default_rng((seed, len(trials)))
    for attempt in range(ATTEMPTS * size):
        if len(settings) == size or len(tried) >= space.size:
            break
        values = _asked(study, space) if attempt < GUIDED * size else _drawn(space, random)
        if (key := _key(space, values)) not in tried:
            tried.add(key)
            settings.append(values)
    return settings


def _study(
    space: SearchSpace, trials: Sequence[Trial], higher: bool, runs: int, seed: int, place: int
) -> optuna.Study:
    """A study with the finished trials, whose sampler begins with a seed of its own at each place
    of the search.
    """
    optuna = must_be_installed()
    own = int(np.random.SeedSequence((seed, place)).generate_state(1)[0])
    # a liar: settings chosen together count as bad while they are not known, and so keep apart
    sampler = optuna.samplers.TPESampler(seed=own, n_startup_trials=STARTUP, constant_liar=True)
    study, distributions = optuna.create_study(sampler=sampler), _distributions(space)
    for trial in trials:
        params = {p.path: _told(p, trial.values[p.path]) for p in space.parameters}
        study.add_trial(
            optuna.trial.create_trial(
                params=params, distributions=distributions, value=trial.score(higher, runs)
            )
        )
    return study


def _distributions(space: SearchSpace) -> dict[str, Any]:
    from optuna.distributions import CategoricalDistribution, FloatDistribution, IntDistribution

    found: dict[str, Any] = {}
    for p in space.parameters:
        if isinstance(p, Choice):
            found[p.path] = CategoricalDistribution(p.words)
        else:
            found[p.path] = (
                IntDistribution(int(p.low), int(p.high), p.log)
                if p.whole
                else FloatDistribution(p.low, p.high, p.log)
            )
    return found


def _told(p: Parameter, value: object) -> Any:
    """A value as optuna knows it: choices by their words."""
    return flow_text(value) if isinstance(p, Choice) else value


def _asked(study: optuna.Study, space: SearchSpace) -> dict[str, object]:
    params = study.ask(_distributions(space)).params
    return {
        p.path: p.chosen(params[p.path]) if isinstance(p, Choice) else p.rounded(params[p.path])
        for p in space.parameters
    }


def _drawn(space: SearchSpace, random: np.random.Generator) -> dict[str, object]:
    def of(p: Parameter) -> object:
        return (
            p.values[random.integers(len(p.values))]
            if isinstance(p, Choice)
            else p.rounded(p.at(random.random()))
        )

    return {p.path: of(p) for p in space.parameters}


def _key(space: SearchSpace, values: dict[str, object]) -> tuple[object, ...]:
    return tuple(_told(p, values[p.path]) for p in space.parameters)
