"""Points followed from one picture to the next, in place of matching each picture with the goal's."""

from __future__ import annotations

from typing import Annotated, Literal

import cv2
import numpy as np
from annotated_types import Ge, Le
from numpy.typing import NDArray

from vstestbed.core.geometry import Array
from vstestbed.core.quantity import PositivePixels
from vstestbed.core.spec import OneOf, spec

LEVELS = 3
"""Levels of the pyramid besides the picture itself: a window reaches 2^3 times as far."""


@spec
class NoTracking:
    """Every picture is matched with the goal's."""

    kind: Literal["none"] = "none"


@spec
class Klt:
    """Points are followed from picture to picture by pyramidal Lucas-Kanade, there and back again.

    Of every `redetect_every`-th picture, and where fewer than `keep` points are left, key points are matched with the goal's
    again: points that were followed stay, and empty rows are filled.

    Args:
        redetect_every: pictures from one matching with the goal's picture to the next [1].
        keep: points below which they are matched again at once [1]; none: half of the detector's `best`, but not under `least`;
            e.g. `12`.
        window_px: side of the window round each point [px].
        astray_px: largest distance of a point, followed there and back again, from where it was [px].

    References: Lucas & Kanade 1981; Bouguet 2000, Pyramidal implementation of the Lucas Kanade feature tracker; Kalal, Mikolajczyk &
    Matas 2010, doi:10.1109/ICPR.2010.675 (there and back again).
    """

    kind: Literal["klt"] = "klt"
    redetect_every: Annotated[int, Ge(1), Le(100_000)] = 10
    keep: Annotated[int, Ge(3), Le(200)] | None = None
    window_px: Annotated[int, Ge(5), Le(101)] = 21
    astray_px: PositivePixels = 0.5


TRACKS = OneOf("track", NoTracking, Klt, default="none")
Tracking = Annotated[NoTracking | Klt, TRACKS]


def followed(klt: Klt, before: NDArray[np.uint8], now: NDArray[np.uint8], uv: Array) -> Array:
    """Where points uv (K, 2) of the picture before are now (K, 2); NaN where they are lost, or were.

    Args:
        before, now: the pictures' brightness (H, W).
    """
    known = np.isfinite(uv).all(axis=1)
    out = np.full(uv.shape, np.nan)
    if not known.any():
        return out
    size, start = (klt.window_px, klt.window_px), uv[known].astype(np.float32)[:, None]
    there, found, _ = cv2.calcOpticalFlowPyrLK(before, now, start, start.copy(), winSize=size, maxLevel=LEVELS)
    # Back from where it began: a point that is another now does not stay there.
    back, returned, _ = cv2.calcOpticalFlowPyrLK(
        now, before, there, start.copy(), winSize=size, maxLevel=1, flags=cv2.OPTFLOW_USE_INITIAL_FLOW
    )
    aside = np.linalg.norm((back - start)[:, 0], axis=1)
    height, width = now.shape
    inside = ((there[:, 0] >= 0) & (there[:, 0] <= [width - 1, height - 1])).all(axis=1)
    kept = (found.ravel() > 0) & (returned.ravel() > 0) & (aside < klt.astray_px) & inside
    out[known] = np.where(kept[:, None], there[:, 0], np.nan)
    return out
