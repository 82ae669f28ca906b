"""Timing in whole physics steps: exposure, latency, jitter and dropped pictures of the camera, latency of commands."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import Annotated, Generic, Literal, TypeVar

import numpy as np
from annotated_types import Ge, Le, Lt

from vstestbed.camera import Camera
from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array
from vstestbed.core.quantity import Narrower, PositiveTime, Time
from vstestbed.core.spec import spec
from vstestbed.sim.row_weights import Contribution, contributions, of_rows
from vstestbed.sim.scene.flicker import STEADY, Flicker

T = TypeVar("T")
LEAST_PERIODS = 3
"""A command lasts this many camera periods at least."""


@spec
class Timing:
    """Timing of pictures and commands beyond the camera's rate and latency, rounded to whole physics steps.

    A picture's time stamp is the true middle of its exposure, with a rolling shutter (`camera.readout_s`) that of its middle row. It
    arrives `camera.latency_s` after the end of the exposure, with a rolling shutter of the last row's, never before an earlier one.

    With a rolling shutter each row is composed of the images nearest to its own exposure (`sim/row_weights.py`). With images tau
    apart, and a marker that moves in the picture at v [px/s] with an acceleration a [px/s^2], the marker's centre is right but for
    a tau^2 / 8 [px], and its edge is double by v tau at most, a pixel at 500 px/s and the 2 ms of a physics step. Shorter steps
    (`physics.step_s`) allow more images; an exposure longer than tau blurs the edge as it should.

    Only the rows to which an image contributes are drawn, where the renderer can draw a part (the perspective lens without distortion,
    and rays). CPU time of a frame of `arm_ibvs`, 640 x 480, by OpenGL in software and by rays: 6.6 and 4.2 ms without, 22 and 14 ms with
    a readout of 20 ms (11 images), 36 and 23 ms with an exposure of 5 ms besides, 38 and 43 ms with flicker besides the readout. An oracle
    takes 3 ms in place of 1.

    Args:
        exposure_s: exposure time [s], with a rolling shutter of each row; the picture is the mean of images rendered during it (motion
            blur); e.g. `0.01`.
        exposure_pictures: number of these images, at most one a physics step; with a rolling shutter it is readout_pictures.
        readout_pictures: number of images of which a picture with a rolling shutter is composed, from the first row's exposure to the
            last one's, at most one a physics step.
        jitter: distribution of the jitters: `uniform` within +- the number given, or `normal` with it as standard deviation.
        exposure_jitter_s: jitter of the time of exposure [s]; e.g. `0.005`.
        latency_jitter_s: jitter of the latency [s]; e.g. `0.01`.
        drop_probability: probability that a picture never arrives [1]; e.g. `0.1`.
        command_latency_s: time from a law's command to the robot's new setpoint [s]; e.g. `0.02`.
        command_timeout_s: how long a command lasts [s], three camera periods at least. Then, without a new one, the robot stops
            within its limits; a picture that arrives so much later than `camera.latency_s` is none.
    """

    exposure_s: Time = 0.0
    exposure_pictures: Annotated[int, Ge(3), Le(999)] = 9
    readout_pictures: Annotated[int, Ge(3), Le(999)] = 21
    jitter: Literal["uniform", "normal"] = "uniform"
    exposure_jitter_s: Time = 0.0
    latency_jitter_s: Annotated[Time, Narrower(le=60)] = 0.0
    drop_probability: Annotated[float, Ge(0), Lt(1)] = 0.0
    command_latency_s: Annotated[Time, Narrower(le=60)] = 0.0
    command_timeout_s: PositiveTime = 0.5

    @property
    def draws(self) -> bool:
        """Whether the timing is random, so that it depends on the seed."""
        return self.exposure_jitter_s > 0 or self.latency_jitter_s > 0 or self.drop_probability > 0

    def order_s(self, camera: Camera) -> float:
        """How long a command lasts [s]: single pictures may be dropped, whatever the timeout."""
        return max(self.command_timeout_s, LEAST_PERIODS * camera.period)

    def latest_s(self, camera: Camera) -> float:
        """The age at which a picture arrives too late to be one, from the middle of its exposure [s]."""
        return (self.exposure_s + camera.readout_s) / 2 + camera.latency_s + self.order_s(camera)

    def check(self, camera: Camera, step_s: float) -> None:
        """Refuse exposures that are too short for the physics clock, and those that would overlap.

        Raises:
            ParameterError: with the limit.
        """
        if self.exposure_s and round(self.exposure_s / step_s) < 2 and not camera.readout_s:
            words = f"must be 0 or at least two physics steps, {2 * step_s:g} s, whose pictures are averaged; or give physics.step_s"
            raise ParameterError("timing.exposure_s", words, self.exposure_s)
        if self.exposure_s > camera.period:
            raise ParameterError("timing.exposure_s", f"must be at most the camera's period, {camera.period:g} s", self.exposure_s)
        open_s = 2 * self.half_steps(camera, step_s) * step_s if camera.readout_s else self.exposure_s
        room = camera.period - open_s
        if room < -1e-9:
            most = 2 * math.floor(camera.period / step_s / 2 + 1e-9) * step_s
            words = f"must be at most {most:g} s with timing.exposure_s = {self.exposure_s:g} s added: the last row's exposure ends before"
            raise ParameterError("camera.readout_s", f"{words} the next picture's first row begins", camera.readout_s)
        if self.exposure_jitter_s > room / 2:
            words = f"must be at most {room / 2:g} s, half of what the exposure leaves of the camera's period"
            raise ParameterError("timing.exposure_jitter_s", words, self.exposure_jitter_s)

    def half_steps(self, camera: Camera, step_s: float) -> int:
        """Half the time from the first row's exposure to the last one's end, in physics steps; 0 for a picture of an instant."""
        if not camera.readout_s:
            return round(self.exposure_s / step_s / 2)
        return math.ceil((self.exposure_s + camera.readout_s) / step_s / 2 - 1e-9)

    def jittered(self, size_s: float, rng: np.random.Generator) -> float:
        """One random jitter of this size [s]; nothing is drawn for size 0."""
        if size_s == 0:
            return 0.0
        return float(rng.uniform(-size_s, size_s) if self.jitter == "uniform" else rng.normal(0.0, size_s))


@dataclass(frozen=True, slots=True)
class Planned:
    """A planned picture, in physics steps: its number, middle of the exposure, steps to be rendered with their weights, arrival.

    A weight is that of a whole image, or, with a rolling shutter or flickering light, what the image contributes to each row.
    """

    frame: int
    middle: int
    opens: tuple[int, ...]
    weights: tuple[float | Contribution, ...]
    arrives: int


class Shutter:
    """Plans the camera's pictures; those that will be dropped are not rendered at all.

    Attributes:
        nodes: times of the images of a picture from its middle (K,) [s].

    Args:
        timing, camera: as the scenario says. step_s: of the physics [s]. steps_per_frame: in a camera's period.
        rng: draws jitters and losses. flicker: of the light.
    """

    def __init__(
        self,
        timing: Timing,
        camera: Camera,
        step_s: float,
        steps_per_frame: int,
        rng: np.random.Generator,
        flicker: Flicker = STEADY,
    ):
        self._timing, self._step_s, self._per_frame, self._rng = timing, step_s, steps_per_frame, rng
        self._camera, self._flicker = camera, flicker
        self._latency = camera.latency_s
        self._half = timing.half_steps(camera, step_s)
        self._offsets, self._weights = _opening(self._half, timing.readout_pictures if camera.readout_s else timing.exposure_pictures)
        self.nodes: Array = np.array(self._offsets) * step_s
        self._rows: Array = camera.row_delay(np.arange(float(camera.height)))
        # Jitter is clipped to it: the exposures of two frames must not overlap.
        self._room = (steps_per_frame - 2 * self._half) // 2
        self._frame = -1
        self._draws, self._late_steps = timing.draws, round(max(0.0, self._latency) / step_s)
        # What does not depend on the time is computed once.
        self._steady = None if flicker.depth else self._contributed(0.0)

    def following(self) -> Planned:
        """The next picture that will not be dropped."""
        timing, rng = self._timing, self._rng
        while True:
            self._frame += 1
            if not self._draws:
                return self._planned(self._frame * self._per_frame, self._late_steps)
            shift = round(timing.jittered(timing.exposure_jitter_s, rng) / self._step_s)
            middle = max(0, self._frame * self._per_frame + max(-self._room, min(self._room, shift)))
            late = max(0.0, self._latency + timing.jittered(timing.latency_jitter_s, rng))
            if timing.drop_probability == 0 or rng.random() >= timing.drop_probability:
                return self._planned(middle, round(late / self._step_s))

    def _planned(self, middle: int, late_steps: int) -> Planned:
        """The frame with the middle of its exposure at this step, `late_steps` under way."""
        opens = (middle,) if self._half == 0 else tuple(max(0, middle + offset) for offset in self._offsets)
        weights = self._steady or self._contributed(middle * self._step_s)
        return Planned(self._frame, middle, opens, weights, middle + self._half + late_steps)

    def _contributed(self, t: float) -> tuple[float | Contribution, ...]:
        """What the images of a picture with time stamp t [s] contribute to it."""
        exposure_s, flicker = self._timing.exposure_s, self._flicker
        if self._camera.readout_s:
            return contributions(*of_rows(t + self.nodes, t + self._rows, exposure_s, flicker), flicker.depth)
        if not flicker.depth:
            return self._weights
        # All rows are exposed at once, under the mean light of the exposure: one image each is enough.
        brightness = float(flicker.mean(t, exposure_s))
        return tuple(Contribution(((brightness, weight),)) for weight in self._weights)


def _opening(half: int, most: int) -> tuple[tuple[int, ...], tuple[float, ...]]:
    """Steps from the middle at which an exposure of 2 half steps is sampled, symmetric, and their weights (trapezoids, sum 1)."""
    if half == 0:
        return (0,), (1.0,)
    n = min(2 * half + 1, most - 1 + most % 2)  # odd: the middle is one of them
    # Rounded to whole steps they are unevenly spaced: the weights are those of the trapezoidal rule, so that the mean stays unbiased.
    offsets = np.round(np.linspace(-half, half, n)).astype(int)
    weights: Array = np.gradient(offsets.astype(float))
    weights[[0, -1]] /= 2
    return tuple(offsets.tolist()), tuple((weights / weights.sum()).tolist())


class DelayLine(Generic[T]):
    """A first-in first-out queue: an item pushed at step k is due at step k + delay, and never before an earlier item.

    Args:
        delay_steps: whole physics steps between in and out, >= 0.
    """

    def __init__(self, delay_steps: int = 0):
        self.delay_steps = delay_steps
        self._waiting: deque[tuple[int, T]] = deque()

    def push(self, step: int, item: T) -> None:
        """Put an item in at this step."""
        due = step + self.delay_steps
        self._waiting.append((max(due, self._waiting[-1][0]) if self._waiting else due, item))

    def pop_due(self, step: int) -> list[T]:
        """Take out the items due at or before this step, oldest first."""
        due = []
        while self._waiting and self._waiting[0][0] <= step:
            due.append(self._waiting.popleft()[1])
        return due

    def clear(self) -> None:
        """Drop all that is on its way."""
        self._waiting.clear()

    def next_due(self) -> int | None:
        """The step at which the next item is due, None when the queue is empty."""
        return self._waiting[0][0] if self._waiting else None
