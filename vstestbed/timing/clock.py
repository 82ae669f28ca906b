"""Clocks and what is under way: the physics clock, stamps by wrong clocks, a queue of what is late,
a link that loses in bursts.
"""

from __future__ import annotations

import math
from bisect import insort
from collections import deque
from collections.abc import Callable
from typing import Annotated, Generic, Literal, Protocol, TypeVar

import numpy as np
from annotated_types import Ge, Gt, Le, Lt

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array
from vstestbed.core.quantity import Bounded, PositiveTime, TighterBounds, Time
from vstestbed.core.spec import spec
from vstestbed.imaging.exposure import ExposureControl

# largest default step [s]; the arm's actuators are tuned and tested at 1 and 2 ms
LARGEST_STEP_S = 0.002


class _Shot(Protocol):
    """What is asked of a camera: when its rows are exposed, and for how long."""

    @property
    def rate_hz(self) -> float: ...
    @property
    def period(self) -> float: ...
    @property
    def readout_s(self) -> float: ...
    @property
    def latency_s(self) -> float: ...
    @property
    def height(self) -> int: ...
    @property
    def blurring(self) -> ExposureControl | None: ...
    def row_delay(self, v: Array) -> Array: ...


@spec
class Clock:
    """The physics clock, with a whole number of steps between pictures.

    Args:
        step_s: fixed step [s]; without it the largest step that divides the camera's period and is
            no longer than 2 ms; e.g. `0.001`.
    """

    step_s: PositiveTime | None = None

    def resolve(self, camera: _Shot, largest: float = LARGEST_STEP_S) -> tuple[float, int]:
        """(step [s], steps per camera frame). Raises ParameterError: step_s does not divide the
        camera's period.
        """
        if self.step_s is None:
            # The small number keeps a ratio of exactly n from being rounded up to n + 1.
            n = math.ceil(camera.period / largest - 1e-9)
            return camera.period / n, n
        n = round(camera.period / self.step_s)
        if n < 1 or abs(n * self.step_s - camera.period) > 1e-9 * camera.period:
            better = camera.period / max(1, math.ceil(camera.period / max(self.step_s, 1e-5)))
            words = (
                f"must divide the camera's period {camera.period:.9g} s"
                f" ({camera.rate_hz:g} Hz); {better:.12g} does"
            )
            raise ParameterError("physics.step_s", words, self.step_s)
        return self.step_s, n


T = TypeVar("T")


class DelayLine(Generic[T]):
    """A queue: an item pushed at step k is due at step k + delay, and never before an earlier item,
    unless items may overtake. delay_steps: whole physics steps between in and out, >= 0. overtakes:
    an item that is due before an earlier one leaves first.
    """

    def __init__(self, delay_steps: int = 0, overtakes: bool = False):
        self.delay_steps = delay_steps
        self._overtakes = overtakes
        self._waiting: deque[tuple[int, T]] = deque()

    def push(self, step: int, item: T) -> None:
        """Put an item in at this step."""
        due = step + self.delay_steps
        if self._overtakes:
            insort(self._waiting, (due, item), key=lambda waiting: waiting[0])
        else:
            self._waiting.append((max(due, self._waiting[-1][0]) if self._waiting else due, item))

    def pop_due(self, step: int) -> list[T]:
        """Take out the items due at or before this step, oldest first."""
        waiting = self._waiting
        due: list[T] = []
        while waiting and waiting[0][0] <= step:
            due.append(waiting.popleft()[1])
        return due

    def clear(self) -> None:
        """Drop all that is on its way."""
        self._waiting.clear()

    def next_due(self) -> int | None:
        """The step at which the next item is due, None when the queue is empty."""
        return self._waiting[0][0] if self._waiting else None


Probability = Annotated[float, Ge(0), Le(1)]
Offset = Annotated[
    float,
    Bounded(-60.0, 60.0, "s", "a minute; clocks that differ by more are not taken for one another"),
]
"""How far a clock is ahead [s]."""
Drift = Annotated[
    float,
    Bounded(
        -1e5,
        1e5,
        "ppm",
        "a clock that is wrong by a tenth is broken; a quartz is wrong by 10 to 100 ppm",
    ),
]
"""By how much a clock is fast [ppm]."""
PER_MILLION = 1e-6


