"""Exposure time and gain of a camera, fixed or automatic, and light that is not that of the
rendered scene.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge, Gt, Le
from numpy.typing import NDArray

from vstestbed.core.errors import ParameterError
from vstestbed.core.quantity import PositiveGrey, PositiveTime, Time, check_ordered
from vstestbed.core.spec import spec

# Least brightness that is reckoned with [grey levels]: of a black picture the ratio to the target
# has no bound
DARKEST = 0.5
SETTLING = 30  # halvings of the interval in which the settled exposure is sought: to 1e-8 of it
SKIP = 4  # every fourth row and column is metered, as cameras meter in blocks
Grey = NDArray[np.uint8]
Factor = Annotated[float, Gt(0), Le(1e4)]


@spec
class AutoExposure:
    """Automatic exposure and gain: an integrating controller in stops, on the brightness of
    pictures that were taken.

    x = time x gain. From picture k with the measured mean m_k (without the black level), for the
    picture `delay_pictures` + 1 later,

    x <- x (target_grey / m_k)^a,   a = 1 - exp(-T / lag_s),  T the camera's period,

    held within the limits. First the time is made longer, up to `longest_s`, then the gain higher,
    as cameras do to keep noise small. Without a delay the error in stops, log2(m / target_grey),
    falls as exp(-t / lag_s), as long as nothing is clipped; with a delay of n pictures it is that
    of e_(k+1) = e_k - a e_(k-n), which is stable for a < 2 sin(pi / (2 (2 n + 1))). Pictures that
    are never taken (`timing.drop_probability`) are not metered. Where white is clipped the mean
    says too little, and it takes longer.

    Args:
        target_grey: mean that is aimed at, of 0 to 255 [grey levels].
        lag_s: time constant [s].
        delay_pictures: how many further pictures are taken before a measurement acts: registers are
            written for a picture to come.
        metering: `mean` of the whole picture, or of its `centre`, half as wide and half as high.
        shortest_s, longest_s: limits of the exposure time [s].
        largest_gain: limit of the gain, which begins at 1 [1].
        settled: the camera has been running before: the first picture is exposed as the scene then
            needs it. Otherwise it begins with the time x gain of `camera.exposure`.

    References: Levin & May 1976, doi:10.1016/0040-5809(76)90043-5 (the condition for stability).
    """

    target_grey: PositiveGrey = 110.0
    lag_s: PositiveTime = 0.2
    delay_pictures: Annotated[int, Ge(0), Le(20)] = 2
    metering: Literal["mean", "centre"] = "mean"
    shortest_s: PositiveTime = 2e-5
    longest_s: PositiveTime = 0.02
    largest_gain: Annotated[float, Ge(1), Le(1000)] = 16.0
    settled: bool = True

    def __post_init__(self) -> None:
        check_ordered(self, "shortest_s", "longest_s")

    def share(self, period_s: float) -> float:
        """The exponent a [1] for a period of the camera [s]."""
        return -math.expm1(-period_s / self.lag_s)

    def check(self, period_s: float) -> None:
        """Refuse a delay with which it is not stable. Raises ParameterError: with the least lag."""
        most = 2 * math.sin(math.pi / (2 * (2 * self.delay_pictures + 1)))
        if self.share(period_s) >= most:
            least = -period_s / math.log1p(-most)
            why = f"with a delay of {self.delay_pictures} pictures it oscillates otherwise"
            raise ParameterError.bound(
                "exposure.auto.lag_s", "over", f"{least:.3g} s", self.lag_s, why=why
            )

    def within(self, x: float) -> float:
        """Time x gain [s] held within the limits."""
        return min(max(x, self.shortest_s), self.longest_s * self.largest_gain)

    def split(self, x: float) -> tuple[float, float]:
        """Time [s] and gain [1] of time x gain [s]: the time first."""
        time_s = min(max(x, self.shortest_s), self.longest_s)
        return time_s, x / time_s

    def metered(self, image: Grey, skip: int = SKIP) -> float:
        """Mean of the metered part of a picture (H, W, 3) [grey levels], of every row and column or
        fewer.
        """
        height, width = image.shape[:2]
        centre = self.metering == "centre"
        rows, columns = (
            slice(n // 4, n - n // 4, skip) if centre else slice(0, n, skip)
            for n in (height, width)
        )
        return float(image[rows, columns].mean())


@dataclass(frozen=True, slots=True)
class ExposureSetting:
    """How a picture is exposed."""

    light: float = 1.0  # of the scene, relative to the rendered one [1]
    time_s: float = 1.0  # exposure time [s]
    gain: float = 1.0  # of the amplifier [1]
    nominal_s: float = 1.0  # exposure time for which the scene is rendered [s]

    @property
    def collected(self) -> float:
        """Light on the sensor relative to the rendered picture's [1]: what noise depends on."""
        return self.light * self.time_s / self.nominal_s


