"""What reaches the control step with a picture: the exposure, and the moment at which it arrives."""

from __future__ import annotations

from dataclasses import dataclass

from vstestbed.camera import Picture
from vstestbed.robots.reading import Reading
from vstestbed.vision.base import TruthView


@dataclass(frozen=True, slots=True)
class Exposure:
    """A picture, with the robot's sensor reading at its exposure.

    Attributes:
        number: counts frames. t: time of the exposure's middle [s]. picture: None where no detector asks for one.
        reading: of the robot's sensors at that time. view: the truth for an oracle; None for every other detector.
    """

    number: int
    t: float
    picture: Picture | None
    reading: Reading
    view: TruthView | None = None


@dataclass(frozen=True, slots=True)
class Arrival:
    """Arrival of a picture: its time [s], when its command will reach the robot [s], and the robot's sensor reading now."""

    t: float
    t_cmd: float
    reading: Reading
