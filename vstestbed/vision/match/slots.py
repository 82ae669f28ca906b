"""Rows for points that come and go: a fixed number, in which a point keeps its row as long as it is there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vstestbed.core.geometry import Array


@dataclass(frozen=True, slots=True)
class Slots:
    """K rows of points that are matched with the goal's picture.

    Attributes:
        uv_goal, uv: where each is in the goal's picture and in this one (K, 2) [px]; NaN in an empty row.
        ids: number of the point in each row (K,), -1 in an empty row; a point that comes to a row gets a new one.
        next_id: the next point's number.
    """

    uv_goal: Array
    uv: Array
    ids: NDArray[np.intp]
    next_id: int = 0

    @classmethod
    def empty(cls, rows: int) -> Slots:
        """No points yet."""
        return cls(np.full((rows, 2), np.nan), np.full((rows, 2), np.nan), np.full(rows, -1))

    @property
    def taken(self) -> NDArray[np.bool_]:
        """Which rows have a point (K,)."""
        return self.ids >= 0

    def placed(self, uv_goal: Array, uv: Array) -> Slots:
        """The rows with these M <= K points (M, 2) in place of the present ones: those that are there already, by their place in the

        goal's picture, keep their row and number; the others come into free rows in their order.
        """
        rows = {tuple(place): k for k, place in enumerate(self.uv_goal.tolist()) if self.ids[k] >= 0}
        made = Slots.empty(len(self.ids))
        at = np.array([rows.get(tuple(place), -1) for place in uv_goal.tolist()], dtype=np.intp)
        ids = np.where(at >= 0, self.ids[at], -1)
        free = iter(np.setdiff1d(np.arange(len(self.ids)), at).tolist())
        next_id = self.next_id
        for m in np.flatnonzero(at < 0).tolist():
            at[m], ids[m], next_id = next(free), next_id, next_id + 1
        made.uv_goal[at], made.uv[at], made.ids[at] = uv_goal, uv, ids
        return Slots(made.uv_goal, made.uv, made.ids, next_id)

    def unseen(self) -> Slots:
        """The same points, none of which is seen."""
        return Slots(self.uv_goal, np.full(self.uv.shape, np.nan), self.ids, self.next_id)

    def moved(self, uv: Array) -> Slots:
        """The same points at uv (K, 2); those with NaN leave their rows."""
        stays = self.taken & np.isfinite(uv).all(axis=1)
        goal = np.where(stays[:, None], self.uv_goal, np.nan)
        return Slots(goal, np.where(stays[:, None], uv, np.nan), np.where(stays, self.ids, -1), self.next_id)
