"""The marker of a region: the edge of the target's body."""

from __future__ import annotations

from typing import Literal

from vstestbed.core.spec import spec
from vstestbed.targets.markers import Flat


@spec
class Outline(Flat):
    """The edge of a region of one colour, which is the target's body: its points have no geoms of their own.

    Args:
        lit: whether the scene's lights shade the region; otherwise its colour is constant.
    """

    kind: Literal["outline"] = "outline"
    lit: bool = True

    @property
    def solid(self) -> None:
        """None: the target's body is drawn."""
        return None

    @property
    def radius(self) -> float:
        """A point of an outline has no extent [m]."""
        return 0.0

    def looks(self, count: int) -> str:
        """The region."""
        return "a region of the target's colour"

    def check_spacing(self, gap: float, count: int) -> None:
        """Nothing: the points of an outline may be as near as they like."""
