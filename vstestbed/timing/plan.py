"""Timing in whole physics steps: exposure, latency, jitter and dropped pictures of the camera,
latency of commands.
"""

from __future__ import annotations

import math
from typing import Annotated, Literal, NamedTuple

import numpy as np
from annotated_types import Ge, Le, Lt

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array
from vstestbed.core.quantity import Frequency, PositiveTime, TighterBounds, Time
from vstestbed.core.spec import spec
from vstestbed.imaging.flicker import STEADY, Flicker
from vstestbed.imaging.shutter import Contribution, Opening, contributions, of_rows
from vstestbed.timing.clock import BurstLoss, CameraStamps, Loses, RobotStamps, _Shot
from vstestbed.timing.setpoints import Interpolator, Mode

LEAST_PERIODS = 3  # a command lasts this many camera periods at least
# exposures under this share of a physics step are instants: of three images the outer ones would
# have weights of 1/600 each
BLURRED = 0.2


Images = Annotated[int, Ge(3), Le(999)]  # of which a picture is composed
Minute = Annotated[Time, TighterBounds(le=60)]


@spec
class Timing:
    """Timing of pictures and commands beyond the camera's rate and latency, rounded to whole
    physics steps.

    A picture's time stamp is the true middle of its exposure, with a rolling shutter
    (`camera.readout_s`) that of its middle row, unless `camera_clock` says otherwise. It arrives
    `camera.latency_s` after the end of the exposure, with a rolling shutter of the last row's, and
    not before an earlier one, unless `out_of_order` lets it. The law works at the rate of the
    pictures, one command for each; `command_hz` is that at which setpoints reach the actuators.

    Processor time in a frame of an arm at 25 Hz, 1.0 ms with the oracle and all of it off: wrong
    clocks 0.3 ms, as the robot's sensors are read every 2 ms; interpolated commands 0.6 ms at 500
    Hz, 0.3 ms at 100 Hz; the link and pictures out of order none to be measured.
    `imaging/shutter.py` tells of the rolling shutter's pictures and what they cost.

    Args:
        exposure_s: exposure time [s], with a rolling shutter of each row; the picture is the mean
            of images rendered during it (motion blur); e.g. `0.01`. With `camera.exposure.blurs`
            the camera's exposure has it, and this must be 0.
        exposure_pictures: number of these images, at most one a physics step; with a rolling
            shutter it is readout_pictures.
        readout_pictures: number of images of which a picture with a rolling shutter is composed,
            from the first row's exposure to the last one's, at most one a physics step.
        jitter: distribution of the jitters: `uniform` within +- the number given, or `normal` with
            it as standard deviation.
        exposure_jitter_s: jitter of the time of exposure [s]; e.g. `0.005`.
        latency_jitter_s: jitter of the latency [s]; e.g. `0.01`.
        drop_probability: probability that a picture never arrives [1]; e.g. `0.1`.
        command_latency_s: time from a law's command to the robot's new setpoint [s]; e.g. `0.02`.
        command_timeout_s: how long a command lasts [s], three camera periods at least. Then,
            without a new one, the robot stops within its limits; a picture that arrives so much
            later than `camera.latency_s` is none.
        out_of_order: whether jitter of the latency lets a picture overtake an earlier one. The
            controller refuses a picture that is older than one that it has used; the log counts
            them in the column `refused`.
        camera_clock: errors of the pictures' time stamps; null for true ones; e.g.
            `{offset_s: -0.02, drift_ppm: 50}`.
        robot_clock: errors of the time stamps of the robot's readings; null for true ones; e.g.
            `{drift_ppm: 80}`.
        link: losses of pictures and commands in bursts; null for none; e.g.
            `{enter_probability: 0.02, leave_probability: 0.2}`.
        command_hz: rate at which setpoints reach the actuators [Hz], a whole number of physics
            steps apart; null: with the law's command, or with `interpolation` at each physics step;
            e.g. `500`.
        interpolation: between two commands: `hold` the last one; go to the new one within a camera
            period in a straight line (`ramp`), or with limited jerk (`smooth`), both late by half a
            period (`timing.setpoints.Profile`).
    """

    exposure_s: Time = 0.0
    exposure_pictures: Images = 9
    readout_pictures: Images = 21
    jitter: Literal["uniform", "normal"] = "uniform"
    exposure_jitter_s: Time = 0.0
    latency_jitter_s: Minute = 0.0
    drop_probability: Annotated[float, Ge(0), Lt(1)] = 0.0
    command_latency_s: Minute = 0.0
    command_timeout_s: PositiveTime = 0.5
    out_of_order: bool = False
    camera_clock: CameraStamps | None = None
    robot_clock: RobotStamps | None = None
    link: BurstLoss | None = None
    command_hz: Frequency | None = None
    interpolation: Mode = "hold"

    @property
    def draws(self) -> bool:
        """Whether the timing is random, so that it depends on the seed."""
        stamps_jitter = self.camera_clock is not None and self.camera_clock.jitter_s > 0
        jitter = self.exposure_jitter_s > 0 or self.latency_jitter_s > 0 or stamps_jitter
        return jitter or self.drop_probability > 0 or (self.link is not None and self.link.draws)

    @property
    def stamps(self) -> bool:
        """Whether time stamps are other than the true times."""
        return self.camera_clock is not None or self.robot_clock is not None

    @property
    def refuses(self) -> bool:
        """Whether a picture may come that is older than one before it, by its stamp: the controller
        refuses it.
        """
        return self.out_of_order or self.camera_clock is not None

    @property
    def columns(self) -> tuple[str, ...]:
        """Columns of the log that only runs with these effects have."""
        commands = self.link is not None and self.link.carries != "pictures"
        given = {"t_stamp": self.stamps, "refused": self.refuses, "command_lost": commands}
        return tuple(name for name, is_there in given.items() if is_there)

    def interpolator(self, step_s: float, steps_per_frame: int) -> Interpolator | None:
        """Leads the setpoints of a run from one command to the next; None: each command is the
        setpoint at once.
        """
        if self.command_hz is None and self.interpolation == "hold":
            return None
        every = 1 if self.command_hz is None else max(1, round(1 / (self.command_hz * step_s)))
        return Interpolator(self.interpolation, every, steps_per_frame)

    def order_s(self, camera: _Shot) -> float:
        """How long a command lasts [s]: single pictures may be dropped, whatever the timeout."""
        return max(self.command_timeout_s, LEAST_PERIODS * camera.period)

    def latest_s(self, camera: _Shot) -> float:
        """The age at which a picture arrives too late to be one, from the middle of its exposure
        [s].
        """
        open_s = self.longest_s(camera) + camera.readout_s
        return open_s / 2 + camera.latency_s + self.order_s(camera)

    def first_s(self, camera: _Shot) -> float:
        """Exposure time of a picture [s], as far as it is known without a picture."""
        return self.exposure_s if camera.blurring is None else camera.blurring.first[0]

    def longest_s(self, camera: _Shot) -> float:
        """The longest exposure time [s]."""
        return self.exposure_s if camera.blurring is None else camera.blurring.most_s

    def check(self, camera: _Shot, step_s: float) -> None:
        """Refuse exposures that are too short for the physics clock, those that would overlap, and
        rates of setpoints that the physics clock has not got, or that are too low for what they are
        to do. Raises ParameterError: with the limit.
        """
        self._check_exposure(camera, step_s)
        if self.out_of_order and self.latency_jitter_s == 0:
            why = (
                "with one and the same latency no picture overtakes another;"
                " or set out_of_order to false"
            )
            raise ParameterError.needs(
                "timing.out_of_order", "latency_jitter_s", self.out_of_order, why=why
            )
        if self.command_hz is not None:
            self._check_command_rate(self.command_hz, camera, step_s)

    def _check_exposure(self, camera: _Shot, step_s: float) -> None:
        if self.exposure_s and camera.blurring is not None:
            why = "with camera.exposure.blurs the camera's exposure has the time"
            raise ParameterError.fixed("timing.exposure_s", "0", self.exposure_s, why=why)
        if self.exposure_s and round(self.exposure_s / step_s) < 2 and not camera.readout_s:
            words = (
                f"must be 0 or at least two physics steps, {2 * step_s:g} s,"
                " whose pictures are averaged; or give physics.step_s"
            )
            raise ParameterError("timing.exposure_s", words, self.exposure_s)
        if self.exposure_s > camera.period:
            most = f"the camera's period, {camera.period:g} s"
            raise ParameterError.bound("timing.exposure_s", "at most", most, self.exposure_s)
        most_s = self._room(camera, step_s) / 2
        if self.exposure_jitter_s > most_s:
            most = f"{most_s:g} s, half of what the exposure leaves of the camera's period"
            field = "timing.exposure_jitter_s"
            raise ParameterError.bound(field, "at most", most, self.exposure_jitter_s)

    def _check_command_rate(self, rate_hz: float, camera: _Shot, step_s: float) -> None:
        steps = 1 / (rate_hz * step_s)
        whole = max(1, round(steps))
        if abs(steps - whole) > 1e-6 * steps:
            near = ", ".join(f"{1 / (n * step_s):.10g}" for n in (whole + 1, whole))
            words = (
                f"must be a whole number of physics steps of {step_s:.6g} s apart:"
                f" {near}, or give physics.step_s"
            )
            raise ParameterError("timing.command_hz", words, rate_hz)
        if self.interpolation == "hold":
            least_hz = 1 / self.order_s(camera)
            why = "a command would end before it reaches the robot"
        else:
            least_hz = 2 * camera.rate_hz
            why = "two setpoints a camera period"
        if rate_hz < least_hz * (1 - 1e-9):
            least = f"{least_hz:.6g} Hz here ({why})"
            raise ParameterError.bound("timing.command_hz", "at least", least, rate_hz)

    def _room(self, camera: _Shot, step_s: float) -> float:
        """What the longest exposure leaves of the camera's period [s]; refuses one that does not
        fit into it.
        """
        open_s = self.exposure_s
        if camera.readout_s > 0 or camera.blurring is not None:
            open_s = 2 * self.half_steps(camera, step_s) * step_s
        room = camera.period - open_s
        if room >= -1e-9:
            return room
        most_s = 2 * math.floor(camera.period / step_s / 2 + 1e-9) * step_s
        longest = self.longest_s(camera)
        if camera.blurring is not None and longest > most_s - camera.readout_s:
            most = (
                f"{max(0.0, most_s - camera.readout_s):g} s,"
                " the camera's period in pairs of physics steps"
            )
            if camera.readout_s:
                most += f" less camera.readout_s = {camera.readout_s:g} s"
            field = f"camera.{camera.blurring.most_field}"
            raise ParameterError.bound(field, "at most", most, longest)
        most = f"{max(most_s - longest, 0):.6g} s"
        why = (
            f"readout and timing.exposure_s, {longest:g} s, must fit into the camera's period,"
            f" {camera.period:g} s"
        )
        raise ParameterError.bound("camera.readout_s", "at most", most, camera.readout_s, why=why)

    def half_steps(self, camera: _Shot, step_s: float, exposure_s: float | None = None) -> int:
        """Half the time from the first row's exposure to the last one's end, in physics steps; 0
        for a picture of an instant. exposure_s: of this picture [s]; None: the longest.
        """
        open_s = self.longest_s(camera) if exposure_s is None else exposure_s
        if camera.readout_s:
            return math.ceil((open_s + camera.readout_s) / step_s / 2 - 1e-9)
        if camera.blurring is None:
            return round(open_s / step_s / 2)
        return 0 if open_s < BLURRED * step_s else math.ceil(open_s / step_s / 2 - 1e-9)

    def jittered(self, size_s: float, rng: np.random.Generator) -> float:
        """One random jitter of this size [s]; nothing is drawn for size 0."""
        if size_s == 0:
            return 0.0
        if self.jitter == "uniform":
            return float(rng.uniform(-size_s, size_s))
        return float(rng.normal(0.0, size_s))


