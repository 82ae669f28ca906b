"""Apps: tools on experiments. The kernel runs, films, reports and compares experiments; whatever
works on them stands in an app, and nothing below knows it.

A bundled app is a folder of `vstestbed/apps`, with its description `APP` in `__init__.py`. Another
package offers one by an entry point of the group `vstestbed.apps`, which names an `App` of its own:

    [project.entry-points."vstestbed.apps"]
    lighthouse = "lighthouse.vs:APP"
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

GROUP = "vstestbed.apps"
Places = Mapping[str, str]
"""By a word where what it stands for is: `package.module:name`, imported when it is asked for."""


@dataclass(frozen=True)
class App:
    """What an app adds to the program, each by its word.

    Args:
        commands: of the command line: functions with the parameters that typer reads.
        executors: of `--executor`: functions (workers, folder, flown) -> pool, as
            `studies.pools.pool_of` describes them.
        exports: of `export --to`: functions that write recorded runs, as `apps.export` calls them.
        reports: functions (folder, plugins) -> page that write the page of a folder again, by the
            file that tells whose folder it is.
        records: functions (path, scenario, words of `--remap`) -> table that read what a robot did
            and told, for `identify`, by the ending of a file, or the file that a folder holds.
    """

    commands: Places = field(default_factory=dict[str, str])
    executors: Places = field(default_factory=dict[str, str])
    exports: Places = field(default_factory=dict[str, str])
    reports: Places = field(default_factory=dict[str, str])
    records: Places = field(default_factory=dict[str, str])


@cache
def bundled() -> dict[str, App]:
    """The apps of this package by name; none where the folder is not there."""
    import pkgutil

    folder = Path(__file__).parents[1] / "apps"
    names = [module.name for module in pkgutil.iter_modules([str(folder)])]
    return {name: import_module(f"{GROUP}.{name}").APP for name in names}


@cache
def installed() -> dict[str, App]:
    """The apps that other packages offer, by the names of their entry points.

    Raises:
        PluginError: one cannot be imported, or is no `App`.
    """
    from importlib.metadata import entry_points

    from vstestbed.core.errors import PluginError

    found: dict[str, App] = {}
    for point in entry_points(group=GROUP):
        try:
            app = point.load()
        except Exception as error:  # of any kind: it is the code of others
            raise PluginError(point.value, f"cannot be imported: {error}") from error
        if not isinstance(app, App):
            raise PluginError(point.value, "must be an App of vstestbed.core.apps")
        found[point.name] = app
    return found


def offered(what: str) -> dict[str, str]:
    """All words of one sort (`commands`) with their places; a bundled one is not replaced."""
    found: dict[str, str] = {}
    for app in (*installed().values(), *bundled().values()):
        found |= getattr(app, what)
    return found


def loaded(what: str, word: str) -> Any:
    """What a word of one sort (`commands`) stands for, imported; None where no app has it. Other
    packages are asked only for what no bundled app has: to find them takes longer than to run.
    """
    for apps in (bundled, installed):
        for app in apps().values():
            if place := getattr(app, what).get(word):
                module, _, name = place.partition(":")
                return getattr(import_module(module), name)
    return None
