"""Imperfections that all vehicles have: wheels of unequal radius, rolling resistance, a drive with lag, an uneven floor."""

from __future__ import annotations

import dataclasses
import math
from typing import Annotated, ClassVar, Self, TypeVar

import numpy as np
from annotated_types import Ge, Le

from vstestbed.core.geometry import Array
from vstestbed.core.quantity import Narrower, Time
from vstestbed.core.spec import spec
from vstestbed.robots.ground import Vehicle
from vstestbed.robots.realism import Realistic
from vstestbed.robots.uneven_floor import UnevenFloor
from vstestbed.robots.wheels import WheelSpread

Rolling = Annotated[float, Ge(0), Le(0.5)]
Lag = Annotated[Time, Narrower(le=5)]

Value = TypeVar("Value", float, Array)


@spec
class WornVehicle(Vehicle, Realistic):
    """A vehicle with imperfections, which its allocation and its odometry do not know: both go by the nominal vehicle.

    Args:
        wheel_spread: unequal radii of its wheels; none: all have the nominal one; e.g. `{sigma: 0.003}`.
        rolling_resistance: torque on each wheel over its static load and radius [1]; none: that of its file; e.g. `0.02`.
        drive_lag_s: time constant with which the drive follows the speed it is told, of first order [s]; none: it follows at once;
            e.g. `0.1`.
        uneven_floor: heights of the floor that its wheels meet; none: a plane; e.g. `{rms_m: 0.002}`.
    """

    wheel_spread: WheelSpread | None = None
    rolling_resistance: Rolling | None = None
    drive_lag_s: Lag | None = None
    uneven_floor: UnevenFloor | None = None
    drawn_fields: ClassVar[tuple[str, ...]] = ("wheel_spread.drawn_errors", "uneven_floor.drawn_seed")

    @property
    def draws(self) -> bool:
        """Wheels whose errors are not listed, a floor whose seed is not given."""
        wheels, floor = self.wheel_spread, self.uneven_floor
        return (wheels is not None and wheels.sigma > 0) or (floor is not None and floor.seed is None)

    def drawn(self, rng: np.random.Generator) -> Self:
        """The same vehicle with wheels and a floor of its own, drawn from `rng`: each the same with the other as without."""
        wheels, floor = self.wheel_spread, self.uneven_floor
        if wheels is None and floor is None:
            return self
        of_wheels, of_floor = rng.spawn(2)
        return dataclasses.replace(self, wheel_spread=wheels and wheels.drawn(of_wheels), uneven_floor=floor and floor.drawn(of_floor))

    def randomised(self, rng: np.random.Generator) -> Self:
        """The same vehicle with a start drawn from the box. ParameterError without a box."""
        return dataclasses.replace(self, start=self.start.drawn(rng))

    def lagged(self, now: Value, order: Value, dt: float) -> Value:
        """What the drive follows after dt [s] of an order, from what it follows now, (n,) each: y' = (order - y) / drive_lag_s, exactly."""
        return order + (now - order) * math.exp(-dt / self.drive_lag_s) if self.drive_lag_s else order
