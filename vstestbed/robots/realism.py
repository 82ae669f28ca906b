"""Presets of a robot's imperfections (`robot.realism`): sets of effects that are otherwise switched on one by one."""

from __future__ import annotations

import dataclasses
import typing
from collections.abc import Collection, Mapping
from typing import Any, ClassVar, Literal

from pydantic import model_validator
from pydantic_core import ArgsKwargs

from vstestbed.core.registry import to_mapping
from vstestbed.core.spec import spec
from vstestbed.effects.base import Further
from vstestbed.robots.defaults import RobotBase

Level = Literal["none", "lab", "field"]
LEVELS: tuple[Level, ...] = typing.get_args(Level)
NOTHING = object()
"""No value, also not None."""


@spec
class Realistic(RobotBase):
    """A robot with imperfections. Each is a block (or a number) of its own, None where it is off.

    A subclass names in `presets` what each level fills. What is given stays: None switches an effect off, and a mapping of some fields of a
    block has the other fields from the preset (an object of the block's class is whole). A robot states the level that has filled it, so
    that another `realism` over a run's scenario, or over a robot by `dataclasses.replace`, replaces what the former level had filled, and
    nothing else. This is told from the values alone: one that is equal to the former level's counts as filled by it, also where it is given
    in the same `replace` as another level.

    Args:
        effects: further imperfections, of kinds that plugins add; e.g. `[]`.
        realism: imperfections that are not given: `none`, those of a well-kept robot in a `lab`, or those of one in the `field`, worn and
            badly calibrated; e.g. `lab`.
        filled: the level whose values the scenario of a run states; another `realism` replaces them, so leave it out; e.g. `lab`.

    Attributes:
        presets: by level, the fields that it fills and their values.
    """

    effects: Further = ()
    realism: Level = "none"
    filled: Level | None = None
    presets: ClassVar[Mapping[Level, Mapping[str, object]]] = {}

    @model_validator(mode="before")
    @classmethod
    def _fill(cls, given: Any) -> Any:
        """What is given, from a file or in Python, with the preset's values for the rest."""
        values = dict(given.kwargs or {}) if isinstance(given, ArgsKwargs) else given
        if not isinstance(values, Mapping):
            return given  # a robot already
        level, former = values.get("realism", "none"), values.get("filled")
        if level not in LEVELS or former not in (None, *LEVELS):
            return given  # which is refused
        own: dict[str, Any] = dict(values) if former in (None, level) else cls.own_block(values)
        for name, preset in cls.presets.get(level, {}).items():
            own[name] = _completed(own[name], preset) if name in own else preset
        own["filled"] = level
        return ArgsKwargs((), own) if isinstance(given, ArgsKwargs) else own

    @classmethod
    def before_changes(cls, block: Mapping[str, Any], changes: Mapping[str, object]) -> dict[str, Any]:
        """The robot's block before the values of `changes` are put over it: without what another level had filled."""
        block = super().before_changes(block, changes)
        return block if changes.get("realism", block.get("filled")) == block.get("filled") else cls.own_block(block)

    @classmethod
    def own_block(cls, block: Mapping[str, Any]) -> dict[str, Any]:
        """The block without what the level in `filled` has given it: all of it where it states none."""
        if block.get("filled") not in LEVELS:
            return dict(block)
        former, samples = cls.presets.get(block["filled"], {}), {n: value for preset in cls.presets.values() for n, value in preset.items()}
        own = {name: value for name, value in block.items() if name != "filled"}  # in its order
        for name in samples.keys() & own.keys():
            drawn = {path.removeprefix(f"{name}.") for path in cls.drawn_fields}
            own[name] = _own_part(own[name], former.get(name), type(samples[name]), drawn)
        return {name: value for name, value in own.items() if value is not NOTHING}

    @property
    def preset_values(self) -> dict[str, object]:
        """The level's values of the fields that it fills, and the level itself."""
        return {**self.presets.get(self.realism, {}), "filled": self.realism}


def _own_part(value: Any, preset: object, cls: type, drawn: Collection[str]) -> Any:
    """A value without what the preset gave: of a block, of class `cls`, the fields that differ from the preset's, or from the defaults.

    NOTHING where all of it is the preset's; fields that are drawn are nobody's own.
    """
    fields = _fields(value)
    if fields is None:
        return NOTHING if value == preset else value
    base = _fields(preset) or _defaults(cls)
    kept = {name: one for name, one in fields.items() if name not in drawn and not (name in base and _same(one, base[name]))}
    return kept if kept or preset is None else NOTHING


def _completed(value: Any, preset: object) -> Any:
    """A mapping of some fields of a block, with the other ones of the preset; any other value as it is."""
    return {**(_fields(preset) or {}), **value} if isinstance(value, Mapping) else value


def _fields(value: Any) -> Mapping[str, Any] | None:
    """The fields of a block, which is an object or a mapping; None for anything else."""
    if isinstance(value, Mapping):
        return value
    return {f.name: getattr(value, f.name) for f in dataclasses.fields(value)} if dataclasses.is_dataclass(value) else None


def _defaults(cls: type) -> dict[str, Any]:
    """The defaults of a block's class."""
    return {f.name: f.default for f in dataclasses.fields(cls) if f.default is not dataclasses.MISSING}


def _same(one: Any, other: Any) -> bool:
    """Whether two values are the same in a file."""
    return to_mapping(one) == to_mapping(other)
