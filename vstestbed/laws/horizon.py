"""Prediction over a horizon: where markers, joints and camera go under a plan of velocities, and how they change with the plan."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from vstestbed.core.geometry import Array, adjoint, exp, skew, transform
from vstestbed.robots.own_model import OwnModel

STILL = np.zeros(6)
"""The motion of a target that stands still."""


@dataclass(frozen=True, slots=True)
class Predicted:
    """A robot under a plan, at the ends of the K periods to come; the first begins when this frame's command takes effect.

    Attributes:
        p: the markers in the camera frame (K, N, 3) [m]; p_begin: at the beginning (N, 3).
        D: change of the camera's pose, as a twist (v, w) in the camera's own frame, with the plan: (K, 6, B n).
        q: positions (K, n). Q: their change with the plan (K, n, B n).
        J: the Jacobian during each period (K, 6, n).
    """

    p: Array
    p_begin: Array
    D: Array
    q: Array
    Q: Array
    J: Array


@dataclass(frozen=True, slots=True)
class PlanBlocks:
    """A plan's blocks: velocities are constant over each, of `lengths` periods, which the horizon consists of.

    Reference: Cagienard, Grieder, Kerrigan & Morari 2007, doi:10.1016/j.jprocont.2007.01.001 (move blocking).
    """

    lengths: tuple[int, ...]

    @classmethod
    def of(cls, horizon: int, blocks: int) -> PlanBlocks:
        """Blocks that grow: the first periods matter most."""
        left, lengths = horizon, []
        for i in range(min(blocks, horizon)):
            after = min(blocks, horizon) - i - 1
            length = max(1, left // 2**after) if after else left
            lengths.append(min(length, left - after))
            left -= lengths[-1]
        return cls(tuple(lengths))

    @property
    def horizon(self) -> int:
        """Number of periods."""
        return sum(self.lengths)

    @property
    def of_period(self) -> list[int]:
        """The block of each period."""
        return [b for b, length in enumerate(self.lengths) for _ in range(length)]

    def shifted(self, plan: Array) -> Array:
        """A plan (B, n) a period later; the last velocities stay."""
        each = plan[self.of_period]
        later = np.vstack([each[1:], each[-1:]])
        starts = np.cumsum((0, *self.lengths[:-1]))
        return later[starts]


def lagged(blocks: PlanBlocks, plan: Array, before: Array, lag: float) -> tuple[Array, Array]:
    """Mean velocities (K, n) in each period of first-order servos, and their change with the blocks' orders, (K, B), alike for each n.

    With a = exp(-1/lag) and g = lag (1 - a): mean = (1 - g) u + g r, and r' = (1 - a) u + a r at the end of the period.

    Args:
        plan: (B, n). before: the velocity r at the beginning (n,). lag: time constant in periods.
    """
    decay = math.exp(-1 / lag) if lag > 0 else 0.0
    carried = lag * (1 - decay)
    r, R = before, np.zeros(len(plan))
    means, changes = [], []
    for b in blocks.of_period:
        means.append((1 - carried) * plan[b] + carried * r)
        changes.append(carried * R)
        changes[-1][b] += 1 - carried
        r, R = (1 - decay) * plan[b] + decay * r, decay * R
        R[b] += 1 - decay
    return np.array(means), np.array(changes)


def predict(p: Array, robot: OwnModel, blocks: PlanBlocks, plan: Array, relinearise: bool, target: Array = STILL) -> Predicted:
    """What a plan (B, n) does, from markers p (N, 3) [m] in the camera frame at the exposure.

    The camera's pose follows T <- T exp(period J mean) exactly; a small change d of the pose before a period has become
    Ad(exp(-period J mean)) d at its end, to which period J times the change of the velocity is added, less half of its bracket with the
    twist: the derivative of the exponential to second order.

    relinearise: J at the predicted positions; else that of now throughout. target: camera twist (6,) that would move the markers as the
        target's own motion does.
    """
    n, period = len(robot.names), robot.period_s
    mean, change = lagged(blocks, plan, robot.ordered, robot.lag_s / period)
    steps, size = len(mean), plan.size
    p, q = transform(exp(-(robot.way + target * robot.underway_s)), p), robot.q_then
    D, Q = np.zeros((6, size)), np.zeros((n, size))
    out = Predicted(
        np.empty((steps, *p.shape)),
        p,
        np.empty((steps, 6, size)),
        np.empty((steps, n)),
        np.empty((steps, n, size)),
        np.empty((steps, 6, n)),
    )
    each = change[:, :, None, None] * np.eye(n)  # (K, B, n, n)
    each = each.transpose(0, 2, 1, 3).reshape(steps, n, size) * period
    way = mean * period
    for k in range(steps):
        J = robot.jacobian(q) if relinearise else robot.J
        twist = J @ way[k] + target * period
        back, change = exp(-twist), J @ each[k]
        D = adjoint(back) @ D + change - _bracket(twist) @ change / 2
        p, q, Q = transform(back, p), q + way[k], Q + each[k]
        out.p[k], out.D[k], out.q[k], out.Q[k], out.J[k] = p, D, q, Q, J
    return out


def _bracket(twist: Array) -> Array:
    """The matrix (6, 6) of the Lie bracket of a twist (v, w) with others."""
    W, out = skew(twist[3:]), np.zeros((6, 6))
    out[:3, :3] = out[3:, 3:] = W
    out[:3, 3:] = skew(twist[:3])
    return out