@spec
class ExposureControl:
    """Exposure time and gain. The rendered picture is that of `nominal_s` and gain 1, its values
    taken as linear in the light:

    value = rendered * light * (time / nominal_s) * gain, clipped at 255.

    What is white in the rendered picture stays clipped: a shorter exposure makes it grey, without
    its structure. The time here sets how much light is collected, and so the noise
    (`camera.sensor`). Motion blur has its own time, `timing.exposure_s`, unless `blurs` makes them
    one, as they are in a camera: of half the light automatic exposure then makes a picture that is
    blurred over twice the time and arrives later by half of what was added, and, once the time is
    as long as it may be, a noisier one. Cost of a picture of 640 x 480: 2 ms, and with `blurs` that
    of the images of which it is the mean.

    Args:
        nominal_s: exposure time for which the scene is rendered [s].
        time_s: exposure time [s], at the beginning where it is automatic; default `nominal_s`; e.g.
            `0.01`.
        gain: of the amplifier, likewise [1].
        light: [time, factor] pairs: from that time on [s] the scene is as many times as bright as
            the rendered one [1], from the start 1; e.g. `[[2.0, 4.0]]`.
        auto: automatic exposure and gain; None for fixed ones.
        blurs: the exposure time is also that of the motion blur, of each row of a rolling shutter
            and of what flicker is averaged over, in place of `timing.exposure_s`. The time stamp
            stays its middle. The log then has each picture's time and gain in the columns
            `exposure_s` and `gain`. Without pictures (detector `oracle`) it is the time with which
            the camera begins; e.g. `true`.
    """

    nominal_s: PositiveTime = 0.005
    time_s: PositiveTime | None = None
    gain: Annotated[float, Ge(0.01), Le(1000)] = 1.0
    light: tuple[tuple[Time, Factor], ...] = ()
    auto: AutoExposure | None = None
    blurs: bool = False

    def __post_init__(self) -> None:
        times = [t for t, _ in self.light]
        if times != sorted(set(times)):
            raise ParameterError(
                "light", "must have rising times", [list(pair) for pair in self.light]
            )

    @property
    def first(self) -> tuple[float, float]:
        """Time [s] and gain [1] of a fixed exposure, or with which an automatic one begins that has
        not settled.
        """
        time_s = self.time_s or self.nominal_s
        if self.auto is None:
            return time_s, self.gain
        return self.auto.split(self.auto.within(time_s * self.gain))

    @property
    def most_s(self) -> float:
        """The longest exposure time [s]."""
        return self.first[0] if self.auto is None else self.auto.longest_s

    @property
    def most_field(self) -> str:
        """The field of the longest exposure time, below `camera`."""
        if self.auto:
            return "exposure.auto.longest_s"
        return "exposure.nominal_s" if self.time_s is None else "exposure.time_s"

    def light_at(self, t: float) -> float:
        """Light of the scene at a time [s], relative to the rendered one [1]."""
        later = bisect_right([begun for begun, _ in self.light], t)
        return self.light[later - 1][1] if later else 1.0


class ExposureLoop:
    """The exposure of one run's pictures, in their order.

    control: as the camera has it; None for the rendered exposure. period_s: of the camera [s].
    black: level of a picture without light, which the camera knows [grey levels].
    """

    def __init__(self, control: ExposureControl | None, period_s: float, black: float = 0.0):
        control = control or ExposureControl()
        auto = control.auto
        self._control = control
        self._black = black
        self._auto = auto
        self._share = 0.0
        self._fresh = False
        # time x gain of the next pictures [s]
        self._coming = deque([(control.time_s or control.nominal_s) * control.gain])
        if auto is not None:
            self._share = auto.share(period_s)
            self._fresh = auto.settled
            self._coming *= auto.delay_pictures + 1

    def setting(self, t: float, pictured: Callable[[ExposureSetting], Grey]) -> ExposureSetting:
        """Of the next picture, taken at a time t [s].

        pictured: every `SKIP`th row and column of the picture that a setting would give, for a
            camera that has settled.
        """
        if self._fresh:
            self._fresh = False
            self._coming = deque([self._settled(t, pictured)] * len(self._coming))
        return self._split(t, self._coming[0])

    def settled(self, t: float, pictured: Callable[[ExposureSetting], Grey]) -> ExposureSetting:
        """As a camera that rests would be set; the run's own exposure is left as it is."""
        x = self._coming[-1] if self._auto is None else self._settled(t, pictured)
        return self._split(t, x)

    def saw(self, image: Grey) -> None:
        """Meter the picture just taken."""
        if self._auto is None:
            return
        measured = max(self._auto.metered(image) - self._black, DARKEST)
        wanted = self._coming[-1] * (self._auto.target_grey / measured) ** self._share
        self._coming.append(self._auto.within(wanted))
        self._coming.popleft()

    def _split(self, t: float, x: float) -> ExposureSetting:
        control = self._control
        time_s, gain = control.first if self._auto is None else self._auto.split(x)
        return ExposureSetting(control.light_at(t), time_s, gain, control.nominal_s)

    def _settled(self, t: float, pictured: Callable[[ExposureSetting], Grey]) -> float:
        """Time x gain at which the mean is the target, or the nearest limit: by bisection, as the
        mean never falls with it.
        """
        auto = self._auto
        assert auto is not None
        low = math.log(auto.within(0.0))
        high = math.log(auto.within(math.inf))
        for _ in range(SETTLING):
            middle = (low + high) / 2
            image = pictured(self._split(t, math.exp(middle)))
            if auto.metered(image, 1) - self._black >= auto.target_grey:
                high = middle
            else:
                low = middle
        return math.exp((low + high) / 2)
