"""The four wheels of a vehicle: their names, and how far their radii are from one another."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from annotated_types import Ge, Gt, Le, Len, Lt

from vstestbed.core.errors import ParameterError
from vstestbed.core.spec import spec

WHEELS = ("front_left", "front_right", "rear_left", "rear_right")
RadiusError = Annotated[float, Gt(-0.2), Lt(0.2)]
Errors = Annotated[tuple[RadiusError, ...], Len(4, 4)]


@spec
class WheelSpread:
    """How far the true radius of each wheel is from the nominal one, which the vehicle knows: listed, or drawn with the scenario's seed.

    Args:
        sigma: standard deviation of the relative errors that are drawn, one for each wheel [1]; e.g. `0.003`.
        errors: relative errors of the radii, front left, front right, rear left, rear right [1]; none: they are drawn;
            e.g. `[0, 0, 0.004, -0.004]`.
    """

    sigma: Annotated[float, Ge(0), Le(0.05)] = 0.0
    errors: Errors | None = None

    def __post_init__(self) -> None:
        if self.sigma and self.errors is not None:
            words = "must be none with sigma > 0, which draws them, also that of robot.realism; works: sigma 0 beside the listed errors"
            raise ParameterError("errors", words, list(self.errors))

    def drawn(self, rng: np.random.Generator) -> WheelSpread:
        """With four errors listed that are drawn from `rng`; itself where sigma is 0."""
        if not self.sigma:
            return self
        errors = np.clip(self.sigma * rng.standard_normal(4), -0.19, 0.19)
        return WheelSpread(errors=tuple(np.round(errors, 9).tolist()))

    @property
    def factors(self) -> tuple[float, ...]:
        """True over nominal radius of each wheel, (4,); 1 before they are drawn."""
        return tuple(1 + error for error in self.errors or (0.0,) * len(WHEELS))
