"""The four wheels of a vehicle: their names, and how far their radii are from one another."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from annotated_types import Ge, Gt, Le, Len, Lt

from vstestbed.core.spec import spec

WHEELS = ("front_left", "front_right", "rear_left", "rear_right")
RadiusError = Annotated[float, Gt(-0.2), Lt(0.2)]


@spec
class WheelSpread:
    """How far the true radius of each wheel is from the nominal one, which the vehicle knows.

    Args:
        sigma: standard deviation of the relative errors, drawn for each wheel where they are not listed [1]; e.g. `0.003`.
        errors: relative errors of the radii, front left, front right, rear left, rear right [1]; none: they are drawn;
            e.g. `[0, 0, 0.004, -0.004]`.
        seed: of the draw; a run with a seed draws it anew [1].
    """

    sigma: Annotated[float, Ge(0), Le(0.05)] = 0.0
    errors: Annotated[tuple[RadiusError, ...], Len(4, 4)] | None = None
    seed: Annotated[int, Ge(0), Le(2**31 - 1)] = 0

    @property
    def factors(self) -> tuple[float, ...]:
        """True over nominal radius of each wheel, (4,)."""
        errors = self.errors
        if errors is None:
            errors = np.clip(self.sigma * np.random.default_rng(self.seed).standard_normal(4), -0.19, 0.19).tolist()
        return tuple(1 + error for error in errors)
