"""Uncalibrated visual servoing: the image Jacobian of the robot's own velocities is measured, not
computed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Annotated, Literal, NamedTuple

import numpy as np
from annotated_types import Ge, Le

from vstestbed.core.geometry import Array
from vstestbed.core.quantity import PositivePixels, PositiveShare, PositiveTime, Time
from vstestbed.core.registry import Registry
from vstestbed.core.spec import spec
from vstestbed.features.depth import AtGoal
from vstestbed.features.observation import Goal, Observation
from vstestbed.laws.base import Command, ConstantGain, Gain, Law
from vstestbed.laws.points import TOO_FEW
from vstestbed.laws.solve import Solve, units_of
from vstestbed.robots.own_model import OwnModel


@spec
class Broyden:
    """J + rate (y - J x) x^T / (x^T x): the least change of J that explains a share `rate` of the
    surprise.

    Args:
        rate: share of the difference between the measured and the expected motion in the picture
            that is taken over [1].

    References: Broyden 1965, doi:10.1090/S0025-5718-1965-0198670-6; Jagersand, Fuentes & Nelson
    1997, doi:10.1109/ROBOT.1997.606723.
    """

    kind: Literal["broyden"] = "broyden"
    rate: PositiveShare = 0.5

    def corrected(self, J: Array, P: Array, x: Array, y: Array, most: float) -> tuple[Array, Array]:
        """The next J and P of markers whose motion was measured. J: image Jacobian of each marker
        (N, 2, m). P: unused, (N, m, m). x: displacement (m,), not 0. y: its motion in the picture
        (N, 2). most: unused.
        """
        return J + self.rate * (y - J @ x)[..., None] * (x / (x @ x)), P


@spec
class RecursiveLeastSquares:
    """The J that minimises the sum of forgetting^(k - i) |y_i - J x_i|^2 over all displacements i
    up to the present one k.

        gain = P x / (forgetting + x^T P x),
        J + (y - J x) gain^T,  P = (P - gain x^T P) / forgetting

    Motion in a few directions only would let P grow without end in the others (wind-up), where the
    first measurement after that, noise included, would replace J. So the eigenvalues of P are kept
    under a bound, by which a displacement of `step_px` in a direction unknown so far corrects J by
    half of its surprise or, with forgetting, a little more.

    Args:
        forgetting: weight of a displacement against the one after it [1]; 1 forgets nothing.

    References: Piepmeier, McMurray & Lipkin 2004, doi:10.1109/TRA.2003.820923; Haykin 2002,
    Adaptive Filter Theory, chapter 9.
    """

    kind: Literal["rls"] = "rls"
    forgetting: Annotated[float, Ge(0.1), Le(1)] = 0.8

    def corrected(self, J: Array, P: Array, x: Array, y: Array, most: float) -> tuple[Array, Array]:
        """As `Broyden.corrected`; P: inverse of the weighted sum of x x^T, (N, m, m). most: bound
        of the eigenvalues of P.
        """
        Px = P @ x
        gain = Px / (self.forgetting + Px @ x)[:, None]
        J = J + (y - J @ x)[..., None] * gain[:, None, :]
        P = (P - gain[..., None] * Px[:, None, :]) / self.forgetting
        if np.einsum("nii->n", P).max() > most:  # only then may an eigenvalue be over the bound
            w, V = np.linalg.eigh(P)
            P = (V * np.minimum(w, most)[:, None, :]) @ V.mT
        return J, P


ESTIMATORS = Registry("estimator", Broyden, RecursiveLeastSquares)
Estimator = Annotated[Broyden | RecursiveLeastSquares, ESTIMATORS]


class MotionSums(NamedTuple):
    """Sums of displacements and of the motion in the picture that they made, for J by least
    squares.

    Attributes:
        xx: sum of x x^T for each marker (N, m, m).
        yx: sum of y x^T, (N, 2, m).
        taken: x x^T of all frames, seen or not (m, m).
    """

    xx: Array
    yx: Array
    taken: Array

    @classmethod
    def none(cls, markers: int, m: int) -> MotionSums:
        """No samples of N markers and m velocities."""
        return cls(np.zeros((markers, m, m)), np.zeros((markers, 2, m)), np.zeros((m, m)))

    def with_one(self, x: Array, y: Array) -> MotionSums:
        """One more displacement x (m,) with its motion in the picture y (N, 2), NaN for markers
        that are not seen.
        """
        seen = np.isfinite(y[:, 0])
        one = np.outer(x, x)
        y = np.where(seen[:, None], y, 0.0)
        return MotionSums(
            self.xx + seen[:, None, None] * one, self.yx + y[..., None] * x, self.taken + one
        )

    def jacobian(self, least_share: float = 0.5) -> Array:
        """J (N, 2, m) that minimises the sum of |y - J x|^2; NaN for markers that were seen in too
        small a share of some velocity.

        A velocity that never moved anything has a column of zeros.
        """
        moved = np.sqrt(np.diagonal(self.taken))
        unit = np.where(moved > 0, moved, 1.0)  # so that columns of other units weigh the same
        inverse = np.linalg.pinv(self.xx / np.outer(unit, unit), rcond=1e-9, hermitian=True)
        J = (self.yx / unit) @ inverse / unit
        seen = np.diagonal(self.xx, axis1=1, axis2=2) >= least_share * np.diagonal(self.taken)
        J[~seen.all(axis=1)] = np.nan
        return J


# Excitation: each velocity of a robot in turn to one side, to the other and back, by which the
# image Jacobian is measured.

# the speed that is tried first [rad/s, goal's unit/s], or less where the limits ask for it: slow
# for any robot and picture
FIRST = 0.01
RETURNED_PX = 2.0  # the way back is over at this distance from its start [px]
# the legs of a velocity: to one side, over to the other (twice as long), and back
OUT, OVER, BACK = range(3)


@dataclass(frozen=True, slots=True)
class Excited:
    """How far an excitation is.

    Attributes:
        uv: markers (N, 2) [px] at its start; with a target that moves, in the last picture.
        x: displacement since its start (m,), of the robot and, with a target that moves, of time.
        samples: all that was measured.
        turn: what was measured of the velocity that moves, with time (2 columns), where the target
            may move, too.
        known: motion of the markers per unit of each velocity (m,) [px], 0 where it is unknown.
        units: of the velocities (m,).
        uv_before, x_before: markers, and displacement of the velocity that moves, when its turn
            began.
        which: number of the velocity that moves.
        leg: out, over or back.
        side: sign of the way out.
        speed: magnitude of that velocity.
        pixels: motion of the markers per unit of it [px], 0 where it is not known yet.
        elapsed_s: since the leg began [s].
    """

    uv: Array
    x: Array
    samples: MotionSums
    turn: MotionSums
    known: Array
    units: Array
    uv_before: Array
    x_before: float = 0.0
    which: int = 0
    leg: int = OUT
    side: float = 0.0
    speed: float = 0.0
    pixels: float = 0.0
    elapsed_s: float = 0.0


@spec
class Excitation:
    """The motion by which an uncalibrated law measures its image Jacobian before it servoes, and
    again where it makes no progress.

    A velocity begins slowly, and grows until the markers move. From then on it is so fast that its
    way of twice the amplitude takes `time_s`, and it turns where the markers are expected half the
    amplitude from where they began, pictures and commands that are underway included; also where a
    joint nears its limit, or a marker is lost. The two sides cancel the curvature of the markers'
    ways.

    Args:
        amplitude_px: mean way of the markers from one side to the other [px].
        time_s: time for one velocity [s]; a robot's limits may make it longer.
        speed_share: largest share of a velocity's own limit [1].
    """

    amplitude_px: PositivePixels = 20.0
    time_s: PositiveTime = 0.4
    speed_share: PositiveShare = 0.2

    def step(
        self, state: Excited, uv: Array, moved: Array, robot: OwnModel
    ) -> tuple[Excited, Array | None]:
        """One frame: the next state, and the velocities (n,) to order; None when all have moved.
        state: so far. uv: markers (N, 2) [px]. moved: displacement (m,) since the last picture, the
        robot's first. robot: its own.
        """
        n = len(robot.names)
        x = state.x + moved
        y = uv - state.uv
        if len(x) == n:  # a sample since the start, where noise counts least
            state = replace(state, x=x, samples=state.samples.with_one(x, y))
        else:  # from picture to picture, where a target moves
            turn = state.turn.with_one(moved[[state.which, n]], y)
            state = replace(state, x=x, samples=state.samples.with_one(moved, y), turn=turn, uv=uv)
        state = replace(
            state, elapsed_s=state.elapsed_s + robot.since_s, pixels=self._pixels(state, uv, n)
        )
        while state.which < n and self._leg_ends(state, uv, robot):
            state = _next_leg(state, uv)
        if state.which == n:  # all have moved
            return state, None
        return self._ordered(state, robot)

    def retreat(self, state: Excited, moved: Array, robot: OwnModel) -> tuple[Excited, Array]:
        """A frame with too few markers: back to where the velocity's turn began, by the robot's
        sensors; otherwise as `step`.
        """
        # of a target that moves: what comes next
        uv = state.uv if len(state.x) == len(robot.names) else np.full_like(state.uv, np.nan)
        return self._ordered(replace(state, uv=uv, x=state.x + moved, leg=BACK), robot)

    def _pixels(self, state: Excited, uv: Array, n: int) -> float:
        """Mean motion of the markers per unit of the velocity that moves [px]; as before where it
        is too small to tell.
        """
        x = abs(float(state.x[state.which]) - state.x_before)
        if state.leg != OUT or x == 0:
            return state.pixels
        if len(state.x) == n:
            per_unit = np.linalg.norm(uv - state.uv_before, axis=1) / x
        else:
            per_unit = np.linalg.norm(state.turn.jacobian()[:, :, 0], axis=1)
        per_unit = per_unit[np.isfinite(per_unit)]
        # The share is well over RETURNED_PX, the rest of the way of the velocity before.
        if not len(per_unit) or per_unit.mean() * x < 0.2 * self.amplitude_px:
            return state.pixels
        return float(per_unit.mean())

    def _leg_ends(self, state: Excited, uv: Array, robot: OwnModel) -> bool:
        """Whether the velocity that moves has come far enough, cannot go on, or takes too long."""
        expected_s = (2.0 if state.leg == OVER else 1.0) * self.time_s / 4 + robot.underway_s
        if state.elapsed_s > 4 * expected_s:  # a velocity that the markers do not show
            return True
        ahead = _ahead(state, robot)
        if state.leg == BACK:
            # Also in the picture, or the rest of this way would count as the next velocity's.
            left = max(abs(ahead), abs(float(robot.underway[state.which])))
            return left * state.pixels <= RETURNED_PX
        side = _side(state, robot)
        lost = side * ahead > 0 and not np.isfinite(uv[np.isfinite(state.uv_before[:, 0])]).all()
        near_limit = _room(state.which, side, robot) <= 0.02  # [rad, m]
        return lost or near_limit or side * ahead * state.pixels >= self.amplitude_px / 2

    def _ordered(self, state: Excited, robot: OwnModel) -> tuple[Excited, Array]:
        i = state.which
        side = _side(state, robot)
        most = self.speed_share * float(robot.speed[i])
        speed = max(state.speed, min(FIRST * float(state.units[i]), most))
        if state.pixels:
            speed = 2 * self.amplitude_px / (self.time_s * state.pixels)
        elif state.speed and abs(state.x[i] - state.x_before) >= abs(robot.underway[i]):
            speed = 2 * speed  # not before the picture has shown what was ordered
        speed = min(speed, most)
        state = replace(state, speed=speed)
        if state.leg == OUT:
            state = replace(state, side=side)
        rates = np.zeros(len(robot.names))
        if state.leg == BACK:
            # The time constant of this approach, four periods, is one that a servo can follow.
            rates[i] = np.clip(-_ahead(state, robot) / (4 * robot.period_s), -speed, speed)
        else:
            rates[i] = side * speed
        return state, rates


def _next_leg(state: Excited, uv: Array) -> Excited:
    """The state with the next leg, or with the turn of the next velocity, for markers uv (N, 2)
    [px].
    """
    if state.leg < BACK:
        return replace(state, leg=state.leg + 1, elapsed_s=0.0)
    i = state.which + 1
    if i == len(state.x):
        return replace(state, which=i)
    return replace(
        state,
        which=i,
        leg=OUT,
        side=0.0,
        speed=state.speed / 4 * float(state.units[i] / state.units[i - 1]),
        pixels=float(state.known[i]),
        elapsed_s=0.0,
        uv_before=uv,
        x_before=float(state.x[i]),
    )


def _ahead(state: Excited, robot: OwnModel) -> float:
    """Displacement of the velocity that moves, since its turn began, when this frame's command will
    take effect.
    """
    return float(state.x[state.which] - state.x_before + robot.underway[state.which])


def _side(state: Excited, robot: OwnModel) -> float:
    """The direction of this leg; at first to where a joint has more room."""
    i = state.which
    side = state.side or (1.0 if _room(i, 1.0, robot) >= _room(i, -1.0, robot) else -1.0)
    return side if state.leg == OUT else -side


def _room(i: int, side: float, robot: OwnModel) -> float:
    """Distance of a velocity's position from its limit on one side [rad, m]."""
    return float(robot.high[i] - robot.q[i] if side > 0 else robot.q[i] - robot.low[i])


