"""Depth from motion: recursive least squares for each marker's inverse range from the flow of its ray, for any lens."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from vstestbed.core.geometry import Array
from vstestbed.features.depth import Estimate

FLOW_NOISE = 3e-4
"""Standard deviation of a ray along one direction [rad]: 0.1 px at a focal length of 350 px."""
RANGE = 50.0
"""The estimate is limited to the initial depth divided and multiplied by this."""
BESIDE = 0.2
"""A unit ray with a z below this starts with the initial depth as its range: there depth is a small share of the range."""
CLEAR = 30.0
"""Evidence, in units of that of the noise, at which a frame (it gives the range to 18 %) forgets at half the full rate. Weaker
frames forget less: information fades as new information arrives, not as the motion fades."""

_AHEAD = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, slots=True)
class FlowMemory:
    """State of the estimator, of N markers.

    Attributes:
        inverse_range: estimates theta, shape (N,) [1/m], NaN until the marker is first seen.
        information: sum of phi.phi with forgetting, shape (N,) [(m/s)^2].
        ray: unit rays at the last frame, shape (N, 3).
        t: time of the last frame [s].
        ids: number of the point in each row, shape (N,), where they are not always the same markers.
    """

    inverse_range: Array
    information: Array
    ray: Array
    t: float
    ids: NDArray[np.intp] | None = None

    def of(self, ids: NDArray[np.intp] | None) -> FlowMemory:
        """The state for rows with points `ids` (N,): of a point that was not in its row nothing is known."""
        if ids is None or self.ids is None:
            return self if ids is None else replace(self, ids=ids)
        same = ids == self.ids
        theta, ray = np.where(same, self.inverse_range, np.nan), np.where(same[:, None], self.ray, np.nan)
        return FlowMemory(theta, np.where(same, self.information, 0.0), ray, self.t, ids)


def init_flow(n: int) -> FlowMemory:
    """No marker seen yet."""
    return FlowMemory(np.full(n, np.nan), np.zeros(n), np.full((n, 3), np.nan), np.nan)


def update_flow(estimate: Estimate, memory: FlowMemory, t: float, ray: Array, twist: Array) -> FlowMemory:
    """One frame of recursive least squares on theta = 1/R of each marker, under the twist in force since the last frame.

    The flow of a unit ray r to a point at the range R:   r_dot = -(v - r (r.v)) / R - w x r
    at mid-interval:   y = r_dot + w x r = phi theta + noise,   phi = r (r.v) - v
    gain:        I <- I exp(-c dt/forget) + phi.phi,   theta <- theta + phi.(y - phi theta) / I
                 c = phi.phi / (phi.phi + CLEAR least), so that I settles no lower than CLEAR least forget / dt
    prediction:  theta_dot = theta^2 r.v,   since R_dot = -r.v (half before, half after)
    A marker starts at the initial depth. I starts at and never falls below least = (sqrt(2) FLOW_NOISE / (dt theta))^2, which
    is a prior of 100 % uncertainty. A frame with less evidence than that is skipped, without forgetting.

    Args:
        estimate: the parameters.
        memory: the state at the last frame.
        t: time of this frame [s].
        ray: unit rays in the camera's frame, shape (N, 3), NaN where not seen.
        twist: camera twist in its own frame, shape (6,).

    Reference: De Luca, Oriolo & Robuffo Giordano 2008, doi:10.1177/0278364908095847 (depth from flow and known motion);
    Ljung 1999, System Identification, section 11.2 (least squares with forgetting).
    """
    dt = t - memory.t
    begin = np.where(ray[:, 2] > BESIDE, ray[:, 2], 1.0) / estimate.initial_m
    theta = np.where(np.isnan(memory.inverse_range) & np.isfinite(ray[:, 0]), begin, memory.inverse_range)
    if not dt > 0:  # also the first frame, whose dt is NaN
        return FlowMemory(theta, memory.information, np.where(np.isfinite(ray), ray, memory.ray), t, memory.ids)
    known = np.isfinite(ray[:, 0]) & np.isfinite(memory.ray[:, 0])
    # Lost markers get any unit ray, so that no NaN spreads; `known` masks the result.
    middle = np.where(known[:, None], ray + memory.ray, _AHEAD)
    middle /= np.linalg.norm(middle, axis=1, keepdims=True)
    nearing = middle @ twist[:3]
    theta = _advance(theta, nearing, dt / 2)  # to mid-interval, where the flow is measured
    phi = middle * nearing[:, None] - twist[:3]
    y = np.where(known[:, None], (ray - memory.ray) / dt + np.cross(twist[3:], middle), 0.0)
    evidence = np.einsum("ni,ni->n", phi, phi)
    least = (np.sqrt(2) * FLOW_NOISE / (dt * theta)) ** 2
    teaches = known & (evidence > least)
    information = np.fmax(memory.information, least)
    forgotten = np.exp(-dt / estimate.forget_s * evidence / (evidence + CLEAR * least))
    information = np.where(teaches, information * forgotten + evidence, information)
    innovation = np.einsum("ni,ni->n", phi, y - phi * theta[:, None])
    # The limits keep a single bad frame from sending a range to infinity or to zero.
    theta = theta + np.where(teaches, innovation / information, 0.0)
    low, high = 1 / (RANGE * estimate.initial_m), RANGE / estimate.initial_m
    theta = np.clip(_advance(np.clip(theta, low, high), nearing, dt / 2), low, high)
    return FlowMemory(theta, information, ray, t, memory.ids)


def _advance(theta: Array, nearing: Array, dt: float) -> Array:
    """Inverse ranges (N,) a short time later: one midpoint step of theta_dot = theta^2 (r.v), nearing = r.v (N,) [m/s]."""
    half = theta + theta**2 * nearing * dt / 2
    return theta + half**2 * nearing * dt
