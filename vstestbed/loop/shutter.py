"""The camera on the loop's clock: exposures, and pictures in transit."""

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
    """A picture in transit to the law, with the sensor reading and the integrated commands at its exposure.

    Attributes:
        number: counts frames. picture: None where no detector asks for one. t: time of exposure [s].
        truth, reading: truth and sensor reading at that time. commanded: mean of the twists commanded since the last exposure (6,).
        displacement: integral of all commands until then, (6,) [m, rad].
    """

    number: int
    picture: Picture | None
    t: float
    truth: Truth
    reading: Reading
    commanded: Array
    displacement: Array


class CameraClock:
    """The camera on the clock: takes the pictures that its shutter plans, and sends them with their latency.

    Attributes:
        line: pictures in transit. displacement: integral of all commands so far, (6,) [m, rad]; the loop adds to it.
    """

    def __init__(self, scenario: Scenario, plant: Plant):
        self.plant = plant
        rng = scenario.rng(TIMING_STREAM)
        self.shutter = Shutter(scenario.timing, scenario.camera, plant.step_s, plant.steps_per_frame, rng)
        self.line: DelayLine[Exposed] = DelayLine()
        self.displacement, self._displacement_before, self._step_before = np.zeros(6), np.zeros(6), 0
        self.look: Look | None
        self._plan()

    def _plan(self) -> None:
        self.planned: Planned = self.shutter.following()
        self.opening, self.middle, self.look = 0, None, None

    def next_event(self) -> int:
        """The step at which the shutter opens next, or a picture arrives."""
        opens, due = self.planned.opens[self.opening], self.line.next_due()
        return opens if due is None else min(opens, due)

    def act(self, step: int, look_next: Callable[[], Look | None]) -> None:
        """Open the shutter when it is due, and send complete pictures. `look_next` gives the detector's region of interest."""
        while (planned := self.planned).opens[self.opening] == step:
            # With pictures in transit the region of interest is not known yet: the detector has not seen them.
            # It is decided once: all images of an exposure show the same part.
            if self.opening == 0:
                self.look = look_next() if self.line.next_due() is None else None
            if len(planned.opens) == 1:
                picture, truth = self.plant.capture(self.look)
                if picture is not None and planned.arrives > step:
                    picture = picture.copy()  # the next picture overwrites the renderer's buffer before this one arrives
                self._send(planned, picture, self._shot(step, truth))
            else:
                self._expose(planned, step)

    def _expose(self, planned: Planned, step: int) -> None:
        # Truth, time stamp and reading are those of the exposure's middle: a symmetric smear leaves a marker's centre there.
        if step >= planned.middle and self.middle is None:
            self.middle = self._shot(step, self.plant.truth())
        self.plant.expose(planned.weights[self.opening], self.look)
        self.opening += 1
        if self.opening == len(planned.opens) and self.middle is not None:
            self._send(planned, self.plant.developed(self.middle.t), self.middle)

    def _shot(self, step: int, truth: Truth) -> Exposed:
        """Truth and reading at an exposure, still without the picture."""
        commanded = (self.displacement - self._displacement_before) / (max(1, step - self._step_before) * self.plant.step_s)
        self._displacement_before, self._step_before = self.displacement, step
        return Exposed(self.planned.frame, None, step * self.plant.step_s, truth, self.plant.reading(), commanded, self.displacement)

    def _send(self, planned: Planned, picture: Picture | None, shot: Exposed) -> None:
        self.line.push(planned.arrives, shot if picture is None else replace(shot, picture=picture))
        self._plan()
