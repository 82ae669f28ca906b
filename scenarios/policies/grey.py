"""A policy of grey levels for the poster of `arm_photometric`; `tests/long/train_grey.py` made its
weights.

    u = GAIN (f(I) - f(I*)),  f: four convolutions of stride two with rectifiers, then two layers

f was trained so that f(I) - f(I*) is the rest of the way to the goal, as a twist of the camera [m,
rad], from small pictures alone. It is zero where the picture is the goal's, so that the end is
exact where the light is the same. It knows one poster and one goal.

The idea to learn the pose from two pictures: Bateux, Marchand, Leitner, Chaumette & Corke 2018,
doi:10.1109/ICRA.2018.8461068.
"""

from pathlib import Path

import numpy as np

GAIN = 2.0  # [1/s]
WEIGHTS = (
    dict(np.load(Path(__file__).with_suffix(".npz")))
    if Path(__file__).with_suffix(".npz").is_file()
    else {}
)


def grey(pixels):
    """Luminance (H, W) of RGB, less its mean and over its standard deviation: brightness and
    contrast of the whole picture do not count.
    """
    y = pixels @ np.array([0.299, 0.587, 0.114])
    return (y - y.mean()) / (y.std() + 1.0)


def convolved(x, w, b):
    """A convolution of stride two over channels (C, H, W), with a border of zeros, rectified; w (O,
    C, k, k).
    """
    k = w.shape[-1]
    x = np.pad(x, ((0, 0), (k // 2, k // 2), (k // 2, k // 2)))
    windows = np.lib.stride_tricks.sliding_window_view(x, (k, k), axis=(1, 2))[:, ::2, ::2]
    return np.maximum(np.einsum("chwij,ocij->ohw", windows, w, optimize=True) + b[:, None, None], 0)


class Grey:
    """One run of the policy."""

    def __init__(self):
        """Begin with the weights of the file beside this one."""
        self.w, self.goal, self.there = (
            {name: value.astype(np.float32) for name, value in WEIGHTS.items()},
            None,
            None,
        )

    def pose(self, pixels):
        """Features f (6,) of a picture (H, W, 3)."""
        x = grey(pixels)[None].astype(np.float32)
        for i in range(4):
            x = convolved(x, self.w[f"W{i}"], self.w[f"b{i}"])
        return self.w["W5"] @ np.maximum(self.w["W4"] @ x.ravel() + self.w["b4"], 0)

    def act(self, observation):
        """The action (6,), with an action of 1 for 1 m/s or 1 rad/s."""
        # a new array each frame
        if self.goal is None or not np.array_equal(observation["goal_pixels"], self.goal):
            self.goal, self.there = (
                observation["goal_pixels"],
                self.pose(observation["goal_pixels"]),
            )
        return GAIN * (self.pose(observation["pixels"]) - self.there)
