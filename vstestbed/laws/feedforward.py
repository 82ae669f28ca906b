"""What a law does about a target that moves: it estimates the target's motion, orders as much beforehand, and looks ahead.

With e_dot = L v + L B tau, v = B u the camera's own motion and tau (n,) what the target's motion looks like in the robot's
motion space, the law u = -lambda pinv(L B) e lags behind by |tau| / lambda. Here

    u = -lambda (x + p tau + own) - tau,   x = pinv(L B) e

where p is how far ahead of the exposure to look, `own` the camera's own motion from the exposure until then, which no picture
shows yet (the idea of Smith's predictor), and tau the estimate of a filter. The filter works in motion space: what
features change from one picture to the next, less what the measured motion of the camera in between explains, is made
a displacement by pinv(L B), whichever markers were seen in both; six numbers (n) with one covariance serve for every feature.
A pose is not needed, a depth is: with depths too large by a factor over two the estimate feeds on itself.

References: Corke 1996, Visual Control of Robots, section 7.5 (feedforward of the target's estimated velocity); Smith 1957 (dead
time); Bar-Shalom, Li & Kirubarajan 2001, doi:10.1002/0471221279, section 6.2 (models of constant velocity and acceleration).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge, Gt, Le

from vstestbed.core.geometry import Array
from vstestbed.core.spec import OneOf, spec
from vstestbed.features.observation import OwnMotion
from vstestbed.laws.solve import least_squares

Ahead = Annotated[float, Ge(0), Le(2)]
LEARNS = 1e3
"""How many times its steady value the variance of a rate that nobody has seen yet is."""


@dataclass(frozen=True, slots=True)
class Trend:
    """What is known of the target's motion: rows of displacement, rate and, where estimated, acceleration (k, n); their covariance (k, k)

    in units of the measurement's. `way` (n,) is the displacement as measured.
    """

    state: Array
    way: Array
    P: Array

    @property
    def rate(self) -> Array:
        """Tau (n,) at the last exposure [m/s, rad/s]."""
        return self.state[1]

    def ahead(self, duration: float) -> tuple[Array, Array]:
        """Displacement (n,) in the duration after the last exposure [m, rad], and the rate (n,) at its end."""
        if len(self.state) == 2:
            return self.state[1] * duration, self.state[1]
        rate, change = self.state[1:]
        return rate * duration + change * duration**2 / 2, rate + change * duration


def _model(order: int, dt: float) -> Array:
    """Transition (order, order) of displacement, rate, ... over dt."""
    return np.array([[dt ** (j - i) / math.factorial(j - i) if j >= i else 0.0 for j in range(order)] for i in range(order)])


def white_noise(order: int, dt: float, density: float) -> Array:
    """Covariance (order, order) that white noise of the highest derivative + 1 adds over dt.

    Q_ij = density dt^(2k-1-i-j) / ((k-1-i)! (k-1-j)! (2k-1-i-j)), k = order.  Reference: Bar-Shalom et al. 2001, eqs 6.2.2-4, 6.2.3-2.
    """
    k, f = order, math.factorial
    return density * np.array(
        [[dt ** (2 * k - 1 - i - j) / (f(k - 1 - i) * f(k - 1 - j) * (2 * k - 1 - i - j)) for j in range(k)] for i in range(k)]
    )


@spec
class NoFeedforward:
    """The law as it is: it lags behind a target that moves."""

    kind: Literal["none"] = "none"


@spec
class Integral:
    """The plain alternative: u = -lambda x - rate_per_s2 * integral of x.

    It needs no model and no camera's own motion; a target at a constant speed is followed without an error, any other with less than
    without. It overshoots. What limits take off the command is not summed up.

    Args:
        rate_per_s2: gain of the integral [1/s^2]; lambda^2/4 is critically damped.
    """

    kind: Literal["integral"] = "integral"
    rate_per_s2: Annotated[float, Gt(0)] = 0.25


@spec
class AlphaBeta:
    """A filter of constant gains: displacement += alpha r, rate += beta r / dt, r the measured less the expected displacement.

    Args:
        alpha: share of r that is believed. beta follows: alpha^2 / (2 - alpha).
        predict_s: how far ahead of the exposure to look [s].

    Reference: Benedict & Bordner 1962, doi:10.1109/TAC.1962.1105477 (beta of least noise for a given lag).
    """

    kind: Literal["alpha_beta"] = "alpha_beta"
    alpha: Annotated[float, Gt(0), Le(1)] = 0.8
    predict_s: Ahead = 0.0

    def update(self, trend: Trend | None, step: Array | None, dt: float, size: int) -> Trend:
        """Take in the target's displacement `step` (n,) during dt, None where it was not seen."""
        if trend is None:
            return Trend(np.zeros((2, size)), np.zeros(size), np.zeros((2, 2)))
        state = _model(2, dt) @ trend.state
        if step is None:
            return Trend(state, state[0], trend.P)
        way = trend.way + step
        beta = self.alpha**2 / (2 - self.alpha)
        return Trend(state + np.outer([self.alpha, beta / dt], way - state[0]), way, trend.P)


