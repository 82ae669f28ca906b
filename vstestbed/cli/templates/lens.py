"""The lens my_lens, by the picture's radius as a function of the angle from the optical axis.

    pytest my_lens.py
    vstestbed run arm_fisheye --plugin my_lens.py --set camera.kind=my_lens

The lens is stereographic: m(theta) = 2 tan(theta / 2), u = f m cos(phi) + cx, v = f m sin(phi) +
cy. A lens without this symmetry derives from `vs.Camera` and has `project` and `ray`; its pictures
are rendered by them alone.
"""

import math
from typing import Literal

import numpy as np

import vstestbed as vs
import vstestbed.testing
from vstestbed.camera import Radial


@vs.CAMERAS.add
@vs.spec
class MyLens(Radial):
    """m(theta) = 2 tan(theta / 2); `Radial` has size, rate, mount and focal length, by default such
    that the picture is filled.

    Args:
        fov_deg: full field of view [deg].
    """

    kind: Literal["my_lens"] = "my_lens"  # its word in a scenario
    fov_deg: float = 180.0

    @property
    def reach(self):
        """Smallest and largest angle from the axis that the lens sees [rad]."""
        return 0.0, math.radians(self.fov_deg) / 2

    def radius(self, theta):
        """M (...) in focal lengths of angles theta (...) within the reach [rad]."""
        return 2 * np.tan(theta / 2)

    def angle(self, radius):
        """The inverse: theta (...) [rad] of m (...)."""
        return 2 * np.arctan(radius / 2)


def test_my_lens():
    """From pixels to rays and back, and what is rendered is detected where it projects."""
    vstestbed.testing.check_camera(MyLens())
