"""Presets of a robot's imperfections (`robot.realism`): sets of effects that are otherwise switched
on one by one.
"""

from __future__ import annotations

import dataclasses
import typing
from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import model_validator
from pydantic_core import ArgsKwargs

from vstestbed.core.errors import ParameterError
from vstestbed.core.named_files import named_file
from vstestbed.core.plain_yaml import plain_documents
from vstestbed.core.registry import brief_mapping
from vstestbed.core.spec import OrText, spec
from vstestbed.effects.base import Further
from vstestbed.robots.base import Robot

Level = Literal["none", "lab", "field"]
Presets = Mapping[
    Level, Mapping[str, object]
]  # by level, the fields that it fills and their values
LEVELS: tuple[Level, ...] = typing.get_args(Level)
MOST_PRESET = 100_000  # bytes of a preset's file, as of a scenario


def _preset_in(file: str) -> dict[str, Any]:
    """The fields of a robot in a file. ParameterError: it is not there, or holds no mapping."""
    works = "fields of the robot, such as drive_lag_s: 0.05"
    with named_file("realism", file, works, MOST_PRESET) as path:
        documents = plain_documents(path.read_text(encoding="utf-8-sig"))
        if len(documents) != 1 or not isinstance(documents[0], dict) or "kind" in documents[0]:
            raise ValueError("it is no block of imperfections")
    return documents[0]


@spec
class Realistic(Robot):
    """A robot with imperfections. Each is a block (or a number) of its own, None where it is off.

    A subclass names in `presets` what each level fills when a robot is made. What is given stays:
    None switches an effect off, and a mapping of some fields of a block has the other fields from
    the preset (an object of the block's class is whole). `dataclasses.replace` gives every field,
    so that a level in it fills nothing: `at_level` makes the same robot at another level.

    Args:
        effects: further imperfections, of kinds that plugins add; e.g. `[]`.
        realism: imperfections that are not given: `none`, those of a well-kept robot in a `lab`, or
            those of one in the `field`, worn and badly calibrated; or the name of a file with them,
            such as `vstestbed identify` writes it, which is read with the scenario; e.g. `lab`.

    Attributes:
        presets: by level, the fields that it fills and their values.
    """

    effects: Further = ()
    realism: Annotated[Level, OrText()] = "none"
    presets: ClassVar[Presets] = {}

    @model_validator(mode="before")
    @classmethod
    def _fill(cls, given: Any) -> Any:
        """What is given, from a file or in Python, with the preset's values for the rest."""
        in_python = isinstance(given, ArgsKwargs)
        values = (given.kwargs or {}) if in_python else given
        if not isinstance(values, Mapping):
            return given  # a robot already
        level: Level = values.get("realism", "none")
        if isinstance(level, str) and level.lower().endswith((".yaml", ".yml")):
            own = {**_preset_in(level), **values, "realism": "none"}
        elif level not in LEVELS:
            return given  # which is refused
        else:
            if in_python:
                cls._refuse_another_level(level, values)
            own = cls._completed(level, values)
        return ArgsKwargs((), own) if in_python else own

    @classmethod
    def _completed(cls, level: Level, values: Mapping[str, Any]) -> dict[str, Any]:
        """The values with a level's preset for the rest. ParameterError: it has none."""
        if level != "none" and level not in cls.presets:
            words = (
                f"fills nothing: {cls.__name__} has no preset of that name;"
                " works: none, and single effects"
            )
            raise ParameterError("realism", words, level)
        own = dict(values)
        for name, preset in cls.presets.get(level, {}).items():
            value = own.setdefault(name, preset)
            # some fields of a block: the others are the preset's
            if isinstance(value, Mapping) and dataclasses.is_dataclass(preset):
                whole = {f.name: getattr(preset, f.name) for f in dataclasses.fields(preset)}
                own[name] = {**whole, **value}
        return own

    @classmethod
    def _refuse_another_level(cls, level: Level, values: Mapping[str, Any]) -> None:
        """Refuse a level whose effects are all given, with the values of another level: it would
        fill nothing.
        """
        for other in LEVELS:
            filled = cls._filled(other)
            given = all(name in values and values[name] == filled[name] for name in filled)
            if given and filled != cls._filled(level):
                words = (
                    f"fills nothing here, where every effect is given as at {other};"
                    f" works: robot.at_level({level!r})"
                )
                raise ParameterError("realism", words, level)

    @classmethod
    def _filled(cls, level: Level) -> dict[str, object]:
        """The values at a level of all fields that some level fills."""
        every: dict[str, object] = {}
        for preset in cls.presets.values():
            every |= dict.fromkeys(preset)
        return {**every, **cls.presets.get(level, {})}

    @property
    def preset_values(self) -> dict[str, object]:
        """Its level's values of the fields that some level fills."""
        return self._filled(self.realism)

    def at_level(self, level: Level) -> Self:
        """The same robot at another level, which fills anew what this one's level has filled; what
        differs from that stays.
        """
        block: Any = brief_mapping(self)
        if not isinstance(block, Mapping):  # its word alone: all is default
            block = {}
        return type(self)(**{**block, "realism": level})
