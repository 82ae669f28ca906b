"""In which fields of their scenarios the controllers of a comparison differ."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from vstestbed.core.errors import ScenarioError
from vstestbed.report.comparison.columns import ComparisonResults
from vstestbed.scenario.yaml_marks import plain_mapping

UNCOMPARED = ("name", "description", "seed", "plugins")
"""Fields that change nothing of an experiment, or differ between seeds."""
MISSING = object()
"""Stands for a field that a scenario does not have."""


def differing_fields(folder: Path, comparison: ComparisonResults) -> tuple[str, ...]:
    """Dotted names of the fields in which the controllers' scenarios differ, sorted; empty where one of them cannot be read.

    Args:
        folder: the comparison's folder. comparison: its results; the first run of each controller stands for all of its seeds.
    """
    return differing([folder / str(c.runs["folder"][0]) / "scenario.yaml" for c in comparison.controllers])


def differing(scenarios: Sequence[Path]) -> tuple[str, ...]:
    """Dotted names of the fields in which scenario files differ, sorted; empty where one of them cannot be read."""
    try:
        found = [dict(_flat(_scenario(path))) for path in scenarios]
    except (OSError, UnicodeError, ScenarioError):
        return ()
    names = {name for fields in found for name in fields if name.split(".")[0] not in UNCOMPARED}
    first = found[0]
    return tuple(sorted(n for n in names if any(fields.get(n, MISSING) != first.get(n, MISSING) for fields in found)))


def only_gains(fields: Sequence[str]) -> bool:
    """Whether all these fields are gains of the law: `law.gain`, `law.gain.at_zero`, `law.gain_z`, `law.k_rho`."""
    return bool(fields) and all(
        name.startswith("law.") and any("gain" in part or part.startswith("k_") for part in name.split(".")) for name in fields
    )


def gains_alone(fields: Sequence[str]) -> str:
    """The gains in which controllers differ that differ in nothing else, in words; "" for other controllers."""
    if not only_gains(fields):
        return ""
    names = list(dict.fromkeys(name.removesuffix(".value") for name in fields))  # a constant gain may be written as a number
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
