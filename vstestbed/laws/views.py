"""Many views at once: what a batch of ideal cameras sees, with the names of an Observation's fields."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol, runtime_checkable

import numpy as np

from vstestbed.core.geometry import Array
from vstestbed.features.depth import AtGoal, Constant, Depth
from vstestbed.features.observation import Goal


@dataclass(frozen=True)
class Views:
    """What M cameras see at one instant of the same N markers, all of them seen by each.

    Attributes:
        t: time [s].
        p: the markers in the camera's frame (M, N, 3) [m]. T_camera_target: poses (M, 4, 4).
        goal: the goal view of these markers. depth_from: where depth comes from; a pose or the oracle tells it exactly.
    """

    t: float
    p: Array
    T_camera_target: Array
    goal: Goal
    depth_from: Depth

    @cached_property
    def xy(self) -> Array:
        """Normalised coordinates (M, N, 2)."""
        return self.p[..., :2] / self.p[..., 2:]

    @cached_property
    def depth(self) -> Array:
        """Depth of each as the law knows it (M, N) [m]."""
        return self._known(self.p[..., 2], self.goal.depth)

    @cached_property
    def ray(self) -> Array:
        """Unit rays (M, N, 3)."""
        return self.p / self._reach[..., None]

    @cached_property
    def range(self) -> Array:
        """Distance of each as the law knows it (M, N) [m]."""
        return self._known(self._reach, self.goal.range)

    @cached_property
    def _reach(self) -> Array:
        return np.sqrt(np.einsum("mni,mni->mn", self.p, self.p))

    def _known(self, true: Array, at_goal: Array) -> Array:
        match self.depth_from:
            case Constant(depth_m=depth):
                return np.full(true.shape, depth)
            case AtGoal():
                return np.broadcast_to(at_goal, true.shape)
            case _:
                return true


@runtime_checkable
class BatchLaw(Protocol):
    """A law that can also fly a batch: by the equations of its `step`, which are written for leading axes."""

    @property
    def state_size(self) -> int:
        """How many numbers k a run's memory has."""
        ...

    def step_batch(self, memory: Array, views: Views, goal: Goal) -> tuple[Array, Array]:
        """One frame of M runs: the next memory (M, k), and the camera twists (M, 6); NaN where the law orders rest.

        The memory is NaN before the first frame. `goal` is of the markers in `views`.
        """
        ...
