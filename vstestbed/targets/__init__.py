"""Targets of the camera: their markers, their shape, their motion."""

from vstestbed.core.contract import Contract
from vstestbed.core.spec import OneOf
from vstestbed.targets.base import Pad, Target, TargetContract
from vstestbed.targets.ground_lines import GroundLines
from vstestbed.targets.points import Points, Square

TARGETS = OneOf("target", Square, Points, GroundLines, contract=Contract(TargetContract, base=Target))

__all__ = ["TARGETS", "GroundLines", "Pad", "Points", "Square", "Target"]
