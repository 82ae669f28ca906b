"""The image feature my_feature, by its values s, its interaction matrix L and its error.

    pytest my_feature.py
    vstestbed run ibvs_book --plugin my_feature.py --set law.feature=my_feature

The feature is s = (atan x, atan y) of each marker, the angles [rad] at which it is seen to the
right and below the optical axis.
"""

from typing import ClassVar, Literal

import numpy as np

import vstestbed as vs
import vstestbed.testing


@vs.FEATURES.add
@vs.spec
class MyFeature(vs.Feature):
    """s = (atan x, atan y), s_dot = L v with L = L_point / (1 + x^2) and / (1 + y^2),
    row by row.
    """

    kind: Literal["my_feature"] = "my_feature"  # its word in a scenario
    inputs: ClassVar[tuple[str, ...]] = ("xy", "depth")  # of a wide lens: ("ray", "range")
    rows_per_marker: ClassVar[int] = 2  # 0 where the rows describe the markers as a whole
    least_markers: ClassVar[int] = 1

    def measure(self, xy):
        """S (..., 2N) of xy (..., N, 2), the normalised coordinates X/Z and Y/Z."""
        return np.arctan(xy).reshape(*xy.shape[:-2], -1)

    def interaction(self, xy, depth):
        """L (..., 2N, 6) of xy (..., N, 2) and depth (..., N) [m], for a camera twist (v, w) in its
        own frame.
        """
        slope = 1 / (1 + xy**2)  # the derivative of atan: the chain rule makes L of the points' L
        return slope.reshape(*xy.shape[:-2], -1, 1) * vs.features.Point().interaction(xy, depth)

    def error(self, s, s_star):
        """S - s*; an angle that may turn round belongs wrapped to (-pi, pi] here."""
        return s - s_star


def test_my_feature():
    """L is the derivative of the error over motions of the camera."""
    vstestbed.testing.check_feature(MyFeature())