EXCITES, SERVOES = range(2)
NO_CIRCLE = (
    "the robot cannot turn on the spot,"
    " by which its velocities are not free to be excited one by one"
)
TILTS = (
    "the craft tilts when it moves,"
    " by which the picture does not depend on its own velocities alone"
)


@dataclass(frozen=True, slots=True)
class ImageJacobian:
    """The image Jacobian and what it is corrected by.

    Attributes:
        J: of each marker (N, 2, m), in pixels per pixel: the columns are divided by `scale`; NaN
            for markers not known.
        P: of recursive least squares (N, m, m) [1/px^2].
        scale: mean motion of the markers per unit of each velocity (m,) [px].
        uv: markers when the last correction was made (N, 2) [px].
        x: displacement since then (m,), times `scale` [px].
    """

    J: Array
    P: Array
    scale: Array
    uv: Array
    x: Array


@dataclass(frozen=True, slots=True)
class UncalibratedState:
    """The excitation while it lasts, the estimate from then on.

    Attributes:
        excited: None while the law servoes.
        estimate: None before the end of the first excitation.
        least_px: least error since the last excitation.
        t: when it was found [s].
        patience_s: how long no progress is borne now [s].
        excitations: how many there were.
        units: of the velocities (m,) (`units_of`).
    """

    excited: Excited | None = None
    estimate: ImageJacobian | None = None
    least_px: float = math.inf
    t: float = 0.0
    patience_s: float = math.nan
    excitations: int = 0
    units: Array = field(default_factory=lambda: np.ones(0))


