"""Time stamps of the pictures and of the robot's readings, by clocks that are not the computer's."""

from __future__ import annotations

from typing import Annotated, Literal

from vstestbed.core.quantity import Narrower, Time, Within
from vstestbed.core.spec import spec

Offset = Annotated[float, Within(-60.0, 60.0, "s", "a minute; clocks that differ by more are not taken for one another")]
"""How far a clock is ahead [s]."""
Drift = Annotated[float, Within(-1e5, 1e5, "ppm", "a clock that is wrong by a tenth is broken; a quartz is wrong by 10 to 100 ppm")]
"""By how much a clock is fast [ppm]."""
PER_MILLION = 1e-6


@spec
class CameraStamps:
    """The time stamps that the camera's driver gives its pictures: t' = t + offset_s + 1e-6 drift_ppm t + jitter.

    t is the true middle of the exposure, or the time of arrival, by the computer's clock, on which the law's commands are given. All that
    the controller knows of a picture's time is t': its rates (differences of two stamps), its latency compensation (the age of the picture,
    now less t') and the robot's reading that belongs to the picture (that with the same stamp) are wrong by it. A stamp later than the
    arrival is taken for the arrival, and a picture whose stamp is not later than that of the last one used is refused. The log has true
    times, t' as `t_stamp` and the number of pictures refused so far as `refused`.

    Reference: Furgale, Rehder & Siegwart 2013, doi:10.1109/IROS.2013.6696514 (offset of a camera's clock, and how it is calibrated). The
    sizes are chosen; a quartz is off by some 10 to 100 ppm, 1 ms in 10 to 100 s.

    Args:
        offset_s: how far the stamps are ahead of the true times at the start [s]; negative: old; e.g. `-0.02`.
        drift_ppm: by how much the camera's clock is fast [ppm]; e.g. `50`.
        jitter_s: jitter of the stamps [s], of the distribution `timing.jitter`; e.g. `0.002`.
        stamped: what is stamped: `middle`, that of the exposure, or `arrival`, by a driver that does not know the time of exposure.
    """

    offset_s: Offset = 0.0
    drift_ppm: Drift = 0.0
    jitter_s: Annotated[Time, Narrower(le=60)] = 0.0
    stamped: Literal["middle", "arrival"] = "middle"

    def at(self, t: float) -> float:
        """The camera's clock at a time t [s], without jitter."""
        return t + self.offset_s + PER_MILLION * self.drift_ppm * t


@spec
class RobotStamps:
    """The time stamps of the robot's sensor readings: t' = t + offset_s + 1e-6 drift_ppm t, by the clock of the robot's controller.

    The reading that belongs to a picture is the one with the same stamp. A robot's clock that is ahead of the camera's by d thus makes the
    controller take a reading that is older by d: at a joint speed w the joints at the exposure are wrong by w d. Readings come with each
    period of the robot's onboard controller, else every 2 ms; those of the last ten seconds are kept, and none is known before it comes.

    Args:
        offset_s: how far the robot's clock is ahead of the computer's at the start [s]; e.g. `0.01`.
        drift_ppm: by how much it is fast [ppm]; e.g. `-80`.
    """

    offset_s: Offset = 0.0
    drift_ppm: Drift = 0.0

    def true(self, stamp: float) -> float:
        """The time [s] at which the robot's clock shows `stamp` [s]."""
        return (stamp - self.offset_s) / (1 + PER_MILLION * self.drift_ppm)
