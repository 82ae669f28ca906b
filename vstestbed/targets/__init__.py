"""Targets of the camera: their markers, their shape, their motion."""

from vstestbed.core.registry import Contract, Registry
from vstestbed.targets.base import Name, Pad, Points, Square, Target
from vstestbed.targets.ground_lines import GroundLines
from vstestbed.targets.mesh import MeshTarget
from vstestbed.targets.picture import PictureTarget
from vstestbed.targets.regions import Ball, Shape

TARGETS = Registry(
    "target",
    Square,
    Points,
    PictureTarget,
    MeshTarget,
    GroundLines,
    Shape,
    Ball,
    contract=Contract(Target, base=Target),
)

__all__ = [
    "TARGETS",
    "Ball",
    "GroundLines",
    "MeshTarget",
    "Name",
    "Pad",
    "PictureTarget",
    "Points",
    "Shape",
    "Square",
    "Target",
]
