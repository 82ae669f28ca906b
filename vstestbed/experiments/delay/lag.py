"""How a robot's servos follow: the shares b_j of a one-frame command that each joint makes in the frames after it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from vstestbed.core.geometry import Array
from vstestbed.experiments.delay.theory import closed_form, gain_limit, roots
from vstestbed.scenario.scenario import Scenario
from vstestbed.sim.base import Plant
from vstestbed.sim.build import build_plant

SWINGS, SETTLING, ROUNDS = 10, 4, 4
"""How many swings a joint is driven for, and how many of them pass before what it does counts; and how often
the swing is chosen anew."""


@dataclass(frozen=True)
class Lag:
    """How one joint follows a swing of commands.

    Attributes:
        joint: its name. shares: (b_0, b_1) [1].
        swing_s: the swing's period, that of the loop at its limit [s].
        lag_s: by how much its motion lags behind the command at that swing [s]. gain: the motion's size over the command's [1].
    """

    joint: str
    shares: tuple[float, float]
    lag_s: float
    gain: float
    swing_s: float


def measure_lags(scenario: Scenario, delay_frames: int, off: float) -> list[Lag]:
    """How each joint of an arm follows commands that swing as the loop does at its limit.

    One joint after the other is told u(k) = off gain cos(w k) frame by frame, held in between; of its way in each frame,
    (q(k+1) - q(k)) / period = b_0 u(k) + b_1 u(k-1) by least squares. Two numbers say what a linear servo does to one swing; a
    servo with friction is told by those of a swing of this size (its describing function). w and the gain are those at which
    the loop with these b goes unstable, found in ROUNDS; up to .9 pi, since at pi both numbers look the same.

    Args:
        scenario: of an arm, its start where the joints are to be driven about.
        delay_frames: d. off: size of the swing of each joint [rad].
    """
    plant, _ = build_plant(
        scenario.robot, scenario.camera, scenario.target, scenario.world, scenario.physics, needs_image=False, needs_truth=False
    )
    try:
        return [_lag_of(plant, name, i, scenario.camera.period, delay_frames, off) for i, name in enumerate(scenario.robot.joints)]
    finally:
        plant.close()


def _lag_of(plant: Plant, name: str, joint: int, period: float, delay_frames: int, off: float) -> Lag:
    w, g, b = math.pi / (2 * delay_frames + 1), closed_form(delay_frames), (1.0, 0.0)
    for _ in range(ROUNDS):
        w = min(w, 0.9 * math.pi)
        b = _shares(plant, joint, period, w, off * g / period)
        g = gain_limit(delay_frames, b)
        w = abs(float(np.angle(roots(g, delay_frames, b)[0])))
    w = min(w, 0.9 * math.pi)
    response = b[0] + b[1] * np.exp(-1j * w)
    return Lag(name, b, float(-np.angle(response) / w * period), float(np.abs(response)), 2 * math.pi / w * period)


def _shares(plant: Plant, joint: int, period: float, w: float, speed: float) -> tuple[float, float]:
    """(b_0, b_1) of one joint told to swing by w [rad a frame] with this speed [rad/s]; it rests afterwards."""
    frames, first = (math.ceil(n * 2 * math.pi / w) for n in (SWINGS, SETTLING))
    told, q = speed * np.cos(w * np.arange(frames)), np.empty(frames + 1)
    for k in range(frames):
        q[k] = plant.reading().q[joint]
        plant.apply(np.where(np.arange(len(plant.reading().q)) == joint, told[k], 0.0))
        plant.advance(plant.steps_per_frame)
    q[frames] = plant.reading().q[joint]
    plant.apply(np.zeros(len(plant.reading().q)))
    plant.advance(5 * plant.steps_per_frame)
    b = _fit(np.diff(q) / period, told, first)
    return float(b[0]), float(b[1])


def _fit(made: Array, told: Array, first: int) -> Array:
    """(b_0, b_1) from motions made (m,) and told (m,), from the frame `first` on; a constant drift is left out."""
    A = np.column_stack([told[first:], told[first - 1 : -1], np.ones(len(told) - first)])
    return np.asarray(np.linalg.lstsq(A, made[first:], rcond=None)[0][:2], dtype=float)