@spec
class CameraStamps:
    """The time stamps that the camera's driver gives its pictures: t' = t + offset_s + 1e-6
    drift_ppm t + jitter.

    t is the true middle of the exposure, or the time of arrival, by the computer's clock, on which
    the law's commands are given. All that the controller knows of a picture's time is t': its rates
    (differences of two stamps), its latency compensation (the age of the picture, now less t') and
    the robot's reading that belongs to the picture (that with the same stamp) are wrong by it. A
    stamp later than the arrival is taken for the arrival, and a picture whose stamp is not later
    than that of the last one used is refused. The log has true times, t' as `t_stamp` and the
    number of pictures refused so far as `refused`.

    Reference: Furgale, Rehder & Siegwart 2013, doi:10.1109/IROS.2013.6696514 (offset of a camera's
    clock, and how it is calibrated). The sizes are chosen; a quartz is off by some 10 to 100 ppm, 1
    ms in 10 to 100 s.

    Args:
        offset_s: how far the stamps are ahead of the true times at the start [s]; negative: old;
            e.g. `-0.02`.
        drift_ppm: by how much the camera's clock is fast [ppm]; e.g. `50`.
        jitter_s: jitter of the stamps [s], of the distribution `timing.jitter`; e.g. `0.002`.
        stamped: what is stamped: `middle`, that of the exposure, or `arrival`, by a driver that
            does not know the time of exposure.
    """

    offset_s: Offset = 0.0
    drift_ppm: Drift = 0.0
    jitter_s: Annotated[Time, TighterBounds(le=60)] = 0.0
    stamped: Literal["middle", "arrival"] = "middle"

    def at(self, t: float) -> float:
        """The camera's clock at a time t [s], without jitter."""
        return t + self.offset_s + PER_MILLION * self.drift_ppm * t


@spec
class RobotStamps:
    """The time stamps of the robot's sensor readings: t' = t + offset_s + 1e-6 drift_ppm t, by the
    clock of the robot's controller.

    The reading that belongs to a picture is the one with the same stamp. A robot's clock that is
    ahead of the camera's by d thus makes the controller take a reading that is older by d: at a
    joint speed w the joints at the exposure are wrong by w d. Readings come with each period of the
    robot's onboard controller, else every 2 ms; those of the last ten seconds are kept, and none is
    known before it comes.

    Args:
        offset_s: how far the robot's clock is ahead of the computer's at the start [s]; e.g.
            `0.01`.
        drift_ppm: by how much it is fast [ppm]; e.g. `-80`.
    """

    offset_s: Offset = 0.0
    drift_ppm: Drift = 0.0

    def true(self, stamp: float) -> float:
        """The time [s] at which the robot's clock shows `stamp` [s]."""
        return (stamp - self.offset_s) / (1 + PER_MILLION * self.drift_ppm)


@spec
class BurstLoss:
    """A link whose losses come in bursts: a Markov chain of a good and a bad state, with a
    probability of loss in each.

    The chain takes one step a camera period, with p = `enter_probability` from good to bad and r =
    `leave_probability` back; it begins in its steady state. Pictures and commands have a chain
    each, since interference is that at the receiver. In the mean

        share of the time in the bad state   p / (p + r)
        length of a bad stretch              1 / r  periods, geometric
        share lost                           (r good_loss + p bad_loss) / (p + r)

    A command that is lost does not reach the robot, which keeps the last one until it ends
    (`timing.command_timeout_s`); the controller does not know of it. The log has such commands in
    the column `command_lost`.

    References: Gilbert 1960, doi:10.1002/j.1538-7305.1960.tb03959.x (no loss in the good state);
    Elliott 1963, doi:10.1002/j.1538-7305.1963.tb00955.x (loss in both). The defaults are chosen: 9
    % lost, in bursts of 0.2 s at 25 Hz.

    Args:
        enter_probability: of the step from the good to the bad state, p [1].
        leave_probability: of the step back, r [1]; small for long bursts.
        good_loss: probability of a loss in the good state [1]; e.g. `0.01`.
        bad_loss: probability of a loss in the bad state [1].
        carries: what goes over the link.
    """

    enter_probability: Probability = 0.02
    leave_probability: Annotated[float, Gt(0), Le(1)] = 0.2
    good_loss: Annotated[float, Ge(0), Lt(1)] = 0.0
    bad_loss: Probability = 1.0
    carries: Literal["pictures", "commands", "both"] = "both"

    @property
    def draws(self) -> bool:
        """Whether anything is lost."""
        return self.good_loss > 0 or (self.enter_probability > 0 and self.bad_loss > 0)


# whether what is sent in a camera period is lost; periods count from 0, and never go back
Loses = Callable[[int], bool]


def bursty_link(loss: BurstLoss, rng: np.random.Generator) -> Loses:
    """One direction of the link in a run. loss: its parameters. rng: of this direction alone."""
    steps, losses = rng.spawn(2)
    p = loss.enter_probability
    r = loss.leave_probability
    bad = bool(steps.random() < p / (p + r))
    now = 0

    def loses(period: int) -> bool:
        nonlocal bad, now
        while now < period:
            bad ^= bool(steps.random() < (r if bad else p))
            now += 1
        return bool(losses.random() < (loss.bad_loss if bad else loss.good_loss))

    return loses


def directions(
    loss: BurstLoss | None, rng: np.random.Generator
) -> tuple[Loses | None, Loses | None]:
    """The link for pictures and that for commands; None where nothing is lost. rng: of the link
    alone.
    """
    if loss is None:
        return None, None
    pictures, commands = (bursty_link(loss, stream) for stream in rng.spawn(2))
    return (
        pictures if loss.carries != "commands" else None,
        commands if loss.carries != "pictures" else None,
    )
