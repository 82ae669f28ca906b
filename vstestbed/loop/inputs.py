"""Pictures, times and readings of a real camera and robot,
checked before the controller uses them.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace

import numpy as np

from vstestbed.camera import DepthImage, Image, Picture
from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array
from vstestbed.loop.ego_motion import Exposure
from vstestbed.robots import Reading
from vstestbed.robots.flight import FlightReading
from vstestbed.scenario.cameras import OtherCamera
from vstestbed.scenario.scenario import Scenario

__all__ = [
    "OUTSIDE",
    "Inputs",
    "OwnClock",
    "Readings",
    "SightClock",
    "all_or_none",
    "numbers_of",
    "seconds",
]

Readings = tuple[Reading, Reading]
# of a clock that tells no time: too long for any order, and finite, since ages are differences
UNKNOWN_S = 1e6
MOST_S = 1e10  # times in seconds, also since 1970, are less; of milliseconds and less they are more
MISSING = 1.5  # a picture is missing where two are further apart than this [camera periods]
OUTSIDE = 0.2
"""A joint reads outside of its range where it is this far beyond a limit [rad; m for one that
slides]: no encoder is so far off.
"""


class Inputs:
    """Checks what a controller is given, and counts the pictures (`taken`)."""

    def __init__(self, scenario: Scenario | OtherCamera):
        self._camera = scenario.camera
        self._robot = scenario.robot
        self._detector = scenario.detector
        self._latest_s = scenario.timing.latest_s(scenario.camera)
        self._refuses = scenario.timing.refuses
        self._reading = scenario.robot.onboard.reading if scenario.robot.onboard else Reading
        self._reads_depth = scenario.reads_depth
        self._t: float | None = None
        self._arrived: float | None = None
        self.taken = -1

    @property
    def newest(self) -> float:
        """When its last picture was taken [s]; -inf before the first one."""
        return -math.inf if self._t is None else self._t

    def reading(self, reading: Reading) -> Reading:
        """A reading of this robot of float64, in arrays of its own: a driver may write the next one
        into the same arrays.
        """
        n = len(self._robot.joints)
        if not isinstance(reading, self._reading):
            raise ParameterError.fixed(
                "readings",
                f"{self._reading.__name__}s",
                type(reading).__name__,
                where="for this robot",
            )
        joints = f"must be {n} finite numbers: {', '.join(self._robot.joints)}"
        q = _finite("readings.q", joints, reading.q, (n,))
        qd = _finite("readings.qd", joints, reading.qd, (n,))
        self._check_ranges(q)
        if reading.heading is not None:
            words = "must be an angle in radians, or None without a compass"
            _finite("readings.heading", words, reading.heading, ())
        if reading.tilt is not None:
            words = "must be roll and pitch in radians, or None"
            _finite("readings.tilt", words, reading.tilt, (2,))
        if reading.wrench is not None or getattr(self._robot, "wrist", None) is not None:
            words = "must be six finite numbers, with robot.wrist"
            _finite("readings.wrench", words, reading.wrench, (6,))
        if isinstance(reading, FlightReading):
            _check_flight(reading)
        return replace(copy.deepcopy(reading), q=q, qd=qd)

    def _check_ranges(self, q: Array) -> None:
        """Refuse joints (n,) outside of their ranges: of another unit, in another order, or of a
        failed encoder.
        """
        body = self._robot.body
        if body is None or body.limits is None:
            return
        low, high = body.limits.T
        beyond = np.maximum(low - q, q - high)
        i = int(beyond.argmax())
        if beyond[i] > OUTSIDE:
            joints = self._robot.joints
            words = f"has {joints[i]} outside of its range of {low[i]:.4g} to {high[i]:.4g}"
            works = f"must be in radians, a slide's in metres, in the order {', '.join(joints)}"
            raise ParameterError("readings.q", f"{words}: {works}", round(float(q[i]), 4))

    def depth(self, image: DepthImage | None) -> DepthImage | None:
        """A depth picture as float32 in metres, NaN in its holes, in an array of its own;
        ParameterError where the law reads it.
        """
        if image is None and not self._reads_depth:
            return None
        wanted = self._camera.height, self._camera.width
        if not isinstance(image, np.ndarray) or image.shape != wanted or image.dtype.kind != "f":
            words = "floats, in metres, NaN or 0 where nothing was measured"
            raise ParameterError.count("depth", wanted, words, _kind_of(image))
        return np.where(image > 0, image, np.nan).astype(np.float32)

    def shot(self, picture: Image | Sequence[Image], t: float, reading: Reading) -> Exposure:
        """An exposure of a further camera, whose times rise like those of the law's camera."""
        before = self.taken
        (checked, _), _ = self.given(picture, t, reading, None)
        if self.taken == before:
            raise ParameterError.bound(
                "t", "after", f"{self._t:g} s, when its last picture was taken", t
            )
        return Exposure(self.taken, t, Picture(t, images_of(picture)), checked)

    def now(self, t: float) -> float:
        """A time [s] at which no picture has come, which is not before the last picture's."""
        t = seconds(t, words="must be the time now in seconds")
        if self._t is not None and t < self._t:
            raise ParameterError.bound(
                "t", "at least", f"{self._t:g} s, when the last picture was taken", t
            )
        return t

    def given(
        self,
        picture: Image | Sequence[Image],
        t: float,
        readings: Reading | Readings,
        arrived: float | None,
    ) -> tuple[Readings, tuple[str, ...]]:
        """The readings, at the exposure and now, and what is unusual about a picture's time, in
        words: late, come twice, missing before.
        """
        if self._detector.needs_truth:
            words = (
                "is the simulator's truth, which no real camera has; works: --set detector=blobs"
            )
            raise ParameterError("detector", words, self._detector.kind)
        self._check_picture(picture)
        pair = readings if isinstance(readings, tuple) else (readings, readings)
        if len(pair) != 2:
            raise ParameterError.count(
                "readings", "one or two", "readings", len(pair), why="at the exposure and now"
            )
        at_exposure = self.reading(pair[0])
        now = at_exposure if pair[1] is pair[0] else self.reading(pair[1])
        t = seconds(t)
        late = self._late(t, arrived)  # before the picture is counted: a mistake changes nothing
        notes = (*self._timed(t), *late)
        self._arrived = self._arrived if arrived is None else arrived
        return (at_exposure, now), notes

    def _check_picture(self, picture: Image | Sequence[Image]) -> None:
        """Refuse a picture of another size or kind than the camera's."""
        panels = self._camera.panels
        images = (picture,) if isinstance(picture, np.ndarray) else picture
        if not isinstance(images, Sequence) or len(images) != len(panels):
            words = "must be one image"
            if len(panels) > 1:
                words = f"must be {len(panels)} images, one for each face of the camera"
            raise ParameterError("picture", words, type(picture).__name__)
        for image, panel in zip(images, panels, strict=True):
            wanted = panel.lens.height, panel.lens.width, 3
            if (
                not isinstance(image, np.ndarray)
                or image.shape != wanted
                or image.dtype != np.uint8
            ):
                words = "uint8, RGB, as the scenario's camera has it"
                raise ParameterError.count("picture", wanted, words, _kind_of(image))

    def _timed(self, t: float) -> tuple[str, ...]:
        """Count a picture by its time, and say what is unusual about that."""
        before = self._t
        if before is not None and t < before:
            if not self._refuses:
                raise ParameterError.bound(
                    "t", "at least", f"{before:g} s, when the last picture was taken", t
                )
            older = f"the picture of {t:g} s is older than the last one"
            return (f"{older}, of {before:g} s: it is refused",)
        if t == before:
            return (f"the picture of {t:g} s came again",)
        self._t = t
        self.taken += 1
        periods = 1.0 if before is None else (t - before) / self._camera.period
        if periods <= MISSING:
            return ()
        missing = round(periods) - 1
        are = "picture is" if missing == 1 else "pictures are"
        return (f"{missing} {are} missing before this one",)

    def _late(self, t: float, arrived: float | None) -> tuple[str, ...]:
        """What is to be said of a picture that is too old when it arrives."""
        if arrived is None:
            return ()
        words = f"must be a time after the exposure, {t:g} s"
        if seconds(arrived, "arrived", words) < t:
            raise ParameterError("arrived", words, arrived)
        if self._arrived is not None and arrived < self._arrived:
            least = f"{self._arrived:g} s, when the last picture arrived"
            raise ParameterError.bound("arrived", "at least", least, arrived)
        age = arrived - t
        if age <= self._latest_s:
            return ()
        return (f"the picture is {age:.2g} s old: the robot is told to stop",)


