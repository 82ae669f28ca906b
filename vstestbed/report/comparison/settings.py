"""In which fields of their scenarios the controllers of a comparison differ."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

from vstestbed.core.errors import ScenarioError
from vstestbed.report.comparison.columns import ComparisonResults
from vstestbed.scenario.yaml_marks import plain_mapping

UNCOMPARED = ("name", "description", "seed", "plugins")
"""Fields that change nothing of an experiment, or differ between seeds."""
MISSING = object()
"""Stands for a field that a scenario does not have."""


def differing(scenarios: Sequence[Path]) -> tuple[str, ...]:
    """Dotted names of the fields in which scenario files differ, sorted; empty where one of them cannot be read."""
    try:
        return tuple(sorted(set[str]().union(*_from_first(scenarios))))
    except (OSError, UnicodeError, ScenarioError):
        return ()


def _from_first(scenarios: Iterable[Path]) -> Iterator[set[str]]:
    """The fields in which each scenario file differs from the first."""
    first: dict[str, object] | None = None
    for path in scenarios:
        fields = {name: value for name, value in _flat(_scenario(path)) if name.split(".")[0] not in UNCOMPARED}
        first = fields if first is None else first
        yield {name for name in first.keys() | fields.keys() if fields.get(name, MISSING) != first.get(name, MISSING)}


def only_gains(fields: Iterable[str]) -> bool:
    """Whether all these fields are gains of the law: `law.gain`, `law.gain.at_zero`, `law.gain_z`, `law.k_rho`."""
    names = list(fields)
    return bool(names) and all(
        name.startswith("law.") and any("gain" in part or part.startswith("k_") for part in name.split(".")) for name in names
    )


def gains_alone(folder: Path, comparison: ComparisonResults) -> str:
    """The gains in which controllers differ that differ in nothing else, in words; "" for others, or where a scenario cannot be read.

    The first run of each controller stands for all of its seeds. Reading ends at the first difference that is no gain: to read a scenario
    takes 50 ms.

    Args:
        folder: the comparison's folder. comparison: its results.
    """
    found: set[str] = set()
    try:
        for fields in _from_first(folder / str(c.runs["folder"][0]) / "scenario.yaml" for c in comparison.controllers):
            if fields and not only_gains(fields):
                return ""
            found |= fields
    except (OSError, UnicodeError, ScenarioError):
        return ""
    return in_words(found)


def in_words(gains: Iterable[str]) -> str:
    """Names of gains in a sentence: `law.gain and law.k_rho`."""
    names = list(dict.fromkeys(name.removesuffix(".value") for name in sorted(gains)))  # a constant gain may be written as a number
    return " and ".join(names) if len(names) < 3 else f"{', '.join(names[:-1])} and {names[-1]}"


def _scenario(path: Path) -> Any:
    return plain_mapping(path.read_text(encoding="utf-8"), str(path), "")[0]


def _flat(value: Any, name: str = "") -> Iterator[tuple[str, object]]:
    """Every scalar of nested mappings and lists with its dotted name."""
    if isinstance(value, dict | list) and value:
        for key, inner in value.items() if isinstance(value, dict) else enumerate(value):
            yield from _flat(inner, f"{name}.{key}" if name else str(key))
    else:
        yield name, value
