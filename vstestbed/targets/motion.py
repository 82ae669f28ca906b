"""Prescribed motions of targets and plates: a displacement D(t) (4, 4) in the frame at rest,
T_world(t) = T_world_rest D(t).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Annotated, Any, ClassVar, Literal

import numpy as np

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array, Pose, rotation_from_rpy
from vstestbed.core.planar import pose_on_ground
from vstestbed.core.quantity import (
    Angle,
    Angles,
    Frequencies,
    Frequency,
    Length,
    Position,
    PositiveLength,
    PositiveSpeed,
    PositiveTime,
    TighterBounds,
    Time,
    Velocity,
)
from vstestbed.core.registry import Registry
from vstestbed.core.spec import spec
from vstestbed.targets.route import AnyRoute

Path = Callable[[float], Array]  # displacement (4, 4) at a time [s]


def _shift(x: float, y: float, z: float) -> Array:
    D = np.eye(4)
    D[:3, 3] = x, y, z
    return D


class MotionBase:
    """Defaults of a motion: the target moves along a prescribed path.

    Attributes:
        moves: it does not stand still. by_itself: it follows `path`, whatever robots and vehicles
            do.
        on_gripper: the robot's gripper holds the target, and the camera stands in the room (eye to
            hand).
        draws: `path` draws from its generator, so that another seed gives another path.
    """

    kind: Any  # the word in a scenario: a field of each motion
    moves: ClassVar[bool] = True
    by_itself: ClassVar[bool] = True
    on_gripper: ClassVar[bool] = False
    draws: ClassVar[bool] = False

    @property
    def carrier(self) -> Carried | None:
        """The vehicle that carries the target; None without one."""
        return None

    def path(self, rng: np.random.Generator) -> Path:
        """The displacement as a function of time. Raises ParameterError: something else moves the
        target.
        """
        raise ParameterError(
            "target.motion", "has no path of its own: the target goes where it is carried"
        )

    def start(self, pose: Array) -> Array:
        """T_world_target (4, 4) at the start, of a target whose pose at rest is `pose` (4, 4)."""
        # Any generator will do: the random walk, the only motion that draws, starts in its place.
        return pose @ self.path(np.random.default_rng(0))(0.0)


@spec
class Still(MotionBase):
    """It does not move."""

    kind: Literal["still"] = "still"
    moves = False
    by_itself = False

    def path(self, rng: np.random.Generator) -> Path:
        D = np.eye(4)  # one array for all times: nobody writes to a displacement
        return lambda t: D


@spec
class Line(MotionBase):
    """D = velocity (t - from_s) between two times; it stands before and after.

    Args:
        velocity_mps: velocity along its own axes [m/s]; e.g. `[0.1, 0, 0]`.
        from_s, until_s: start and end of the motion [s].
    """

    kind: Literal["line"] = "line"
    velocity_mps: Velocity
    from_s: Time = 0.0
    until_s: PositiveTime = 1e9

    def path(self, rng: np.random.Generator) -> Path:
        v = np.array(self.velocity_mps)
        return lambda t: _shift(*(v * (min(max(t, self.from_s), self.until_s) - self.from_s)))


@spec
class Circle(MotionBase):
    """D = radius (cos 2 pi f t, sin 2 pi f t, 0): about its place at rest, in its own plane x, y,
    at a constant speed 2 pi f radius.

    Args:
        radius_m: radius of the circle [m].
        frequency_hz: revolutions per second [Hz].
        phase_deg: starting angle, from x towards y [deg].
    """

    kind: Literal["circle"] = "circle"
    radius_m: PositiveLength
    frequency_hz: Frequency
    phase_deg: Angle = 0.0

    def path(self, rng: np.random.Generator) -> Path:
        r = self.radius_m
        w = 2 * math.pi * self.frequency_hz
        start = math.radians(self.phase_deg)
        return lambda t: _shift(r * math.cos(w * t + start), r * math.sin(w * t + start), 0.0)


@spec
class Sinusoid(MotionBase):
    """D = sin(2 pi f t) times a translation and times roll-pitch-yaw angles.

    Args:
        amplitude: translation and angles at the peak; e.g.
            `{xyz: [0.1, 0, 0], rpy_deg: [0, 0, 10]}`.
        frequency_hz: f [Hz]; e.g. `0.2`.
    """

    kind: Literal["sinusoid"] = "sinusoid"
    amplitude: Pose
    frequency_hz: Frequency

    def path(self, rng: np.random.Generator) -> Path:
        xyz = np.array(self.amplitude.xyz)
        rpy = np.array(self.amplitude.rpy_deg)
        w = 2 * math.pi * self.frequency_hz

        def at(t: float) -> Array:
            s = math.sin(w * t)
            D = _shift(*(xyz * s))
            if rpy.any():
                D[:3, :3] = rotation_from_rpy(np.radians(rpy * s))
            return D

        return at


@spec
class Lissajous(MotionBase):
    """D_i = amplitude_i sin(2 pi f_i t + phase_i) along each of its own axes; incommensurable
    frequencies never repeat.

    Args:
        amplitude_m: largest displacement along each axis [m]; e.g. `[0.2, 0.1, 0]`.
        frequency_hz: frequency of each axis; a negative one runs backwards [Hz]; e.g.
            `[0.1, 0.2, 0]`.
        phase_deg: phase of each axis [deg].
    """

    kind: Literal["lissajous"] = "lissajous"
    amplitude_m: Position
    frequency_hz: Frequencies
    phase_deg: Angles = (0.0, 0.0, 0.0)

    def path(self, rng: np.random.Generator) -> Path:
        a = np.array(self.amplitude_m)
        w = 2 * math.pi * np.array(self.frequency_hz)
        start = np.radians(self.phase_deg)
        return lambda t: _shift(*(a * np.sin(w * t + start)))


# sampling period of a random walk, which is interpolated by cubic Hermite polynomials of position
# and speed [s]
DRAW_S = 0.01


@spec
class RandomWalk(MotionBase):
    """A random walk bound by a spring: x'' = -W^2 x - sqrt(2) W x' + white noise on each axis, W =
    2 pi corner_hz.

    The stationary distribution of each axis is normal with standard deviation rms_m, that of its
    speed with W rms_m. It starts at rest with D = 1 and is drawn from the seed of the run, so that
    every law meets the same path.

    Args:
        rms_m: standard deviation of the displacement along each axis [m].
        corner_hz: corner frequency [Hz]; above it the power spectrum falls with the fourth power of
            frequency.

    Reference: Papoulis & Pillai 2002, Probability, Random Variables and Stochastic Processes,
    section 10.2 (the harmonically bound particle of Uhlenbeck & Ornstein 1930,
    doi:10.1103/PhysRev.36.823); exact steps by Van Loan 1978, doi:10.1109/TAC.1978.1101743.
    """

    kind: Literal["random_walk"] = "random_walk"
    rms_m: Position
    corner_hz: Frequency = 0.2
    draws = True

    def path(self, rng: np.random.Generator) -> Path:
        F, chol = self.exact_step(DRAW_S)
        states = [np.zeros((2, 3))]
        rms = np.array(self.rms_m)

        def at(t: float) -> Array:
            k = int(t / DRAW_S + 1e-9)
            # Drawn in order of time whenever they are first needed, and kept: `at` is a function of
            # t, whoever asks first and how often.
            while len(states) < k + 2:
                states.append(F @ states[-1] + chol @ rng.standard_normal((2, 3)))
            (x0, v0), (x1, v1) = states[k], states[k + 1]
            s = t / DRAW_S - k
            h = DRAW_S
            x = (
                x0 * (1 + 2 * s) * (1 - s) ** 2
                + v0 * h * s * (1 - s) ** 2
                + x1 * s * s * (3 - 2 * s)
                + v1 * h * s * s * (s - 1)
            )
            return _shift(*(rms * x))

        return at

    def exact_step(self, dt: float) -> tuple[Array, Array]:
        """Exact step of (position, speed) at unit variance of position: transition (2, 2), and the
        noise's Cholesky factor (2, 2).
        """
        from scipy.linalg import expm

        W = 2 * math.pi * self.corner_hz
        # damping ratio: a spectrum that is flat up to the corner frequency (Butterworth)
        damping = 1.0 / math.sqrt(2.0)
        F = np.asarray(expm(np.array([[0.0, 1.0], [-W * W, -2 * damping * W]]) * dt), dtype=float)
        # The noise that keeps the stationary covariance P where it is: P = F P F^T + Q.
        stationary = np.diag([1.0, W * W])
        return F, np.asarray(np.linalg.cholesky(stationary - F @ stationary @ F.T), dtype=float)


OWN_MOTIONS = (Still, Line, Circle, Sinusoid, Lissajous, RandomWalk)
PLATE_MOTIONS = Registry("motion", *OWN_MOTIONS, default="still")


@spec
class Carried(MotionBase):
    """The target rides on a vehicle that drives along a route; `target.pose` is then where it sits
    in the vehicle's frame.

    The vehicle is simulated with its masses, wheels and servos. Its driver steers by the true
    place, and is no part of the experiment.

    Args:
        by: the vehicle's kind. It starts on the route.
        route: its path on the floor.
        speed_mps: its speed [m/s].
        from_m: arc length on the route at which it starts [m].
    """

    kind: Literal["carried"] = "carried"
    by: Literal["car", "omni"] = "car"
    route: AnyRoute
    # 3 m/s is the largest speed limit that a car may have (`CarLimits`).
    speed_mps: Annotated[PositiveSpeed, TighterBounds(le=3)] = 0.5
    from_m: Length = 0.0
    by_itself = False

    @property
    def carrier(self) -> Carried:
        """Itself: the vehicle, its route and its speed."""
        return self

    def start(self, pose: Array) -> Array:
        """On the vehicle, at its start on the route."""
        return pose_on_ground(self.route.at(self.from_m)[:3]) @ pose


@spec
class Held(MotionBase):
    """The robot's gripper holds the target, and the camera stands in the room (eye to hand).

    `target.pose` is then where the target sits in the flange's frame, `camera.mount` where the
    camera stands in the world.
    """

    kind: Literal["held"] = "held"
    by_itself = False
    on_gripper = True

    def start(self, pose: Array) -> Array:
        """The pose in the flange's frame; its place in the world depends on the robot
        (`sim.base`).
        """
        return pose


MOTIONS = Registry("motion", *OWN_MOTIONS, Carried, Held, default="still")
