"""Many ideal closed loops at once: the image-based law from thousands of starts, one numpy call for all."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vstestbed.errors import ParameterError
from vstestbed.geometry import Array, exp
from vstestbed.laws import IBVS
from vstestbed.laws.base import ConstantGain
from vstestbed.observation import Goal
from vstestbed.stop import FAR_M, Outcome

RIDGE = 1e-12
"""Added to the diagonal of the normal equations, as a share of its mean: they are exactly singular at some starts."""
STILL = 1e-12
"""A run with |L^T e| under this share of |L| |e| stands in a local minimum, but for rounding."""


@dataclass(frozen=True)
class Batch:
    """How the runs ended.

    Attributes:
        outcome: an `Outcome` each, shape (M,). steps: after how many steps, shape (M,).
        T_camera_target: where each ended, shape (M, 4, 4). farthest_m: largest distance to the target's origin (M,) [m].
        run_steps: steps of all runs together.
    """

    outcome: NDArray[np.object_]
    steps: NDArray[np.int_]
    T_camera_target: Array
    farthest_m: Array
    run_steps: int


def fly(law: IBVS, goal: Goal, points: Array, start: Array, *, period: float, steps: int, error_px: float) -> Batch:
    """Ideal cameras with true depth and a picture without border, each from its own start, until each has ended.

    u = -gain (L^T L + ridge)^-1 L^T e,  T_camera_target <- exp(-u period) T_camera_target. A run that has ended leaves the
    batch. Ends: converged (RMS pixel error under `error_px`), target_lost (a marker at or behind the lens, or the camera
    behind the plane of markers that lie in one), diverged (over 200 m away), local_minimum (no motion), timed_out.

    Args:
        law: an image-based law with a constant gain; its depth, limits, smooth start and field at the border do not count.
        goal: the goal view.
        points: markers in the target's frame, shape (N, 3) [m].
        start: poses T_camera_target, shape (M, 4, 4).
        period: time of a step [s]. steps: of a run, at most. error_px: when the goal counts as reached [px].

    Raises:
        ParameterError: the gain is not constant.
    """
    if not isinstance(law.gain, ConstantGain):
        raise ParameterError("law.gain", "must be constant for a batch of ideal runs", law.gain)
    T = np.array(start, dtype=float)
    outcome = np.full(len(T), Outcome.timed_out, dtype=object)
    ended_at, farthest = np.full(len(T), steps), np.zeros(len(T))
    final, left, done = T.copy(), np.arange(len(T)), 0
    planar = bool(np.ptp(points[:, 2]) == 0)
    for step in range(steps + 1):
        p = np.swapaxes((T[:, :3, :3].reshape(-1, 3) @ points.T).reshape(len(T), 3, -1) + T[:, :3, 3:], 1, 2)
        distance = np.sqrt(np.einsum("mi,mi->m", T[:, :3, 3], T[:, :3, 3]))
        farthest[left] = np.maximum(farthest[left], distance)
        ends = _seen_ends(T, p, distance, goal, planar, error_px)
        twist = np.zeros((len(T), 6))
        going = np.equal(ends, None)
        if step < steps and going.any():
            some = slice(None) if going.all() else going
            twist[some], still = _twist(law, goal, p[some])
            ends[np.flatnonzero(going)[still]] = Outcome.local_minimum
        over = ~np.equal(ends, None)
        if over.any() or step == steps:
            outcome[left[over]], ended_at[left[over]] = ends[over], step
            final[left] = T
            left, T, twist = left[~over], T[~over], twist[~over]
        if not len(left) or step == steps:
            break
        done += len(left)
        T = exp(-period * twist) @ T
    return Batch(outcome, ended_at, final, farthest, done)


def _seen_ends(T: Array, p: Array, distance: Array, goal: Goal, planar: bool, error_px: float) -> NDArray[np.object_]:
    """The outcome of each run that its view tells (M,), None for those that go on."""
    ends = np.full(len(T), None, dtype=object)
    behind = (p[..., 2] <= 0).any(axis=1)
    if planar:
        behind |= np.einsum("mi,mi->m", T[:, :3, 2], T[:, :3, 3]) <= 0
    error = (goal.camera.project(p) - goal.uv).reshape(len(T), -1)
    near = np.einsum("mi,mi->m", error, error) < error_px**2 * error.shape[1]  # NaN, of what is not seen, is not near
    for which, how in ((distance > FAR_M, Outcome.diverged), (behind, Outcome.target_lost), (near & ~behind, Outcome.converged)):
        if which.any():
            ends[which] = how
    return ends


def _twist(law: IBVS, goal: Goal, p: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Camera twists (M, 6) of markers at p (M, N, 3), and who stands in a local minimum (M,)."""
    feature = law.feature
    if "ray" in feature.inputs:
        reach = np.linalg.norm(p, axis=-1)
        now, distance, there, goal_distance = p / reach[..., None], reach, goal.ray, goal.range
    else:
        now, distance, there, goal_distance = p[..., :2] / p[..., 2:], p[..., 2], goal.xy, goal.depth
    e = feature.error(feature.measure(now), feature.measure(there))
    L = np.broadcast_to(feature.interaction(there, goal_distance), (len(p), e.shape[-1], 6))
    if law.interaction != "desired":
        current = feature.interaction(now, distance)
        L = current if law.interaction == "current" else 0.5 * (current + L)
    A = np.swapaxes(L, 1, 2) @ L
    b = (e[:, None] @ L)[:, 0]
    size2 = np.einsum("mii->m", A)
    still = np.einsum("mi,mi->m", b, b) < STILL**2 * size2 * np.einsum("mi,mi->m", e, e)
    A += (RIDGE / 6 * size2)[:, None, None] * np.eye(6)
    return -law.gain.at(b) * np.linalg.solve(A, b[..., None])[..., 0], still
