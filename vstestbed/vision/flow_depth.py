"""Depth from motion: each marker's inverse depth by recursive least squares on its optical flow."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vstestbed.features import Point
from vstestbed.geometry import Array
from vstestbed.observation import Estimate

FLOW_NOISE = 3e-4
"""Standard deviation of one normalised coordinate: 0.1 px at a focal length of 350 px."""
RANGE = 50.0
"""The estimate stays between the initial depth over this and the initial depth times this."""
CLEAR = 30.0
"""A frame with this many times the evidence of one that shows no more than noise (it gives the depth to 18 %) forgets at half
the full rate, a poorer one at less: what is known fades as new knowledge comes in, not as the motion fades."""

_POINT = Point()


@dataclass(frozen=True, slots=True)
class FlowMemory:
    """Inverse depths (N,) [1/m] at the last frame, what is known of them (N,), the image points (N, 2) and the time then.

    `information` is the sum of squared translational flows per unit of inverse depth [(m/s)^2], old ones forgotten.
    """

    inverse_depth: Array
    information: Array
    xy: Array
    t: float


def init_flow(estimate: Estimate, n: int) -> FlowMemory:
    """Every marker at the initial depth, on little evidence."""
    inverse = np.full(n, 1 / estimate.initial_m)
    return FlowMemory(inverse, np.zeros(n), np.full((n, 2), np.nan), np.nan)


def update_flow(estimate: Estimate, memory: FlowMemory, t: float, xy: Array, twist: Array) -> FlowMemory:
    """One frame of recursive least squares on theta = 1/Z of each marker, under the twist in force since the last frame.

    Flow at mid-interval, L = L_v(x, y) theta + L_w(x, y):   y = xy_dot - L_w w = (L_v v) theta =: phi theta + noise
    gain:        I <- I exp(-c dt/forget) + phi.phi,   theta <- theta + phi.(y - phi theta) / I
                 c = phi.phi / (phi.phi + CLEAR least), so that I settles no lower than CLEAR least forget / dt
    prediction:  theta_dot = theta^2 vz + theta (wx y - wy x),   since Z_dot = -vz - wx y Z + wy x Z (half before, half after)
    I starts at and never falls under least = (sqrt(2) FLOW_NOISE / (dt theta))^2, an uncertainty of the prior as large as itself.
    A frame whose motion shows less than that noise teaches nothing, and makes nothing forgotten.

    Args:
        estimate: the parameters.
        memory: the last frame.
        t: time of this frame [s].
        xy: normalised image points, shape (N, 2), NaN where not seen.
        twist: camera twist in its own frame, shape (6,).

    Reference: De Luca, Oriolo & Robuffo Giordano 2008, doi:10.1177/0278364908095847 (depth from flow and known motion);
    Ljung 1999, System Identification, section 11.2 (least squares with forgetting).
    """
    dt = t - memory.t
    theta = memory.inverse_depth
    if not dt > 0:
        return FlowMemory(theta, memory.information, np.where(np.isfinite(xy), xy, memory.xy), t)
    known = np.isfinite(xy[:, 0]) & np.isfinite(memory.xy[:, 0])
    middle = np.where(known[:, None], (xy + memory.xy) / 2, 0.0)
    theta = _advance(theta, middle, twist, dt / 2)
    unit = _POINT.interaction(middle, np.ones(len(theta))).reshape(-1, 2, 6)
    phi = unit[..., :3] @ twist[:3]
    y = np.where(known[:, None], (xy - memory.xy) / dt - unit[..., 3:] @ twist[3:], 0.0)
    evidence = np.einsum("ni,ni->n", phi, phi)
    least = (np.sqrt(2) * FLOW_NOISE / (dt * theta)) ** 2
    teaches = known & (evidence > least)
    information = np.maximum(memory.information, least)
    forgotten = np.exp(-dt / estimate.forget_s * evidence / (evidence + CLEAR * least))
    information = np.where(teaches, information * forgotten + evidence, information)
    innovation = np.einsum("ni,ni->n", phi, y - phi * theta[:, None])
    theta = theta + np.where(teaches, innovation / information, 0.0)
    low, high = 1 / (RANGE * estimate.initial_m), RANGE / estimate.initial_m
    theta = np.clip(_advance(np.clip(theta, low, high), middle, twist, dt / 2), low, high)
    return FlowMemory(theta, information, xy, t)


def _advance(theta: Array, xy: Array, twist: Array, dt: float) -> Array:
    """Inverse depths (N,) a short time later: one midpoint step of theta_dot = theta^2 vz + theta (wx y - wy x)."""
    _, _, vz, wx, wy, _ = twist
    turn = wx * xy[:, 1] - wy * xy[:, 0]
    half = theta + (theta * vz + turn) * theta * dt / 2
    return theta + (half * vz + turn) * half * dt
