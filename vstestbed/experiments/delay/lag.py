"""Identification of the actuators' lag: the shares b_j of a one-frame command that each joint executes in the frames after it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from vstestbed.core.geometry import Array
from vstestbed.loop.theory import closed_form, gain_limit, roots
from vstestbed.scenario.scenario import Scenario
from vstestbed.sim.base import Plant
from vstestbed.sim.build import build_plant

SWINGS, SETTLING, ROUNDS = 10, 4, 4
"""Periods for which a joint is excited; how many of them pass before its motion is used (transient); iterations of the frequency."""
LEAST_W = 0.05
"""A joint that does not follow a swing of this frequency follows none [rad per frame]."""


@dataclass(frozen=True)
class Lag:
    """Response of one joint to a sinusoidal velocity command.

    Attributes:
        joint: name of the joint. shares: (b_0, b_1) [1].
        swing_s: period of the excitation, that of the loop at its gain limit [s].
        lag_s: phase lag of the motion at that period, as a time [s]. gain: amplitude ratio of motion to command [1].
    """

    joint: str
    shares: tuple[float, float]
    lag_s: float
    gain: float
    swing_s: float


def measure_lags(scenario: Scenario, delay_frames: float, off: float) -> list[Lag]:
    """Measure the response of each joint of an arm at the frequency at which the loop oscillates at its gain limit.

    One joint after the other gets the velocity command u(k) = off gain cos(w k), held over each frame (or led to, with
    `timing.interpolation`), and (q(k+1) - q(k)) / period = b_0 u(k) + b_1 u(k-1) is fitted by least squares. Two numbers describe a linear
    actuator at one frequency; for a joint with friction they are its describing function at this amplitude. w and gain are those at which
    the loop with these b becomes unstable, found by ROUNDS iterations; w is at most 0.9 pi, since at pi b_0 and b_1 cannot be
    distinguished.

    Args:
        scenario: of an arm; its start is the configuration about which the joints move.
        delay_frames: d. off: amplitude of each joint [rad].
    """
    # neither images nor true poses are needed: the encoders are the measurement
    parts = (scenario.robot, scenario.camera, scenario.target, scenario.world, scenario.physics)
    plant, _ = build_plant(*parts, needs_image=False, needs_truth=False, led=scenario.timing.interpolated(*scenario.clock))
    try:
        return [_lag_of(plant, name, i, scenario.camera.period, delay_frames, off) for i, name in enumerate(scenario.robot.joints)]
    finally:
        plant.close()


def _lag_of(plant: Plant, name: str, joint: int, period: float, delay_frames: float, off: float) -> Lag:
    w, g, b = math.pi / (2 * delay_frames + 1), closed_form(delay_frames), (1.0, 0.0)  # first guess: a robot without lag
    for _ in range(ROUNDS):
        w = min(w, 0.9 * math.pi)
        while sum(b := _shares(plant, joint, period, w, off * g / period)) <= 0 and w > LEAST_W:
            w /= 2  # so fast a swing the joint answers by moving against it: the loop swings more slowly
        g = gain_limit(delay_frames, b)
        w = abs(float(np.angle(roots(g, delay_frames, b)[0])))
    w = min(w, 0.9 * math.pi)
    response = b[0] + b[1] * np.exp(-1j * w)
    return Lag(name, b, float(-np.angle(response) / w * period), float(np.abs(response)), 2 * math.pi / w * period)


def _shares(plant: Plant, joint: int, period: float, w: float, speed: float) -> tuple[float, float]:
    """(b_0, b_1) of one joint under a sinusoidal command of frequency w [rad per frame] and amplitude `speed` [rad/s]; then it rests."""
    frames, first = (math.ceil(n * 2 * math.pi / w) for n in (SWINGS, SETTLING))
    command, q = speed * np.cos(w * np.arange(frames)), np.empty(frames + 1)
    for k in range(frames):
        q[k] = plant.reading().q[joint]
        plant.apply(np.where(np.arange(len(plant.reading().q)) == joint, command[k], 0.0))
        plant.advance(plant.steps_per_frame)
    q[frames] = plant.reading().q[joint]
    plant.apply(np.zeros(len(plant.reading().q)))
    plant.advance(5 * plant.steps_per_frame)  # the next joint begins with the arm at rest
    b = _fit(np.diff(q) / period, command, first)
    return float(b[0]), float(b[1])


def _fit(velocity: Array, command: Array, first: int) -> Array:
    """(b_0, b_1) from measured and commanded velocities (m,), from the frame `first` on; the third column takes up a constant drift."""
    A = np.column_stack([command[first:], command[first - 1 : -1], np.ones(len(command) - first)])
    return np.asarray(np.linalg.lstsq(A, velocity[first:], rcond=None)[0][:2], dtype=float)
