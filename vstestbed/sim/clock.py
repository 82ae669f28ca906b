"""The physics clock: a step that divides the camera's period."""

from __future__ import annotations

import math

from vstestbed.camera import Camera
from vstestbed.core.errors import ParameterError
from vstestbed.core.quantity import PositiveTime
from vstestbed.core.spec import spec
from vstestbed.robots import Robot

LARGEST_STEP_S = 0.002
"""Largest default step [s]; the arm's actuators are tuned and tested at 1 and 2 ms."""


def longest_step(robot: Robot) -> float:
    """The longest default step of a robot [s]."""
    return min(robot.largest_step_s, robot.needed_step_s)


@spec
class Clock:
    """The physics clock, with a whole number of steps between pictures.

    Args:
        step_s: fixed step [s]; without it the largest step that divides the camera's period and is no longer than 2 ms; e.g. `0.001`.
    """

    step_s: PositiveTime | None = None

    def resolve(self, camera: Camera, largest: float = LARGEST_STEP_S) -> tuple[float, int]:
        """(step [s], steps per camera frame).

        Raises:
            ParameterError: step_s does not divide the camera's period.
        """
        if self.step_s is None:
            # The small number keeps a ratio of exactly n from being rounded up to n + 1.
            n = math.ceil(camera.period / largest - 1e-9)
            return camera.period / n, n
        n = round(camera.period / self.step_s)
        if n < 1 or abs(n * self.step_s - camera.period) > 1e-9 * camera.period:
            better = camera.period / max(1, math.ceil(camera.period / max(self.step_s, 1e-5)))
            words = f"must divide the camera's period {camera.period:.9g} s ({camera.rate_hz:g} Hz); {better:.12g} does"
            raise ParameterError("physics.step_s", words, self.step_s)
        return self.step_s, n
