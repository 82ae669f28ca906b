"""The camera on the loop's clock: exposures, and pictures in transit."""

from __future__ import annotations

import math
from bisect import bisect_left
from collections import deque
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from vstestbed.camera import Camera, Picture, Regions
from vstestbed.core.geometry import Array
from vstestbed.imaging.flicker import STEADY
from vstestbed.loop.ego_motion import Exposure
from vstestbed.robots import Reading
from vstestbed.scenario.cameras import OtherCamera
from vstestbed.scenario.distributions import STAMP_STREAM, TIMING_STREAM
from vstestbed.scenario.scenario import Scenario
from vstestbed.sim.base import PlantCamera, Truth
from vstestbed.timing.clock import CameraStamps, DelayLine, Loses, RobotStamps
from vstestbed.timing.plan import Planned, Shutter
from vstestbed.vision.base import TruthView

ROUNDS = 12
"""Iterations to the time at which a marker is exposed. Each divides the error by H / (readout_s
v'), v' the marker's speed down the picture [px/s]: 24 for one that crosses it in half a second
while 20 ms are read out.
"""


class RowViews:
    """Views of the truth while a picture is read out, and the one view that the picture is of.

    Marker i is exposed at the time t_i that solves t = d(v_i(t)), with the delay d(v) of a row
    (`Camera.row_delay`) and v_i(t) the row of the marker's centre at t; its place is interpolated
    between the views. A marker that the lens cannot project is taken at the picture's time stamp,
    one beyond the picture at the begin or end of the readout.

    camera: the lens. times: of the views from the picture's time stamp (K,) [s], rising.
    """

    def __init__(self, camera: Camera, times: Array):
        self._camera = camera
        self._times = times
        self._ends = camera.row_delay(np.array([0.0, camera.height - 1.0]))
        self._views: list[TruthView] = []

    def add(self, view: TruthView) -> None:
        """Add the view at the next of the times."""
        self._views.append(view)

    def taken(self) -> TruthView:
        """The view in which each marker is where it was when its row was exposed; the next view is
        the first one of the next picture.
        """
        views, self._views = self._views, []
        p = np.stack([view.p_camera for view in views])
        t = np.zeros(p.shape[1])
        for _ in range(ROUNDS):
            v = self._camera.project(self._at(p, t))[:, 1]
            t = np.clip(np.where(np.isfinite(v), self._camera.row_delay(v), 0.0), *self._ends)
        nearest = np.abs(self._times[:, None] - t).argmin(axis=0)
        hidden: NDArray[np.bool_] = np.stack([view.hidden for view in views])
        return TruthView(self._at(p, t), hidden[nearest, np.arange(len(t))])

    def _at(self, p: Array, t: Array) -> Array:
        """Places (N, 3), each at its own time (N,), between those at all times (K, N, 3)."""
        k = np.clip(np.searchsorted(self._times, t, side="right") - 1, 0, len(self._times) - 2)
        share = ((t - self._times[k]) / (self._times[k + 1] - self._times[k]))[:, None]
        i = np.arange(len(t))
        return (1 - share) * p[k, i] + share * p[k + 1, i]


# Time stamps in a run: by them the controller knows when a picture was taken, and which of the
# robot's readings belongs to it.

# time between readings of a robot without an onboard controller [s]: 500 Hz, as arms in industry
# report their joints
READING_S = 0.002
KEPT_S = 10.0  # how long readings are kept [s]


class Stamps:
    """Stamps the pictures that arrive, and finds the robot's reading of the same stamp
    (`timing.clock`).
    """

    def __init__(self, scenario: Scenario | OtherCamera, plant: PlantCamera):
        timing = scenario.timing
        self._timing = timing
        self._plant = plant
        self._rng = scenario.rng(STAMP_STREAM)
        self._camera = timing.camera_clock or CameraStamps()
        self._robot = timing.robot_clock or RobotStamps()
        # At the steps at which an onboard controller reads the sensors anyway, no other noise is
        # drawn for it.
        onboard = scenario.robot.onboard
        period_s = onboard.control_period_s if onboard else READING_S
        self._every = max(1, round(period_s / plant.step_s))
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
        """What the controller gets of an exposure that arrives at this step, and its stamp [s],
        which may lie in the future.
        """
        now = step * self._plant.step_s
        stamp = self._camera.at(now if self._camera.stamped == "arrival" else shot.t)
        stamp += self._timing.jittered(self._camera.jitter_s, self._rng)
        t = min(stamp, now)
        picture = None if shot.picture is None else replace(shot.picture, t=t)
        return shot._replace(t=t, picture=picture, reading=self._reading(stamp)), stamp

    def _reading(self, stamp: float) -> Reading:
        at = self._robot.true(stamp) / self._plant.step_s
        i = bisect_left(self._steps, at)
        if i == len(self._steps) or (i > 0 and at - self._steps[i - 1] <= self._steps[i] - at):
            i -= 1
        return self._readings[i]


