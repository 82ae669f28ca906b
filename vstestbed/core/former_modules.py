"""Modules by the names that they had once: scripts and other packages go on importing them.

It imports next to nothing: `import vstestbed` comes by here.
"""

from __future__ import annotations

import sys
from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from importlib.machinery import ModuleSpec
    from types import ModuleType

APPS = "vstestbed.apps"
FORMER = {
    "vstestbed.env": "vstestbed.apps.learn.environments",
    "vstestbed.live": "vstestbed.apps.live",
    "vstestbed.report.export": "vstestbed.apps.export",
    "vstestbed.report.export.source": "vstestbed.report.recorded_run",
    "vstestbed.report.scores": "vstestbed.apps.suite.scores",
    "vstestbed.ros": "vstestbed.apps.ros",
    "vstestbed.sim.render.warp": "vstestbed.apps.gpu.warp",
    "vstestbed.studies.basin": "vstestbed.apps.maps.basin",
    "vstestbed.studies.bench": "vstestbed.apps.bench.bench",
    "vstestbed.studies.calibration": "vstestbed.apps.calibrate.calibration",
    "vstestbed.studies.convergence": "vstestbed.apps.maps.convergence",
    "vstestbed.studies.delay": "vstestbed.apps.maps.delay",
    "vstestbed.studies.hand_eye": "vstestbed.apps.calibrate.hand_eye",
    "vstestbed.studies.identification": "vstestbed.apps.identify.identification",
    "vstestbed.studies.search_space": "vstestbed.apps.tune.search_space",
    "vstestbed.studies.submission": "vstestbed.apps.suite.submission",
    "vstestbed.studies.suite": "vstestbed.apps.suite.suite",
    "vstestbed.studies.together": "vstestbed.apps.gpu.together",
    "vstestbed.studies.tuned": "vstestbed.apps.tune.tuned",
    "vstestbed.studies.tuning": "vstestbed.apps.tune.tuning",
    "vstestbed.tasks.monitors": "vstestbed.endings.monitors",
    "vstestbed.testing.grading": "vstestbed.apps.course.grading",
}
"""Names of modules once, under which scripts import them, and where they are now."""

FORMER_PACKAGES = {
    "vstestbed.env": "vstestbed.apps.learn",
    "vstestbed.live": "vstestbed.apps.live",
    "vstestbed.report.export": "vstestbed.apps.export",
    "vstestbed.ros": "vstestbed.apps.ros",
}
"""Packages of which every part moved."""


def now_at(name: str) -> str | None:
    """Where a module of a former name is today; None where the name is none."""
    if not name.startswith("vstestbed."):
        return None
    if name in FORMER:
        return FORMER[name]
    package, _, part = name.rpartition(".")
    if package in FORMER_PACKAGES:
        return f"{FORMER_PACKAGES[package]}.{part}"
    return None


def imported(module: str, asked: str) -> ModuleType:
    """A module, maybe of an app. asked: what is asked for, in the user's words.

    Raises:
        ModuleNotFoundError: there is no such module, or its app is missing, in a sentence.
    """
    try:
        return import_module(module)
    except ModuleNotFoundError as error:
        if not module.startswith(f"{APPS}.") or not f"{module}.".startswith(f"{error.name}."):
            raise
        app = module.removeprefix(f"{APPS}.").partition(".")[0]
        if error.name not in (APPS, f"{APPS}.{app}"):
            raise
        raise ModuleNotFoundError(app_is_missing(asked, app), name=module) from None


def app_is_missing(what: str, app: str) -> str:
    """The sentence for what belongs to an app that is not there."""
    return f"{what} is of the app {app}, which is not in this installation of vstestbed"


class FormerModules:
    """Finds a module by its former name: the same module, not a second one. It is a finder and a
    loader by what it does: their base classes would triple the time of `import vstestbed`.
    """

    def __init__(self):
        self._specs: dict[str, ModuleSpec | None] = {}

    def find_spec(
        self, fullname: str, path: object = None, target: object = None
    ) -> ModuleSpec | None:
        """The spec of a former name; None of any other."""
        if now_at(fullname) is None:
            return None
        from importlib.machinery import ModuleSpec

        return ModuleSpec(fullname, self)  # pyright: ignore[reportArgumentType] - a loader all the same

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        """The module as it is today. Raises ModuleNotFoundError: its app is missing."""
        module = imported(now_at(spec.name) or spec.name, spec.name)
        self._specs[spec.name] = module.__spec__
        return module

    def exec_module(self, module: ModuleType) -> None:
        """Nothing runs a second time. The import has given the module another spec: back to it."""
        assert module.__spec__ is not None, "the import system gives it one"
        module.__spec__ = self._specs.pop(module.__spec__.name)


def know_former_modules() -> None:
    """Let modules be imported by the names that they had once."""
    if not any(type(finder).__name__ == FormerModules.__name__ for finder in sys.meta_path):
        sys.meta_path.insert(0, FormerModules())  # pyright: ignore[reportArgumentType] - as above
