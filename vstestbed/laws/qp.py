"""A law as a quadratic program: its motion in the least-squares sense, within what joints, picture and target allow."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal

import numpy as np
from annotated_types import Ge, Le
from numpy.typing import NDArray

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array
from vstestbed.core.quantity import Distance, Pixels, PositiveGain, PositiveTime
from vstestbed.core.spec import OneOf, spec
from vstestbed.features.base import Feature
from vstestbed.features.depth import Depth
from vstestbed.features.observation import Goal, Observation
from vstestbed.laws.base import Command, LawBase, TwistLimits
from vstestbed.laws.constraints import above_plane, border, damped, off_singularities, shared_limits, twist_limits, velocity_bounds
from vstestbed.laws.feedforward import Feedforward
from vstestbed.laws.hybrid import Hybrid
from vstestbed.laws.ibvs import IBVS
from vstestbed.laws.partitioned import Partitioned
from vstestbed.laws.pbvs import PBVS
from vstestbed.laws.program import Group, Solution, load_solver, minimise
from vstestbed.laws.secondary import Secondary, added, among_solutions
from vstestbed.laws.select import usable_rows
from vstestbed.laws.solve import least_squares
from vstestbed.laws.views import Views
from vstestbed.laws.visibility import check_margin, pixel_interaction
from vstestbed.robots.own_model import OwnModel

SERVO = OneOf("law", IBVS, Partitioned, PBVS, Hybrid, default="ibvs")
"""Laws whose motion a quadratic program may take."""
GIVE_WAY = ("singularity", "border", "plane", "twist", "shared", "acceleration")
"""Constraints in the order in which they give way; those of joint position and joint speed never do."""
FREE, BOUND, UNSOLVED = 0, 1, 2 + len(GIVE_WAY)


@dataclass(frozen=True, slots=True)
class QPMemory:
    """The memory of the law within."""

    servo: Any


@spec
class QP(LawBase):
    """The velocities x of the robot's joints that come nearest to a law's motion u, subject to constraints.

    min |W (J x - B u)|^2 + secondary tasks    subject to

    joint positions   x_i <= (q_max - margin - q) / damper_s, and alike below     (velocity damper)
    joint speeds      |x_i| <= its largest
    accelerations     |x_i - x_i before| <= its largest times the period
    shared            wheels' speeds of a platform, the tightest circle of a car
    twist             `limits` of the camera's twist
    singularity       the arm's smallest singular value stays over `least_singular_value` (barrier)
    plane             the camera stays `plane_m` from the target's plane          (barrier)
    border            markers stay `margin_px` within the picture                 (barrier)

    With W the law's interaction matrix L, the rows of the features count, as in least squares of the task itself: without a binding
    constraint the command is that of the law. Laws without an image feature (`pbvs`, `hybrid`, `partitioned`) have W = I in m and rad.
    Near singularities of an arm the velocities are damped as those of all other laws are (`resolved_rate`).
    A law alone is scaled as a whole when a joint reaches its stop, and ends there; here the other joints go on.

    Where constraints contradict each other, they give way one after the other: singularity, border, plane, twist, shared, acceleration;
    positions and speeds of the joints never do. The log's `law_mode` tells: 0 nothing binds, 1 a constraint binds, 2 to 7 the last of these
    that gave way, 8 the program was not solved, and the law rests.

    The law's gain, feature, depth, feedforward and inversion are those of `law`. Constraints hold where the command takes effect: latency
    is bridged by the robot's own measured motion.

    Args:
        law: whose motion is wanted: ibvs, pbvs, hybrid or partitioned, with its parameters.
        margin_px: distance of the markers' edges from the border of the picture [px]; None: no such constraint.
        barrier_gain: rate of the barriers [1/s]: a marker may approach the border no faster than the distance times it.
        plane_m: least distance of the camera from the plane of the target's markers [m]; None: no such constraint; e.g. `0.3`.
        least_singular_value: of the Jacobian, lengths in the arm's own unit [1]; under .05 all laws' velocities are damped. The arm
            does not leave its branch through a singularity of the wrist. 0: no such constraint.
        joint_margin: distance from its limit at which a joint comes to rest [rad; m for one that slides].
        damper_s: in which time a joint may reach that margin [s].
        accelerations: whether the robot's accelerations count.
        secondary: tasks beside the law's: posture, straight, manipulability.
        limits: largest speed and rate of the camera's twist, here as a constraint.

    References: Ames et al. 2019, doi:10.23919/ECC.2019.8796030; Faverjon & Tournassoud 1987, doi:10.1109/ROBOT.1987.1087982; quadratic
    programs for visual servoing: Agravante, Claudio, Spindler & Chaumette 2017, doi:10.1109/LRA.2016.2645512.
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
    modes = ("free", "constrained", *(f"{word} gave way" for word in GIVE_WAY), "not solved")

    @property
    def tasks(self) -> tuple[str, ...]:  # pyright: ignore[reportIncompatibleVariableOverride] - a property in place of a constant
        """Those of the law within."""
        return self.law.tasks

    @property
    def inputs(self) -> tuple[str, ...]:  # pyright: ignore[reportIncompatibleVariableOverride] - a property in place of a constant
        """Those of the law within, the robot, and what the constraints need."""
        seen = ("xy", "depth", "radius_px") if self.margin_px is not None or self.plane_m is not None else ()
        named = (*self.law.inputs, "robot", *seen, *(name for task in self.secondary for name in task.inputs))
        return tuple(dict.fromkeys(named))

    @property
    def depth(self) -> Depth:  # pyright: ignore[reportIncompatibleVariableOverride] - a property in place of a constant
        """That of the law within."""
        return self.law.depth

    @property
    def feature(self) -> Feature | None:  # pyright: ignore[reportIncompatibleVariableOverride] - a property in place of a constant
        """That of the law within."""
        return self.law.feature

    @property
    def feedforward(self) -> Feedforward:  # pyright: ignore[reportIncompatibleVariableOverride] - a property in place of a constant
        """That of the law within."""
        return self.law.feedforward

    @property
    def needs_same_markers(self) -> bool:  # pyright: ignore[reportIncompatibleVariableOverride] - a property in place of a constant
        """Those of the law within."""
        return self.law.needs_same_markers

    def markers_needed(self, basis: Array) -> int:
        """As many as the law within."""
        return self.law.markers_needed(basis)

    def check(self, points: Array, goal: Goal) -> None:
        """What the law within refuses."""
        self.law.check(points, goal)

    def check_view(self, goal: Goal, marker_radius_m: float, called: Callable[[int], str] = str) -> None:
        """Refuse a goal with a marker inside the margin, where the barrier would not let it."""
        self.law.check_view(goal, marker_radius_m, called)
        if self.margin_px is not None and len(goal.camera.panels) == 1:
            check_margin("law.margin_px", self.margin_px, goal, marker_radius_m, called)
        if self.plane_m is not None and (distance := float(goal.normal @ goal.middle)) <= self.plane_m:
            words = f"must be under {distance:.4g} m, the distance of the goal from the target's plane, which it would keep the camera off"
            raise ParameterError("law.plane_m", words, self.plane_m)

    def init(self, goal: Goal) -> QPMemory:
        """The memory of the law within."""
        return QPMemory(self.law.init(goal))

    def prepare(self) -> None:
        """The solvers of the program, and of `least_squares`."""
        super().prepare()
        load_solver()

    def step(self, memory: QPMemory, observation: Observation, goal: Goal, basis: Array) -> tuple[QPMemory, Command]:
        """One frame; rest where the law within rests, or where the program was not solved."""
        robot = observation.robot
        assert robot is not None
        kept, wanted = self.law.step(memory.servo, observation, goal, basis)
        if wanted.rest_reason and not wanted.twist.any():
            return QPMemory(kept), replace(wanted, free=())
        solution, gave_way = self._solved(wanted, observation, goal, robot)
        if solution.x is None:
            return QPMemory(kept), replace(Command.rest(basis, solution.failure), mode=UNSOLVED)
        mode = 2 + GIVE_WAY.index(gave_way[-1]) if gave_way else BOUND if solution.bound else FREE
        twist = robot.J @ solution.x
        scale = self.limits.scale(twist)
        rates, twist = solution.x * scale, twist * scale
        u = twist if basis.shape == (6, 6) else least_squares(basis, twist)
        return QPMemory(kept), Command(u, twist, wanted.rest_reason, scale * wanted.scale, rates=rates, mode=mode)

    @property
    def state_size(self) -> int:
        """As that of the law within."""
        return self.law.state_size

    def step_batch(self, memory: Array, views: Views, goal: Goal) -> tuple[Array, Array]:
        """One frame of many runs (see `BatchLaw`): where the motion of the law within breaks no constraint, it is the solution.

        Only the programs of the others are solved, one by one; the ideal cameras of a batch have no joints.
        """
        memory, twist = self.law.step_batch(memory, views, goal)
        for i in np.flatnonzero(self._binds(views, twist, goal) & np.isfinite(twist[:, 0])):
            seen = views.of_run(int(i), self.inputs)
            assert seen.robot is not None
            x = self._solved(Command(twist[i], twist[i]), seen, goal, seen.robot)[0].x
            twist[i] = np.nan if x is None else x
        return memory, self.limits.within(twist)

    def _binds(self, views: Views, twist: Array, goal: Goal) -> NDArray[np.bool_]:
        """Which runs' twists (M, 6) break a constraint, (M,)."""
        if self.secondary or self.plane_m is not None:
            return np.ones(len(twist), dtype=bool)
        binds = self.limits.within(twist) != twist
        if self.margin_px is None or len(goal.camera.panels) > 1:
            return binds.any(axis=1)
        M, N, _ = views.p.shape
        distance, inwards = goal.camera.borders(goal.camera.project(views.p.reshape(-1, 3)))
        h = (distance - views.radius_px.reshape(-1, 1) - self.margin_px).reshape(M, -1)
        L = pixel_interaction(goal.camera, (views.ray * views.range[..., None]).reshape(-1, 3)).reshape(M, N, 2, 6)
        uv_dot = np.einsum("mnki,mi->mnk", L, twist).reshape(-1, 2)
        h_dot = np.einsum("nbk,nk->nb", inwards, uv_dot).reshape(M, -1)
        return (h_dot < -self.barrier_gain * h).any(axis=1) | binds.any(axis=1)

    def _solved(self, wanted: Command, seen: Observation, goal: Goal, robot: OwnModel) -> tuple[Solution, tuple[str, ...]]:
        """The velocities, and the words of what gave way, in the order of GIVE_WAY."""
        low, high, too_quick = velocity_bounds(robot, self.joint_margin, self.damper_s, self.accelerations)
        groups = self._groups(wanted, seen, goal, robot)
        W = self._metric(seen)
        main = W @ robot.J, W @ wanted.twist
        calm = damped(robot, float(np.einsum("ij,ij->", W, W)) / 6)
        A, b = added(*main, self.secondary, seen, goal, robot)
        solution = minimise(np.vstack([A, calm]), np.concatenate([b, np.zeros(len(calm))]), low, high, groups)
        if solution.x is not None:
            solution = among_solutions(solution, main[0], self.secondary, seen, goal, robot, low, high, groups)
        return solution, solution.gave_way + (("acceleration",) if too_quick else ())

    def _groups(self, wanted: Command, seen: Observation, goal: Goal, robot: OwnModel) -> tuple[Group, ...]:
        """The inequalities, the softest first."""
        groups = []
        if self.least_singular_value > 0:
            groups.append(off_singularities(robot, self.least_singular_value, self.barrier_gain))
        if self.margin_px is not None:
            groups.append(border(seen, goal, robot, self.margin_px, self.barrier_gain, np.zeros(6)))
        if self.plane_m is not None:
            groups.append(above_plane(seen, goal, robot, self.plane_m, self.barrier_gain))
        return (
            *groups,
            twist_limits(self.limits.speed_mps, self.limits.rate_radps, robot.J),
            shared_limits(robot, float(robot.J[:, 0] @ wanted.twist)),
        )

    def _metric(self, seen: Observation) -> Array:
        """W: the interaction matrix (m, 6) of the law's feature now, or I."""
        feature = self.law.feature
        rows = "" if feature is None else usable_rows(seen, feature.inputs, 1)
        if feature is None or isinstance(rows, str):
            return np.eye(6)
        what, distance = feature.inputs
        return feature.interaction(getattr(seen, what)[rows], getattr(seen, distance)[rows])
