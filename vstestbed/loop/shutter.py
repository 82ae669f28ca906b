"""The camera on the loop's clock: exposures, and pictures in transit."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from vstestbed.camera import Look, Picture
from vstestbed.loop.exposure import Exposure
from vstestbed.loop.row_views import RowViews
from vstestbed.loop.stamps import Stamps
from vstestbed.scenario.scenario import Scenario
from vstestbed.scenario.streams import TIMING_STREAM
from vstestbed.sim.base import Plant, Truth
from vstestbed.sim.delay_line import DelayLine
from vstestbed.sim.link import BurstyLink
from vstestbed.sim.scene.flicker import STEADY
from vstestbed.sim.timing import Planned, Shutter
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
        link: may lose pictures; None for one that loses none.
    """

    def __init__(self, scenario: Scenario, plant: Plant, whole: bool = False, link: BurstyLink | None = None):
        self.plant, self.whole, self._view = plant, whole, scenario.detector.needs_truth
        # A perturbation, metering or a stream may work on the picture as a whole: a part of it would not be changed as the whole is.
        self._in_parts = not (scenario.noise.on_pictures or scenario.camera.imaged)
        rng = scenario.rng(TIMING_STREAM)
        light = scenario.world.light
        flicker = STEADY if light is None or (not scenario.needs_image and not whole) else light.flicker
        self.shutter = Shutter(scenario.timing, scenario.camera, plant.step_s, plant.steps_per_frame, rng, link, flicker)
        rolls = self._view and scenario.camera.readout_s > 0
        self._row_views = RowViews(scenario.camera, self.shutter.opening.nodes) if rolls else None
        self.line: DelayLine[Exposed] = DelayLine(overtakes=scenario.timing.out_of_order)
        self._stamps = Stamps(scenario, plant) if scenario.timing.stamps else None
        self.look: Look | None
        self._takes_whole = whole
        # An oracle's exposures do not depend on whether pictures are taken for a film.
        self._metered = scenario.needs_image and scenario.camera.blurring is not None
        self._plan()

    def _plan(self) -> None:
        self.planned: Planned = self.shutter.following(self.plant.exposure_s() if self._metered else None)
        self.opening, self.middle, self.look = 0, None, None

    def next_event(self) -> int:
        """The step at which the shutter opens next, a picture arrives, or the robot's sensors are read for one."""
        opens, due = self.planned.opens[self.opening], self.line.next_due()
        following = opens if due is None else min(opens, due)
        return following if self._stamps is None else min(following, self._stamps.next_event())

    def act(self, step: int, look_next: Callable[[], Look | None]) -> None:
        """Open the shutter when it is due, and send complete pictures. `look_next` gives the detector's region of interest."""
        if self._stamps is not None:
            self._stamps.act(step)
        while (planned := self.planned).opens[self.opening] == step:
            # With pictures in transit the region of interest is not known yet: the detector has not seen them.
            # It is decided once: all images of an exposure show the same part.
            if self.opening == 0:
                self._takes_whole = self.whole
                self.look = look_next() if self.line.next_due() is None and self._in_parts and not self.whole else None
            if planned.weights == (1.0,):
                picture, truth = self.plant.capture(self.look)
                if picture is not None and planned.arrives > step:
                    picture = picture.copy()  # the next picture overwrites the renderer's buffer before this one arrives
                self._send(planned, picture, self._shot(step, truth))
            else:
                self._expose(planned, step)

    def received(self, shot: Exposure, step: int) -> tuple[Exposure, float]:
        """What the controller gets of an exposure that arrives at this step, and its time stamp [s]."""
        return (shot, shot.t) if self._stamps is None else self._stamps.received(shot, step)

    def _expose(self, planned: Planned, step: int) -> None:
        # Truth, time stamp and reading are those of the exposure's middle: a symmetric smear leaves a marker's centre there.
        is_middle = step >= planned.middle and self.middle is None
        truth = self._truth(is_middle)
        if truth is not None and is_middle:
            self.middle = self._shot(step, truth)
        self.plant.expose(planned.weights[self.opening], self.look, is_middle)
        self.opening += 1
        if self.opening == len(planned.opens) and self.middle is not None:
            self._send(planned, self.plant.developed(self.middle.shot.t), self._by_rows(self.middle))

    def _truth(self, is_middle: bool) -> Truth | None:
        """The truth of an image of an exposure, where it is needed: in the middle, and for an oracle behind a rolling shutter always."""
        if self._row_views is None:
            return self.plant.truth() if is_middle else None
        truth = self.plant.truth()
        self._row_views.add(TruthView(truth.p_camera, truth.hidden))
        return truth

    def _by_rows(self, made: Exposed) -> Exposed:
        """With what an oracle sees through a rolling shutter; the truth itself stays that of the time stamp."""
        return made if self._row_views is None else replace(made, shot=replace(made.shot, view=self._row_views.taken()))

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
