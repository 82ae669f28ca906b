"""What `list` prints: the words of registries and of bundled files."""

from __future__ import annotations

from collections.abc import Sequence

import typer

from vstestbed.core.fields import class_text
from vstestbed.core.named_files import bundled_comparisons, bundled_scenarios
from vstestbed.scenario.plugins import load_plugins, registry
from vstestbed.scenario.yaml_marks import bundled_mapping

__all__ = ["show"]


def show(names: Sequence[str], plugins: Sequence[str]) -> None:
    """Print the words of one registry, or of several, each under its name."""
    load_plugins(plugins)
    if len(names) == 1:
        _show_one(names[0], "")
        return
    for name in names:
        typer.echo(f"{name}:")
        _show_one(name, "  ")


def _show_one(name: str, indent: str) -> None:
    """The words of a registry, or of bundled files, a line each."""
    entries = _entries(name)
    if not entries:
        words = "none; those of the package are blocks of robots (vstestbed describe puma560)"
        typer.echo(f"{indent}{words}")
        return
    width = max(map(len, entries))
    for word, text in entries.items():
        typer.echo(f"{indent}{word:{width}}  {text}")


def _entries(name: str) -> dict[str, str]:
    """The words of a registry, or of bundled files, and what they are."""
    bundled = {"scenarios": bundled_scenarios, "comparisons": bundled_comparisons}.get(name)
    if bundled is None:
        return {word: class_text(cls).summary for word, cls in registry(name).members.items()}
    # as they are written: an arm's file may be in a package that is not installed
    return {word: str(bundled_mapping(path)["description"]) for word, path in bundled().items()}
