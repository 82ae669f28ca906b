"""The settings of a live run: a scenario and what was changed of it, checked as `--set` is."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from vstestbed.core.errors import Mistake, ScenarioError
from vstestbed.core.files import write_whole
from vstestbed.core.folders import file_word, numbered
from vstestbed.scenario.dump import dump
from vstestbed.scenario.load import load
from vstestbed.scenario.scenario import Scenario
from vstestbed.scenario.yaml_marks import from_option

SEED = "seed"
"""The setting that draws start and noise as `--seed` does; None for the scenario's own start."""
DISTORTION = "camera.distortion"


class Settings:
    """A scenario and the settings that replace values of it.

    Args:
        name: path of a YAML file, or a bundled scenario's name. overrides: settings from the start, by dotted path.
        seed: as `--seed`. plugins: as `--plugin`.

    Attributes:
        scenario: with all settings in force. seed: in force.

    Raises:
        ScenarioError, PluginError: as `load`.
    """

    def __init__(
        self, name: str | Path, overrides: Mapping[str, object] | None = None, seed: int | None = None, plugins: Sequence[str] = ()
    ):
        self._name, self._plugins = name, tuple(plugins)
        self._overrides, self.seed = dict(overrides or {}), seed
        self.scenario = load(name, self._overrides, seed, from_option(self._overrides), self._plugins)

    def change(self, path: str, value: object) -> Scenario:
        """Set a field, and load the scenario again; what is refused changes nothing.

        Args:
            path: dotted, such as `law.gain`. value: as YAML would read it; a bare word for a block of that kind.

        Raises:
            ScenarioError: all mistakes that the new value makes, as `--set` tells them.
        """
        if path.split(".")[0] == "plugins":  # a page must not be able to run other code than the command line named
            raise ScenarioError([Mistake("page", path, "can be given on the command line alone (--plugin)")])
        overrides, seed = self._overrides, self.seed
        if path == SEED:
            seed = None if value is None else self._whole(value)
        else:
            path, value = self._whole_list(path, value)
            # what was set inside the old value, or round it, is gone; the last setting is applied last
            overrides = {p: v for p, v in overrides.items() if p != path and not p.startswith(f"{path}.")} | {path: value}
        scenario = load(self._name, overrides, seed, from_option(overrides), self._plugins)
        self._overrides, self.seed, self.scenario = overrides, seed, scenario
        return scenario

    def copy(self) -> Settings:
        """The same settings, which later changes leave alone."""
        return copy.copy(self)  # `change` replaces its parts, and writes into none

    def _whole(self, value: object) -> int:
        if not isinstance(value, int) or isinstance(value, bool) or value < 0:
            raise ScenarioError([Mistake("page", SEED, f"must be a whole number from 0 on, got {value!r}")])
        return value

    def _whole_list(self, path: str, value: object) -> tuple[str, object]:
        """A coefficient of a lens's distortion as a setting of all of them, since a lens without one has no list to change."""
        parent, _, item = path.rpartition(".")
        if parent != DISTORTION or not item.isdecimal():
            return path, value
        now: Any = getattr(self.scenario.camera, "distortion", None) or (0.0,) * 5
        return parent, [value if i == int(item) else k for i, k in enumerate(now)]

    def keep(self, note: str = "") -> Path:
        """Write the scenario that repeats these settings from the start, `runs/<scenario>/live/<number>/scenario.yaml`.

        note: joins the description, such as what was changed by hand meanwhile.

        Raises:
            OutputError, EnvironmentLackError: it cannot be written.
        """
        scenario = self.scenario
        if note:
            scenario = replace(scenario, description=f"{scenario.description} {note}".strip())
        path = numbered(Path("runs") / file_word(scenario.name) / "live") / "scenario.yaml"
        write_whole(path, dump(scenario, defaults=True))
        return path
