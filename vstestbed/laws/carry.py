"""What a frame does not show, carried over from the last one by the motion of the camera relative to the target."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from vstestbed.camera.base import FORWARD_COSINE
from vstestbed.core.geometry import Array, lengths, transform
from vstestbed.features.observation import Goal, Observation, Relative


def points(observation: Observation) -> Array:
    """The markers in the camera frame by the law's own depths or ranges, shape (N, 3) [m]; NaN where one is not known."""
    if observation.ray is not None and observation.range is not None:
        return observation.ray * observation.range[:, None]
    xy = observation.xy
    return np.column_stack([xy, np.ones(len(xy))]) * observation.depth[:, None]


def moved_markers(observation: Observation, p: Array, which: NDArray[np.bool_]) -> Observation:
    """The observation with its markers `which` (N,) at p (N, 3) [m] in the camera frame; `uv` stays, which is what the picture shows."""
    reach = lengths(p)
    ray = p / reach
    with np.errstate(invalid="ignore"):
        xy = ray[:, :2] / np.where(ray[:, 2:] > FORWARD_COSINE, ray[:, 2:], np.nan)
    new = {"xy": np.where(which[:, None], xy, observation.xy), "depth": np.where(which, p[:, 2], observation.depth)}
    if observation.ray is not None and observation.range is not None:
        new |= {"ray": np.where(which[:, None], ray, observation.ray), "range": np.where(which, reach[:, 0], observation.range)}
    return replace(observation, **new)


def moved_relative(relative: Relative, way: Array, goal: Goal) -> Relative:
    """The homography H = R + t n^T/d* after a motion `way` (4, 4) of the target in the camera's frame: R <- dR R, t <- dR t + dt."""
    R, t = way[:3, :3], way[:3, 3]
    n = goal.normal
    return Relative(R @ relative.H + np.outer(t, n / (n @ goal.middle)), R @ relative.R_camera_goal)


def carried(seen: Observation, last: Observation, way: Array, goal: Goal, kept: NDArray[np.bool_], whole: bool) -> Observation:
    """`seen` with what it lacks taken from `last`, after a motion `way` (4, 4) of the target in the camera's frame.

    p <- way p for markers, T <- way T for the pose, and so on for the homography.

    Args:
        seen: this frame. last: the frame before. goal: the goal view, to whose plane the homography belongs.
        kept: the markers (N,) that may be carried over. whole: whether the pose and the homography may be.
    """
    T, relative = seen.T_camera_target, seen.relative
    if whole and T is None and last.T_camera_target is not None:
        T = way @ last.T_camera_target
    if whole and relative is None and last.relative is not None:
        relative = moved_relative(last.relative, way, goal)
    if T is not seen.T_camera_target or relative is not seen.relative:
        seen = replace(seen, T_camera_target=T, relative=relative)
    return moved_markers(seen, transform(way, points(last)), kept) if kept.any() else seen
