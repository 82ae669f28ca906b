"""Visual predictive control: velocities over a horizon that bring the features to the goal, within
what joints and picture allow.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge, Le
from numpy.typing import NDArray

from vstestbed.camera.base import pixel_interaction
from vstestbed.core.geometry import Array, adjoint, exp, homogeneous, inverse, skew, transform
from vstestbed.core.quantity import Pixels, PositiveGain, PositiveTime
from vstestbed.core.spec import spec
from vstestbed.features import FEATURES, Point
from vstestbed.features.base import Feature
from vstestbed.features.depth import Depth, PnP
from vstestbed.features.observation import Goal, Observation
from vstestbed.laws.base import Command, Law, TwistLimits
from vstestbed.laws.constraints import (
    Group,
    Solution,
    load_solver,
    minimise,
    program_modes,
    shared_limits,
    twist_limits,
    velocity_bounds,
)
from vstestbed.laws.error_law import ErrorState, StackWeight
from vstestbed.laws.feedforward import Estimator, Feedforward, NoFeedforward
from vstestbed.laws.ibvs import IBVS
from vstestbed.laws.points import Rows, check_margin, points, usable_rows
from vstestbed.laws.solve import units_of
from vstestbed.robots.own_model import OwnModel

STILL = np.zeros(6)
Blocks = NDArray[np.intp]  # the block of each period (K,), over which velocities are constant


@dataclass(frozen=True, slots=True)
class Predicted:
    """A robot under a plan, at the ends of the K periods to come; the first begins when this
    frame's command takes effect.

    Attributes:
        p_begin: the markers in the camera frame at the beginning (N, 3) [m].
        p: the same at the ends (K, N, 3).
        D: change of the camera's pose, as a twist (v, w) in the camera's own frame, with the plan:
            (K, 6, B n).
        q: positions (K, n).
        Q: their change with the plan (K, n, B n).
        J: the Jacobian during each period (K, 6, n).
    """

    p_begin: Array
    p: Array
    D: Array
    q: Array
    Q: Array
    J: Array


def blocks_of(horizon: int, blocks: int) -> Blocks:
    """The block of each period (K,): a plan's velocities are constant over each block, and blocks
    grow, as the first periods matter most.

    Reference: Cagienard, Grieder, Kerrigan & Morari 2007, doi:10.1016/j.jprocont.2007.01.001 (move
    blocking).
    """
    left = horizon
    lengths = []
    blocks = min(blocks, horizon)
    for after in reversed(range(blocks)):
        length = max(1, left // 2**after) if after else left
        lengths.append(min(length, left - after))
        left -= lengths[-1]
    return np.repeat(np.arange(blocks), lengths)


def beginnings(block: Blocks) -> NDArray[np.intp]:
    """The first period of each block (B,)."""
    return np.flatnonzero(np.diff(block, prepend=-1))


def shifted(plan: Array, block: Blocks) -> Array:
    """A plan (B, n) a period later; the last velocities stay."""
    each = plan[block]
    return np.vstack([each[1:], each[-1:]])[beginnings(block)]


def lagged(block: Blocks, plan: Array, before: Array, lag: float) -> tuple[Array, Array]:
    """Mean velocities (K, n) in each period of first-order servos, and their change with the
    blocks' orders, (K, B), alike for each n.

    With a = exp(-1/lag) and g = lag (1 - a): mean = (1 - g) u + g r, and r' = (1 - a) u + a r at
    the end of the period.

    block: of each period (K,). plan: (B, n). before: the velocity r at the beginning (n,). lag:
    time constant in periods.
    """
    decay = math.exp(-1 / lag) if lag > 0 else 0.0
    kept = lag * (1 - decay)
    order = np.eye(len(plan))  # of each block, its change with the blocks' orders
    r = before
    r_change = np.zeros(len(plan))
    means = []
    changes = []
    for b in block:
        means.append((1 - kept) * plan[b] + kept * r)
        changes.append((1 - kept) * order[b] + kept * r_change)
        r = (1 - decay) * plan[b] + decay * r
        r_change = (1 - decay) * order[b] + decay * r_change
    return np.array(means), np.array(changes)


def predict(
    p: Array,
    robot: OwnModel,
    block: Blocks,
    plan: Array,
    relinearise: bool,
    target: Array = STILL,
) -> Predicted:
    """What a plan (B, n) does, from markers p (N, 3) [m] in the camera frame at the exposure.

    The camera's pose follows T <- T exp(period J mean) exactly; a small change d of the pose before
    a period has become Ad(exp(-period J mean)) d at its end, to which period J times the change of
    the velocity is added, less half of its bracket with the twist: the derivative of the
    exponential to second order.

    block: of each period (K,). relinearise: J at the predicted positions; else that of now
    throughout. target: camera twist (6,) that would move the markers as the target's own motion
    does.
    """
    n = len(robot.names)
    period = robot.period_s
    mean, mean_change = lagged(block, plan, robot.ordered, robot.lag_s / period)
    way = mean * period
    # of the way in each period with the plan (K, n, B n): alike for each velocity
    way_change = np.kron(mean_change, np.eye(n)).reshape(-1, n, plan.size) * period
    p_begin = transform(exp(-(robot.way + target * robot.underway_s)), p)
    p = p_begin
    q = robot.q_then
    D = np.zeros((6, plan.size))
    Q = np.zeros((n, plan.size))
    found = []
    for step, step_change in zip(way, way_change, strict=True):
        J = robot.jacobian(q) if relinearise else robot.J
        twist = J @ step + target * period
        back = exp(-twist)
        change = J @ step_change
        V = skew(twist[:3])
        W = skew(twist[3:])
        bracket = np.block([[W, V], [np.zeros((3, 3)), W]])
        D = adjoint(back) @ D + change - bracket @ change / 2
        p = transform(back, p)
        q = q + step
        Q = Q + step_change
        found.append((p, D, q, Q, J))
    return Predicted(p_begin, *map(np.stack, zip(*found, strict=True)))


GIVE_WAY = ("border", "positions", "twist", "shared", "acceleration")
"""Constraints in the order in which they give way; bounds of the next command by joint limits and
speeds never do.
"""
# most motion in a period for which the prediction is linearised, in distances of the nearest marker
# and in rad
TRUST = 0.1
LEAST_DEPTH = 1e-3  # depth under which no feature is computed, in distances at the goal
PlanState = tuple[Array | None, ErrorState | None]
"""The velocities planned in the last frame (B, n), and the state of the target's estimated motion;
None before the first frame.
"""


@spec
class Predictive(Law[PlanState]):
    """min over u_1 ... u_B of  sum over k = 1 ... K of |e_k - exp(-gain k T) e_0|^2 +
    effort |u|^2,   of which u_1 is ordered.

    e_k = s(p_k) - s* is the error at the end of the k-th camera period T, predicted with the
    robot's model: servos of first order with their lag, the Jacobian at the joints of that time,
    the markers moved as rigid bodies. e_0 is that at the time when the command takes effect:
    latency is part of the model. The prediction is made with the plan of the last frame and
    linearised about it (one step of sequential quadratic programming a frame); plans are constant
    over `blocks` of growing length.

    Subject to, over the whole horizon: markers' edges `margin_px` inside the picture; joint
    positions, speeds and accelerations; `limits` of the camera's twist. Where they contradict each
    other, they give way one after the other: border, positions (of later periods; the next command
    always stops before a joint limit), twist, shared, acceleration. The log's `law_mode` tells: 0
    nothing binds, 1 a constraint binds, 2 to 6 the last of these that gave way, 7 the program was
    not solved, and the law rests.

    One linearisation a frame holds for small motions: in a period the camera turns by 0.1 rad at
    most, and moves by 0.1 of its distance from the nearest marker. A robot without limits of its
    own needs that.

    Without a binding constraint, latency and lag, it moves as `ibvs` of the same gain does with the
    current interaction matrix.

    Args:
        gain: decay of the wanted error [1/s]. Where gain K T is under .5, the wanted way is little
            more than its beginning, and the camera retreats from a large rotation about its axis as
            that of `ibvs` does.
        feature: the feature s.
        horizon: K, number of periods that are predicted [1].
        blocks: B, number of velocities in a plan, at most the horizon [1].
        model: `global` takes interaction matrix and Jacobian along the predicted way, `local` those
            of now throughout.
        effort: weight of squared velocities, as a share of the features' largest [1].
        margin_px: distance of the markers' edges from the border of the picture [px]; None: no such
            constraint.
        joint_margin: distance from its limit at which a joint comes to rest [rad; m for one that
            slides].
        damper_s: in which time a joint may reach that margin [s].
        accelerations: whether the robot's accelerations count.
        depth: source of Z (for `spherical`, of the range).
        limits: largest speed and rate of the camera's twist, here as a constraint.
        feedforward: estimates the motion of the target, as that of `ibvs` does; it goes on over the
            horizon.
        cameras: further cameras by name, whose errors are predicted and count, too, with the
            weights of their squares; e.g. `{right: 1}`.

    References: Allibert, Courtial & Chaumette 2010, doi:10.1109/TRO.2010.2056590; Sauvée, Poignet,
    Dombre & Courtial 2006, doi:10.1109/CDC.2006.377808; one step of sequential quadratic
    programming a frame: Diehl, Bock & Schlöder 2005, doi:10.1137/S0363012902400713.
    """

    kind: Literal["predictive"] = "predictive"
    gain: PositiveGain = 2.0
    feature: Annotated[Feature, FEATURES] = Point()
    horizon: Annotated[int, Ge(1), Le(50)] = 10
    blocks: Annotated[int, Ge(1), Le(50)] = 4
    model: Literal["global", "local"] = "global"
    effort: Annotated[float, Ge(0), Le(1e3)] = 1e-6
    margin_px: Pixels | None = 5.0
    joint_margin: Annotated[float, Ge(0), Le(1)] = 0.035
    damper_s: PositiveTime = 0.3
    accelerations: bool = True
    depth: Depth = PnP()
    limits: TwistLimits = TwistLimits()
    feedforward: Feedforward = NoFeedforward()
    cameras: dict[str, StackWeight] = field(default_factory=dict)
    modes = program_modes(GIVE_WAY)
    stacks = True

    @property
    def inputs(self) -> tuple[str, ...]:  # pyright: ignore[reportIncompatibleVariableOverride] - a property in place of a constant
        """The inputs of the feature, the robot, and the markers' radii for the border."""
        radius = ("radius_px",) if self.margin_px is not None else ()
        return *self.feature.inputs, "robot", *radius

    @property
    def needs_same_markers(self) -> bool:  # pyright: ignore[reportIncompatibleVariableOverride] - a property in place of a constant
        """As `ibvs` with this feature."""
        return self._ibvs.needs_same_markers

    def markers_needed(self, basis: Array) -> int:
        """As many as `ibvs` with this feature."""
        return self._ibvs.markers_needed(basis)

    def check(self, points: Array, goal: Goal) -> None:
        self._ibvs.check(points, goal)

    def check_view(
        self, goal: Goal, marker_radius_m: float, called: Callable[[int], str] = str
    ) -> None:
        """Refuse a goal with a marker inside the margin, where the constraint would not let it."""
        if self.margin_px is not None and len(goal.camera.panels) == 1:
            check_margin("law.margin_px", self.margin_px, goal, marker_radius_m, called)

    @cached_property
    def _ibvs(self) -> IBVS:
        """The law with this feature, source of depth and feedforward, whose estimate of the
        target's motion it takes.
        """
        return IBVS(feature=self.feature, depth=self.depth, feedforward=self.feedforward)

    def init(self, goal: Goal) -> PlanState:
        return None, None

    def prepare(self) -> None:
        super().prepare()
        load_solver()

    def step(
        self, state: PlanState, observation: Observation, goal: Goal, basis: Array
    ) -> tuple[PlanState, Command]:
        """One frame with the visible markers; rest when they are too few, or where the program was
        not solved.
        """
        rows = usable_rows(observation, self.feature.inputs, self.markers_needed(basis))
        if isinstance(rows, str):
            return (None, None), Command.rest(basis, rows)
        robot = observation.robot
        before, tracked = state
        assert robot is not None
        # the camera twist (6,) that would move the markers as the target's own motion does
        target = STILL
        if isinstance(self.feedforward, Estimator):
            tracked, _ = self._ibvs.step(tracked or self._ibvs.init(goal), observation, goal, basis)
            target = STILL if tracked.target is None else basis @ tracked.target.rate
        if before is None:
            plan = np.tile(robot.ordered, (self._block[-1] + 1, 1))
        else:
            plan = shifted(before, self._block)
        solution = self._solved(rows, observation, goal, robot, plan, target)
        command = solution.command(robot, basis, self.limits, GIVE_WAY)
        if solution.x is None:
            return (None, None), command
        return (solution.x.reshape(plan.shape), tracked), command

    @cached_property
    def _block(self) -> Blocks:
        """The block of each period (K,)."""
        return blocks_of(self.horizon, self.blocks)

    def _solved(
        self, rows: Rows, seen: Observation, goal: Goal, robot: OwnModel, plan: Array, target: Array
    ) -> Solution:
        """The plan as one vector."""
        p = points(seen)[rows]
        relinearise = self.model == "global"
        ahead = predict(p, robot, self._block, plan, relinearise, target)
        # of a plan that flies through the target nothing can be predicted
        if not _in_front(ahead.p, self.feature, goal):
            plan = np.zeros_like(plan)
            ahead = predict(p, robot, self._block, plan, relinearise, target)
            if not _in_front(ahead.p, self.feature, goal):
                return Solution(None, failure="a marker is predicted behind the camera")
        u = plan.ravel()
        A, b = self._objective(ahead, seen, goal, rows, robot, u)
        low, high, too_quick = velocity_bounds(
            robot, self.joint_margin, self.damper_s, self.accelerations
        )
        # only speeds are bounded after the next command
        later = np.tile(robot.speed, len(plan) - 1)
        low = np.concatenate([low, -later])
        high = np.concatenate([high, later])
        trusted = self._trusted(p, robot.period_s)
        shared = shared_limits(robot, float(plan[0, 0]))
        # The camera's twist in each block, at the Jacobian with which it begins.
        of_blocks = [twist_limits(*trusted, J) for J in ahead.J[beginnings(self._block)]]
        A_of_blocks = [part.A for part in of_blocks]
        rows_of_blocks = np.einsum("bmn,bc->bmcn", A_of_blocks, np.eye(len(of_blocks)))
        low_of_blocks = np.concatenate([part.low for part in of_blocks])
        twist = Group("twist", rows_of_blocks.reshape(-1, len(u)), low_of_blocks)
        repeated = np.asarray(np.kron(np.eye(len(plan)), shared.A), dtype=float)
        groups = [
            self._positions(ahead, robot, u),
            twist,
            Group("shared", repeated, np.tile(shared.low, len(plan))),
            self._slopes(robot),
        ]
        if self.margin_px is not None:
            groups.insert(0, self._border(ahead, seen, goal, rows, u))
        solution = minimise(A, b, low, high, tuple(groups), self._units(goal, robot))
        return solution.and_accelerations(too_quick)

    def _trusted(self, p: Array, period_s: float) -> tuple[float, float]:
        """Largest speed [m/s] and rate [rad/s] within the law's limits and those within which the
        linearisation holds (TRUST).
        """
        # Numbers, no TwistLimits: of a marker far away, or at a high frame rate, they are beyond
        # what a scenario may give.
        speed = TRUST * float(np.linalg.norm(p, axis=-1).min()) / period_s
        rate = TRUST / period_s
        given = self.limits
        return min(speed, given.speed_mps or speed), min(rate, given.rate_radps or rate)

    def _objective(
        self, ahead: Predicted, seen: Observation, goal: Goal, rows: Rows, robot: OwnModel, u: Array
    ) -> tuple[Array, Array]:
        """A and b of the wanted A u = b, of the law's camera and of the further ones, in whose
        frames the prediction is the same motion.
        """
        parts = [self._wanted(ahead, goal, rows, robot, u)]
        for name, weight in self.cameras.items():
            view = (seen.cameras or {}).get(name)
            if view is None or view.goal is None:
                continue
            back = inverse(view.T_camera_this)
            moved = replace(
                ahead,
                p_begin=transform(back, ahead.p_begin),
                p=transform(back, ahead.p),
                D=adjoint(back) @ ahead.D,
            )
            if _in_front(moved.p, self.feature, goal):
                A, b = self._wanted(moved, view.goal, rows, robot, u)
                parts.append((math.sqrt(weight) * A, math.sqrt(weight) * b))
        A = np.vstack([A for A, _ in parts])
        b = np.concatenate([b for _, b in parts])
        units = self._units(goal, robot)
        scaled = A * units
        weight = np.sqrt(self.effort * float(np.einsum("ij,ij->", scaled, scaled)) / len(u))
        A = np.vstack([A, weight * np.eye(len(u)) / units])
        return A, np.concatenate([b, np.zeros(len(u))])

    def _units(self, goal: Goal, robot: OwnModel) -> Array:
        """Units (B n,) of the plan's velocities."""
        units = np.broadcast_to(units_of(goal, robot.J), len(robot.names))
        return np.tile(units, self._block[-1] + 1)

    def _wanted(
        self, ahead: Predicted, goal: Goal, rows: Rows, robot: OwnModel, u: Array
    ) -> tuple[Array, Array]:
        """A and b of the wanted A u = b of one camera."""
        feature = self.feature
        K = len(ahead.p)
        s_star = feature.measure(getattr(goal, feature.inputs[0])[rows])
        x, distance = _inputs(ahead.p, feature.inputs)
        e = feature.error(feature.measure(x), s_star)
        L = feature.interaction(x, distance)
        if self.model == "local":
            L = np.broadcast_to(L[0], L.shape)
        change = L @ ahead.D  # (K, rows, B n)
        start = feature.error(feature.measure(_inputs(ahead.p_begin, feature.inputs)[0]), s_star)
        wanted = start * np.exp(-self.gain * robot.period_s * np.arange(1, K + 1))[:, None]
        return change.reshape(-1, len(u)), (wanted - e + change @ u).ravel()

    def _positions(self, ahead: Predicted, robot: OwnModel, u: Array) -> Group:
        """Joint positions within their limits, less the margin, at the end of each period."""
        limited = np.isfinite(robot.low) | np.isfinite(robot.high)
        Q = ahead.Q[:, limited]
        q = (ahead.q - ahead.Q @ u)[:, limited]
        below = (robot.low + self.joint_margin)[limited] - q
        above = q - (robot.high - self.joint_margin)[limited]
        A = np.concatenate([Q, -Q]).reshape(-1, len(u))
        low = np.concatenate([below, above]).ravel()
        return Group.finite("positions", A, low)

    def _slopes(self, robot: OwnModel) -> Group:
        """Accelerations from block to block."""
        lengths = np.bincount(self._block)
        quick = np.isfinite(robot.acceleration)
        n = len(robot.names)
        B = len(lengths)
        if not self.accelerations or B == 1 or not quick.any():
            return Group.none("acceleration", B * n)
        rows = np.kron(np.eye(B)[1:] - np.eye(B)[:-1], np.eye(n)[quick])
        most = np.outer(lengths[:-1], robot.acceleration[quick] * robot.period_s).ravel()
        A = np.asarray(np.vstack([rows, -rows]), dtype=float)
        return Group("acceleration", A, np.tile(-most, 2))

    def _border(
        self, ahead: Predicted, seen: Observation, goal: Goal, rows: Rows, u: Array
    ) -> Group:
        """Markers' edges inside the picture, less the margin, at the end of each period."""
        camera = goal.camera
        K = len(ahead.p)
        if len(camera.panels) > 1:
            return Group.none("border", len(u))
        flat = ahead.p.reshape(-1, 3)
        L = pixel_interaction(camera, flat)
        distance, inwards = camera.borders(camera.project(flat))
        radius = 0.0 if seen.radius_px is None else np.tile(seen.radius_px[rows], K)[:, None]
        h = (distance - radius - (self.margin_px or 0.0)).reshape(K, -1)
        change = np.einsum("mbk,mki->mbi", inwards, L).reshape(K, -1, 6) @ ahead.D
        return Group.finite("border", change.reshape(-1, len(u)), (change @ u - h).ravel())


def _in_front(p: Array, feature: Feature, goal: Goal) -> bool:
    """Whether the feature is defined for points p (K, N, 3) [m]."""
    near = np.linalg.norm(p, axis=-1) if feature.inputs[0] == "ray" else p[..., 2]
    return bool(near.min() > LEAST_DEPTH * goal.reach_m)


def _inputs(p: Array, names: tuple[str, ...]) -> tuple[Array, Array]:
    """The inputs of a feature, xy or xyw and depth, or ray and range, of points (K, N, 3) [m]."""
    if names[0] == "xy":
        return p[..., :2] / p[..., 2:], p[..., 2]
    if names[0] == "xyw":
        return homogeneous(p[..., :2]) / p[..., 2:], p[..., 2]
    reach = np.linalg.norm(p, axis=-1)
    return p / reach[..., None], reach
