"""Local features by a small convolutional network, as a plugin:
`detector: {kind: keypoints, features: conv}`.

The network has fixed random filters, so that nothing needs to be downloaded; one with learned
weights goes to the same place. Random filters tell places apart well, but not under a rotation of
the picture: start within some 15 degrees of the goal.

    vstestbed run camera_keypoints --plugin tests/examples/conv_features.py --set
    detector.features=conv \\
        --set "robot.start.nominal={xyz: [0.1, 0.05, -0.7], rpy_deg: [3, -4, 8]}"
"""

from __future__ import annotations

from functools import lru_cache
from typing import Annotated, Literal

import cv2
import numpy as np
from annotated_types import Ge, Le
from numpy.typing import NDArray

import vstestbed as vs

CHANNELS, SIZE = 24, 7
CELLS = np.stack(np.meshgrid(np.arange(-2, 3), np.arange(-2, 3)), axis=-1).reshape(-1, 2) * 5
"""Places round a key point at which the network's output is read, (25, 2) [px]."""


@lru_cache
def filters(seed: int) -> NDArray[np.float32]:
    """The weights (CHANNELS, SIZE, SIZE): smooth noise without a mean. A learned network is loaded
    here, once.
    """
    noise = np.random.default_rng(seed).normal(size=(CHANNELS, SIZE, SIZE)).astype(np.float32)
    smooth = np.stack([cv2.GaussianBlur(one, (0, 0), 1.0) for one in noise])
    smooth -= smooth.mean(axis=(1, 2), keepdims=True)
    return smooth / np.linalg.norm(smooth, axis=(1, 2), keepdims=True)


@vs.KEYPOINTS.add
@vs.spec
class ConvFeatures:
    """Corners, each described by a layer of random convolutions, rectified and averaged, at 25
    places round it.

    Args:
        most: number of key points [1].
        seed: of the filters.
    """

    kind: Literal["conv"] = "conv"
    most: Annotated[int, Ge(10), Le(5000)] = 600
    seed: Annotated[int, Ge(0), Le(1000)] = 0

    def extract(self, image: NDArray[np.uint8]) -> tuple[NDArray[np.float64], NDArray[np.float32]]:
        """Pixels (M, 2) and descriptors (M, 600) of a picture (H, W, 3) RGB."""
        grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
        corners = cv2.goodFeaturesToTrack(grey, self.most, 0.01, 5)
        if corners is None:
            return np.empty((0, 2)), np.empty((0, CHANNELS * len(CELLS)), np.float32)
        uv = np.asarray(corners, dtype=float)[:, 0]
        layers = [
            cv2.blur(np.maximum(cv2.filter2D(grey.astype(np.float32), -1, f), 0), (5, 5))
            for f in filters(self.seed)
        ]
        at = np.clip(
            np.rint(uv[:, None] + CELLS).astype(int), 0, [grey.shape[1] - 1, grey.shape[0] - 1]
        )
        described = np.stack(layers, axis=-1)[at[..., 1], at[..., 0]].reshape(len(uv), -1)
        described = described - described.mean(axis=1, keepdims=True)
        return uv, described / np.maximum(np.linalg.norm(described, axis=1, keepdims=True), 1e-6)
