"""The list of targets: markers that form something, and lines on the floor."""

from __future__ import annotations

from vstestbed.core.spec import OneOf
from vstestbed.targets.base import Points, Square
from vstestbed.targets.ground_lines import GroundLines

TARGETS = OneOf("target", Square, Points, GroundLines)
