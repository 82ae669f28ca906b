"""Statistics of a dataset's features, by which LeRobot normalises: of each episode, and of all."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from vstestbed.camera import Image
from vstestbed.core.geometry import Array

Statistics = dict[str, NDArray[Any]]
"""min, max, mean, std, count, q01 ... q99 of a feature."""
QUANTILES = {"q01": 0.01, "q10": 0.10, "q50": 0.50, "q90": 0.90, "q99": 0.99}
SIDE_PX = 150
"""Pictures are counted on a grid of about so many pixels along their shorter side."""


def statistics(values: NDArray[Any]) -> Statistics:
    """Of a feature's values (frames, k): shape (k,) each."""
    x = values.astype(float)
    found = {"min": x.min(axis=0), "max": x.max(axis=0), "mean": x.mean(axis=0), "std": x.std(axis=0), "count": np.array([len(x)])}
    return found | {name: np.quantile(x, share, axis=0) for name, share in QUANTILES.items()}


def together(parts: list[Statistics]) -> Statistics:
    """Of several episodes; quantiles are the mean of the episodes', weighted by their frames, as LeRobot takes them."""
    counts = np.array([part["count"][0] for part in parts], dtype=float)
    weights = counts / counts.sum()

    def mean(name: str) -> Array:
        return np.tensordot(weights, np.array([part[name] for part in parts]), axes=1)

    square = np.tensordot(weights, np.array([part["std"] ** 2 + part["mean"] ** 2 for part in parts]), axes=1)
    found = {"min": np.min([part["min"] for part in parts], axis=0), "max": np.max([part["max"] for part in parts], axis=0)}
    found |= {"mean": mean("mean"), "std": np.sqrt(np.maximum(square - mean("mean") ** 2, 0.0)), "count": np.array([int(counts.sum())])}
    return found | {name: mean(name) for name in QUANTILES}


class PictureStatistics:
    """Of pictures as they pass, channel by channel, from how often each grey level occurs."""

    def __init__(self) -> None:
        self._counts = np.zeros((3, 256))
        self._pictures = 0

    def add(self, image: Image) -> None:
        """Count a picture (H, W, 3) uint8 RGB."""
        every = max(1, min(image.shape[:2]) // SIDE_PX)
        small = image[::every, ::every].reshape(-1, 3)
        self._counts += [np.bincount(small[:, i], minlength=256) for i in range(3)]
        self._pictures += 1

    def result(self) -> Statistics:
        """Of all so far, as shares of 255, shape (3, 1, 1) each."""
        share = self._counts / self._counts.sum(axis=1, keepdims=True)
        grey, upto = np.arange(256.0), share.cumsum(axis=1)
        mean = share @ grey
        found = {"min": (share > 0).argmax(axis=1), "max": 255 - (share[:, ::-1] > 0).argmax(axis=1), "mean": mean}
        found["std"] = np.sqrt(np.maximum(share @ grey**2 - mean**2, 0.0))
        found |= {name: (upto >= q - 1e-12).argmax(axis=1) for name, q in QUANTILES.items()}
        return {name: (value / 255).reshape(3, 1, 1) for name, value in found.items()} | {"count": np.array([self._pictures])}
