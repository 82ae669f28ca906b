"""What a frame does not show, carried over from the last one by the motion of the camera relative to the target."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from vstestbed.camera.base import FORWARD_COSINE
from vstestbed.core.geometry import Array, exp, lengths, skew, transform
from vstestbed.features.observation import Goal, Observation, Relative
from vstestbed.laws.solve import least_squares

TRUST_S = 0.04
"""Time constant with which a marker that is not seen loses its weight against those that are seen [s]."""


def points(observation: Observation) -> Array:
    """The markers in the camera frame by the law's own depths or ranges, shape (N, 3) [m]; NaN where one is not known."""
    if observation.ray is not None and observation.range is not None:
        return observation.ray * observation.range[:, None]
    xy = observation.xy
    return np.column_stack([xy, np.ones(len(xy))]) * observation.depth[:, None]


def moved_markers(observation: Observation, p: Array, which: NDArray[np.bool_]) -> Observation:
    """The observation with its markers `which` (N,) at p (N, 3) [m] in the camera frame; `uv` stays: it is what the picture shows."""
    reach = lengths(p)
    ray = p / reach
    with np.errstate(invalid="ignore"):
        xy = ray[:, :2] / np.where(ray[:, 2:] > FORWARD_COSINE, ray[:, 2:], np.nan)
    new = {"xy": np.where(which[:, None], xy, observation.xy), "depth": np.where(which, p[:, 2], observation.depth)}
    if observation.ray is not None and observation.range is not None:
        new |= {"ray": np.where(which[:, None], ray, observation.ray), "range": np.where(which, reach[:, 0], observation.range)}
    return replace(observation, **new)


def carried_markers(
    seen: Observation, last: Observation, way: Array, unseen_s: Array, longest_s: float, basis: Array | None
) -> Observation:
    """`seen` with the markers that it lacks where those of `last` are after a motion `way` (4, 4) of the target in the camera frame.

    The markers are one rigid body, and four of them tell lateral motion from tilt by little: one that is off by the thousandth part of
    its distance against the others may cost a law a twentieth of it. So, with a basis, all that are not seen are moved further by
    exp(-B c), where c minimises sum of w_i^2 |r_i - r_i(c)|^2: r_i are the unit rays, as measured where the marker is seen (w = 1), as
    carried over where it is not, with w = exp(-unseen_s / TRUST_S).
    Without a basis, all markers are carried over, also those that are seen, as the rest would not fit to them.

    Args:
        unseen_s: for how long each marker has not been seen (N,) [s]. longest_s: those that were unseen for longer are left out.
        basis: the robot's motions (6, n), or None where too few markers are seen to correct the others by.
    """
    p = transform(way, points(last))
    known = np.isfinite(p[:, 0]) & seen.same(last)
    kept = known & (unseen_s <= longest_s)
    if basis is None:
        return moved_markers(seen, p, kept)
    kept &= ~seen.seen
    if not kept.any():
        return seen
    rays = _rays(seen)
    measured = known & np.isfinite(rays[:, 0])
    use = measured | kept
    reach = lengths(p[use])
    r = p[use] / reach
    w = np.where(measured, 1.0, np.exp(-unseen_s / TRUST_S))[use, None]
    change = np.where(measured[use, None], rays[use] - r, 0.0)
    # p_dot = -v - w x p of a fixed point, and so r_dot = -(I - r r^T) v / |p| + r x w.
    L = np.concatenate([(r[:, :, None] * r[:, None, :] - np.eye(3)) / reach[:, :, None], skew(r)], axis=-1)
    c = least_squares((w[:, :, None] * L).reshape(-1, 6) @ basis, (w * change).ravel())
    return moved_markers(seen, transform(exp(-basis @ c), p), kept)


def _rays(observation: Observation) -> Array:
    """Unit rays (N, 3) to the markers; NaN where one is not seen."""
    if observation.ray is not None:
        return observation.ray
    ahead = np.column_stack([observation.xy, np.ones(len(observation.xy))])
    return ahead / lengths(ahead)


def carried_pose(seen: Observation, last: Observation, way: Array, goal: Goal) -> Observation:
    """`seen` with the pose T <- way T of `last` and its homography, where it has none.

    The homography H = R + t n^T/d* from the goal's view goes on by R <- dR R, t <- dR t + dt, with way = (dR, dt).
    """
    T, relative = seen.T_camera_target, seen.relative
    if T is None and last.T_camera_target is not None:
        T = way @ last.T_camera_target
    if relative is None and last.relative is not None:
        R, n = way[:3, :3], goal.normal
        relative = Relative(R @ last.relative.H + np.outer(way[:3, 3], n / (n @ goal.middle)), R @ last.relative.R_camera_goal)
    return replace(seen, T_camera_target=T, relative=relative)
