"""Laws of an error e and its Jacobian J, e_dot = J v: a law gives its equations, over one view or
many; all else stands here.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Annotated, Any

import numpy as np
from annotated_types import Gt, Le

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array, adjoint, exp, inverse
from vstestbed.core.quantity import Time
from vstestbed.core.spec import spec
from vstestbed.features.observation import CameraView, Goal, Observation
from vstestbed.laws.base import Command, ConstantGain, Gain, Law, Motions, TwistLimits, Views, held
from vstestbed.laws.feedforward import (
    Estimator,
    Feedforward,
    Integral,
    NoFeedforward,
    TargetEstimate,
    follow,
    look_ahead,
)
from vstestbed.laws.points import (
    ALL,
    NO_POSE,
    TOO_FEW,
    Rows,
    Visibility,
    reckoned_markers,
    usable_rows,
)
from vstestbed.laws.solve import Solve, least_squares, units_of

StackWeight = Annotated[float, Gt(0), Le(1e3)]
Equations = tuple[Array, Array]
"""An error e (..., rows) and its Jacobian J (..., rows, 6), e_dot = J v."""
DEAD_RECKON_S = 0.3
"""How long what is not seen is dead-reckoned by the estimated motion of the target [s]: longer, and
what it accelerates by counts.
"""


@dataclass(frozen=True, slots=True)
class ErrorState:
    """The state of a law of an error between frames: of the shape of its command, and of the
    tracker of its feedforward.

    Attributes:
        extra: numbers (k,) that a law adds to it, NaN before the first frame
            (`ErrorLaw.extra_size`).
        t0: time of the first command [s]; it and the next three only where a later command depends
            on them.
        u0: the first command without the smooth start (n,).
        t: time of the last command [s].
        u: the last command, before limits (n,).
        seen: the last observation, with what was dead-reckoned, with which the next is compared;
            None before the first.
        known_t: time of the last observation that sufficed for the law [s]; NaN before the first.
        marker_t: time of the last observation of each marker (N,) [s]; None before the first.
        target: the estimate of the target's motion.
        integral: integral of the remaining motion (n,), for the feedforward `integral`.
    """

    extra: Array
    t0: float = math.nan
    u0: Array | None = None
    t: float = math.nan
    u: Array | None = None
    seen: Observation | None = None
    known_t: float = math.nan
    marker_t: Array | None = None
    target: TargetEstimate | None = None
    integral: Array | None = None


@spec
class ErrorLaw(Law[ErrorState], ABC):
    """u = -gain pinv(J B) e, camera twist v = B u, for an error e with e_dot = J v: a law of one's
    own gives `equations` alone.

        class Mine(ErrorLaw):  # with @LAWS.add and @spec
            kind: Literal["mine"] = "mine"
            inputs = ("xy", "depth")  # the fields of a view that `equations` reads

            def equations(self, view, goal): ... return e, J

    With `smooth_start_s` = tau the command grows from rest: u - u(0) exp(-t/tau). With
    `smoothing_s` = T it is filtered: u_k = u_(k-1) + (1 - exp(-dt/T)) (u - u_(k-1)), from the first
    command on. A goal view that moves along a path adds its own velocity u*.

    With `feedforward` a moving target is tracked without lag, for DEAD_RECKON_S also while it is
    not visible.

    Args:
        gain: lambda [1/s], a number or an adaptive gain of the remaining motion pinv(J B) e.
        solve: inversion of J B (`Solve`), in the estimate of the feedforward, too.
        smooth_start_s: tau [s]; 0 starts with the full command.
        smoothing_s: time constant of a low-pass filter of the command [s]; 0: none. An exponential
            average that gives each new command the weight a is -1/(rate ln(1 - a)): 0.0249 s for
            a = 0.8 at 25 pictures a second.
        keep_last: where too few markers are seen, go on with the last command in place of rest,
            until `stop.lost_after_s`.
        limits: largest speed and rate of the commanded twist.
        visibility: repulsive field at the border of the image.
        feedforward: the feedforward term for a moving target.
        cameras: further cameras by name, with the weights of their squared errors: their equations
            stand below those of the law's own camera, J_i Ad(T_i_camera), and each adds what it
            sees; e.g. `{right: 1}`.

    References: Chaumette & Hutchinson 2006, eqs 3-5, doi:10.1109/MRA.2006.250573; moving target:
    Chaumette & Hutchinson 2007, doi:10.1109/MRA.2007.339609; smooth start: Mansard & Chaumette
    2007, doi:10.1109/TRO.2006.889487; several cameras: Malis, Chaumette & Boudet 2000,
    doi:10.1109/ROBOT.2000.844150.
    """

    gain: Gain = ConstantGain()
    solve: Solve = Solve()
    smooth_start_s: Time = 0.0
    smoothing_s: Time = 0.0
    keep_last: bool = False
    limits: TwistLimits = TwistLimits()
    visibility: Visibility = Visibility()
    feedforward: Feedforward = NoFeedforward()
    cameras: dict[str, StackWeight] = field(default_factory=dict)
    # whether `cameras` may be given: not to a law whose motion is more than that of e and J
    stacks = True
    extra_size = 0  # Numbers k that the law adds to the state (`ErrorState.extra`)

    @abstractmethod
    def equations(self, view: Any, goal: Any) -> Equations:
        """The error e (..., rows) and J (..., rows, 6) with e_dot = J v, v (6,) the camera twist; J
        (rows, 6) where all views share it.

        view: an Observation of one view, or `Views` of many with leading axes: xy (..., N, 2) and
        depth (..., N) [m], ray (..., N, 3) and range (..., N) [m], T_camera_target (..., 4, 4), as
        `inputs` names them, of N markers that are all known. goal: a view of the same markers,
        without leading axes: the goal, or for the feedforward the frame before, which has these
        fields alone.
        """

    def _checked(self, view: Any, goal: Any) -> Equations:
        """Those of a view, of which the shapes are right; ParameterError where they are not."""
        e, J = self.equations(view, goal)
        if J.ndim < 2 or J.shape[-1] != 6 or e.shape[-1:] != J.shape[-2:-1]:
            works = f"{type(self).__name__}.equations must give e (..., rows) and J (..., rows, 6)"
            raise ParameterError("law", f"{works}; it gave e {e.shape} and J {J.shape}")
        return e, J

    def change(self, before: Observation, now: Observation, goal: Goal) -> Equations:
        """The error of this view from the last one (rows,) and its Jacobian (rows, 6), for the
        feedforward.

        By default the law's equations with the last view as the goal. With the matrix of one of the
        views the change is explained to first order in the motion only: J is the mean of both.
        """
        e, J = self.equations(now, before)
        return e, (self.equations(before, now)[1] + J) / 2

    def free_motions(self, J: Array, e: Array, x: Array | None, basis: Array) -> Motions:
        """Motions left to the robot's secondary task, for J (rows, 6), e (rows,) and the remaining
        motion x (n,): none by default.
        """
        return ()

    def motion(
        self,
        extra: Array,
        equations: Equations,
        view: Any,
        goal: Goal,
        basis: Array | None,
        shift: Array | None,
    ) -> tuple[Array, Array | str, Array | None]:
        """The law's extra state (..., k), velocities u = -gain x (..., n) or the reason for rest,
        and x = pinv(J B) e, None if not needed.

        equations: e (..., rows) and J (..., rows, 6) of the view. basis: the robot's motions (6,
        n); None: all six of the camera. shift: the predicted change of x (n,) until the horizon of
        the feedforward, None without one.
        """
        e, J = equations
        if basis is not None:
            J = J @ basis
        units = units_of(goal, basis)
        x = self.solve.least_squares(J * units, e)
        ahead = x if shift is None else x + shift / units
        return extra, -self.gain.at(ahead) * ahead * units, x * units

    def markers_needed(self, basis: Array) -> int:
        """As many as the robot's motions, basis (6, n), need with two equations each; three for a
        pose.

        With three a pose has up to four solutions, and the observer takes the one next to the last
        pose.
        """
        return 3 if self._reads[1] else Law.markers_needed(self, basis)

    def init(self, goal: Goal) -> ErrorState:
        return ErrorState(np.full(self.extra_size, np.nan))

    def step(
        self, state: ErrorState, observation: Observation, goal: Goal, basis: Array
    ) -> tuple[ErrorState, Command]:
        """One frame; rest where too few markers are seen, or no pose is known."""
        known, rows, why = self._known(state, observation, goal, basis)
        measured = self._measured(known, rows, goal, basis)
        if isinstance(measured, str):
            return self._unseen(state, basis, measured)
        equations, view, at = measured
        e, J = equations
        after = state
        shift = tau = None
        if known.motion is not None and isinstance(self.feedforward, Estimator):
            after, shift, tau = self._estimated(state, known, goal, basis, why)
        extra, u, x = self.motion(state.extra, equations, view, at, basis, shift)
        if isinstance(u, str):
            return self._unseen(state, basis, u)
        if isinstance(self.feedforward, Integral):
            remaining = self.solve.least_squares(J @ basis, e) if x is None else x
            after, tau = integrated(self.feedforward, after, known, remaining)
        if tau is not None:
            u = u - tau
        if goal.twist is not None:
            u = u + least_squares(basis, goal.twist)  # u*, as far as the robot's motions allow
        if extra is not state.extra:
            after = replace(after, extra=extra)
        after, command = self._limited(state, after, u, observation, goal, basis)
        return after, self._explained(command, self.free_motions(J, e, x, basis), why)

    def _explained(self, command: Command, free: Motions, why: str) -> Command:
        """A command with the motions left free, and with what the law's camera lacks where it is
        the only one.
        """
        if self.cameras:
            why = ""
        if free or why:
            return replace(command, free=free, rest_reason=why)
        return command

    def _measured(
        self, known: Observation, rows: Rows | str, goal: Goal, basis: Array
    ) -> tuple[Equations, Observation, Goal] | str:
        """The error and its Jacobian, with the views of which they are; or the reason for rest.
        rows: usable ones, or why none are.
        """
        if self.cameras:
            stacked = self._stacked(known, goal, basis)
            return stacked if isinstance(stacked, str) else (stacked, known, goal)
        if isinstance(rows, str):
            return rows
        if rows is not ALL:
            known = known.of_rows(rows)
            goal = goal.of_rows(rows)
        return self._checked(known, goal), known, goal

    def _limited(
        self,
        state: ErrorState,
        after: ErrorState,
        u: Array,
        observation: Observation,
        goal: Goal,
        basis: Array,
    ) -> tuple[ErrorState, Command]:
        """The command for the velocities u (n,): shaped, kept from the border of the picture,
        within the limits.
        """
        if self._shapes or self.keep_last:
            after, u = self._shaped(after, observation.t, u)
        if self.visibility.margin_px > 0:
            u = u + self.visibility.push(observation, goal, basis)
        command = self.limits.command(u, basis)
        # anti-windup: while limits shorten the command, the integral does not grow
        if command.scale < 1 and after.integral is not None:
            after = replace(after, integral=state.integral)
        return after, command

    def _stacked(self, own: Observation, goal: Goal, basis: Array) -> Equations | str:
        """The error (rows,) and its Jacobian (rows, 6) in all pictures, each with what it shows, or
        the reason for rest.
        """
        fewest = self.markers_needed(basis[:, :1])  # that a camera needs to add something
        found = 0
        errors = []
        jacobians = []
        this = CameraView(own, goal, np.eye(4), rigid=True)
        views = {"": this, **(own.cameras or {})}
        for name, weight in {"": 1.0, **self.cameras}.items():
            view = views.get(name)
            if view is None or view.goal is None:
                continue
            rows = self._rows_of(view.seen, fewest)
            if rows is None:
                continue
            e, J = self._checked(view.seen.of_rows(rows), view.goal.of_rows(rows))
            J = J @ adjoint(inverse(view.T_camera_this))
            found += len(view.seen.uv[rows])
            errors.append(math.sqrt(weight) * e)
            jacobians.append(math.sqrt(weight) * J)
        if found < self.markers_needed(basis):
            return TOO_FEW
        return np.concatenate(errors), np.vstack(jacobians)

    def _rows_of(self, seen: Observation, fewest: int) -> Rows | None:
        """The usable markers of one of several cameras; None where it shows too few, or no pose."""
        of_markers, of_pose = self._reads
        rows = usable_rows(seen, of_markers or ("xy",), fewest)
        return None if isinstance(rows, str) or _without(seen, of_pose) else rows

    @property
    def state_size(self) -> int:
        """Numbers of the state of one of many runs: the law's extra ones, and u0, u and t of the
        shape of its command.
        """
        return self.extra_size + (13 if self._shapes else 0)

    def step_batch(self, state: Array, views: Views, goal: Goal) -> tuple[Array, Array]:
        """One frame of M runs: the next state (M, state_size), and the camera twists (M, 6), NaN
        where the law orders rest.

        state: NaN before the first frame. views: the current views. goal: the goal view of the same
            markers.
        """
        equations = self._checked(views, goal)
        extra, u, _ = self.motion(state[:, : self.extra_size], equations, views, goal, None, None)
        assert not isinstance(u, str)
        if not self._shapes:
            return extra, self.limits.within(u)
        u0, last, since = np.split(state[:, self.extra_size :], [6, 12], axis=1)
        if self.smooth_start_s > 0:
            u0 = np.where(np.isnan(u0), u, u0)
            u = u - u0 * math.exp(-views.t / self.smooth_start_s)
        if self.smoothing_s > 0:
            filtered = last + (1 - np.exp(-(views.t - since) / self.smoothing_s)) * (u - last)
            u = np.where(np.isnan(last), u, filtered)
        return np.column_stack([extra, u0, u, np.full(len(u), views.t)]), self.limits.within(u)

    @cached_property
    def _shapes(self) -> bool:
        """Whether the command is shaped by a smooth start or a filter."""
        return self.smooth_start_s > 0 or self.smoothing_s > 0

    @cached_property
    def _reads(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Of `inputs` the fields that each marker has, and those that the view has as a whole."""
        of_markers = tuple(n for n in self.inputs if n in ("xy", "xyw", "depth", "ray", "range"))
        return of_markers, tuple(n for n in self.inputs if n in ("T_camera_target", "relative"))

    def _shaped(self, before: ErrorState, t: float, u: Array) -> tuple[ErrorState, Array]:
        """The next state, and the command after smooth start and filter, for the law's u (n,) at a
        time t [s].
        """
        t0 = before.t0
        u0 = before.u0
        if self.smooth_start_s > 0:
            if u0 is None:
                t0 = t
                u0 = u
            u = u - u0 * math.exp(-(t - t0) / self.smooth_start_s)
        if self.smoothing_s > 0 and before.u is not None:
            u = before.u + (1 - math.exp(-(t - before.t) / self.smoothing_s)) * (u - before.u)
        return replace(before, t0=t0, u0=u0, t=t, u=u), u

    def _unseen(self, before: ErrorState, basis: Array, why: str) -> tuple[ErrorState, Command]:
        """A frame without a measurement: rest, from which the next command starts smoothly again,
        or the last command; why: in words.
        """
        if not self.keep_last or before.u is None:
            return ErrorState(before.extra), Command.rest(basis, why)
        # the tracker begins again
        after = ErrorState(before.extra, before.t0, before.u0, before.t, before.u)
        return after, held(self.limits, before.u, basis, why)

    def _known(
        self, state: ErrorState, seen: Observation, goal: Goal, basis: Array
    ) -> tuple[Observation, Rows | str, str]:
        """The observation, with what was dead-reckoned; its usable markers, or the reason for rest;
        what it lacks itself, "" if nothing.
        """
        kind = self.feedforward
        needed = self.markers_needed(basis)
        lacks = ""
        of_markers, of_pose = self._reads
        if of_pose:
            if np.count_nonzero(seen.seen) < needed:
                lacks = TOO_FEW
            elif _without(seen, of_pose):
                lacks = NO_POSE
            if lacks:
                reckoned = usable_pose(kind, state, seen, goal, basis)
                if reckoned is None or _without(reckoned, of_pose):
                    return seen, lacks, lacks
                seen = reckoned
            if not of_markers:
                return seen, ALL, lacks
        known, rows, why = usable_markers(kind, state, seen, basis, of_markers, needed)
        return known, rows, lacks or why

    def _estimated(
        self, before: ErrorState, known: Observation, goal: Goal, basis: Array, why: str
    ) -> tuple[ErrorState, Array, Array]:
        """The state with the next estimate, how the remaining motion changes until the prediction
        horizon (n,), and tau (n,).
        """
        kind = self.feedforward
        motion = known.motion
        assert isinstance(kind, Estimator) and motion is not None
        # What was dead-reckoned is no measurement: the estimate goes on without.
        change = None if why or before.target is None else self._change(before, known, goal, basis)
        target = follow(kind, before.target, change, basis, motion, self.solve)
        shift, tau = look_ahead(kind, target, basis, motion)
        last_t = -np.inf if before.marker_t is None else before.marker_t
        marker_t = np.where(known.seen, known.t, last_t)
        known_t = before.known_t if why else known.t
        after = replace(before, seen=known, known_t=known_t, marker_t=marker_t, target=target)
        return after, shift, tau

    def _change(
        self, state: ErrorState, now: Observation, goal: Goal, basis: Array
    ) -> Equations | None:
        """`change` since the last frame, by the markers that are known in both; None where they are
        too few, or a pose is lacking.
        """
        before = state.seen
        of_markers, of_pose = self._reads
        if before is None or _without(before, of_pose):
            return None
        if of_markers:
            both = now.same(before)
            for view in (before, now):
                for name in of_markers:
                    values = getattr(view, name)
                    first = values if values.ndim == 1 else values[:, 0]
                    both = both & np.isfinite(first)
            if np.count_nonzero(both) < self.markers_needed(basis):
                return None
            if not both.all():
                before = before.of_rows(both)
                now = now.of_rows(both)
        return self.change(before, now, goal)


