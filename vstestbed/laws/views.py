"""Views of a batch of ideal cameras, with the field names of an Observation."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from vstestbed.core.geometry import Array
from vstestbed.features.depth import AtGoal, Constant, Depth
from vstestbed.features.observation import Goal, Observation
from vstestbed.robots.own_model import OwnModel


@dataclass(frozen=True)
class Views:
    """M views of the same N markers at one instant; every camera sees all of them.

    Attributes:
        t: time [s]. p: the markers in the camera frame (M, N, 3) [m]. T_camera_target: poses (M, 4, 4).
        goal: the goal view of these markers. depth_from: the source of depth; `pnp` and `oracle` give the true depth.
        marker_radius_m: of every marker [m].
    """

    t: float
    p: Array
    T_camera_target: Array
    goal: Goal
    depth_from: Depth
    marker_radius_m: float = 0.0
    relative = None  # exact pixels: what a homography tells, the pose tells as well

    @cached_property
    def xy(self) -> Array:
        """Normalised coordinates (M, N, 2)."""
        return self.p[..., :2] / self.p[..., 2:]

    @cached_property
    def depth(self) -> Array:
        """Depth z of each marker as known to the law (M, N) [m]."""
        return self._known(self.p[..., 2], self.goal.depth)

    @property
    def xyw(self) -> Array:
        """Normalised coordinates and inverse depths as known to the law (M, N, 3)."""
        return np.concatenate([self.xy, 1 / self.depth[..., None]], axis=-1)

    @cached_property
    def ray(self) -> Array:
        """Unit rays (M, N, 3)."""
        return self.p / self._reach[..., None]

    @cached_property
    def range(self) -> Array:
        """Distance of each marker as known to the law (M, N) [m]."""
        return self._known(self._reach, self.goal.range)

    @cached_property
    def radius_px(self) -> Array:
        """Apparent radius of each marker by its depth as known to the law (M, N) [px]."""
        p = self.ray * self.range[..., None]
        return self.goal.camera.half_size(p.reshape(-1, 3), self.marker_radius_m).max(axis=1).reshape(p.shape[:2])

    @cached_property
    def _reach(self) -> Array:
        return np.sqrt(np.einsum("mni,mni->mn", self.p, self.p))  # the true distance, whatever `depth_from` says

    def _known(self, true: Array, at_goal: Array) -> Array:
        match self.depth_from:
            case Constant(depth_m=depth):
                return np.full(true.shape, depth)
            case AtGoal():
                return np.broadcast_to(at_goal, true.shape)
            case _:
                return true

    @cached_property
    def uv(self) -> Array:
        """Pixels (M, N, 2)."""
        return self.goal.camera.project(self.p)

    def of_run(self, i: int, inputs: tuple[str, ...], moved: Array | None = None) -> Observation:
        """What the law of run i is shown: of the costly fields those that it names. moved: its last motion (6,); None: none."""
        rays = (self.ray[i], self.range[i]) if {"ray", "range"} & set(inputs) else (None, None)
        radius = self.radius_px[i] if "radius_px" in inputs else None
        robot = OwnModel.of_ideal_camera(self.goal.camera.period, moved) if "robot" in inputs else None
        seen = self.xy[i], self.depth[i], self.T_camera_target[i]
        return Observation(self.t, self.uv[i], *seen, *rays, radius_px=radius, robot=robot)


def has_batch(law: Any) -> bool:
    """Whether a law controls a batch by the equations of its own `step`: a class that overrides `step` alone inherits another law's."""
    first = next((vars(c) for c in type(law).__mro__ if {"step", "step_batch"} & vars(c).keys()), {})
    return "step_batch" in first
