"""How a thing moves of itself, as a displacement D(t) (4, 4) in its own frame at rest: T_world(t) = T_world_rest D(t).

All but the random walk are closed forms; that one is drawn from the run's seed, so that every controller meets the same.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import numpy as np
from annotated_types import Ge, Gt

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array, Pose, Triple, rotation_from_rpy
from vstestbed.core.spec import OneOf, spec

if TYPE_CHECKING:
    from vstestbed.targets.attached import Carried

Path = Callable[[float], Array]
"""Displacement (4, 4) at a time [s]."""
Frequency = Annotated[float, Gt(0)]


def _shift(x: float, y: float, z: float) -> Array:
    D = np.eye(4)
    D[:3, 3] = x, y, z
    return D


class MotionBase:
    """Defaults of a motion: the target moves by itself, along a path of its own.

    Attributes:
        moves: it does anything but stand in the world. by_itself: along a path of its own (`path`), whatever robots and vehicles do.
        on_gripper: the robot's gripper holds the target, and the camera stands in the room (eye to hand).
    """

    moves: ClassVar[bool] = True
    by_itself: ClassVar[bool] = True
    on_gripper: ClassVar[bool] = False

    kind: Any  # the word in a scenario: a field of each motion

    @property
    def carrier(self) -> Carried | None:
        """The vehicle that carries the target, where one does."""
        return None

    def path(self, rng: np.random.Generator) -> Path:
        """The displacement as a function of time.

        Raises:
            ParameterError: something else moves the target.
        """
        raise ParameterError("target.motion", "has no path of its own: it goes where it is carried")

    def start(self, pose: Array) -> Array:
        """Where a target of this pose (4, 4) at rest is at the start, T_world_target (4, 4)."""
        return pose @ self.path(np.random.default_rng(0))(0.0)


@spec
class Still(MotionBase):
    """It does not move."""

    kind: Literal["still"] = "still"
    moves: ClassVar[bool] = False
    by_itself: ClassVar[bool] = False

    def path(self, rng: np.random.Generator) -> Path:
        """No displacement."""
        D = np.eye(4)
        return lambda t: D


@spec
class Line(MotionBase):
    """D = velocity (t - from_s) between two times; before and after, it stands.

    Args:
        velocity_mps: along its own axes [m/s].
        from_s, until_s: when it moves [s].
    """

    kind: Literal["line"] = "line"
    velocity_mps: Triple
    from_s: Annotated[float, Ge(0)] = 0.0
    until_s: Annotated[float, Gt(0)] = 1e9

    def path(self, rng: np.random.Generator) -> Path:
        """The displacement as a function of time."""
        v = np.array(self.velocity_mps)
        return lambda t: _shift(*(v * (min(max(t, self.from_s), self.until_s) - self.from_s)))


@spec
class Circle(MotionBase):
    """D = radius (cos 2 pi f t, sin 2 pi f t, 0): about its place at rest, in its own plane x, y, at a constant speed 2 pi f radius.

    Args:
        radius_m: [m]. frequency_hz: turns a second. phase_deg: where it starts, from x towards y [deg].
    """

    kind: Literal["circle"] = "circle"
    radius_m: Annotated[float, Gt(0)]
    frequency_hz: Frequency
    phase_deg: float = 0.0

    def path(self, rng: np.random.Generator) -> Path:
        """The displacement as a function of time."""
        r, w, start = self.radius_m, 2 * math.pi * self.frequency_hz, math.radians(self.phase_deg)
        return lambda t: _shift(r * math.cos(w * t + start), r * math.sin(w * t + start), 0.0)


@spec
class Sinusoid(MotionBase):
    """D = sin(2 pi f t) times a translation, and a turn by as much of the roll-pitch-yaw angles.

    Args:
        amplitude: translation [m] and angles [deg] at the peak. frequency_hz: f.
    """

    kind: Literal["sinusoid"] = "sinusoid"
    amplitude: Pose
    frequency_hz: Frequency

    def path(self, rng: np.random.Generator) -> Path:
        """The displacement as a function of time."""
        xyz, rpy = np.array(self.amplitude.xyz), np.array(self.amplitude.rpy_deg)
        w = 2 * math.pi * self.frequency_hz

        def at(t: float) -> Array:
            s = math.sin(w * t)
            D = np.eye(4)
            D[:3, 3] = xyz * s
            if rpy.any():
                D[:3, :3] = rotation_from_rpy(np.radians(rpy * s))
            return D

        return at


@spec
class Lissajous(MotionBase):
    """D_i = amplitude_i sin(2 pi f_i t + phase_i) along each of its own axes; frequencies without a common measure never repeat.

    Args:
        amplitude_m: [m]. frequency_hz, phase_deg: of each axis.
    """

    kind: Literal["lissajous"] = "lissajous"
    amplitude_m: Triple
    frequency_hz: Triple
    phase_deg: Triple = (0.0, 0.0, 0.0)

    def path(self, rng: np.random.Generator) -> Path:
        """The displacement as a function of time."""
        a, w, start = np.array(self.amplitude_m), 2 * math.pi * np.array(self.frequency_hz), np.radians(self.phase_deg)
        return lambda t: _shift(*(a * np.sin(w * t + start)))


DRAW_S = 0.01
"""Times at which a random walk is drawn; between them it is the cubic that has both ends' places and speeds [s]."""
DAMPING = 1.0 / math.sqrt(2.0)
"""Of the random walk's spring: flat up to its corner frequency (Butterworth)."""