def _without(seen: Observation, names: tuple[str, ...]) -> bool:
    """Whether an observation lacks one of these fields."""
    return any(getattr(seen, name) is None for name in names)


def _motion_since(
    kind: Feedforward, state: ErrorState, seen: Observation, basis: Array
) -> Array | None:
    """The motion (4, 4) of the target in the camera's frame since the last frame; None where it is
    not known.

    Relative to the target, the camera moves by its own measured twist and the estimated motion of
    the target, v + B tau.
    """
    target = state.target
    motion = seen.motion
    if not isinstance(kind, Estimator) or target is None or motion is None:
        return None
    return exp(-(motion.twist * motion.since_s + basis @ target.ahead(motion.since_s)[0]))


def usable_pose(
    kind: Feedforward, state: ErrorState, seen: Observation, goal: Goal, basis: Array
) -> Observation | None:
    """An observation without a pose or a homography, with those of the last frame; None where the
    law is to rest.

    They are dead-reckoned by the measured motion of the camera and the estimated one of the target,
    motion = (dR, dt), for DEAD_RECKON_S at most: the pose T <- motion T, the homography H = R + t
    n^T/d* from the goal's view by R <- dR R, t <- dR t + dt. Without an estimator the law rests.

    state: that of the law at the last frame. seen: the observation of this frame.
    """
    motion = _motion_since(kind, state, seen, basis)
    last = state.seen
    if motion is None or last is None or seen.t - state.known_t > DEAD_RECKON_S:
        return None
    T = seen.T_camera_target
    relative = seen.relative
    if T is None and last.T_camera_target is not None:
        T = motion @ last.T_camera_target
    if relative is None and last.relative is not None:
        H, R_camera_goal = last.relative
        R = motion[:3, :3]
        n = goal.normal
        relative = R @ H + np.outer(motion[:3, 3], n / (n @ goal.middle)), R @ R_camera_goal
    return replace(seen, T_camera_target=T, relative=relative)


