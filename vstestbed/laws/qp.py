"""A law as a quadratic program: its motion in the least-squares sense, within what joints, picture
and target allow.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from operator import attrgetter
from typing import Annotated, Any, Literal

import numpy as np
from annotated_types import Ge, Gt, Le
from numpy.typing import NDArray

from vstestbed.camera.base import pixel_interaction
from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array, inverse
from vstestbed.core.quantity import Angle, Distance, Pixels, PositiveGain, PositiveTime
from vstestbed.core.registry import Registry
from vstestbed.core.spec import spec
from vstestbed.features.observation import Goal, Observation
from vstestbed.laws.base import Command, Law, TwistLimits, Views, inputs_of
from vstestbed.laws.constraints import (
    Group,
    Solution,
    above_plane,
    border,
    load_solver,
    minimise,
    off_singularities,
    program_modes,
    shared_limits,
    twist_limits,
    velocity_bounds,
)
from vstestbed.laws.error_law import ErrorState
from vstestbed.laws.hybrid import Hybrid
from vstestbed.laws.ibvs import IBVS
from vstestbed.laws.partitioned import Partitioned
from vstestbed.laws.pbvs import PBVS
from vstestbed.laws.points import check_margin, usable_rows
from vstestbed.laws.solve import PSEUDO_INVERSE, units_of
from vstestbed.robots.arm import singularity_damping2
from vstestbed.robots.own_model import OwnModel

# Secondary tasks of a quadratic program: posture, a straight path of the camera, manipulability.
#
# A weighted one competes with the law's motion: where it is not fulfilled at the goal, the camera
# comes to rest beside it. A strict one has only the motions that the law's features do not see.
Weight = Annotated[float, Gt(0), Le(1e3)]
Priority = Literal["weighted", "strict"]
STEP = 1e-5  # step of finite differences of the manipulability [rad, m]
Wanted = tuple[Array, Array]  # A (m, n) and b (m,) of the wanted A x = b


@spec
class PosturePull:
    """Joints towards a posture: x = gain (q* - q).

    Args:
        q_deg: the posture [deg; m for a joint that slides]; by default that of the start; e.g.
            `[0, 45, -180, 0, 45, -45]`.
        gain: of the approach [1/s].
        weight: of the squared difference from that, beside the law's rows [1].
        priority: `weighted` beside the law, or `strict`: only motions that the law's features do
            not see.
    """

    kind: Literal["posture"] = "posture"
    q_deg: tuple[Angle, ...] | None = None
    gain: PositiveGain = 0.5
    weight: Weight = 0.01
    priority: Priority = "strict"
    inputs = ()

    def rows(self, seen: Observation, goal: Goal, robot: OwnModel) -> Wanted:
        """A (n, n) and b (n,) of the wanted A x = b."""
        wanted = robot.nominal if self.q_deg is None else robot.positions(self.q_deg)
        return np.eye(len(robot.names)), self.gain * (wanted - robot.q)


@spec
class StraightPath:
    """The camera's origin on the straight line to its goal: no velocity across it.

    Args:
        weight: of the squared velocity across, beside the law's rows [1].
        priority: `weighted` beside the law, or `strict`: only motions that the law's features do
            not see.
    """

    kind: Literal["straight"] = "straight"
    weight: Weight = 1.0
    priority: Priority = "weighted"
    inputs = ("T_camera_target",)

    def rows(self, seen: Observation, goal: Goal, robot: OwnModel) -> Wanted:
        """A (3, n) and b (3,) of the wanted A x = b; no rows without a pose, or at the goal."""
        T = seen.T_camera_target
        t = np.zeros(3) if T is None else (T @ inverse(goal.T_camera_target))[:3, 3]
        distance = float(np.linalg.norm(t))
        if distance < 1e-3 * goal.reach_m:
            return np.zeros((0, len(robot.names))), np.zeros(0)
        along = t / distance
        return (np.eye(3) - np.outer(along, along)) @ robot.J[:3], np.zeros(3)


@spec
class Manipulability:
    """Away from singularities: up the gradient of sqrt(det(J J^T)), lengths in metres.

    Args:
        gain: size of the velocity up the gradient [rad/s].
        weight: of the squared difference from it, beside the law's rows [1].
        priority: `weighted` beside the law, or `strict`: only motions that the law's features do
            not see.

    Reference: Yoshikawa 1985, doi:10.1177/027836498500400201.
    """

    kind: Literal["manipulability"] = "manipulability"
    gain: PositiveGain = 0.2
    weight: Weight = 0.01
    priority: Priority = "strict"
    inputs = ()

    def rows(self, seen: Observation, goal: Goal, robot: OwnModel) -> Wanted:
        """A (n, n) and b (n,) of the wanted A x = b."""
        n = len(robot.names)
        gradient = np.zeros(n)
        for i, d in enumerate(STEP * np.eye(n)):
            ahead = manipulability(robot.jacobian(robot.q + d))
            behind = manipulability(robot.jacobian(robot.q - d))
            gradient[i] = (ahead - behind) / (2 * STEP)
        size = float(np.linalg.norm(gradient))
        if size <= 1e-9:
            return np.eye(n), np.zeros(n)
        return np.eye(n), self.gain * gradient / size


SECONDARY = Registry("secondary", PosturePull, StraightPath, Manipulability)
Secondary = Annotated[PosturePull | StraightPath | Manipulability, SECONDARY]


def manipulability(J: Array) -> float:
    """The product of the singular values of J (6, n), of as many as there are."""
    return float(np.prod(np.linalg.svd(J, compute_uv=False)))


def rows_of(
    tasks: tuple[Secondary, ...],
    priority: Priority,
    seen: Observation,
    goal: Goal,
    robot: OwnModel,
) -> list[Wanted]:
    """The rows of the tasks of a priority, times the roots of their weights."""
    parts = list[Wanted]()
    for task in tasks:
        if task.priority == priority:
            rows, wanted = task.rows(seen, goal, robot)
            parts.append((np.sqrt(task.weight) * rows, np.sqrt(task.weight) * wanted))
    return parts


def _stacked(parts: list[Wanted]) -> Wanted:
    return np.vstack([A for A, _ in parts]), np.concatenate([b for _, b in parts])


def among_solutions(
    solution: Solution,
    main: Array,
    strict: list[Wanted],
    low: Array,
    high: Array,
    groups: tuple[Group, ...],
) -> Solution:
    """Of all velocities with the same main @ x (m,), those that fit the strict tasks best, within
    the same constraints.

    x + N z with N the directions that `main` (m, n) does not see. Reference: Siciliano & Slotine
    1991, doi:10.1109/ICAR.1991.240390.
    """
    x = solution.x
    if x is None or not strict:
        return solution
    A, b = _stacked(strict)
    if not len(A):
        return solution
    N = PSEUDO_INVERSE.null_space(main)
    if N.shape[1] == 0:
        return solution
    # The bounds of x as inequalities of z, which z = 0 satisfies; rounding may have put x on the
    # wrong side.
    room = np.minimum(np.concatenate([low - x, x - high]), 0.0)
    bounds = Group("bounds", np.vstack([N, -N]), room)
    inside = []
    for group in groups:
        low_z = np.minimum(group.low - group.A @ x, 0.0)
        inside.append(Group(group.word, group.A @ N, low_z))
    endless = np.full(N.shape[1], np.inf)
    found = minimise(A @ N, b - A @ x, -endless, endless, (*inside, bounds))
    if found.x is None:
        return solution
    x = np.clip(x + N @ found.x, low, high)
    return replace(solution, x=x, bound=solution.bound or found.bound)


# laws whose motion a quadratic program may take
SERVO = Registry("law", IBVS, Partitioned, PBVS, Hybrid, default="ibvs")
GIVE_WAY = ("singularity", "border", "plane", "twist", "shared", "acceleration")
"""Constraints in the order in which they give way; those of joint position and joint speed never
do.
"""


def _of_law(name: str) -> Any:
    """A property of a program: that of the law within."""
    return property(attrgetter(f"law.{name}"))


@spec
class QP(Law[ErrorState]):
    """The velocities x of the robot's joints that come nearest to a law's motion u, subject to
    constraints.

    min |W (J x - B u)|^2 + secondary tasks    subject to

    joint positions   x_i <= (q_max - margin - q) / damper_s, and alike below     (velocity damper)
    joint speeds      |x_i| <= its largest
    accelerations     |x_i - x_i before| <= its largest times the period
    shared            wheels' speeds of a platform, the tightest circle of a car
    twist             `limits` of the camera's twist
    singularity       the arm's smallest singular value stays over `least_singular_value` (barrier)
    plane             the camera stays `plane_m` from the target's plane          (barrier)
    border            markers stay `margin_px` within the picture                 (barrier)

    With W the law's interaction matrix L, the rows of the features count, as in least squares of
    the task itself: without a binding constraint the command is that of the law. Laws without an
    image feature (`pbvs`, `hybrid`, `partitioned`) have W = I in m and rad. Near singularities of
    an arm the velocities are damped as those of all other laws are (`resolved_rate`).
    A law alone is scaled as a whole when a joint reaches its stop, and ends there; here the other
    joints go on.

    Where constraints contradict each other, they give way one after the other: singularity, border,
    plane, twist, shared, acceleration; positions and speeds of the joints never do. The log's
    `law_mode` tells: 0 nothing binds, 1 a constraint binds, 2 to 7 the last of these that gave way,
    8 the program was not solved, and the law rests.

    The law's gain, feature, depth, feedforward and inversion are those of `law`. Constraints hold
    where the command takes effect: latency is bridged by the robot's own measured motion.

    Args:
        law: whose motion is wanted: ibvs, pbvs, hybrid or partitioned, with its parameters.
        margin_px: distance of the markers' edges from the border of the picture [px]; None: no such
            constraint.
        barrier_gain: rate of the barriers [1/s]: a marker may approach the border no faster than
            the distance times it.
        plane_m: least distance of the camera from the plane of the target's markers [m]; None: no
            such constraint; e.g. `0.3`.
        least_singular_value: of the Jacobian, lengths in the arm's own unit [1]; under .05 all
            laws' velocities are damped. The arm does not leave its branch through a singularity of
            the wrist. 0: no such constraint.
        joint_margin: distance from its limit at which a joint comes to rest [rad; m for one that
            slides].
        damper_s: in which time a joint may reach that margin [s].
        accelerations: whether the robot's accelerations count.
        secondary: tasks beside the law's: posture, straight, manipulability.
        limits: largest speed and rate of the camera's twist, here as a constraint.

    References: Ames et al. 2019, doi:10.23919/ECC.2019.8796030; Faverjon & Tournassoud 1987,
    doi:10.1109/ROBOT.1987.1087982; quadratic programs for visual servoing: Agravante, Claudio,
    Spindler & Chaumette 2017, doi:10.1109/LRA.2016.2645512.
    """

    kind: Literal["qp"] = "qp"
    law: Annotated[IBVS | Partitioned | PBVS | Hybrid, SERVO] = IBVS()
    margin_px: Pixels | None = 5.0
    barrier_gain: PositiveGain = 3.0
    plane_m: Distance | None = None
    least_singular_value: Annotated[float, Ge(0), Le(1)] = 0.05
    joint_margin: Annotated[float, Ge(0), Le(1)] = 0.035
    damper_s: PositiveTime = 0.3
    accelerations: bool = True
    secondary: tuple[Secondary, ...] = ()
    limits: TwistLimits = TwistLimits()
    modes = program_modes(GIVE_WAY)

    tasks = _of_law("tasks")
    depth = _of_law("depth")
    feature = _of_law("feature")
    feedforward = _of_law("feedforward")
    cameras = _of_law("cameras")
    needs_same_markers = _of_law("needs_same_markers")
    state_size = _of_law("state_size")

    @property
    def inputs(self) -> tuple[str, ...]:
        """Those of the law within, the robot, and what the constraints need."""
        named = [*inputs_of(self.law), "robot"]
        if self.margin_px is not None or self.plane_m is not None:
            named += "xy", "depth", "radius_px"
        for task in self.secondary:
            named += task.inputs
        return tuple(dict.fromkeys(named))

    def markers_needed(self, basis: Array) -> int:
        """As many as the law within."""
        return self.law.markers_needed(basis)

    def check(self, points: Array, goal: Goal) -> None:
        self.law.check(points, goal)

    def check_view(
        self, goal: Goal, marker_radius_m: float, called: Callable[[int], str] = str
    ) -> None:
        """Refuse a goal with a marker inside the margin, where the barrier would not let it."""
        self.law.check_view(goal, marker_radius_m, called)
        if self.margin_px is not None and len(goal.camera.panels) == 1:
            check_margin("law.margin_px", self.margin_px, goal, marker_radius_m, called)
        distance = float(goal.normal @ goal.middle)
        if self.plane_m is not None and distance <= self.plane_m:
            words = (
                f"{distance:.4g} m, the distance of the goal from the target's plane,"
                " which it would keep the camera off"
            )
            raise ParameterError.bound("law.plane_m", "under", words, self.plane_m)

    def init(self, goal: Goal) -> ErrorState:
        return self.law.init(goal)

    def prepare(self) -> None:
        super().prepare()
        load_solver()

    def step(
        self, state: ErrorState, observation: Observation, goal: Goal, basis: Array
    ) -> tuple[ErrorState, Command]:
        """One frame; rest where the law within rests, or where the program was not solved."""
        robot = observation.robot
        assert robot is not None
        state, wanted = self.law.step(state, observation, goal, basis)
        if wanted.rest_reason and not wanted.twist.any():
            return state, replace(wanted, free=())
        solution = self._solved(wanted.twist, observation, goal, robot)
        command = solution.command(robot, basis, self.limits, GIVE_WAY)
        if solution.x is None:
            return state, command
        return state, replace(
            command, rest_reason=wanted.rest_reason, scale=command.scale * wanted.scale
        )

    def step_batch(self, state: Array, views: Views, goal: Goal) -> tuple[Array, Array]:
        """One frame of many runs (see `ErrorLaw.step_batch`): where the motion of the law within
        breaks no constraint, it is the solution.

        Only the programs of the others are solved, one by one; the ideal cameras of a batch have no
        joints.
        """
        state, twist = self.law.step_batch(state, views, goal)
        for i in np.flatnonzero(self._binds(views, twist, goal) & np.isfinite(twist[:, 0])):
            seen = views.of_run(int(i), self.inputs)
            assert seen.robot is not None
            x = self._solved(twist[i], seen, goal, seen.robot).x
            twist[i] = np.nan if x is None else x
        return state, self.limits.within(twist)

    def _binds(self, views: Views, twist: Array, goal: Goal) -> NDArray[np.bool_]:
        """Which runs' twists (M, 6) break a constraint, (M,)."""
        if self.secondary or self.plane_m is not None:
            return np.ones(len(twist), dtype=bool)
        binds = self.limits.within(twist) != twist
        if self.margin_px is None or len(goal.camera.panels) > 1:
            return binds.any(axis=1)
        M, N, _ = views.p.shape
        distance, inwards = goal.camera.borders(views.uv.reshape(-1, 2))
        h = (distance - views.radius_px.reshape(-1, 1) - self.margin_px).reshape(M, -1)
        p = (views.ray * views.range[..., None]).reshape(-1, 3)
        L = pixel_interaction(goal.camera, p).reshape(M, N, 2, 6)
        uv_dot = np.einsum("mnki,mi->mnk", L, twist).reshape(-1, 2)
        h_dot = np.einsum("nbk,nk->nb", inwards, uv_dot).reshape(M, -1)
        return (h_dot < -self.barrier_gain * h).any(axis=1) | binds.any(axis=1)

    def _solved(self, wanted: Array, seen: Observation, goal: Goal, robot: OwnModel) -> Solution:
        """The velocities that come nearest to the camera twist `wanted` (6,)."""
        low, high, too_quick = velocity_bounds(
            robot, self.joint_margin, self.damper_s, self.accelerations
        )
        barriers = []  # the softest first
        if self.least_singular_value > 0:
            barriers.append(off_singularities(robot, self.least_singular_value, self.barrier_gain))
        if self.margin_px is not None:
            barriers.append(border(seen, goal, robot, self.margin_px, self.barrier_gain))
        if self.plane_m is not None:
            barriers.append(above_plane(seen, goal, robot, self.plane_m, self.barrier_gain))
        twist = twist_limits(self.limits.speed_mps, self.limits.rate_radps, robot.J)
        groups = (*barriers, twist, shared_limits(robot, float(robot.J[:, 0] @ wanted)))
        W = self._weights(seen)
        main = W @ robot.J
        parts = [(main, W @ wanted), *rows_of(self.secondary, "weighted", seen, goal, robot)]
        n = len(robot.names)
        damping2 = singularity_damping2(robot.J, robot.unit_m) if n >= 6 else 0.0
        if damping2 > 0:  # as that of `resolved_rate`, by the weight of a twist
            damping = np.sqrt(damping2 * (np.einsum("ij,ij->", W, W) / 6))
            parts.append((damping * np.eye(n), np.zeros(n)))
        solution = minimise(*_stacked(parts), low, high, groups, units_of(goal, robot.J))
        strict = rows_of(self.secondary, "strict", seen, goal, robot)
        solution = among_solutions(solution, main, strict, low, high, groups)
        return solution.and_accelerations(too_quick)

    def _weights(self, seen: Observation) -> Array:
        """W: the interaction matrix of the law's feature; I where it has none, or sees nothing."""
        feature = self.law.feature
        if feature is None:
            return np.eye(6)
        rows = usable_rows(seen, feature.inputs, 1)
        if isinstance(rows, str):
            return np.eye(6)
        return feature.interaction(*(getattr(seen, name)[rows] for name in feature.inputs))
