"""M-estimators: weights by which least squares leaves outliers out."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

Robust = Literal["none", "huber", "tukey"]
HUBER, TUKEY = 1.345, 4.685
"""Tuning constants with which either has 95 % of the efficiency of least squares on Gaussian errors."""
TO_SIGMA = 1.4826
"""Standard deviation over the median absolute deviation, of Gaussian errors."""
LEAST_SIGMA = 5.0
"""Least scale of grey levels, which are whole numbers: of errors that are nearly all 0, the median would make an outlier of each 1."""
SAMPLE = 20_000
"""Errors of which the median is taken, evenly spread over all: of 300,000 the whole partition would cost as much as the law."""


def scale(e: NDArray[np.float32]) -> float:
    """The standard deviation of most of the errors e (n,): TO_SIGMA times the median of |e - median(e)|, at least LEAST_SIGMA."""
    some = e[:: max(1, len(e) // SAMPLE)]
    return max(TO_SIGMA * float(np.median(np.abs(some - np.median(some)))), LEAST_SIGMA) if len(some) else LEAST_SIGMA


def weights(kind: Robust, e: NDArray[np.float32]) -> NDArray[np.float32] | None:
    """Weights (n,) of errors e (n,), with the scale of `scale`; None where all are 1.

    Huber: 1 up to c sigma, c sigma / |e| beyond. Tukey: (1 - (e / (c sigma))^2)^2 up to c sigma, 0 beyond.

    References: Huber 1981, Robust Statistics; for visual servoing Comport, Marchand & Chaumette 2006, doi:10.1109/TSMCB.2005.855568.
    """
    if kind == "none":
        return None
    bound = np.float32((HUBER if kind == "huber" else TUKEY) * scale(e))
    if kind == "huber":
        return np.asarray(bound / np.maximum(np.abs(e), bound), np.float32)
    ratio = np.minimum(np.square(e / bound), np.float32(1))
    return np.square(np.float32(1) - ratio)
