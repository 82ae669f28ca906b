"""A fair comparison: each law of it is tuned with the same budget first, and then they are compared
from starts that no search has seen.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from vstestbed.apps.tune.tuning import Listener, NoListener, TuningResult, begun, finished, planned
from vstestbed.core.errors import ParameterError, ScenarioError
from vstestbed.core.files import file_word, make_folder
from vstestbed.core.named_files import bundled_comparisons, is_there
from vstestbed.core.registry import to_mapping
from vstestbed.scenario.dump import dump
from vstestbed.scenario.yaml_marks import plain_mapping, text_of
from vstestbed.studies.comparison import ComparisonTable
from vstestbed.studies.comparison import begun as compared
from vstestbed.studies.comparison.plan import Comparison, Tuned, Variant, changed, chosen
from vstestbed.studies.comparison.runs import OnDone
from vstestbed.studies.comparison.tuning_record import (
    gains_of,
    is_gain,
    law_axes,
    laws_of,
    ranges,
    tunable,
    world,
)


@dataclass(frozen=True)
class TunedLaw:
    """One law of a comparison: its name, the scenario with its settings, and what its search found.

    base, case: the scenario, and what the law's case sets (None where the scenario alone is the
    law).
    left: why it was not tuned; "" of one that was. took_s: wall time of the search [s].
    """

    name: str
    base: str
    case: Mapping[str, Any] | None = None
    result: TuningResult | None = None
    left: str = ""
    took_s: float = 0.0

    def words(self) -> str:
        """What was found, in a sentence."""
        if self.result is None:
            return f"{self.name} as it is ({self.left})"
        values = ", ".join(
            f"{path}={value:.4g}" if isinstance(value, float) else f"{path}={value}"
            for path, value in self.result.settings.items()
        )
        return f"{self.name} {values or 'as it is (no run reached the goal)'} ({self.took_s:.0f} s)"


def names_comparison(name: str | None) -> bool:
    """Whether a name is that of a comparison: bundled, or a file with `base`."""
    if name is None or name in bundled_comparisons():
        return name is not None
    return (
        Path(name).suffix in (".yaml", ".yml")
        and is_there(Path(name))
        and "base" in plain_mapping(text_of(Path(name)), name, "")[0]
    )


def tune_comparison(
    name: str,
    vary: Mapping[str, str | Sequence[object]],
    out: Path,
    settings: Mapping[str, object] | None = None,
    plugins: Sequence[str] = (),
    jobs: int | None = None,
    executor: str = "local",
    listener: Listener | None = None,
    on_done: OnDone = lambda job, summary: None,
    say: Callable[[str], None] = lambda words: None,
    **numbers: Any,
) -> tuple[ComparisonTable, list[TunedLaw]]:
    """Tune each law of a comparison in `out/tune/NAME`, and compare them with what was found in
    `out/comparison`.

    Every law has the same ranges, of those gains that it has, and numbers of trials and starts. One
    without a varied field goes into the comparison as it is, and the report says so. Searches use
    seeds from 2,000,000,000 on, and comparisons those below, so that no start is in both. How each
    law was tuned is in the comparison's plan (`Comparison.tuned`).

    Args:
        name: of the comparison, or its file. vary, numbers: as of `tune`; without `vary` all gains
            of all laws (`ranges`).
        settings: values by dotted path for all.
        listener: of the searches. on_done: called after each run of the comparison. say: what is
            being done.

    Raises: as of `tune` and `compare`; ParameterError: no law has the varied fields, or several
    axes vary the law.
    """
    comparison = chosen([name], settings or {}, {}, plugins)
    flown = laws_of(comparison)
    laws: list[TunedLaw] = []
    for law in _laws(comparison):
        say(f"tuning {law.name}")
        began = time.perf_counter()
        own = _own(vary, flown, law.name)
        given = comparison.set | dict(law.case or {})
        try:
            plan = planned(law.base, own, given, (*comparison.plugins, *plugins), **numbers)
            with begun(plan, out / "tune" / file_word(law.name)) as search:
                search.jobs, search.executor = jobs, executor
                search.listener = listener or NoListener()
                result = finished(search)
            laws.append(replace(law, result=result, took_s=time.perf_counter() - began))
        except (ScenarioError, ParameterError) as error:
            laws.append(replace(law, left=str(error).splitlines()[0]))
    results = {law.name: law.result for law in laws if law.result is not None}
    if not results:
        raise ParameterError("--vary", f"fits none of the laws: {laws[0].left}")
    records = {word: _record(comparison, result) for word, result in results.items() if result.best}
    tuned = changed(_with_gains(comparison, laws, make_folder(out / "scenarios")), tuned=records)
    say("comparing")
    with compared(tuned, out / "comparison", film=False) as campaign:
        return campaign.carry_out(jobs, executor, on_done, say), laws


def _own(
    vary: Mapping[str, str | Sequence[object]], laws: Mapping[str, Variant], name: str
) -> Mapping[str, str | Sequence[object]]:
    """What is varied of a law: what is asked for, without the gains that it does not have; else all
    its gains.
    """
    gains, asked = gains_of(laws[name].scenario.law), vary or ranges(laws)
    return {
        path: given for path, given in asked.items() if path in gains or not is_gain(path)
    } or asked


def _laws(comparison: Comparison) -> list[TunedLaw]:
    """The cases of the axis that sets the law, or without one the scenarios."""
    if not tunable(comparison):
        words = (
            "varies the law in several axes, in `axes`, or beside several scenarios;"
            " give its laws as one axis of `cases`"
        )
        raise ParameterError("SCENARIO", words)
    if axes := law_axes(comparison):
        return [
            TunedLaw(name, comparison.base[0], case)
            for name, case in comparison.cases[axes[0]].items()
        ]
    return [TunedLaw(file_word(Path(base).stem), base) for base in comparison.base]


def _with_gains(comparison: Comparison, laws: Sequence[TunedLaw], folder: Path) -> Comparison:
    """The comparison with what the searches found: in its cases, or in scenarios of its own in a
    folder.
    """
    plans = [law.result.plan for law in laws if law.result]
    plan = max(plans, key=lambda plan: len(plan.vary))
    between = ", ".join(f"{p.path}={p}" for p in plan.parameters)
    budget = (
        f"Tuned before by {plan.shown.title.lower()},"
        f" each law with {plan.trials} trials from {plan.seeds or 1} starts"
    )
    words = (
        f"{comparison.description} {budget} that are not among these: {between}."
        f" Found: {'; '.join(law.words() for law in laws)}.".strip()
    )
    axes = law_axes(comparison)
    if not axes:
        base = tuple(_written(law, folder) for law in laws)
        return changed(comparison, base=base, description=words)
    cases = {law.name: _case(law) for law in laws}
    return changed(comparison, cases=comparison.cases | {axes[0]: cases}, description=words)


def _case(law: TunedLaw) -> dict[str, Any]:
    """A law's case with what its search has found."""
    return dict(law.case or {}) | (law.result.settings if law.result else {})


def _record(comparison: Comparison, result: TuningResult) -> Tuned:
    """How a law was tuned."""
    plan, law = result.plan, to_mapping(result.scenario.law)
    budget = {"metric": plan.metric, "trials": plan.trials, "seeds": plan.seeds}
    return Tuned(
        law=law,
        scenario=file_word(Path(plan.scenario).stem),
        set=world(comparison),
        vary=plan.vary,
        **budget,
    )


def _written(law: TunedLaw, folder: Path) -> str:
    if law.result is None or law.result.best is None:
        return law.base
    path = folder / f"{file_word(law.name)}.yaml"
    dump(law.result.scenario, path)
    return str(path.absolute())