def _check_flight(reading: FlightReading) -> None:
    """Refuse a reading without the numbers by which a craft's failsafe lives."""
    if not reading.range_m >= 0:  # infinite over nothing
        raise ParameterError.bound(
            "readings.range_m", ">=", "0 m, infinite over nothing", reading.range_m
        )
    words = "must be three finite numbers"
    _finite("readings.estimate.velocity", words, reading.estimate.velocity, (3,))
    _finite("readings.estimate.rates", words, reading.estimate.rates, (3,))
    if reading.tilt is None:
        raise ParameterError.missing("readings.tilt", "roll and pitch in radians")


def images_of(picture: Image | Sequence[Image]) -> tuple[Image, ...]:
    """The images of a picture, one for each panel of its camera."""
    return (picture,) if isinstance(picture, np.ndarray) else tuple(picture)


def _kind_of(image: object) -> str:
    """What somebody gave as an image, for the message."""
    if isinstance(image, np.ndarray):
        return f"{image.shape} {image.dtype}"
    return type(image).__name__


@contextmanager
def all_or_none(inputs: Iterable[Inputs]) -> Iterator[None]:
    """Of what is given together: where one is refused, none has come."""
    before = [(one, vars(one).copy()) for one in inputs]
    try:
        yield
    except ParameterError:
        for one, was in before:
            vars(one).update(was)
        raise