class _Kalman:
    """A Kalman filter of `order` derivatives; noise of displacement and of the next derivative are white, their ratio told by a bandwidth.

    In continuous time the steady filter's poles are those of a Butterworth filter with the corner (density ratio)^(1/(2 order)).
    """

    order: int
    bandwidth_hz: float

    def update(self, trend: Trend | None, step: Array | None, dt: float, size: int) -> Trend:
        """Take in the target's displacement `step` (n,) during dt, None where it was not seen."""
        k, corner = self.order, 2 * math.pi * self.bandwidth_hz
        if trend is None:
            return Trend(np.zeros((k, size)), np.zeros(size), np.diag([corner, *(LEARNS * corner ** (2 * i + 1) for i in range(1, k))]))
        F = _model(k, dt)
        state, P = F @ trend.state, F @ trend.P @ F.T + white_noise(k, dt, corner ** (2 * k))
        if step is None:
            return Trend(state, state[0], P)
        way = trend.way + step
        K = P[:, 0] / (P[0, 0] + 1 / dt)
        return Trend(state + np.outer(K, way - state[0]), way, P - np.outer(K, P[0]))


Bandwidth = Annotated[float, Gt(0), Le(100)]


@spec
class KalmanCV(_Kalman):
    """A Kalman filter for a target of constant velocity, disturbed by white acceleration.

    Args:
        bandwidth_hz: corner up to which the motion is followed; its rate lags by sqrt(2) / (2 pi bandwidth). More follows faster
            and passes on more of the pixels' noise.
        predict_s: how far ahead of the exposure to look [s].

    Reference: Kalata 1984, doi:10.1109/TAES.1984.310438 (its steady state is an alpha-beta filter).
    """

    kind: Literal["kalman_cv"] = "kalman_cv"
    order = 2
    bandwidth_hz: Bandwidth = 5.0
    predict_s: Ahead = 0.0


@spec
class KalmanCA(_Kalman):
    """A Kalman filter for a target of constant acceleration, disturbed by white jerk: its rate does not lag, and is noisier.

    Args:
        bandwidth_hz: corner up to which the motion is followed.
        predict_s: how far ahead of the exposure to look [s].
    """

    kind: Literal["kalman_ca"] = "kalman_ca"
    order = 3
    bandwidth_hz: Bandwidth = 2.0
    predict_s: Ahead = 0.0


FEEDFORWARDS = OneOf("feedforward", NoFeedforward, Integral, AlphaBeta, KalmanCV, KalmanCA, default="none")
Feedforward = Annotated[NoFeedforward | Integral | AlphaBeta | KalmanCV | KalmanCA, FEEDFORWARDS]
Estimator = AlphaBeta | KalmanCV | KalmanCA


@dataclass(frozen=True, slots=True)
class Change:
    """How the features changed since the last picture (m,), and the mean interaction matrix (m, 6) on the way."""

    e: Array
    L: Array


def follow(kind: Estimator, trend: Trend | None, change: Change | None, basis: Array, motion: OwnMotion) -> Trend:
    """The target's motion after one more picture.

    Args:
        kind: the filter. trend: what was known. change: None where the two pictures have too little in common.
        basis: the robot's motions (6, n). motion: what the robot measured of its own.
    """
    step = None
    if trend is not None and change is not None:
        step = least_squares(change.L @ basis, change.e - change.L @ (motion.twist * motion.since_s))
    return kind.update(trend, step, motion.since_s, basis.shape[1])


def look_ahead(kind: Estimator, trend: Trend, basis: Array, motion: OwnMotion) -> tuple[Array, Array]:
    """What will be added to the motion still to be made by the time that the law looks ahead to (n,), and tau (n,) then.

    The camera's own motion is the measured one until now, the one ordered last from there on.
    """
    p, age = kind.predict_s, motion.age_s
    shift, rate = trend.ahead(p)
    own = motion.moved * min(p / age, 1.0) if age > 0 else motion.moved
    own = own + motion.ordered * max(p - age, 0.0)
    return shift + least_squares(basis, own), rate
