"""Feedforward for a moving target: estimation of its motion, and prediction over the delay of the
loop.

With e_dot = L v + L B tau, where v = B u is the camera twist and tau (n,) the target's motion
expressed in the robot's motion space, the law u = -lambda pinv(L B) e has the steady tracking error
|tau| / lambda. Here

    u = -lambda (x + p tau + ego) - tau,   x = pinv(L B) e

where p is the prediction horizon after the exposure, `ego` the camera's motion from the exposure to
the horizon, which the image does not show yet (as in Smith's predictor), and tau the output of a
filter. The filter works in motion space: the change of the features between two frames, less the
part explained by the measured camera motion, is mapped to a displacement by pinv(L B) of the
markers seen in both frames. So its state has n numbers a derivative with one covariance, for all
features. It needs no pose but a depth: where depths are too large by a factor over two, the
estimate diverges by positive feedback.

References: Corke 1996, Visual Control of Robots, section 7.5 (feedforward of the target's estimated
velocity); Smith 1957 (dead time); Bar-Shalom, Li & Kirubarajan 2001, doi:10.1002/0471221279,
section 6.2 (models of constant velocity and acceleration).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import numpy as np
from annotated_types import Ge, Le

from vstestbed.core.geometry import Array
from vstestbed.core.quantity import Frequency, PositiveGain, TighterBounds
from vstestbed.core.registry import Registry
from vstestbed.core.spec import spec
from vstestbed.features.observation import EgoMotion
from vstestbed.laws.solve import PSEUDO_INVERSE, Solve, least_squares

Ahead = Annotated[float, Ge(0), Le(2)]
# initial variance of the unknown derivatives, as a multiple of their steady value: large, so that
# the first frames set them
LEARNS = 1e3


@dataclass(frozen=True, slots=True)
class TargetEstimate:
    """The estimate of the target's velocity in motion space.

    Attributes:
        state: displacement, rate and, for kalman_ca, acceleration as rows (k, n) [m, rad; per s;
            per s^2].
        moved: the measured displacement since the first frame (n,) [m, rad].
        P: covariance of the rows (k, k) in units of the measurement noise, the same for all n
            motions.
    """

    state: Array
    moved: Array
    P: Array

    @property
    def rate(self) -> Array:
        """Tau (n,) at the last exposure [m/s, rad/s]."""
        return self.state[1]

    def ahead(self, duration: float) -> tuple[Array, Array]:
        """The predicted displacement (n,) over a duration after the last exposure [m, rad], and the
        rate (n,) at its end.
        """
        if len(self.state) == 2:
            return self.state[1] * duration, self.state[1]  # a model of constant velocity
        rate, change = self.state[1:]
        return rate * duration + change * duration**2 / 2, rate + change * duration


def _model(order: int, dt: float) -> Array:
    """Transition matrix (order, order) of displacement, rate, ... over dt [s]."""
    F = np.eye(order)
    for i in range(order):
        for j in range(i + 1, order):
            F[i, j] = dt ** (j - i) / math.factorial(j - i)
    return F


def white_noise(order: int, dt: float, density: float) -> Array:
    """Process noise (order, order) over dt [s], where the derivative after the highest one in the
    state is white noise.

    Q_ij = density dt^(2k-1-i-j) / ((k-1-i)! (k-1-j)! (2k-1-i-j)), k = order.

    Reference: Bar-Shalom et al. 2001, eqs 6.2.2-4, 6.2.3-2.
    """
    k = order
    Q = np.zeros((k, k))
    for i in range(k):
        for j in range(k):
            power = 2 * k - 1 - i - j
            factorials = math.factorial(k - 1 - i) * math.factorial(k - 1 - j)
            Q[i, j] = dt**power / (factorials * power)
    return density * Q


@spec
class NoFeedforward:
    """No feedforward: a moving target is tracked with a lag."""

    kind: Literal["none"] = "none"


@spec
class Integral:
    """Integral action: u = -lambda x - rate_per_s2 * integral of x.

    It needs neither a motion model nor the camera's own motion. A target at constant speed is
    tracked without a steady error. It overshoots. While the limits scale the command down, the
    integral does not grow (anti-windup).

    Args:
        rate_per_s2: gain of the integral [1/s^2]; lambda^2/4 is critically damped.
    """

    kind: Literal["integral"] = "integral"
    rate_per_s2: PositiveGain = 0.25


@spec
class AlphaBeta:
    """A filter of constant gains: displacement += alpha r, rate += beta r / dt, with r the measured
    less the predicted displacement.

    Args:
        alpha: gain of the displacement [1]; beta follows: alpha^2 / (2 - alpha).
        predict_s: prediction horizon after the exposure [s]; null: until the picture has arrived,
            whatever its latency.

    Reference: Benedict & Bordner 1962, doi:10.1109/TAC.1962.1105477 (beta of least noise for a
    given lag).
    """

    kind: Literal["alpha_beta"] = "alpha_beta"
    alpha: Annotated[PositiveGain, TighterBounds(le=1)] = 0.8
    predict_s: Ahead | None = 0.0

    def update(
        self, before: TargetEstimate | None, step: Array | None, dt: float, size: int
    ) -> TargetEstimate:
        """The estimate after the target's displacement `step` (size,) during dt, None where it was
        not seen.
        """
        if before is None:
            # constant gains: P stays unused
            return TargetEstimate(np.zeros((2, size)), np.zeros(size), np.zeros((2, 2)))
        state = _model(2, dt) @ before.state
        if step is None:
            return TargetEstimate(state, state[0], before.P)
        moved = before.moved + step
        beta = self.alpha**2 / (2 - self.alpha)
        state = state + np.outer([self.alpha, beta / dt], moved - state[0])
        return TargetEstimate(state, moved, before.P)


class _Kalman:
    """A Kalman filter with `order` states, displacement first.

    The measurement and the next derivative have white noise, whose ratio sets the bandwidth: in
    continuous time the steady filter's poles are those of a Butterworth filter with the corner
    (density ratio)^(1/(2 order)).
    """

    order: Any  # a constant of each
    bandwidth_hz: Any  # a field of each

    def update(
        self, before: TargetEstimate | None, step: Array | None, dt: float, size: int
    ) -> TargetEstimate:
        """As `AlphaBeta.update`."""
        k = self.order
        corner = 2 * math.pi * self.bandwidth_hz
        if before is None:
            P = np.diag([corner, *(LEARNS * corner ** (2 * i + 1) for i in range(1, k))])
            return TargetEstimate(np.zeros((k, size)), np.zeros(size), P)
        F = _model(k, dt)
        state = F @ before.state
        P = F @ before.P @ F.T + white_noise(k, dt, corner ** (2 * k))
        # prediction only; the measured displacement continues from the predicted one
        if step is None:
            return TargetEstimate(state, state[0], P)
        moved = before.moved + step
        # measurement noise of unit density: its variance in one sample is 1/dt
        K = P[:, 0] / (P[0, 0] + 1 / dt)
        return TargetEstimate(state + np.outer(K, moved - state[0]), moved, P - np.outer(K, P[0]))


Bandwidth = Annotated[Frequency, TighterBounds(le=100)]


@spec
class KalmanCV(_Kalman):
    """A Kalman filter for a target of constant velocity, disturbed by white acceleration.

    Args:
        bandwidth_hz: corner frequency; the estimated rate lags by sqrt(2) / (2 pi bandwidth). A
            higher one tracks faster and passes more pixel noise.
        predict_s: prediction horizon after the exposure [s]; null: until the picture has arrived,
            whatever its latency.

    Reference: Kalata 1984, doi:10.1109/TAES.1984.310438 (its steady state is an alpha-beta filter).
    """

    kind: Literal["kalman_cv"] = "kalman_cv"
    order = 2
    bandwidth_hz: Bandwidth = 5.0
    predict_s: Ahead | None = 0.0


@spec
class KalmanCA(_Kalman):
    """A Kalman filter for a target of constant acceleration, disturbed by white jerk: its rate does
    not lag, and is noisier.

    Args:
        bandwidth_hz: corner frequency.
        predict_s: prediction horizon after the exposure [s]; null: until the picture has arrived,
            whatever its latency.
    """

    kind: Literal["kalman_ca"] = "kalman_ca"
    order = 3
    bandwidth_hz: Bandwidth = 2.0
    predict_s: Ahead | None = 0.0


@spec
class Smith:
    """Prediction of the camera's own motion alone, for a target that stands still: latency no
    longer limits the gain.

    The others estimate the target's motion, too; errors of the robot's own motion then come back as
    motion of the target.

    Args:
        predict_s: prediction horizon after the exposure [s]; null: until the picture has arrived,
            whatever its latency; e.g. `0.04`.

    Reference: Smith 1957, Closer control of loops with dead time, Chem. Eng. Prog. 53(5), 217-219.
    """

    kind: Literal["smith"] = "smith"
    predict_s: Ahead | None = None

    def update(
        self, before: TargetEstimate | None, step: Array | None, dt: float, size: int
    ) -> TargetEstimate:
        """No motion."""
        return TargetEstimate(np.zeros((2, size)), np.zeros(size), np.zeros((2, 2)))


FEEDFORWARDS = Registry(
    "feedforward", NoFeedforward, Integral, AlphaBeta, KalmanCV, KalmanCA, Smith, default="none"
)
Estimator = AlphaBeta | KalmanCV | KalmanCA | Smith
Feedforward = Annotated[NoFeedforward | Integral | Estimator, FEEDFORWARDS]


def follow(
    kind: Estimator,
    before: TargetEstimate | None,
    change: tuple[Array, Array] | None,
    basis: Array,
    motion: EgoMotion,
    solve: Solve = PSEUDO_INVERSE,
) -> TargetEstimate:
    """The target's motion after one more frame, basis (6, n).

    change: the error since the last frame e (m,) and its Jacobian J (m, 6); None where the two have
    too little in common. solve: inversion of J B.
    """
    step = None
    if before is not None and change is not None:
        e, J = change
        step = solve.least_squares(J @ basis, e - J @ (motion.twist * motion.since_s))
    return kind.update(before, step, motion.since_s, basis.shape[1])


def look_ahead(
    kind: Estimator, target: TargetEstimate, basis: Array, motion: EgoMotion
) -> tuple[Array, Array]:
    """The change of the remaining motion (n,) from the exposure to the prediction horizon, and tau
    (n,) at the horizon.

    The camera's own motion is the measured one until now, and the last command from then on.
    """
    age = motion.age_s
    p = age if kind.predict_s is None else kind.predict_s
    shift, rate = target.ahead(p)
    # a horizon before now takes its share of the way
    ego = motion.moved * min(p / age, 1.0) if age > 0 else motion.moved
    ego = ego + motion.commanded * max(p - age, 0.0)
    return shift + least_squares(basis, ego), rate