class Planned(NamedTuple):
    """A planned picture, in physics steps: its number, middle of the exposure, steps to be rendered
    with their weights, arrival.

    A weight is that of a whole image, or, with a rolling shutter or flickering light, what the
    image contributes to each row.
    """

    frame: int
    middle: int
    opens: tuple[int, ...]
    weights: tuple[float | Contribution, ...]
    arrives: int


class Shutter:
    """Plans the camera's pictures; those that will be dropped are not rendered at all. opening: of
    the picture planned last.

    timing, camera: as the scenario says. step_s: of the physics [s], which divides the camera's
    period. rng: draws jitters and losses. link: may lose them in bursts; None for one that loses
    none. flicker: of the light.
    """

    def __init__(
        self,
        timing: Timing,
        camera: _Shot,
        step_s: float,
        rng: np.random.Generator,
        link: Loses | None = None,
        flicker: Flicker = STEADY,
    ):
        self._timing = timing
        self._camera = camera
        self._step_s = step_s
        self._rng = rng
        self._link = link
        self._flicker = flicker
        self._per_frame = round(camera.period / step_s)
        self._rows: Array = camera.row_delay(np.arange(float(camera.height)))
        # Jitter is clipped to it: the exposures of two frames must not overlap.
        self._room = (self._per_frame - 2 * timing.half_steps(camera, step_s)) // 2
        self._frame = -1
        self._draws = timing.draws
        self._late_steps = round(max(0.0, camera.latency_s) / step_s)
        self._open(timing.first_s(camera))

    def _open(self, exposure_s: float) -> None:
        """Expose for so long [s] from now on. What does not depend on the picture's time is
        computed once.
        """
        timing = self._timing
        camera = self._camera
        most = timing.readout_pictures if camera.readout_s else timing.exposure_pictures
        half = timing.half_steps(camera, self._step_s, exposure_s)
        self.opening = Opening(exposure_s, half, most, self._step_s, camera.blurring is not None)
        self._steady = None if self._flicker.depth else self._contributed(0.0)

    def following(self, exposure_s: float | None = None) -> Planned:
        """The next picture that will not be dropped; exposure_s: its exposure time [s], None: that
        of the last one.
        """
        if exposure_s is not None and exposure_s != self.opening.exposure_s:
            self._open(exposure_s)
        timing = self._timing
        rng = self._rng
        while True:
            self._frame += 1
            if not self._draws:
                return self._planned(self._frame * self._per_frame, self._late_steps)
            shift = round(timing.jittered(timing.exposure_jitter_s, rng) / self._step_s)
            shift = max(-self._room, min(self._room, shift))
            middle = max(0, self._frame * self._per_frame + shift)
            late = max(0.0, self._camera.latency_s + timing.jittered(timing.latency_jitter_s, rng))
            arrives = timing.drop_probability == 0 or rng.random() >= timing.drop_probability
            if arrives and (self._link is None or not self._link(self._frame)):
                return self._planned(middle, round(late / self._step_s))

    def _planned(self, middle: int, late_steps: int) -> Planned:
        """The frame with the middle of its exposure at this step, `late_steps` under way."""
        opening = self.opening
        opens = (middle,)  # the usual frame: an instant
        if opening.half:
            opens = tuple(max(0, middle + offset) for offset in opening.offsets)
        weights = self._steady or self._contributed(middle * self._step_s)
        return Planned(self._frame, middle, opens, weights, middle + opening.half + late_steps)

    def _contributed(self, t: float) -> tuple[float | Contribution, ...]:
        """What the images of a picture with time stamp t [s] contribute to it."""
        opening = self.opening
        flicker = self._flicker
        if self._camera.readout_s:
            rows = of_rows(t + opening.nodes, t + self._rows, opening.exposure_s, flicker)
            return contributions(*rows, flicker.depth)
        if not flicker.depth:
            return opening.weights
        # All rows are exposed at once, under the mean light of the exposure: one image each is
        # enough.
        brightness = float(flicker.mean(t, opening.exposure_s))
        return tuple(((brightness, weight),) for weight in opening.weights)
