"""The camera on the loop's clock: exposures, and pictures in transit."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from vstestbed.camera import Look, Picture
from vstestbed.loop.exposure import Exposure
from vstestbed.scenario.scenario import TIMING_STREAM, Scenario
from vstestbed.sim.base import Plant, Truth
from vstestbed.sim.timing import DelayLine, Planned, Shutter
from vstestbed.vision.base import TruthView


@dataclass(frozen=True, slots=True)
class Exposed:
    """A picture in transit to the controller, and the truth at its exposure, which stays behind."""

    shot: Exposure
    truth: Truth


class CameraClock:
    """The camera on the clock: takes the pictures that its shutter plans, and sends them with their latency.

    Attributes:
        line: pictures in transit.
        whole: whether the next exposures take whole pictures; may be changed at any time.

    Args:
        whole: take whole pictures, whatever the detector's regions of interest are.
    """

    def __init__(self, scenario: Scenario, plant: Plant, whole: bool = False):
        self.plant, self.whole, self._view = plant, whole, scenario.detector.needs_truth
        # A perturbation, metering or a stream may work on the picture as a whole: a part of it would not be changed as the whole is.
        self._in_parts = not (scenario.noise.on_pictures or scenario.camera.imaged)
        rng = scenario.rng(TIMING_STREAM)
        self.shutter = Shutter(scenario.timing, scenario.camera, plant.step_s, plant.steps_per_frame, rng)
        self.line: DelayLine[Exposed] = DelayLine()
        self.look: Look | None
        self._takes_whole = whole
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
                self._takes_whole = self.whole
                self.look = look_next() if self.line.next_due() is None and self._in_parts and not self.whole else None
            if len(planned.opens) == 1:
                picture, truth = self.plant.capture(self.look)
                if picture is not None and planned.arrives > step:
                    picture = picture.copy()  # the next picture overwrites the renderer's buffer before this one arrives
                self._send(planned, picture, self._shot(step, truth))
            else:
                self._expose(planned, step)

    def _expose(self, planned: Planned, step: int) -> None:
        # Truth, time stamp and reading are those of the exposure's middle: a symmetric smear leaves a marker's centre there.
        is_middle = step >= planned.middle and self.middle is None
        if is_middle:
            self.middle = self._shot(step, self.plant.truth())
        self.plant.expose(planned.weights[self.opening], self.look, is_middle)
        self.opening += 1
        if self.opening == len(planned.opens) and self.middle is not None:
            self._send(planned, self.plant.developed(self.middle.shot.t), self.middle)

    def _shot(self, step: int, truth: Truth) -> Exposed:
        """Truth and reading at an exposure, still without the picture."""
        # Truth reaches a detector only if it says that it needs it (an oracle): the one place where it passes the fence.
        view = TruthView(truth.p_camera, truth.hidden) if self._view else None
        return Exposed(Exposure(self.planned.frame, step * self.plant.step_s, None, self.plant.reading(), view), truth)

    def _send(self, planned: Planned, picture: Picture | None, made: Exposed) -> None:
        if self._takes_whole and picture is not None:
            picture = self.plant.with_own(picture)
        self.line.push(planned.arrives, made if picture is None else replace(made, shot=replace(made.shot, picture=picture)))
        self._plan()
