"""A metric of how much of the start's error is left, for protocols that judge a run by it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, ClassVar, Literal

import numpy as np
from annotated_types import Gt, Le

from vstestbed.core.geometry import Array
from vstestbed.core.spec import spec
from vstestbed.tasks.base import Log
from vstestbed.tasks.setup import Setup

ERRORS = ("position_error_m", "rotation_error_rad")
QUATERNION = ("cam_qw", "cam_qx", "cam_qy", "cam_qz")
LEAST = 1e-6
"""A start nearer to its goal than this has no share [m, rad]."""


@spec
class StartShares:
    """Distance and angle from the goal at the end as shares of those at the start, by the truth, and the pictures that it took.

    `pictures_to_share` counts the pictures until both are under `share` for the rest of the run; `rotation_path_ratio` is the angle
    that the camera turned through over the angle at the start (of the path in space, `path_ratio` is the same).

    Args:
        share: of the start's distance and angle [1].
    """

    kind: Literal["start_shares"] = "start_shares"
    share: Annotated[float, Gt(0), Le(1)] = 0.1
    titles: ClassVar[Mapping[str, tuple[str, str]]] = {
        "position_share": ("Distance at the end over that at the start", ""),
        "rotation_share": ("Angle at the end over that at the start", ""),
        "pictures_to_share": ("Pictures until both are small for good", ""),
        "rotation_path_ratio": ("Angle turned through over that at the start", ""),
    }

    def part(self, setup: Setup) -> _StartShares:
        """Sums of turns."""
        return _StartShares(self.share)


class _StartShares:
    def __init__(self, share: float) -> None:
        self._share, self._start, self._last = share, np.full(2, np.nan), np.full(2, np.nan)
        self._quaternion: Array = np.empty((0, 4))
        self._turned, self._pictures, self._reached = 0.0, 0, 0

    def add(self, log: Log) -> None:
        """See `Part`."""
        errors = np.column_stack([log[name] for name in ERRORS])
        if not self._pictures:
            self._start = errors[0]
        over = np.flatnonzero((errors >= self._share * self._start).any(axis=1))
        if len(over):
            self._reached = self._pictures + int(over[-1]) + 1  # pictures that are not under it for good
        q = np.vstack([self._quaternion, np.column_stack([log[name] for name in QUATERNION])])
        cosine = np.abs(np.einsum("ij,ij->i", q[1:], q[:-1]))
        sine = np.sqrt(np.maximum(0, 1 - np.minimum(cosine, 1) ** 2))
        self._turned += float(2 * np.arctan2(sine, cosine).sum())
        self._pictures, self._quaternion, self._last = self._pictures + len(errors), q[-1:], errors[-1]

    def figures(self) -> dict[str, object]:
        """See `Part`."""
        known = bool((self._start > LEAST).all())
        if not known:  # also where the goal is no single pose
            return {**dict.fromkeys(StartShares.titles)}
        position, rotation = (self._last / self._start).tolist()
        reached = self._reached + 1 if self._reached < self._pictures else None
        return dict(zip(StartShares.titles, (position, rotation, reached, self._turned / float(self._start[1])), strict=True))
