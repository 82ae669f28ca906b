"""The list of targets: markers that form something, and lines on the floor."""

from __future__ import annotations

from vstestbed.ground_lines import GroundLines
from vstestbed.spec import OneOf
from vstestbed.target import Points, Square

TARGETS = OneOf("target", Square, Points, GroundLines)
