"""Secondary tasks of a quadratic program: posture, a straight path of the camera, manipulability.

A weighted one competes with the law's motion: where it is not fulfilled at the goal, the camera comes to rest beside it. A strict one has
only the motions that the law's features do not see.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Literal

import numpy as np
from annotated_types import Gt, Le

from vstestbed.core.geometry import Array, inverse
from vstestbed.core.quantity import Angle, PositiveGain
from vstestbed.core.spec import OneOf, spec
from vstestbed.features.observation import Goal, Observation
from vstestbed.laws.program import Group, Solution, minimise
from vstestbed.laws.solve import PINV_RCOND
from vstestbed.robots.own_model import OwnModel

Weight = Annotated[float, Gt(0), Le(1e3)]
Priority = Literal["weighted", "strict"]
STEP = 1e-5
"""Step of finite differences of the manipulability [rad, m]."""


@spec
class PosturePull:
    """Joints towards a posture: x = gain (q* - q).

    Args:
        q_deg: the posture [deg; m for a joint that slides]; by default that of the start; e.g. `[0, 45, -180, 0, 45, -45]`.
        gain: of the approach [1/s].
        weight: of the squared difference from that, beside the law's rows [1].
        priority: `weighted` beside the law, or `strict`: only motions that the law's features do not see.
    """

    kind: Literal["posture"] = "posture"
    q_deg: tuple[Angle, ...] | None = None
    gain: PositiveGain = 0.5
    weight: Weight = 0.01
    priority: Priority = "strict"
    inputs = ()

    def rows(self, seen: Observation, goal: Goal, robot: OwnModel) -> tuple[Array, Array]:
        """A (n, n) and b (n,) of the wanted A x = b."""
        wanted = robot.nominal if self.q_deg is None else robot.positions(self.q_deg)
        return np.eye(len(robot.names)), self.gain * (wanted - robot.q)


@spec
class StraightPath:
    """The camera's origin on the straight line to its goal: no velocity across it.

    Args:
        weight: of the squared velocity across, beside the law's rows [1].
        priority: `weighted` beside the law, or `strict`: only motions that the law's features do not see.
    """

    kind: Literal["straight"] = "straight"
    weight: Weight = 1.0
    priority: Priority = "weighted"
    inputs = ("T_camera_target",)

    def rows(self, seen: Observation, goal: Goal, robot: OwnModel) -> tuple[Array, Array]:
        """A (3, n) and b (3,) of the wanted A x = b; no rows without a pose, or at the goal."""
        T = seen.T_camera_target
        t = np.zeros(3) if T is None else (T @ inverse(goal.T_camera_target))[:3, 3]
        distance = float(np.linalg.norm(t))
        if distance < 1e-3:
            return np.zeros((0, len(robot.names))), np.zeros(0)
        along = t / distance
        return (np.eye(3) - np.outer(along, along)) @ robot.J[:3], np.zeros(3)


@spec
class Manipulability:
    """Away from singularities: up the gradient of sqrt(det(J J^T)), lengths in metres.

    Args:
        gain: size of the velocity up the gradient [rad/s].
        weight: of the squared difference from it, beside the law's rows [1].
        priority: `weighted` beside the law, or `strict`: only motions that the law's features do not see.

    Reference: Yoshikawa 1985, doi:10.1177/027836498500400201.
    """

    kind: Literal["manipulability"] = "manipulability"
    gain: PositiveGain = 0.2
    weight: Weight = 0.01
    priority: Priority = "strict"
    inputs = ()

    def rows(self, seen: Observation, goal: Goal, robot: OwnModel) -> tuple[Array, Array]:
        """A (n, n) and b (n,) of the wanted A x = b."""
        n = len(robot.names)
        ahead, behind = (np.array([manipulability(robot.jacobian(robot.q + side * d)) for d in STEP * np.eye(n)]) for side in (1, -1))
        gradient = (ahead - behind) / (2 * STEP)
        size = float(np.linalg.norm(gradient))
        return np.eye(n), self.gain * gradient / size if size > 1e-9 else np.zeros(n)


SECONDARY = OneOf("secondary", PosturePull, StraightPath, Manipulability)
Secondary = Annotated[PosturePull | StraightPath | Manipulability, SECONDARY]


def manipulability(J: Array) -> float:
    """The product of the singular values of J (6, n), of as many as there are."""
    return float(np.prod(np.linalg.svd(J, compute_uv=False)))


def added(
    A: Array, b: Array, tasks: tuple[Secondary, ...], seen: Observation, goal: Goal, robot: OwnModel, priority: Priority = "weighted"
) -> tuple[Array, Array]:
    """The rows A x = b, and those of the tasks of a priority, times the roots of their weights."""
    parts = [(A, b)]
    for task in tasks:
        if task.priority == priority:
            more, wanted = task.rows(seen, goal, robot)
            parts.append((np.sqrt(task.weight) * more, np.sqrt(task.weight) * wanted))
    return np.vstack([rows for rows, _ in parts]), np.concatenate([wanted for _, wanted in parts])


def among_solutions(
    solution: Solution,
    main: Array,
    tasks: tuple[Secondary, ...],
    seen: Observation,
    goal: Goal,
    robot: OwnModel,
    low: Array,
    high: Array,
    groups: tuple[Group, ...],
) -> Solution:
    """Of all velocities with the same main @ x (m,), those that fit the strict tasks best, within the same constraints.

    x + N z with N the directions that `main` (m, n) does not see. Reference: Siciliano & Slotine 1991, doi:10.1109/ICAR.1991.240390.
    """
    A, b = added(np.zeros((0, main.shape[1])), np.zeros(0), tasks, seen, goal, robot, "strict")
    x = solution.x
    assert x is not None
    if not len(A):
        return solution
    _, s, Vt = np.linalg.svd(main)
    N = Vt[int(np.count_nonzero(s > PINV_RCOND * s[0])) :].T
    if N.shape[1] == 0:
        return solution
    # The bounds of x as inequalities of z, which z = 0 satisfies; rounding may have put x on the wrong side.
    bounds = Group("bounds", np.vstack([N, -N]), np.minimum(np.concatenate([low - x, x - high]), 0.0))
    inside = tuple(Group(group.word, group.A @ N, np.minimum(group.low - group.A @ x, 0.0)) for group in groups)
    endless = np.full(N.shape[1], np.inf)
    found = minimise(A @ N, b - A @ x, -endless, endless, (*inside, bounds))
    if found.x is None:
        return solution
    return replace(solution, x=np.clip(x + N @ found.x, low, high), bound=solution.bound or found.bound)
