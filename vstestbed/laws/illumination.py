"""A lamp that changed since the goal's picture was taken: gain and offset of the grey levels.

Near the goal they are fitted together with the camera's motion. Far from it the fit takes errors of the motion for the light's, since the
columns of both look alike in small pictures that show different parts of a scene; there the two pictures get the same mean and contrast.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from vstestbed.core.geometry import Array

Light = Literal["same", "gain_offset"]
LEAST_SPREAD = 1e-3
"""Least standard deviation of a picture, by which one without any structure is divided [grey levels]."""


def light_rows(goal: NDArray[np.float32]) -> NDArray[np.float32]:
    """Derivatives (2, n) of I = (1 + a) I* + b by gain a and offset b, of the goal's grey levels I* (n,)."""
    return np.stack([goal, np.ones_like(goal)])


def without_light(e: NDArray[np.float32], of_light: NDArray[np.float32], w: NDArray[np.float32] | None) -> NDArray[np.float32]:
    """Errors e (n,) without what gain and offset explain of them, in the weighted least-squares sense."""
    weighted = of_light if w is None else of_light * w
    H, b = weighted @ of_light.T, weighted @ e
    found = np.asarray(np.linalg.lstsq(H.astype(float), b.astype(float), rcond=1e-9)[0], np.float32)
    return np.asarray(e - found @ of_light, np.float32)


def relit(grey: NDArray[np.float32], goal: NDArray[np.float32]) -> NDArray[np.float32]:
    """A picture with the mean and the standard deviation of the goal's, (I - m) s* / s + m*; both of the same shape [grey levels]."""
    spread = max(float(grey.std()), LEAST_SPREAD)
    return np.asarray((grey - grey.mean()) * np.float32(goal.std() / spread) + goal.mean(), np.float32)


def eliminated(H: Array, b: Array) -> tuple[Array, Array]:
    """Normal equations (6, 6) and (6,) of the motion alone, of those (8, 8) and (8,) of motion, gain and offset.

    The Schur complement H_mm - H_ml H_ll^-1 H_lm: the motion that solves it is that of the whole system.
    """
    of_light = np.linalg.lstsq(H[6:, 6:], np.column_stack([H[6:, :6], b[6:]]), rcond=1e-9)[0]
    return H[:6, :6] - H[:6, 6:] @ of_light[:, :6], b[:6] - H[:6, 6:] @ of_light[:, 6]
