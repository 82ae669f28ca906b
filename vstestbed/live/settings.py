"""The settings of a live run: a scenario and what was changed of it, checked as `--set` is."""

from __future__ import annotations

import copy
import functools
import typing
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

from vstestbed.core.errors import Mistake, ScenarioError, nearest, short
from vstestbed.core.files import write_whole
from vstestbed.core.folders import file_word, numbered
from vstestbed.core.mapping import to_mapping
from vstestbed.core.named_files import FILE_FIELDS
from vstestbed.core.registry import ROOMS, SPECS, fields_of
from vstestbed.scenario.catalogue import hint_of
from vstestbed.scenario.dump import dump
from vstestbed.scenario.load import load
from vstestbed.scenario.plugins import absolute_files
from vstestbed.scenario.scenario import Scenario
from vstestbed.scenario.yaml_marks import from_option
from vstestbed.targets.picture_file import TEXTURE, textures

SEED = "seed"
"""The setting that draws start and noise as `--seed` does; None for the scenario's own start."""
DISTORTION = "camera.distortion"
TEXTS = {"name", "description", "plugins"}
"""Blocks whose texts are none of the words that other fields may have."""


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
        given: dict[str, Any] = to_mapping(self.scenario)
        self._given = frozenset(text for block, value in given.items() if block not in TEXTS for _, text in _texts(value, block))

    def change(self, path: str, value: object) -> Scenario:
        """Set a field, and load the scenario again; what is refused changes nothing.

        Args:
            path: dotted, such as `law.gain`. value: as YAML would read it; a bare word for a block of that kind.

        Raises:
            ScenarioError: all mistakes that the new value makes, as `--set` tells them; a text in it that may name a file.
        """
        self._refuse_new_texts(path, value)
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

    def _refuse_new_texts(self, path: str, value: object) -> None:
        """Refuse a text that is neither a word of vstestbed or of its plugins, nor in the scenario that the command line named.

        So a page can name no file, and run no code, that the command line did not name, whichever field it is in, also of a plugin.
        """
        if path.split(".")[0] == "plugins":
            raise ScenarioError([Mistake("page", path, "can be given on the command line alone (--plugin)")])
        found = absolute_files({path: value}, Path.cwd())[path]  # as the scenario has the names of files
        block = path.rpartition(".")[2]
        for (key, text), (_, told) in zip(_texts(found, block), _texts(value, block), strict=True):
            known = self._given | (_textures() if key in FILE_FIELDS else _words())
            if text not in known:
                hint = nearest(text, filter(str.isidentifier, known))
                if not hint.startswith("did you mean"):
                    hint = f"files and new names are given on the command line alone (--set {path}=...)"
                raise ScenarioError([Mistake("page", path, f"{short(told)} is no word of this scenario; {hint}")])

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


def _texts(value: object, key: str) -> Iterator[tuple[str, str]]:
    """All texts in plain values, each with its field, and what else is neither a number nor a truth value as the text for it."""
    if isinstance(value, Mapping):
        for name, inner in value.items():
            yield from _texts(inner, name)
    elif isinstance(value, list | tuple):
        for inner in value:
            yield from _texts(inner, key)
    elif value is not None and not isinstance(value, bool | int | float):
        yield key, str(value)


def _textures() -> frozenset[str]:
    """The bundled textures, which every scenario may name."""
    return frozenset(f"{TEXTURE}{name}" for name in textures())


def _words() -> frozenset[str]:
    """The kinds, and the words between which a field has the choice."""
    return _words_with(sum(len(room.members) for room in ROOMS), len(SPECS))


@functools.lru_cache(maxsize=1)
def _words_with(kinds: int, specs: int) -> frozenset[str]:
    """Those of so many kinds and specs: a plugin adds some."""
    choices = {word for cls in SPECS for field in fields_of(cls) for word in _choices(hint_of(cls, field))}
    return frozenset(choices | {kind for room in ROOMS for kind in room.members})


def _choices(hint: Any) -> Iterator[str]:
    """The words of the choices in a type."""
    if typing.get_origin(hint) is Literal:
        yield from filter(lambda word: isinstance(word, str), typing.get_args(hint))
    else:
        for inner in typing.get_args(hint):
            yield from _choices(inner)
