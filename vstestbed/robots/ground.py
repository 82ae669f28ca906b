"""What vehicles on a floor share: where they start, and which body twists they can make.

A vehicle's configuration is (x, y, heading), shape (..., 3), [m, m, rad]; its frame stands on the floor with x forward and z up.
Its motion is u = (vx, vy, wz) of that frame in its own axes, shape (..., 3), [m/s, m/s, rad/s].
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
from annotated_types import Ge, Le

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array
from vstestbed.core.planar import GroundPose
from vstestbed.core.spec import spec

PLANE = np.zeros((6, 3))
"""The body twist (v, w) of a planar motion: PLANE @ (vx, vy, wz). Its transpose takes the motion out of a twist."""
PLANE[[0, 1, 5], [0, 1, 2]] = 1.0


@spec
class GroundBox:
    """Half widths of the box from which random starts are drawn: x, y [m], heading_deg [deg]."""

    x: Annotated[float, Ge(0)] = 0.0
    y: Annotated[float, Ge(0)] = 0.0
    heading_deg: Annotated[float, Ge(0), Le(180)] = 0.0


@spec
class GroundStart:
    """Where a vehicle starts: `nominal`, and the box round it from which `random` starts are drawn."""

    nominal: GroundPose = GroundPose()
    random: GroundBox | None = None

    def configuration(self) -> Array:
        """The nominal start (x, y, heading), shape (3,), [m, m, rad]."""
        return self.nominal.place

    def drawn(self, rng: np.random.Generator) -> GroundStart:
        """A start whose nominal pose is drawn evenly from the box.

        Raises:
            ParameterError: there is no box.
        """
        at, box = self.nominal, self.random
        if box is None:
            raise ParameterError("robot.start.random", "is missing: a seed draws the start from it, e.g. {x: .5, y: .5, heading_deg: 20}")
        x, y, heading = (rng.uniform(-1, 1, 3) * (box.x, box.y, box.heading_deg) + (at.x, at.y, at.heading_deg)).tolist()
        return GroundStart(nominal=GroundPose(x=x, y=y, heading_deg=heading), random=box)