@spec
class RandomWalk(MotionBase):
    """A random walk that a spring keeps near: x'' = -W^2 x - sqrt(2) W x' + noise on each axis, W = 2 pi corner_hz.

    It never repeats; its place and speed are continuous, its acceleration is not. In the long run each axis is normal with
    standard deviation rms_m, and its speed with W rms_m. It starts at rest in its place. The seed of the run draws it.

    Args:
        rms_m: of each of its own axes [m]. corner_hz: above it the spectrum falls with the fourth power of frequency.

    Reference: Papoulis & Pillai 2002, Probability, Random Variables and Stochastic Processes, section 10.2 (the harmonically
    bound particle of Uhlenbeck & Ornstein 1930, doi:10.1103/PhysRev.36.823); exact steps by Van Loan 1978,
    doi:10.1109/TAC.1978.1101743.
    """

    kind: Literal["random_walk"] = "random_walk"
    rms_m: Triple
    corner_hz: Frequency = 0.2

    def path(self, rng: np.random.Generator) -> Path:
        """The displacement as a function of time; further steps are drawn as they are asked for, always the same ones."""
        F, chol = self.exact_step(DRAW_S)
        states, rms = [np.zeros((2, 3))], np.array(self.rms_m)

        def at(t: float) -> Array:
            k = int(t / DRAW_S + 1e-9)
            while len(states) < k + 2:
                states.append(F @ states[-1] + chol @ rng.standard_normal((2, 3)))
            (x0, v0), (x1, v1) = states[k], states[k + 1]
            s = t / DRAW_S - k
            h = DRAW_S
            x = x0 * (1 + 2 * s) * (1 - s) ** 2 + v0 * h * s * (1 - s) ** 2 + x1 * s * s * (3 - 2 * s) + v1 * h * s * s * (s - 1)
            return _shift(*(rms * x))

        return at

    def exact_step(self, dt: float) -> tuple[Array, Array]:
        """Of (place, speed) with unit variance of the place: the transition (2, 2) over dt, and the root (2, 2) of its noise."""
        from scipy.linalg import expm

        W = 2 * math.pi * self.corner_hz
        F = np.asarray(expm(np.array([[0.0, 1.0], [-W * W, -2 * DAMPING * W]]) * dt), dtype=float)
        stationary = np.diag([1.0, W * W])
        return F, np.asarray(np.linalg.cholesky(stationary - F @ stationary @ F.T), dtype=float)


OWN_MOTIONS = (Still, Line, Circle, Sinusoid, Lissajous, RandomWalk)
PlateMotion = Still | Line | Circle | Sinusoid | Lissajous | RandomWalk
PLATE_MOTIONS = OneOf("motion", *OWN_MOTIONS, default="still")
