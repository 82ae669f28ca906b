"""pinv(A) b, the one way in which laws turn feature errors into motion."""

from __future__ import annotations

import numpy as np

from vstestbed.geometry import Array

PINV_RCOND = 1e-6
"""Cut-off of the pseudo-inverse: singular values under this share of the largest count as zero:
a direction that pixels do not tell is not moved in."""


def least_squares(A: Array, b: Array) -> Array:
    """The shortest x (n,) that minimises |A x - b|, for A (m, n) and b (m,)."""
    return np.asarray(np.linalg.lstsq(A, b, rcond=PINV_RCOND)[0], dtype=float)