def numbers_of(given: object) -> Array:
    """What was given as an array of its own; NaN where it is no numbers."""
    try:
        return np.array(given, dtype=float)
    except (TypeError, ValueError, OverflowError):
        return np.array(math.nan)


def _finite(field: str, words: str, given: object, shape: tuple[int, ...]) -> Array:
    numbers = numbers_of(given)
    if numbers.shape != shape or not np.isfinite(numbers).all():
        raise ParameterError(field, words, repr(given) if given is None else given)
    return numbers


def seconds(
    t: object, field: str = "t", words: str = "must be the time of exposure in seconds"
) -> float:
    """A time as a float; ParameterError where it is none, or of another unit."""
    if not isinstance(t, int | float | np.integer | np.floating | np.ndarray):
        raise ParameterError(field, words, t)
    found = float(_finite(field, words, t, ()))
    if abs(found) > MOST_S:  # of nanoseconds, whose next ones a float cannot tell apart
        raise ParameterError.bound(field, "at most", f"{MOST_S:g} s", found, why="it is in seconds")
    return found


class OwnClock:
    """A clock of the receiver, counted forwards alone: where it is set back it goes on from there.
    What is no finite time counts as UNKNOWN_S, and no step counts for more: of larger sums a float
    would lose the steps that follow. Where time is simulated it stands.
    """

    def __init__(self, clock: Callable[[], float]):
        self._clock = clock
        self._last = clock()
        self._sum = 0.0
        self._stands = False

    def stand(self, stands: bool) -> None:
        """Stand from now on, or go on."""
        self.s()
        self._stands = stands

    def s(self) -> float:
        """The time since it was made [s]."""
        now = self._clock()
        passed = UNKNOWN_S
        if math.isfinite(now):
            # UNKNOWN_S also after a beginning that is NaN
            passed = min(UNKNOWN_S, now - self._last)
            self._last = now
        if not self._stands:
            self._sum += max(passed, 0.0)
        return self._sum


class SightClock:
    """By how much the own clock has gone further than stamps tell since the target was seen last,
    `behind_s` [s]: stamps may stand nearly still, of another unit or a failed driver, and a robot
    that sees nothing must stop all the same.
    """

    def __init__(self) -> None:
        self.behind_s = self._gap_s = 0.0
        self._gap_seen_s: float | None = None

    def tick(self, at: float, own_s: float) -> None:
        """A picture has come, by stamps and by the own clock [s]."""
        self._gap_s = own_s - at
        if self._gap_seen_s is None:
            self._gap_seen_s = self._gap_s
        self.behind_s = max(self.behind_s, self._gap_s - self._gap_seen_s)

    def seen(self) -> None:
        """The target is seen in it."""
        self.behind_s = 0.0
        self._gap_seen_s = self._gap_s
