"""Targets: what a camera looks at, what its markers look like, how it moves."""

from vstestbed.core.spec import OneOf
from vstestbed.targets.base import Pad, Target
from vstestbed.targets.ground_lines import GroundLines
from vstestbed.targets.points import Points, Square

TARGETS = OneOf("target", Square, Points, GroundLines)

__all__ = ["TARGETS", "GroundLines", "Pad", "Points", "Square", "Target"]
