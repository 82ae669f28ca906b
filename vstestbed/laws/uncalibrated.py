"""Uncalibrated visual servoing: the image Jacobian of the robot's own velocities is measured, not computed."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from vstestbed.core.geometry import Array
from vstestbed.core.quantity import PositivePixels, Time
from vstestbed.core.spec import spec
from vstestbed.features.depth import AtGoal
from vstestbed.features.observation import Goal, Observation
from vstestbed.laws.base import Command, ConstantGain, Gain, LawBase
from vstestbed.laws.excitation import Excitation, Excited
from vstestbed.laws.image_jacobian import Estimator, RecursiveLeastSquares
from vstestbed.laws.select import TOO_FEW
from vstestbed.laws.solve import Solve
from vstestbed.robots.own_model import OwnModel

EXCITES, SERVOES = range(2)
NO_JACOBIAN = "the image Jacobian of the markers in sight is unknown"
NO_CIRCLE = "the robot cannot turn on the spot, by which its velocities are not free to be excited one by one"
TILTS = "the craft tilts when it moves, by which the picture does not depend on its own velocities alone"
TIME_PXPS = 50.0
"""Scale of the column of time: a target's motion in the picture that counts as much as the robot's [px/s]."""
LEAST_COLUMN = 1e-3
"""A velocity that moves the markers by less than this share of what the strongest one does counts as if it moved them by that."""
PROGRESS = 0.8
"""The error must fall to this share of its least value so far to count as progress."""


@dataclass(frozen=True, slots=True)
class ImageJacobian:
    """The image Jacobian and what it is corrected by.

    Attributes:
        J: of each marker (N, 2, m), in pixels per pixel: the columns are divided by `scale`; NaN for markers not known.
        P: of recursive least squares (N, m, m) [1/px^2]. scale: mean motion of the markers per unit of each velocity (m,) [px].
        uv: markers when the last correction was made (N, 2) [px]. x: displacement since then (m,), times `scale` [px].
    """

    J: Array
    P: Array
    scale: Array
    uv: Array
    x: Array


@dataclass(frozen=True, slots=True)
class UncalibratedMemory:
    """The excitation while it lasts, the estimate from then on.

    Attributes:
        excited: None while the law servoes. estimate: None before the end of the first excitation.
        least_px: least error since the last excitation. t: when it was found [s]. patience_s: how long no progress is borne now.
        excitations: how many there were.
    """

    excited: Excited | None = None
    estimate: ImageJacobian | None = None
    least_px: float = math.inf
    t: float = 0.0
    patience_s: float = math.nan
    excitations: int = 0


@spec
class Uncalibrated(LawBase):
    """u = -gain pinv(J) e with e = uv - uv* in pixels, and the image Jacobian J (2N, n) estimated from motion.

    J maps the robot's own velocities (joints of an arm, motions of a vehicle) to the motion of the markers in the picture. The law reads
    the markers' pixels and the robot's sensors of its own motion. It knows neither the camera's lens and mount, nor depths, nor the
    target, nor the robot's kinematics, and so it works with a camera in the hand and in the room alike.

    At the start each velocity in turn moves the markers a little (`excitation`), which gives J by least squares. From then on the
    `estimator` corrects it by the motion since the last correction, whenever that is larger than `step_px`: x is what the robot's sensors
    tell, y what the picture shows between the same two exposures. While the robot stands still nothing is learnt, so that noise does not
    replace J. A marker that is not seen keeps its rows, and one that was not seen in the excitation has none until the next.

    The damping of the inverse is error / `trust_px`, and not less than that of `solve` (Levenberg 1944, Marquardt 1963).

    Inside, velocities are scaled by how far they move the markers, and so `solve` and `estimator` are the same for all robots.

    With `predict` the error is that of when the command will take effect, e + J q, q the displacement underway. With `dynamic` a target
    may move: time is one more column of J, the motion of the markers while the robot stands still, and u = -pinv(J) (gain e + J_t).

    If the error has not fallen by a fifth within `patience_s`, J is taken to be wrong, and the robot is excited again; after each time
    the patience is twice as long.

    The goal is a picture. Whoever has no calibration can only show it: `calibration.goal: shown`. Told as a pose, it is computed with the
    believed camera, errors included.

    Args:
        gain: lambda [1/s], a number or an adaptive gain of the remaining motion in the robot's own velocities.
        estimator: correction of J while the law servoes.
        excitation: the motion by which J is measured at the start.
        solve: inversion of J, scaled to pixels per pixel. Without damping, errors of J in the directions that the markers hardly show
            would be multiplied.
        step_px: least mean motion of the markers, by the estimated J, from which it is corrected [px].
        trust_px: error at which the damping is 1, if proportional to it. J was measured elsewhere, the farther away the larger the error,
            and so directions that the markers hardly show are left until the end [px].
        most_pxps: largest mean speed of the markers that is ordered [px/s].
        predict: predict the error over the latency of picture and command.
        dynamic: estimate the target's own motion in the picture.
        patience_s: time without progress after which J is measured anew [s]; 0 for never.
        settled_px: error that is small enough: under it nothing is measured anew [px].

    References: Jagersand, Fuentes & Nelson 1997, doi:10.1109/ROBOT.1997.606723; Piepmeier, McMurray & Lipkin 2004,
    doi:10.1109/TRA.2003.820923 (recursive least squares, moving target).
    """

    kind: Literal["uncalibrated"] = "uncalibrated"
    inputs = ("robot",)
    depth = AtGoal()
    modes = ("excites", "servoes")
    needs_same_markers = True
    gain: Gain = ConstantGain()
    estimator: Estimator = RecursiveLeastSquares()
    excitation: Excitation = Excitation()
    solve: Solve = Solve(damping=0.01)
    step_px: PositivePixels = 3.0
    most_pxps: PositivePixels = 200.0
    trust_px: PositivePixels = 1000.0
    predict: bool = True
    dynamic: bool = False
    patience_s: Time = 3.0
    settled_px: PositivePixels = 0.2

    def init(self, goal: Goal) -> UncalibratedMemory:
        """Nothing is known."""
        return UncalibratedMemory(patience_s=self.patience_s)

    def step(self, memory: UncalibratedMemory, observation: Observation, goal: Goal, basis: Array) -> tuple[UncalibratedMemory, Command]:
        """One frame; rest where too few markers are seen, or too few of them are known. An excitation that loses them goes back first."""
        robot, uv = observation.robot, observation.uv
        if robot is None:
            raise RuntimeError("the law needs observation.robot, which its inputs name")
        if why := _refused(robot):
            return memory, Command.rest(basis, why)
        moved = np.append(robot.moved, robot.since_s * np.ones(int(self.dynamic)))
        if np.count_nonzero(observation.seen) < self.markers_needed(basis):
            return self._blind(memory, moved, robot, basis)
        if memory.excited is None and memory.estimate is None:
            memory = self._begun(memory, uv, len(moved))
        if memory.excited is not None:
            excited, rates = self.excitation.step(memory.excited, uv, moved, robot)
            if rates is not None:
                return replace(memory, excited=excited), _command(rates, robot, basis, EXCITES)
            memory = replace(memory, excited=None, estimate=self._measured(excited, uv), least_px=math.inf, t=observation.t)
            moved = np.zeros(len(moved))
        return self._servo(memory, observation, goal, basis, robot, moved)

    def _blind(self, memory: UncalibratedMemory, moved: Array, robot: OwnModel, basis: Array) -> tuple[UncalibratedMemory, Command]:
        """A frame that shows too few markers: an excitation goes back by the robot's sensors; else rest, and the displacement is kept."""
        if memory.excited is not None:
            excited, rates = self.excitation.retreat(memory.excited, moved, robot)
            return replace(memory, excited=excited), replace(_command(rates, robot, basis, EXCITES), rest_reason=TOO_FEW)
        if memory.estimate is not None:
            known = memory.estimate
            memory = replace(memory, estimate=replace(known, x=known.x + known.scale * moved))
        return memory, Command.rest(basis, TOO_FEW)

    def _begun(self, memory: UncalibratedMemory, uv: Array, columns: int) -> UncalibratedMemory:
        known = np.zeros(columns) if memory.estimate is None else memory.estimate.scale
        return replace(memory, excited=self.excitation.begin(uv, columns, known), excitations=memory.excitations + 1)

    def _measured(self, excited: Excited, uv: Array) -> ImageJacobian:
        """The estimate after an excitation."""
        J = excited.samples.jacobian()
        with np.errstate(invalid="ignore"):
            scale = np.sqrt(np.nansum(J**2, axis=(0, 1)) / max(1, np.count_nonzero(np.isfinite(J[:, 0, 0]))))
        if self.dynamic:
            scale[-1] = TIME_PXPS
        scale = np.maximum(scale, LEAST_COLUMN * max(scale.max(), np.finfo(float).tiny))
        P = np.repeat(np.eye(len(scale))[None] / self.step_px**2, len(uv), axis=0)
        return ImageJacobian(J / scale, P, scale, uv, np.zeros(len(scale)))

    def _servo(
        self, memory: UncalibratedMemory, seen: Observation, goal: Goal, basis: Array, robot: OwnModel, moved: Array
    ) -> tuple[UncalibratedMemory, Command]:
        """A frame with an estimate: correct it, and drive the error to zero by it."""
        assert memory.estimate is not None
        known = self._corrected(memory.estimate, seen.uv, moved)
        rows = np.isfinite(known.J[:, 0, 0]) & seen.seen
        if np.count_nonzero(rows) < self.markers_needed(basis):
            return replace(memory, estimate=known), Command.rest(basis, NO_JACOBIAN)
        e, J = (seen.uv - goal.uv)[rows].ravel(), known.J[rows].reshape(-1, len(known.scale))
        memory = self._judged(replace(memory, estimate=known), _mean(e), seen)
        u = self._wanted(e, J, known.scale, robot)
        return memory, _command(u, robot, basis, SERVOES)

    def _wanted(self, e: Array, J: Array, scale: Array, robot: OwnModel) -> Array:
        """The robot's velocities (n,) for an error e (2N,) [px] and a scaled J (2N, m)."""
        n = len(robot.names)
        if self.predict:
            ahead = np.append(robot.underway, robot.underway_s * np.ones(int(self.dynamic)))
            e = e + J @ (scale * ahead)
        damping = _mean(e) / self.trust_px
        solved = self.solve.least_squares(J[:, :n], e, damping) / scale[:n]
        u = -self.gain.at(solved) * solved
        if self.dynamic:
            u = u - self.solve.least_squares(J[:, :n], J[:, n] * scale[n], damping) / scale[:n]
        return u * min(1.0, self.most_pxps / max(_mean(J[:, :n] @ (scale[:n] * u)), np.finfo(float).tiny))

    def _corrected(self, known: ImageJacobian, uv: Array, moved: Array) -> ImageJacobian:
        """The estimate after a displacement (m,) since the last picture."""
        x = known.x + known.scale * moved
        if x @ x < self.step_px**2:
            return replace(known, x=x)
        y = uv - known.uv
        both = np.isfinite(y[:, 0]) & np.isfinite(known.J[:, 0, 0])
        J, P = known.J.copy(), known.P.copy()
        J[both], P[both] = self.estimator.corrected(J[both], P[both], x, y[both], 1 / self.step_px**2)
        return ImageJacobian(J, P, known.scale, uv, np.zeros(len(x)))

    def _judged(self, memory: UncalibratedMemory, error_px: float, seen: Observation) -> UncalibratedMemory:
        """The memory with the progress noted, or with an excitation begun where there was none for too long."""
        if error_px < PROGRESS * memory.least_px or error_px < self.settled_px:
            return replace(memory, least_px=error_px, t=seen.t)
        if not memory.patience_s or seen.t - memory.t <= memory.patience_s:
            return memory
        begun = self._begun(memory, seen.uv, len(memory.estimate.scale) if memory.estimate else 0)
        return replace(begun, patience_s=2 * memory.patience_s)


def _refused(robot: OwnModel) -> str:
    """Why a robot's velocities cannot be excited one by one; "" where they can."""
    return NO_CIRCLE if robot.turning_radius_m else TILTS if robot.tilt is not None else ""


def _mean(values: Array) -> float:
    """Root mean square of the distances of points in the picture, flat (2N,) [px]."""
    return math.sqrt(2 * float(values @ values) / len(values))


def _command(rates: Array, robot: OwnModel, basis: Array, mode: int) -> Command:
    """The command of own velocities; the camera twist that they make by the robot's model is told, and nothing follows from it."""
    twist = robot.J @ rates
    return Command(np.asarray(np.linalg.lstsq(basis, twist, rcond=None)[0], dtype=float), twist, rates=rates, mode=mode)
