"""Bootstrap resamples as numbers of draws, one matrix for all samples of a size: a statistic of all resamples is then a matrix product."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from vstestbed.core.geometry import Array


def draws(sizes: tuple[int, ...], resamples: int, seed: int) -> Array:
    """How often each value is drawn in each resample, shape (resamples, sum of sizes).

    Args:
        sizes: numbers of values of the strata, which follow each other; each is resampled by itself, with replacement.
        resamples: how many. seed: of the random numbers.

    Reference: Efron & Tibshirani 1993, ch. 6 (resampling vectors) and 8.4 (strata), doi:10.1201/9780429246593.
    """
    rng = np.random.default_rng(seed)
    row = np.arange(resamples)[:, None]
    parts = [
        np.bincount((rng.integers(0, n, (resamples, n), dtype=np.int32) + n * row).ravel(), minlength=resamples * n).reshape(resamples, n)
        for n in sizes
    ]
    return np.hstack(parts).astype(float)


@lru_cache(maxsize=4)
def remembered(sizes: tuple[int, ...], resamples: int, seed: int) -> Array:
    """As `draws`, kept, and therefore read-only."""
    found = draws(sizes, resamples, seed)
    found.setflags(write=False)
    return found
