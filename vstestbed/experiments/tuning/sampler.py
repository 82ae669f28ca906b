"""Which settings to try next: a tree-structured Parzen estimator (optuna).

Reference: Bergstra et al. 2011, Algorithms for hyper-parameter optimization, NeurIPS.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from vstestbed.core.errors import EnvironmentLackError
from vstestbed.experiments.tuning.space import Choice, Parameter, SearchSpace
from vstestbed.experiments.tuning.trials import Trial
from vstestbed.scenario.dump import flow_text

if TYPE_CHECKING:
    import optuna

STARTUP = 8
"""Trials that are drawn at random before the estimator has anything to go by."""
GUIDED, ATTEMPTS = 10, 200
"""Attempts at a setting that was not tried yet: by the estimator, then at random as well."""


def must_be_installed() -> Any:
    """Import optuna, and keep its log to itself.

    Raises:
        EnvironmentLackError: it is not installed.
    """
    try:
        import optuna
    except ImportError:
        raise EnvironmentLackError("optuna, which chooses the settings to try, is not installed", "pip install 'vstestbed[tune]'") from None
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    return optuna


def next_settings(space: SearchSpace, trials: Sequence[Trial], higher: bool, runs: int, size: int, seed: int) -> list[dict[str, object]]:
    """Settings to try next, each different from all before; fewer than `size` where the space has no more.

    They depend on the finished trials and the seed alone, and not on how often a search was interrupted, or by how many workers it runs.

    Args:
        space: what is varied. trials: the finished ones. higher: whether more of the metric is better. runs: of a trial.
        size: how many. seed: of the search.
    """
    settings: list[dict[str, object]] = []
    if not trials and space.now is not None:
        settings.append(space.now)
    study = _study(space, trials, higher, runs, seed, len(trials))
    tried = {_key(space, trial.values) for trial in trials} | {_key(space, values) for values in settings}
    random = np.random.default_rng((seed, len(trials)))
    for attempt in range(ATTEMPTS * size):
        if len(settings) == size or len(tried) >= space.size:
            break
        values = _asked(study, space) if attempt < GUIDED * size else _drawn(space, random)
        if (key := _key(space, values)) not in tried:
            tried.add(key)
            settings.append(values)
    return settings


def _study(space: SearchSpace, trials: Sequence[Trial], higher: bool, runs: int, seed: int, place: int) -> optuna.Study:
    """A study with the finished trials, whose sampler begins with a seed of its own at each place of the search."""
    optuna = must_be_installed()
    own = int(np.random.SeedSequence((seed, place)).generate_state(1)[0])
    # a liar: settings chosen together count as bad while they are not known, and so keep apart
    sampler = optuna.samplers.TPESampler(seed=own, n_startup_trials=STARTUP, constant_liar=True)
    study, distributions = optuna.create_study(sampler=sampler), _distributions(space)
    for trial in trials:
        params = {p.path: _told(p, trial.values[p.path]) for p in space.parameters}
        study.add_trial(optuna.trial.create_trial(params=params, distributions=distributions, value=trial.score(higher, runs)))
    return study


def _distributions(space: SearchSpace) -> dict[str, Any]:
    from optuna.distributions import CategoricalDistribution, FloatDistribution, IntDistribution

    found: dict[str, Any] = {}
    for p in space.parameters:
        if isinstance(p, Choice):
            found[p.path] = CategoricalDistribution(p.words)
        else:
            found[p.path] = IntDistribution(int(p.low), int(p.high), p.log) if p.whole else FloatDistribution(p.low, p.high, p.log)
    return found


def _told(p: Parameter, value: object) -> Any:
    """A value as optuna knows it: choices by their words."""
    return flow_text(value) if isinstance(p, Choice) else value


def _asked(study: optuna.Study, space: SearchSpace) -> dict[str, object]:
    params = study.ask(_distributions(space)).params
    return {
        p.path: p.values[p.words.index(params[p.path])] if isinstance(p, Choice) else p.rounded(params[p.path]) for p in space.parameters
    }


def _drawn(space: SearchSpace, random: np.random.Generator) -> dict[str, object]:
    """Settings drawn evenly from the space."""
    values: dict[str, object] = {}
    for p in space.parameters:
        if isinstance(p, Choice):
            values[p.path] = p.values[random.integers(len(p.values))]
        else:
            values[p.path] = p.rounded(p.at(random.random()))
    return values


def _key(space: SearchSpace, values: dict[str, object]) -> tuple[object, ...]:
    return tuple(_told(p, values[p.path]) for p in space.parameters)