# a picture in transit to the controller, and the truth at its exposure, which stays behind
Exposed = tuple[Exposure, Truth]


class CameraClock:
    """The camera on the clock: takes the pictures that its shutter plans, and sends them with their
    latency (`line`). whole: take whole pictures beside what the detector's regions of interest
    show; may be changed at any time. link: may lose pictures.
    """

    def __init__(
        self,
        scenario: Scenario | OtherCamera,
        plant: PlantCamera,
        whole: bool = False,
        link: Loses | None = None,
    ):
        self.plant = plant
        self.whole = whole
        self._view = scenario.detector.needs_truth
        # A perturbation, metering or a stream may work on the picture as a whole: a part of it
        # would not be changed as the whole is.
        self._in_parts = not (scenario.noise.on_pictures or scenario.camera.imaged)
        light = scenario.world.light
        flicker = STEADY
        if light is not None and (scenario.needs_image or whole):
            flicker = light.flicker
        self.shutter = Shutter(
            scenario.timing,
            scenario.camera,
            plant.step_s,
            scenario.rng(TIMING_STREAM),
            link,
            flicker,
        )
        rolls = self._view and scenario.camera.readout_s > 0
        self._row_views = RowViews(scenario.camera, self.shutter.opening.nodes) if rolls else None
        self.line: DelayLine[Exposed] = DelayLine(overtakes=scenario.timing.out_of_order)
        self._stamps = Stamps(scenario, plant) if scenario.timing.stamps else None
        # An oracle's exposures do not depend on whether pictures are taken for a film.
        self._metered = scenario.needs_image and scenario.camera.blurring is not None
        self._plan()

    def _plan(self) -> None:
        exposure_s = self.plant.exposure_s() if self._metered else None
        self.planned: Planned = self.shutter.following(exposure_s)
        self.opening = 0
        self.middle: Exposed | None = None
        self.regions: Regions | None = None

    def next_event(self) -> int:
        """The step at which the shutter opens next, a picture arrives, or the robot's sensors are
        read for one.
        """
        opens, due = self.planned.opens[self.opening], self.line.next_due()
        following = opens if due is None else min(opens, due)
        return following if self._stamps is None else min(following, self._stamps.next_event())

    def act(self, step: int, next_regions: Callable[[], Regions | None]) -> None:
        """Open the shutter when it is due, and send complete pictures. `next_regions` gives the
        detector's region of interest.
        """
        if self._stamps is not None:
            self._stamps.act(step)
        while (planned := self.planned).opens[self.opening] == step:
            # With pictures in transit the region of interest is not known yet: the detector has not
            # seen them. It is decided once: all images of an exposure show the same part.
            if self.opening == 0:
                self._takes_whole = self.whole
                in_parts = self._in_parts and self.line.next_due() is None
                self.regions = next_regions() if in_parts else None
            if planned.weights == (1.0,):
                picture, truth = self.plant.capture(self.regions)
                if picture is not None and planned.arrives > step:
                    # the next picture overwrites the renderer's buffer before this one arrives
                    picture = picture.copy()
                self._send(planned, picture, self._shot(step, truth))
            else:
                self._expose(planned, step)

    def received(self, shot: Exposure, step: int) -> tuple[Exposure, float]:
        """What the controller gets of an exposure that arrives at this step, and its time stamp
        [s].
        """
        return (shot, shot.t) if self._stamps is None else self._stamps.received(shot, step)

    def _expose(self, planned: Planned, step: int) -> None:
        # Truth, time stamp and reading are those of the exposure's middle: a symmetric smear leaves
        # a marker's centre there.
        is_middle = step >= planned.middle and self.middle is None
        if is_middle or self._row_views is not None:
            truth = self.plant.truth()
            if self._row_views is not None:  # an oracle needs the truth of each image
                self._row_views.add(TruthView(truth.p_camera, truth.hidden))
            if is_middle:
                self.middle = self._shot(step, truth)
        self.plant.expose(planned.weights[self.opening], self.regions, is_middle)
        self.opening += 1
        if self.opening == len(planned.opens) and self.middle is not None:
            shot, truth = self.middle
            if self._row_views is not None:  # the truth itself stays that of the time stamp
                shot = shot._replace(view=self._row_views.taken())
            self._send(planned, self.plant.developed(shot.t), (shot, truth))

    def _shot(self, step: int, truth: Truth) -> Exposed:
        # Truth reaches a detector only if it says that it needs it (an oracle): the one place where
        # it passes the fence.
        view = TruthView(truth.p_camera, truth.hidden) if self._view else None
        t = step * self.plant.step_s
        return Exposure(self.planned.frame, t, None, self.plant.reading(), view), truth

    def _send(self, planned: Planned, picture: Picture | None, made: Exposed) -> None:
        if picture is not None:
            shot, truth = made
            taken = self.plant.with_own(picture) if self._takes_whole else picture
            made = shot._replace(picture=taken), truth
        self.line.push(planned.arrives, made)
        self._plan()
