"""The target my_target, by the places of its markers.

    pytest my_target.py
    vstestbed run ibvs_book --plugin my_target.py --set target.kind=my_target

It is a regular polygon of markers. `vs.Target` has its pose, marker, motion and pad.
"""

from functools import cached_property
from typing import Annotated, ClassVar, Literal

import numpy as np
from annotated_types import Ge, Gt, Le

import vstestbed as vs
import vstestbed.testing


@vs.TARGETS.add
@vs.spec
class MyTarget(vs.Target):
    """Markers at the corners of a regular polygon in z = 0, whose first corner lies on the x axis.

    Args:
        corners: number of corners [1].
        side: length of an edge [m].
    """

    kind: Literal["my_target"] = "my_target"  # its word in a scenario
    corners: Annotated[int, Ge(3), Le(12)] = 5
    side: Annotated[float, Gt(0)] = 0.4
    one_sided: ClassVar[bool] = (
        True  # its markers are seen from the front only: a camera behind its plane has lost it
    )

    def __post_init__(self):
        """Refuse markers that overlap."""
        self._check_markers()

    @cached_property
    def points(self):
        """Marker centres (N, 3) [m] in the target's frame, whose z axis points away from a camera
        that faces it.
        """
        angle = 2 * np.pi * np.arange(self.corners) / self.corners
        radius = self.side / (2 * np.sin(np.pi / self.corners))
        return radius * np.column_stack([np.cos(angle), np.sin(angle), np.zeros(self.corners)])


def test_my_target():
    """Its markers are where it says, also in the compiled scene."""
    pose = {"xyz": (0, 0, 1)}
    vstestbed.testing.check_target(MyTarget(pose=pose))  # pyright: ignore[reportArgumentType] - a mapping becomes the block
