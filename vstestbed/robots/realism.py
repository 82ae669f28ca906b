"""Presets of a robot's imperfections (`robot.realism`): sets of effects that are otherwise switched on one by one."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Literal

from vstestbed.core.spec import spec

Level = Literal["none", "lab", "field"]


@spec
class Realistic:
    """A robot with imperfections. Each is a block of its own, None where it is not given.

    A subclass names in `presets` which blocks a level fills; a block that is given keeps its own values, also those that switch it off.

    Args:
        realism: imperfections of the blocks that are not given: `none`, those of a well-kept robot in a `lab`, or those of one in the
            `field`, worn and badly calibrated; e.g. `lab`.
    """

    realism: Level = "none"
    presets: ClassVar[Mapping[Level, Mapping[str, object]]] = {}

    def __post_init__(self) -> None:
        """Fill the blocks that the preset has; so the scenario as run states each of them."""
        for name, value in self.presets.get(self.realism, {}).items():
            if getattr(self, name) is None:
                object.__setattr__(self, name, value)  # frozen, yet still under construction
