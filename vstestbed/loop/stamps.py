"""Time stamps in a run: by them the controller knows when a picture was taken, and which of the robot's readings belongs to it."""

from __future__ import annotations

import math
from bisect import bisect_left
from collections import deque
from dataclasses import replace

from vstestbed.loop.exposure import Exposure
from vstestbed.robots import Reading
from vstestbed.scenario.scenario import Scenario
from vstestbed.scenario.streams import STAMP_STREAM
from vstestbed.sim.base import Plant
from vstestbed.sim.time_stamps import CameraStamps, RobotStamps

READING_S = 0.002
"""Time between readings of a robot without an onboard controller [s]: 500 Hz, as arms in industry report their joints."""
KEPT_S = 10.0
"""How long readings are kept [s]."""


class Stamps:
    """Stamps the pictures that arrive, and finds the robot's reading of the same stamp.

    Args:
        scenario: the experiment, with `timing.stamps`. plant: gives the readings.
    """

    def __init__(self, scenario: Scenario, plant: Plant):
        timing = scenario.timing
        self._timing, self._plant, self._rng = timing, plant, scenario.rng(STAMP_STREAM)
        self._camera, self._robot = timing.camera_clock or CameraStamps(), timing.robot_clock or RobotStamps()
        # At the steps at which an onboard controller reads the sensors anyway, no other noise is drawn for it.
        self._every = max(1, round((scenario.robot.control_period_s or READING_S) / plant.step_s))
        self._steps: deque[int] = deque(maxlen=math.ceil(KEPT_S / (self._every * plant.step_s)))
        self._readings: deque[Reading] = deque(maxlen=self._steps.maxlen)

    def next_event(self) -> int:
        """The step of the next reading."""
        return self._steps[-1] + self._every if self._steps else 0

    def act(self, step: int) -> None:
        """Take a reading when it is due."""
        if step >= self.next_event():
            self._steps.append(step)
            self._readings.append(self._plant.reading())

    def received(self, shot: Exposure, step: int) -> tuple[Exposure, float]:
        """What the controller gets of an exposure that arrives at this step, and its stamp [s], which may lie in the future."""
        now = step * self._plant.step_s
        stamp = self._camera.at(now if self._camera.stamped == "arrival" else shot.t)
        stamp += self._timing.jittered(self._camera.jitter_s, self._rng)
        t = min(stamp, now)
        picture = None if shot.picture is None else replace(shot.picture, t=t)
        return replace(shot, t=t, picture=picture, reading=self._reading(stamp)), stamp

    def _reading(self, stamp: float) -> Reading:
        """The reading whose stamp is nearest to this one [s], of those that have come."""
        at = self._robot.true(stamp) / self._plant.step_s
        i = bisect_left(self._steps, at)
        if i == len(self._steps) or (i > 0 and at - self._steps[i - 1] <= self._steps[i] - at):
            i -= 1
        return self._readings[i]
