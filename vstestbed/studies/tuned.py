"""A fair comparison: each law of it is tuned with the same budget first, and then they are compared from starts that no search has seen."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from vstestbed.core.errors import ParameterError, ScenarioError
from vstestbed.core.files import file_word, make_folder
from vstestbed.core.named_files import bundled_comparisons, is_there
from vstestbed.scenario.dump import dump
from vstestbed.scenario.yaml_marks import plain_mapping, text_of
from vstestbed.studies.comparison import ComparisonTable, carry_out, prepared
from vstestbed.studies.comparison.plan import Comparison, changed, chosen
from vstestbed.studies.comparison.runs import OnDone
from vstestbed.studies.tuning import Listener, NoListener, TuningResult, begun, finished, planned


@dataclass(frozen=True)
class TunedLaw:
    """One law of a comparison: its name, the scenario with its settings, and what its search found.

    base, case: the place of the law in the comparison: a scenario, and a case of the axis that has the laws (None without one).
    left: why it was not tuned; "" of one that was. took_s: wall time of the search [s].
    """

    name: str
    base: str
    case: str | None
    result: TuningResult | None = None
    left: str = ""
    took_s: float = 0.0

    def words(self) -> str:
        """What was found, in a sentence."""
        if self.result is None:
            return f"{self.name} as it is ({self.left})"
        values = ", ".join(
            f"{path}={value:.4g}" if isinstance(value, float) else f"{path}={value}" for path, value in self.result.settings.items()
        )
        return f"{self.name} {values or 'as it is (no run reached the goal)'} ({self.took_s:.0f} s)"


def names_comparison(name: str | None) -> bool:
    """Whether a name is that of a comparison: bundled, or a file with `base`."""
    if name is None or name in bundled_comparisons():
        return name is not None
    return Path(name).suffix in (".yaml", ".yml") and is_there(Path(name)) and "base" in plain_mapping(text_of(Path(name)), name, "")[0]


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
    """Tune each law of a comparison in `out/tune/NAME`, and compare them with what was found in `out/comparison`.

    Every law has the same ranges and numbers of trials and starts. A law that does not have a varied field goes into the comparison as it
    is, and the report says so. Searches use seeds from 2,000,000,000 on, and comparisons those below, so that no start is in both.

    Args:
        name: of the comparison, or its file. vary, numbers: as of `tune`. settings: values by dotted path for all.
        listener: of the searches. on_done: called after each run of the comparison. say: what is being done.

    Raises: as of `tune` and `compare`; ParameterError: no law has the varied fields, or several axes vary the law.
    """
    comparison = chosen([name], settings or {}, {}, plugins)
    laws = list[TunedLaw]()
    for law, own in _laws(comparison):
        say(f"tuning {law.name}")
        began = time.perf_counter()
        try:
            plan = planned(law.base, vary, comparison.set | own, (*comparison.plugins, *plugins), **numbers)
            with begun(plan, out / "tune" / file_word(law.name)) as search:
                search.jobs, search.executor, search.listener = jobs, executor, listener or NoListener()
                laws.append(replace(law, result=finished(search), took_s=time.perf_counter() - began))
        except (ScenarioError, ParameterError) as error:
            laws.append(replace(law, left=str(error).splitlines()[0]))
    if all(law.result is None for law in laws):
        raise ParameterError("--vary", f"fits none of the laws: {laws[0].left}")
    tuned = _with_gains(comparison, laws, make_folder(out / "scenarios"))
    say("comparing")
    with prepared([], {}, out / "comparison", False, {}, (), False, requested=tuned) as (runner, plan):
        return carry_out(runner, plan, jobs, executor, on_done, say), laws


def _laws(comparison: Comparison) -> list[tuple[TunedLaw, dict[str, Any]]]:
    """Each law with its settings: a scenario, with a case of the axis that sets the law."""
    axes = [
        axis for axis, cases in comparison.cases.items() if any(path.split(".")[0] == "law" for case in cases.values() for path in case)
    ]
    if len(axes) > 1 or any(path.split(".")[0] == "law" for path in comparison.axes):
        raise ParameterError("SCENARIO", "varies the law in several axes, or in `axes`; give its laws as one axis of `cases`")
    found = []
    for base in comparison.base:
        if not axes:
            found.append((TunedLaw(Path(base).stem, base, None), {}))
        for case, block in comparison.cases[axes[0]].items() if axes else ():
            word = case if len(comparison.base) == 1 else f"{Path(base).stem} {case}"
            found.append((TunedLaw(word, base, case), dict(block)))
    return found


def _with_gains(comparison: Comparison, laws: Sequence[TunedLaw], folder: Path) -> Comparison:
    """The comparison with what the searches found: in its cases, or in scenarios of its own in a folder."""
    plan = next(law.result.plan for law in laws if law.result)
    ranges = ", ".join(f"{p.path}={p}" for p in plan.parameters)
    budget = f"Tuned before by {plan.shown.title.lower()}, each law with {plan.trials} trials from {plan.seeds or 1} starts"
    words = (
        f"{comparison.description} {budget} that are not among these: {ranges}. Found: {'; '.join(law.words() for law in laws)}.".strip()
    )
    if all(law.case is None for law in laws):
        base = tuple(_written(law, folder) for law in laws)
        return changed(comparison, base=base, description=words)
    axis = next(axis for axis, cases in comparison.cases.items() if laws[0].case in cases)
    if len(comparison.base) > 1:
        raise ParameterError("SCENARIO", "has several scenarios beside its cases of laws; tune one of them", list(comparison.base))
    cases = {law.case or "": comparison.cases[axis][law.case or ""] | (law.result.settings if law.result else {}) for law in laws}
    return changed(comparison, cases=comparison.cases | {axis: cases}, description=words)


def _written(law: TunedLaw, folder: Path) -> str:
    if law.result is None or law.result.best is None:
        return law.base
    path = folder / f"{file_word(law.name)}.yaml"
    dump(law.result.scenario, path)
    return str(path.absolute())
