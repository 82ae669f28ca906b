"""The camera on the loop's clock: exposures, and pictures on their way."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from vstestbed.camera import Look, Picture
from vstestbed.core.geometry import Array
from vstestbed.robots.reading import Reading
from vstestbed.scenario.scenario import TIMING_STREAM, Scenario
from vstestbed.sim.base import Plant, Truth
from vstestbed.sim.timing import DelayLine, Planned, Shutter


@dataclass(frozen=True, slots=True)
class Exposed:
    """A picture on its way to the law, with what the robot measured and had been ordered at its exposure.

    Attributes:
        number: counts frames. picture: None where no detector asks for one. t: exposure [s]. truth: then.
        reading: what the robot measured then. ordered: mean twist (6,) ordered since the last exposure.
        way: the sum of all that was ordered until then, (6,) [m, rad].
    """

    number: int
    picture: Picture | None
    t: float
    truth: Truth
    reading: Reading
    ordered: Array
    way: Array


class CameraClock:
    """The camera on the clock: takes the pictures that its shutter plans, and sends them on their way.

    Attributes:
        line: pictures on their way. way: the sum of all that was ordered so far, (6,) [m, rad]; the loop adds to it.
    """

    def __init__(self, scenario: Scenario, plant: Plant):
        self.plant = plant
        rng = scenario.rng(TIMING_STREAM)
        self.shutter = Shutter(scenario.timing, scenario.camera, plant.step_s, plant.steps_per_frame, rng)
        self.line: DelayLine[Exposed] = DelayLine()
        self.way, self._way_before, self._step_before = np.zeros(6), np.zeros(6), 0
        self._plan()

    def _plan(self) -> None:
        self.planned: Planned = self.shutter.following()
        self.opening, self.middle = 0, None

    def next_event(self) -> int:
        """The step at which the shutter opens next, or a picture arrives."""
        opens, due = self.planned.opens[self.opening], self.line.next_due()
        return opens if due is None else min(opens, due)

    def act(self, step: int, look_next: Callable[[], Look | None]) -> None:
        """Open the shutter where that is due; a picture that is whole is sent. `look_next` tells where the detector will look."""
        while (planned := self.planned).opens[self.opening] == step:
            # with pictures still on their way, nobody knows yet where to look
            look = look_next() if self.line.next_due() is None else None
            if len(planned.opens) == 1:
                picture, truth = self.plant.capture(look)
                if picture is not None and planned.arrives > step:
                    picture = picture.copy()  # it will wait while the next ones are taken
                self._send(planned, picture, self._shot(step, truth))
            else:
                self._expose(planned, step, look)

    def _expose(self, planned: Planned, step: int, look: Look | None) -> None:
        if step >= planned.middle and self.middle is None:
            self.middle = self._shot(step, self.plant.truth())
        self.plant.expose(planned.weights[self.opening], look)
        self.opening += 1
        if self.opening == len(planned.opens) and self.middle is not None:
            self._send(planned, self.plant.developed(self.middle.t), self.middle)

    def _shot(self, step: int, truth: Truth) -> Exposed:
        """What is true and measured at an exposure, still without its picture."""
        ordered = (self.way - self._way_before) / (max(1, step - self._step_before) * self.plant.step_s)
        self._way_before, self._step_before = self.way, step
        return Exposed(self.planned.frame, None, step * self.plant.step_s, truth, self.plant.reading(), ordered, self.way)

    def _send(self, planned: Planned, picture: Picture | None, shot: Exposed) -> None:
        self.line.push(planned.arrives, replace(shot, picture=picture))
        self._plan()
