"""Outcome monitors that a scenario adds to the loop's own (`monitors: [...]`): the referee's rules, which may read the truth."""

from __future__ import annotations

from typing import Literal, Protocol

import numpy as np

from vstestbed.core.contract import Contract
from vstestbed.core.errors import ParameterError
from vstestbed.core.outcome import Outcome, Verdict
from vstestbed.core.quantity import Position
from vstestbed.core.spec import OneOf, spec
from vstestbed.tasks.frame import Frame
from vstestbed.tasks.rules import AfterPictures, Settles
from vstestbed.tasks.setup import Setup


class Monitor(Protocol):
    """Tests every frame of one run."""

    def update(self, frame: Frame) -> Verdict | None:
        """The verdict, if this frame ends the run; None to go on."""
        ...


class MonitorContract(Protocol):
    """A rule of when a run ends: its parameters are frozen in the object, and each run has a `Monitor` of its own."""

    @property
    def kind(self) -> str:
        """The word in a scenario."""
        ...

    def monitor(self, setup: Setup) -> Monitor:
        """What tests each frame of one run, by measurements, commands and truth. It must not write into a frame."""
        ...


@spec
class KeepOut:
    """The run ends as `collided` when the camera's centre enters a box with sides along the world's axes.

    Contacts of the robot's body with what stands in the scene end a run anyway; this box is of no substance.

    Args:
        corner: a corner of the box in the world [m]; e.g. `[0.4, -0.3, 0.5]`.
        opposite: the corner opposite to it [m]; e.g. `[0.8, 0.3, 1.2]`.
    """

    kind: Literal["keep_out"] = "keep_out"
    corner: Position
    opposite: Position

    def __post_init__(self) -> None:
        """Refuse a box without volume."""
        if any(a == b for a, b in zip(self.corner, self.opposite, strict=True)):
            raise ParameterError("opposite", "must differ from `corner` in x, y and z", list(self.opposite))

    def monitor(self, setup: Setup) -> Monitor:
        """By the true place of the camera."""
        return _KeepOut(np.sort([self.corner, self.opposite], axis=0))


class _KeepOut:
    def __init__(self, box: np.ndarray) -> None:
        self._low, self._high = box

    def update(self, frame: Frame) -> Verdict | None:
        """Collided, inside."""
        xyz = frame.truth.T_world_camera[:3, 3]
        if not ((xyz >= self._low) & (xyz <= self._high)).all():
            return None
        x, y, z = xyz.tolist()
        return Outcome.collided, f"the camera entered the forbidden box at x {x:.3f}, y {y:.3f}, z {z:.3f} m"


MONITORS = OneOf("monitor", KeepOut, Settles, AfterPictures, contract=Contract(MonitorContract))


class OwnMonitor:
    """A monitor of a scenario, whose verdicts are checked."""

    def __init__(self, rule: MonitorContract, setup: Setup):
        self._kind, self._monitor = rule.kind, rule.monitor(setup)

    def update(self, frame: Frame) -> Verdict | None:
        """The rule's verdict.

        Raises:
            ParameterError: it is neither None nor an outcome with its reason.
        """
        verdict = self._monitor.update(frame)
        match verdict:
            case None | (Outcome(), str()):
                return verdict
        raise ParameterError(f"monitors: {self._kind}", "update must return None or (Outcome, reason)", repr(verdict))
