"""What a shell offers after Tab: names of scenarios, comparisons and kinds, and the dotted paths of
`--set`.

It reads names of files and the bundled schema alone, since each Tab starts a process; kinds of
plugins are therefore missing. Names of metrics stand in neither, and take half a second.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

from vstestbed.core.named_files import bundled_comparisons, bundled_scenarios, folder

__all__ = ["asked", "experiments", "figures", "kinds", "paths", "scenarios"]

VARIABLE = "_VSTESTBED_COMPLETE"  # environment variable by which a shell's completion asks


def asked(arguments: Sequence[str]) -> bool:
    """Whether a shell asks for words, or a user for its completion: typer does either, and ends the
    process by itself.
    """
    return VARIABLE in os.environ or any(
        word.startswith(("--install-completion", "--show-completion")) for word in arguments
    )


def scenarios(incomplete: str) -> list[str]:
    """Names of bundled scenarios; where none fits, the shell offers files."""
    return [name for name in bundled_scenarios() if name.startswith(incomplete)]


def experiments(incomplete: str) -> list[str]:
    """Names of bundled scenarios and comparisons."""
    return scenarios(incomplete) + [
        name for name in bundled_comparisons() if name.startswith(incomplete)
    ]


def figures(incomplete: str) -> list[str]:
    """Names of the numbers of `summary.json` by which runs are compared."""
    from vstestbed.tasks.metrics import FIGURES, own_metrics

    return [name for name in (*FIGURES, *own_metrics()) if name.startswith(incomplete)]


def kinds(incomplete: str) -> list[str]:
    """Words that `describe` knows: kinds, the fields of a scenario, and after `camera.` the kinds
    and fields of that block.
    """
    whole = _schema()
    if "." in incomplete:
        words = _words_below(incomplete.rpartition(".")[0], whole)
    else:
        words = set(whole["properties"])
        for block in whole["$defs"].values():
            if "kind" in block["properties"]:
                words.add(block["properties"]["kind"]["const"])
    return sorted(word for word in words if word.startswith(incomplete))


def _words_below(owner: str, whole: dict[str, Any]) -> set[str]:
    """The kinds and fields of a block, each after its dotted path."""
    rules = [whole]
    for part in owner.split("."):
        rules = [child for name, child in _within(rules, whole) if name == part]
    return {
        f"{owner}.{rule['const'] if name == 'kind' else name}"
        for name, rule in _within(rules, whole)
    }


def paths(incomplete: str) -> list[str]:
    """Fields of a scenario of any kinds, by their dotted paths; what is in a block once its name
    stands there.
    """
    whole = _schema()
    *parts, last = incomplete.split(".")
    rules, prefix = [whole], "".join(f"{part}." for part in parts)
    for part in parts:
        rules = _begun(part, rules, whole).get(part, [])
    while True:
        found = _begun(last, rules, whole)
        rules = [child for same in found.values() for child in same]
        if len(found) != 1 or not any(_within(rules, whole)):
            return [prefix + name for name in found]
        # A single word would be taken as complete by the shell, which adds a space.
        prefix, last = f"{prefix}{next(iter(found))}.", ""


def _begun(
    begin: str, rules: Iterable[dict[str, Any]], whole: dict[str, Any]
) -> dict[str, list[dict[str, Any]]]:
    """The fields of these blocks whose names begin so, each with its rule in every block that has
    it.
    """
    found: dict[str, list[dict[str, Any]]] = {}
    for name, child in _within(rules, whole):
        if name.startswith(begin):
            found.setdefault(name, []).append(child)
    return found


def _within(
    rules: Iterable[dict[str, Any]], whole: dict[str, Any]
) -> Iterator[tuple[str, dict[str, Any]]]:
    for rule in rules:
        if "$ref" in rule:
            rule = whole["$defs"][rule["$ref"].rpartition("/")[2]]
        yield from rule.get("properties", {}).items()
        yield from _within(rule.get("anyOf", []), whole)


def _schema() -> dict[str, Any]:
    return json.loads((folder("scenarios") / "scenario.schema.json").read_text(encoding="utf-8"))