@spec
class Uncalibrated(Law[UncalibratedState]):
    """u = -gain pinv(J) e with e = uv - uv* in pixels, and the image Jacobian J (2N, n) estimated
    from motion.

    J maps the robot's own velocities (joints of an arm, motions of a vehicle) to the motion of the
    markers in the picture. The law reads the markers' pixels and the robot's sensors of its own
    motion. It knows neither the camera's lens and mount, nor depths, nor the target, nor the
    robot's kinematics, and so it works with a camera in the hand and in the room alike.

    At the start each velocity in turn moves the markers a little (`excitation`), which gives J by
    least squares. From then on the `estimator` corrects it by the motion since the last correction,
    whenever that is larger than `step_px`: x is what the robot's sensors tell, y what the picture
    shows between the same two exposures. While the robot stands still nothing is learnt, so that
    noise does not replace J. A marker that is not seen keeps its rows, and one that was not seen in
    the excitation has none until the next.

    The damping of the inverse is error / `trust_px`, and not less than that of `solve` (Levenberg
    1944, Marquardt 1963).

    Inside, velocities are scaled by how far they move the markers, and so `solve` and `estimator`
    are the same for all robots.

    With `predict` the error is that of when the command will take effect, e + J q, q the
    displacement underway. With `dynamic` a target may move: time is one more column of J, the
    motion of the markers while the robot stands still, and u = -pinv(J) (gain e + J_t).

    If the error has not fallen by a fifth within `patience_s`, J is taken to be wrong, and the
    robot is excited again; after each time the patience is twice as long.

    The goal is a picture. Whoever has no calibration can only show it: `calibration.goal: shown`.
    Told as a pose, it is computed with the believed camera, errors included.

    Args:
        gain: lambda [1/s], a number or an adaptive gain of the remaining motion in the robot's own
            velocities.
        estimator: correction of J while the law servoes.
        excitation: the motion by which J is measured at the start.
        solve: inversion of J, scaled to pixels per pixel. Without damping, errors of J in the
            directions that the markers hardly show would be multiplied.
        step_px: least mean motion of the markers, by the estimated J, from which it is corrected
            [px].
        trust_px: error at which the damping is 1, if proportional to it. J was measured elsewhere,
            the farther away the larger the error, and so directions that the markers hardly show
            are left until the end [px].
        most_pxps: largest mean speed of the markers that is ordered [px/s].
        predict: predict the error over the latency of picture and command.
        dynamic: estimate the target's own motion in the picture.
        patience_s: time without progress after which J is measured anew [s]; 0 for never.
        settled_px: error that is small enough: under it nothing is measured anew [px].

    References: Jagersand, Fuentes & Nelson 1997, doi:10.1109/ROBOT.1997.606723; Piepmeier, McMurray
    & Lipkin 2004, doi:10.1109/TRA.2003.820923 (recursive least squares, moving target).
    """

    kind: Literal["uncalibrated"] = "uncalibrated"
    inputs = ("robot",)
    depth = AtGoal()
    modes = ("excites", "servoes")
    needs_same_markers = True
    gain: Gain = ConstantGain()
    estimator: Estimator = RecursiveLeastSquares()
    excitation: Excitation = Excitation()
    # made when it is needed: a start need not wait for it
    solve: Solve = field(default_factory=lambda: Solve(damping=0.01))
    step_px: PositivePixels = 3.0
    most_pxps: PositivePixels = 200.0
    trust_px: PositivePixels = 1000.0
    predict: bool = True
    dynamic: bool = False
    patience_s: Time = 3.0
    settled_px: PositivePixels = 0.2

    @cached_property
    def _time(self) -> Array:
        """The column of time (1,) of a target that may move; (0,) without."""
        return np.ones(int(self.dynamic))

    def init(self, goal: Goal) -> UncalibratedState:
        return UncalibratedState(patience_s=self.patience_s)

    def step(
        self, state: UncalibratedState, observation: Observation, goal: Goal, basis: Array
    ) -> tuple[UncalibratedState, Command]:
        """One frame; rest where too few markers are seen, or too few of them are known. An
        excitation that loses them goes back first.
        """
        robot = observation.robot
        uv = observation.uv
        assert robot is not None
        if robot.turning_radius_m or robot.tilt is not None:
            return state, Command.rest(basis, NO_CIRCLE if robot.turning_radius_m else TILTS)
        moved = np.append(robot.moved, robot.since_s * self._time)
        units = units_of(goal, robot.J) * np.ones(len(robot.names))
        state = replace(state, units=np.append(units, self._time))
        if np.count_nonzero(observation.seen) < self.markers_needed(basis):
            return self._blind(state, moved, robot, basis)
        if state.excited is None and state.estimate is None:
            state = self._begun(state, uv)
        if state.excited is not None:
            excited, rates = self.excitation.step(state.excited, uv, moved, robot)
            if rates is not None:
                return replace(state, excited=excited), _command(rates, robot, basis, EXCITES)
            known = self._measured(excited, uv)
            state = replace(state, excited=None, estimate=known, least_px=math.inf, t=observation.t)
            moved = np.zeros(len(moved))
        return self._servo(state, observation, goal, basis, robot, moved)

    def _blind(
        self, state: UncalibratedState, moved: Array, robot: OwnModel, basis: Array
    ) -> tuple[UncalibratedState, Command]:
        """A frame that shows too few markers: an excitation goes back by the robot's sensors; else
        rest, and the displacement is kept.
        """
        if state.excited is not None:
            excited, rates = self.excitation.retreat(state.excited, moved, robot)
            command = replace(_command(rates, robot, basis, EXCITES), rest_reason=TOO_FEW)
            return replace(state, excited=excited), command
        if state.estimate is not None:
            known = state.estimate
            state = replace(state, estimate=replace(known, x=known.x + known.scale * moved))
        return state, Command.rest(basis, TOO_FEW)

    def _begun(self, state: UncalibratedState, uv: Array) -> UncalibratedState:
        """The state with an excitation before its first motion, for markers uv (N, 2) [px]."""
        still = np.zeros(len(state.units))
        known = still if state.estimate is None else state.estimate.scale
        samples = MotionSums.none(len(uv), len(still))
        turn = MotionSums.none(len(uv), 2)
        excited = Excited(uv, still, samples, turn, known, state.units, uv, pixels=float(known[0]))
        return replace(state, excited=excited, excitations=state.excitations + 1)

    def _measured(self, excited: Excited, uv: Array) -> ImageJacobian:
        J = excited.samples.jacobian()
        known = np.count_nonzero(np.isfinite(J[:, 0, 0]))
        with np.errstate(invalid="ignore"):
            scale = np.sqrt(np.nansum(J**2, axis=(0, 1)) / max(1, known))
        if self.dynamic:
            # of the column of time: a target's motion in the picture that counts as much as the
            # robot's [px/s]
            scale[-1] = 50.0
        most = float((scale * excited.units).max())
        # of a velocity that hardly moves the markers
        scale = np.maximum(scale, 1e-3 * max(most, np.finfo(float).tiny) / excited.units)
        P = np.repeat(np.eye(len(scale))[None] / self.step_px**2, len(uv), axis=0)
        return ImageJacobian(J / scale, P, scale, uv, np.zeros(len(scale)))

    def _servo(
        self,
        state: UncalibratedState,
        seen: Observation,
        goal: Goal,
        basis: Array,
        robot: OwnModel,
        moved: Array,
    ) -> tuple[UncalibratedState, Command]:
        """A frame with an estimate: correct it, and drive the error to zero by it."""
        assert state.estimate is not None
        known = self._corrected(state.estimate, seen.uv, moved)
        rows = np.isfinite(known.J[:, 0, 0]) & seen.seen
        if np.count_nonzero(rows) < self.markers_needed(basis):
            why = "the image Jacobian of the markers in sight is unknown"
            return replace(state, estimate=known), Command.rest(basis, why)
        n = len(robot.names)
        scale = known.scale
        e = (seen.uv - goal.uv)[rows].ravel()
        J = known.J[rows].reshape(-1, len(scale))
        state = self._judged(replace(state, estimate=known), _mean(e), seen)
        if self.predict:
            ahead = np.append(robot.underway, robot.underway_s * self._time)
            e = e + J @ (scale * ahead)
        damping = _mean(e) / self.trust_px
        solved = self.solve.least_squares(J[:, :n], e, damping) / scale[:n]
        u = -self.gain.at(solved) * solved
        if self.dynamic:
            u = u - self.solve.least_squares(J[:, :n], J[:, n] * scale[n], damping) / scale[:n]
        pxps = _mean(J[:, :n] @ (scale[:n] * u))
        u = u * min(1.0, self.most_pxps / max(pxps, np.finfo(float).tiny))
        return state, _command(u, robot, basis, SERVOES)

    def _corrected(self, known: ImageJacobian, uv: Array, moved: Array) -> ImageJacobian:
        """The estimate after a displacement (m,) since the last picture."""
        x = known.x + known.scale * moved
        if x @ x < self.step_px**2:
            return replace(known, x=x)
        y = uv - known.uv
        both = np.isfinite(y[:, 0]) & np.isfinite(known.J[:, 0, 0])
        J = known.J.copy()
        P = known.P.copy()
        J[both], P[both] = self.estimator.corrected(
            J[both], P[both], x, y[both], 1 / self.step_px**2
        )
        return ImageJacobian(J, P, known.scale, uv, np.zeros(len(x)))

    def _judged(
        self, state: UncalibratedState, error_px: float, seen: Observation
    ) -> UncalibratedState:
        """The state with the progress noted, or with an excitation begun where there was none for
        too long.
        """
        if error_px < 0.8 * state.least_px or error_px < self.settled_px:
            return replace(state, least_px=error_px, t=seen.t)
        if not state.patience_s or seen.t - state.t <= state.patience_s:
            return state
        return replace(self._begun(state, seen.uv), patience_s=2 * state.patience_s)


def _mean(values: Array) -> float:
    """Root mean square of the distances of points in the picture, flat (2N,) [px]."""
    return math.sqrt(2 * float(values @ values) / len(values))


def _command(rates: Array, robot: OwnModel, basis: Array, mode: int) -> Command:
    """The command of own velocities; the camera twist that they make by the robot's model is told,
    and nothing follows from it.
    """
    twist = robot.J @ rates
    return Command(
        np.asarray(np.linalg.lstsq(basis, twist, rcond=None)[0], dtype=float),
        twist,
        rates=rates,
        mode=mode,
    )
