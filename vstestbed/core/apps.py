"""Apps: tools on experiments. The kernel runs, films, reports and compares experiments; whatever
works on them stands in an app, and nothing below knows it.

A bundled app is a folder of `vstestbed/apps`, with its description `APP` in `__init__.py`. Another
package offers one by an entry point of the group `vstestbed.apps`, which names an `App` of its own:

    [project.entry-points."vstestbed.apps"]
    lighthouse = "lighthouse.vs:APP"
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from vstestbed.core.former_modules import app_is_missing

if TYPE_CHECKING:
    from vstestbed.core.errors import PluginError

__all__ = [
    "REMEDY",
    "WORDS",
    "App",
    "bundled",
    "installed",
    "left_out",
    "loaded",
    "must_be_complete",
    "must_be_here",
    "offered",
]

GROUP = "vstestbed.apps"
REMEDY = "mend the package that has it, or uninstall that"
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
            and what its sensors said, for `identify`, by the ending of a file, or by the file that
            a folder holds.
    """

    commands: Places = field(default_factory=dict[str, str])
    executors: Places = field(default_factory=dict[str, str])
    exports: Places = field(default_factory=dict[str, str])
    reports: Places = field(default_factory=dict[str, str])
    records: Places = field(default_factory=dict[str, str])


WORDS = {
    "commands": {
        "bench": "bench",
        "calibrate": "calibrate",
        "grade": "course",
        "export": "export",
        "excite": "identify",
        "identify": "identify",
        "live": "live",
        "basin": "maps",
        "gain-limit": "maps",
        "sweep": "maps",
        "ros": "ros",
        "replay": "ros",
        "suite": "suite",
        "submit": "suite",
        "tune": "tune",
    },
    "executors": {"warp": "gpu"},
    "reports": {"tuning.yaml": "tune"},
    "records": dict.fromkeys((".mcap", ".db3", "metadata.yaml"), "ros"),
}
"""The words of bundled apps with their apps, for a sentence where an app's folder is missing."""


@cache
def bundled() -> dict[str, App]:
    """The apps of this package by name; none where the folder is not there."""
    files = sorted((Path(__file__).parents[1] / "apps").glob("*/__init__.py"))
    names = [file.parent.name for file in files]
    return {name: import_module(f"{GROUP}.{name}").APP for name in names}


@cache
def _found() -> tuple[dict[str, App], dict[str, PluginError]]:
    """What other packages offer by the names of their entry points: apps, and what is none."""
    sound: dict[str, App] = {}
    broken: dict[str, PluginError] = {}
    if not _may_be_offered():
        return sound, broken
    from importlib.metadata import entry_points

    from vstestbed.core.errors import PluginError

    for point in entry_points(group=GROUP):
        try:
            app = point.load()
        except (Exception, SystemExit) as error:  # of any kind: it is the code of others
            broken[point.name] = _cannot_be_imported(point.value, error)
            continue
        if isinstance(app, App):
            sound[point.name] = app
        else:
            problem = f"must be an App of vstestbed.core.apps, not {type(app).__name__}"
            broken[point.name] = PluginError(point.value, problem, REMEDY)
    return sound, broken


def _may_be_offered() -> bool:
    """Whether a file of entry points on the path has the group's name. To import what reads them
    properly takes a tenth of the time of `vstestbed --help`.
    """
    for place in sys.path:
        for file in Path(place).glob("*-info/entry_points.txt"):
            if GROUP.encode() in file.read_bytes():
                return True
    return False


def _cannot_be_imported(place: str, error: BaseException) -> PluginError:
    from vstestbed.core.errors import PluginError

    found = f"cannot be imported: {type(error).__name__}: {error}"
    return PluginError(place, found, REMEDY)


def installed() -> dict[str, App]:
    """The apps that other packages offer, by the names of their entry points."""
    return _found()[0]


def left_out() -> dict[str, PluginError]:
    """What other packages offer and is no app, or cannot be imported: it keeps nobody from using
    the others.
    """
    return _found()[1]


def offered(what: str) -> dict[str, str]:
    """All words of one sort (`commands`) with their places; a bundled one is not replaced."""
    found: dict[str, str] = {}
    for app in (*bundled().values(), *installed().values()):
        for word, place in getattr(app, what).items():
            found.setdefault(word, place)
    return found


def loaded(what: str, word: str) -> Any:
    """What a word of one sort (`commands`) stands for, imported; None where no app has it. Other
    packages are asked only for what no bundled app has: to find them takes longer than to run.

    Raises:
        PluginError: the module of another package cannot be imported.
        EnvironmentLackError: it is of a bundled app whose folder is missing.
    """
    for app in bundled().values():
        if place := getattr(app, what).get(word):
            return _named(place)
    for app in installed().values():
        if place := getattr(app, what).get(word):
            try:
                return _named(place)
            except (Exception, SystemExit) as error:  # as above
                raise _cannot_be_imported(place, error) from error
    if name := WORDS.get(what, {}).get(word):
        must_be_here(name, word)
    return None


def must_be_here(name: str, word: str) -> None:
    """Refuse a word of a bundled app whose folder is missing. Raises EnvironmentLackError."""
    from vstestbed.core.errors import EnvironmentLackError

    if name not in bundled():
        raise EnvironmentLackError(app_is_missing(word, name), "install the whole of vstestbed")


def _named(place: str) -> Any:
    module, _, name = place.partition(":")
    return getattr(import_module(module), name)


def must_be_complete() -> None:
    """For who asks for a word that no app has: one that cannot be imported may have it. Raises
    PluginError: there is such an app.
    """
    for error in left_out().values():
        raise error
