"""Laws or settings of them: a comparison ranks laws where all gains of each come from searches of
one budget, which its plan records.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from itertools import islice
from typing import Any

from vstestbed.core.named_files import bundled_comparisons
from vstestbed.report.marks import listed
from vstestbed.scenario.dump import flow_text
from vstestbed.scenario.yaml_marks import build
from vstestbed.studies.comparison.plan import Comparison, Tuned, Variant, Variants, changed

__all__ = [
    "gains_of",
    "is_gain",
    "law_axes",
    "laws_of",
    "ranges",
    "settings_of",
    "tunable",
    "world",
]

# laws of a comparison that are looked at, each of which takes a hundredth of a second to load
MOST = 500
MOST_REASONS = 4  # groups of laws that the sentence names
# settings for all laws that change nothing of the world in which they fly
UNCOMPARED = ("name", "description", "law", "metrics")


def of_law(paths: Iterable[str]) -> bool:
    """Whether one of some dotted paths is the law, or a field of it."""
    return any(path.split(".")[0] == "law" for path in paths)


def is_gain(path: str) -> bool:
    """Whether a dotted path is that of a gain: `law.gain`, `law.gain.at_zero`, `law.gain_z`,
    `law.k_rho`, `law.law.gain`.
    """
    return of_law([path]) and any(
        "gain" in part or part.startswith("k_") for part in path.split(".")
    )


def gains_of(law: Any) -> dict[str, float]:
    """Every gain of a law by its dotted path, also of the laws in it, without those that do nothing
    in this form of it (`Law.idle`).
    """
    return {
        path: value
        for path, value in _values(law).items()
        if is_gain(path) and type(value) in (int, float)
    }


def _values(part: Any, path: str = "law") -> dict[str, Any]:
    """Every scalar of a spec by its dotted path; a constant gain by the path of the gain, as people
    write it.
    """
    if is_dataclass(part):
        idle = getattr(part, "idle", ())
        part = {
            f.name: getattr(part, f.name) for f in fields(part) if f.init and f.name not in idle
        }
    elif isinstance(part, tuple):
        part = dict(enumerate(part))
    if not isinstance(part, Mapping):
        return {path.removesuffix(".value"): part}
    found = dict[str, Any]()
    for name, inner in part.items():
        found |= _values(inner, f"{path}.{name}")
    return found


def law_axes(comparison: Comparison) -> list[str]:
    """The cases and axes that set the law, or fields of it."""
    cases = [name for name, those in comparison.cases.items() if any(map(of_law, those.values()))]
    return [*cases, *(path for path in comparison.axes if of_law([path]))]


def tunable(comparison: Comparison) -> bool:
    """Whether its laws are one axis of `cases`, or its scenarios: `tune` searches for the gains of
    these.
    """
    return len(law_axes(comparison)) + (len(comparison.base) > 1) < 2 and not of_law(
        comparison.axes
    )


def laws_of(comparison: Comparison) -> dict[str, Variant]:
    """A controller with each law, by name: of its scenario, its case, or both; of all else that is
    varied the first alternative.
    """
    axes, found = law_axes(comparison), dict[str, Variant]()
    few = {path: values if path in axes else values[:1] for path, values in comparison.axes.items()}
    cases = {
        name: those if name in axes else _first(those) for name, those in comparison.cases.items()
    }
    for variant in islice(
        Variants(changed(comparison, axes=few, cases=cases, tasks=_first(comparison.tasks))), MOST
    ):
        words = [flow_text(variant.values[axis]).strip("{}'\"") for axis in axes]
        if len(comparison.base) > 1 or not axes:
            words.insert(0, _scenario(variant))
        found[" ".join(words)] = variant
    return found


def _first(alternatives: Mapping[str, Any]) -> dict[str, Any]:
    return dict(islice(alternatives.items(), 1))


def _scenario(variant: Variant) -> str:
    return variant.folder.split("/")[1]


def world(comparison: Comparison) -> dict[str, Any]:
    """What a comparison sets for all its laws."""
    return {
        path: value
        for path, value in comparison.set.items()
        if path.split(".")[0] not in UNCOMPARED
    }


def ranges(laws: Mapping[str, Variant]) -> dict[str, str]:
    """A range for each gain of any law, as `tune --vary` takes it: 0.3 to 8, or a quarter to four
    times one that is outside.
    """
    found = dict[str, str]()
    for variant in laws.values():
        for path, value in gains_of(variant.scenario.law).items():
            usual = "0.3:8:log" if 0.3 <= value <= 8 else f"{value / 4:g}:{4 * value:g}:log"
            found.setdefault(path, usual if value > 0 else f"{4 * value:g}:{value / 4:g}")
    return found


def settings_of(comparison: Comparison) -> str:
    """Why a comparison ranks settings, and which command makes them laws, in sentences; "" where it
    ranks laws, or all fly with one.
    """
    laws = laws_of(comparison)
    differ = _different([_values(variant.scenario.law) for variant in laws.values()])
    if all(map(is_gain, differ)):
        words = (
            f"one law flies with different {listed(differ)}."
            " A larger gain converges sooner by itself, until delay or limits stop it."
        )
        return f"These are settings, not laws: {words}".replace("law.", "") if differ else ""
    reasons = _reasons(comparison, laws)
    if not reasons:
        return ""
    without = [name for name, variant in laws.items() if not gains_of(variant.scenario.law)]
    reasons += [f"without a gain: {listed(without)}"] if without else []
    return f"These are settings, not laws: {'; '.join(reasons)}. {_remedy(comparison, laws)}"


def _different(each: Sequence[Mapping[str, Any]]) -> list[str]:
    """The paths whose values are not the same in all."""
    paths = dict.fromkeys(path for one in each for path in one)
    return [path for path in paths if any(one.get(path) != each[0].get(path) for one in each)]


def _reasons(comparison: Comparison, laws: Mapping[str, Variant]) -> list[str]:
    """What speaks against the laws, those together of which the same is said."""
    found = defaultdict[str, list[str]](list)
    for name, variant in laws.items():
        for words in dict.fromkeys(_against(comparison, name, variant)):
            found[words].append(name)
    said = [
        f"{listed(names)} {'fly' if len(names) > 1 else 'flies'} with {words}"
        for words, names in found.items()
    ]
    left = len(said) - MOST_REASONS
    if left <= 0:
        return said
    groups = "group" if left == 1 else "groups"
    return [*said[:MOST_REASONS], f"and {left} more such {groups} of laws"]


def _against(comparison: Comparison, name: str, variant: Variant) -> Iterator[str]:
    """What a law flies with that no search of the same budget as the others' has found."""
    law, record = variant.scenario.law, comparison.tuned.get(name)
    vary = record.vary if record else {}
    if left := [f"{path} {value:g}" for path, value in gains_of(law).items() if path not in vary]:
        yield f"{listed(left)}, for which none was tuned".replace("law.", "")
    if record is None:
        return
    now, then = {"law.kind": law.kind}, {"law.kind": record.law.get("kind")}
    if now == then:
        now = _values(law) | world(comparison) | {"scenario": _scenario(variant)}
        then = (
            _values(build(type(law), record.law, {}, "tuned"))
            | record.set
            | {"scenario": record.scenario}
        )
    for path in _different([now, then]):
        yield (
            f"{path} {flow_text(now.get(path))} in place of"
            f" {flow_text(then.get(path))}, as in the search"
        )
    yield from _unequal(record, comparison.tuned.values())


def _unequal(record: Tuned, others: Iterable[Tuned]) -> Iterator[str]:
    """The budget of a search, and its ranges, where those of others are not the same."""
    for other in others:
        if other.budget != record.budget:
            yield f"values of {record.budget}"
        for path, own in record.vary.items():
            if other.vary.get(path, own) != own:
                yield f"{path} of {own}"


def _remedy(comparison: Comparison, laws: Mapping[str, Variant]) -> str:
    """The command that tunes all gains of all laws."""
    if not tunable(comparison):
        return "`vstestbed tune` makes laws of those that are scenarios, or one axis of `cases`."
    # of an option its name
    files = {place.rsplit(":", 2)[0] for place in comparison.places.values()}
    bundled = {str(path): name for name, path in bundled_comparisons().items()}
    words = [
        bundled.get("".join(files), "comparison.yaml"),
        *(f"--vary {path}={own}" for path, own in ranges(laws).items()),
    ]
    return f"`vstestbed tune {' '.join(words)}` makes them laws."
