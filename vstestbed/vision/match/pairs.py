"""Pairs of places that match in two pictures."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vstestbed.core.geometry import Array

Pairs = tuple[Array, Array]
"""Places (M, 2) in the goal's picture and in this one [px]."""


def among(uv: Array, others: Array) -> NDArray[np.bool_]:
    """Which of the points uv (M, 2) are among others (N, 2)."""
    return np.asarray((uv[:, None] == others).all(axis=2).any(axis=1))


def those(pairs: Pairs, which: NDArray[np.bool_], first: int) -> tuple[Pairs, int]:
    """The pairs for which `which` (M,) holds, and how many of the first ones are among them."""
    return (pairs[0][which], pairs[1][which]), int(np.count_nonzero(which[:first]))
