"""Lenses, features, motions, metrics, perturbations and monitors that are wrong, each in one way:
the suites must say so.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, Literal

import numpy as np

from vstestbed.camera import Perspective
from vstestbed.core.outcome import Outcome
from vstestbed.core.spec import spec
from vstestbed.features import Point
from vstestbed.targets.motion import MotionBase, RandomWalk
from vstestbed.vision.perturb import PerturbationBase

COUNT = [0]


@spec
class Backwards(Perspective):
    """It sees points behind the lens as if they were before it."""

    kind: Literal["backwards"] = "backwards"

    def project(self, p_camera: Any) -> Any:
        """As of |Z|."""
        return super().project(p_camera * np.sign(p_camera[..., 2:]))


@spec
class Mirrored(Point):
    """The sign of its L is that of s* - s."""

    kind: Literal["mirrored"] = "mirrored"

    def interaction(self, xy: Any, depth: Any) -> Any:
        """Of the other sign."""
        return -super().interaction(xy, depth)


@spec
class Jumping(MotionBase):
    """A step of 10 cm."""

    kind: Literal["jumping"] = "jumping"

    def path(self, rng: Any) -> Any:
        """At 2 s."""

        def at(t: float) -> Any:
            D = np.eye(4)
            D[0, 3] = 0.1 * (t > 1.9995)
            return D

        return at


@spec
class Untold(RandomWalk):
    """A random walk that does not say that it draws."""

    kind: Literal["untold"] = "untold"
    draws: ClassVar[bool] = False


@spec
class Forgetful:
    """The first time, under another name."""

    kind: Literal["forgetful"] = "forgetful"
    titles: ClassVar[Mapping[str, tuple[str, str]]] = {"first_s": ("First time", "s")}

    def figures(self, log: Any, setup: Any) -> dict[str, object]:
        """It calls it as its title does not."""
        return {"last_s": float(log["t"][0])}


@spec
class Idle(PerturbationBase):
    """It changes nothing."""

    kind: Literal["idle"] = "idle"


@spec
class Impatient:
    """It counts the frames of all runs."""

    kind: Literal["impatient"] = "impatient"

    def monitor(self, setup: Any) -> Any:
        """Itself."""
        return self

    def update(self, frame: Any) -> Any:
        """At the fifth frame ever."""
        COUNT[0] += 1
        return (Outcome.timed_out, f"frame {COUNT[0]}") if COUNT[0] > 5 else None
