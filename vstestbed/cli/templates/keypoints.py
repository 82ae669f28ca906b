"""The local features my_keypoints, which describe the key points of a picture.

    pytest my_keypoints.py
    vstestbed run camera_keypoints --plugin my_keypoints.py --set detector.features=my_keypoints

They are corners of brightness, described by the patch round each, turned to its own direction. A
learned network loads its weights once, in a function with `functools.lru_cache`. One that matches
two pictures by itself has `match(goal_image, image)` in place of `extract`, and returns
`(uv_goal, uv, distance)`: pixels (M, 2) in both, and how unlike each pair is (M,).
"""

from typing import Annotated, Literal

import cv2
import numpy as np
from annotated_types import Ge, Le

import vstestbed as vs
import vstestbed.testing

x = np.stack(np.meshgrid(np.arange(-8, 9), np.arange(-8, 9)), axis=-1).reshape(-1, 2)
# the pixels (P, 2) whose brightness has its centre in a corner's direction
DISC = x[np.linalg.norm(x, axis=1) < 8.5]
# where it is described [px]
GRID = np.stack(np.meshgrid(np.linspace(-12, 12, 9), np.linspace(-12, 12, 9)), axis=-1).reshape(
    -1, 2
)


@vs.KEYPOINTS.add
@vs.spec
class MyKeypoints:
    """Corners of the largest smaller eigenvalue of the gradients' products; 81 differences of
    brightness each.

    Args:
        most: number of key points [1].
    """

    kind: Literal["my_keypoints"] = "my_keypoints"  # its word in a scenario
    most: Annotated[int, Ge(10), Le(5000)] = 600

    def extract(self, image):
        """Pixels uv (M, 2) and descriptors (M, D) of a picture (H, W, 3) uint8 RGB; the first
        pixel's centre is (0, 0).

        Descriptors of floats are compared by their Euclidean distance, those of type uint8 by their
        bits.
        """
        grey = cv2.GaussianBlur(
            cv2.cvtColor(image, cv2.COLOR_RGB2GRAY).astype(np.float32), (0, 0), 1.5
        )
        corners = cv2.goodFeaturesToTrack(grey, self.most, 0.01, 5)
        uv = np.empty((0, 2)) if corners is None else corners[:, 0].astype(float)
        weight = self.read(grey, uv[:, None] + DISC)
        # of the centre of brightness (M,)
        angle = np.arctan2(weight @ DISC[:, 1], weight @ DISC[:, 0])
        R = np.moveaxis(
            np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]), 2, 0
        )
        described = self.read(grey, uv[:, None] + GRID @ R.mT)
        described = described - described.mean(axis=1, keepdims=True)
        return uv, described / np.maximum(np.linalg.norm(described, axis=1, keepdims=True), 1e-6)

    def read(self, grey, uv):
        """Brightness (M, P) at the pixels next to uv (M, P, 2)."""
        u, v = np.moveaxis(
            np.clip(np.rint(uv).astype(int), 0, [grey.shape[1] - 1, grey.shape[0] - 1]), 2, 0
        )
        return grey[v, u]


def test_my_keypoints():
    """Two pictures, one turned by 8 degrees, are matched in place."""
    vstestbed.testing.check_keypoints(MyKeypoints())
