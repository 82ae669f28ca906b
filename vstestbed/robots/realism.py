"""Presets of a robot's imperfections (`robot.realism`): sets of effects that are otherwise switched on one by one."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, ClassVar, Literal

from annotated_types import Len

from vstestbed.core.errors import ParameterError
from vstestbed.core.spec import spec

Level = Literal["none", "lab", "field"]


@spec
class Realistic:
    """A robot with imperfections. Each is a block of its own, None where it is not given.

    A subclass names in `presets` which blocks a level fills; a block that is given keeps its own values, also those that switch it off.

    Args:
        realism: imperfections of the blocks that are not given: `none`, those of a well-kept robot in a `lab`, or those of one in the
            `field`, worn and badly calibrated; e.g. `lab`.
        without: blocks that the preset leaves out, for the effect of each of them alone; e.g. `[gears]`.
    """

    realism: Level = "none"
    without: Annotated[tuple[str, ...], Len(0, 20)] = ()
    presets: ClassVar[Mapping[Level, Mapping[str, object]]] = {}

    def __post_init__(self) -> None:
        """Fill the blocks that the preset has; so the scenario as run states each of them.

        Raises:
            ParameterError: a block is left out that the preset has not.
        """
        preset = self.presets.get(self.realism, {})
        if unknown := [name for name in self.without if name not in preset]:
            has = f"has {', '.join(preset)}" if preset else "fills none here"
            raise ParameterError("without", f"must be blocks of `realism: {self.realism}`, which {has}", unknown[0])
        for name, value in preset.items():
            if getattr(self, name) is None and name not in self.without:
                object.__setattr__(self, name, value)  # frozen, yet still under construction