def usable_markers(
    kind: Feedforward,
    state: ErrorState,
    seen: Observation,
    basis: Array,
    inputs: tuple[str, ...],
    needed: int,
) -> tuple[Observation, Rows | str, str]:
    """The observation, for a law of markers; its usable markers, or the reason for rest; and what
    the law lacks, "" if nothing.

    The markers that are not seen are dead-reckoned as poses are (`usable_pose`), each for
    DEAD_RECKON_S at most (`reckoned_markers`).

    inputs: the fields of the observation that must be known of a marker. needed: the least number
    of markers.
    """
    rows = usable_rows(seen, inputs, needed)
    why = rows if isinstance(rows, str) else ""
    if rows is ALL or state.seen is None or state.marker_t is None:  # the usual frame first
        return seen, rows, why
    motion = _motion_since(kind, state, seen, basis)
    if motion is None or (why and seen.t - state.known_t > DEAD_RECKON_S):
        return seen, rows, why
    corrects = None if why else basis
    unseen_s = seen.t - state.marker_t
    known = reckoned_markers(seen, state.seen, motion, unseen_s, DEAD_RECKON_S, corrects)
    return known, usable_rows(known, inputs, needed), why


def integrated(
    kind: Integral, state: ErrorState, seen: Observation, x: Array
) -> tuple[ErrorState, Array]:
    """The next state and the feedforward term (n,), for the remaining motion x (n,)."""
    # Without an observation at the last frame nothing is added: the error in between is unknown.
    since = seen.t - state.seen.t if state.seen else 0.0
    total = x * since
    if state.integral is not None:
        total = total + state.integral
    return replace(state, seen=seen, integral=total), kind.rate_per_s2 * total
