"""Defaults of ground vehicles: start, planar motion, log.

A vehicle's configuration is (x, y, heading), shape (..., 3), [m, m, rad]; its frame lies on the
floor with x forward and z up. Its motion is u = (vx, vy, wz) of that frame in its own axes, shape
(..., 3), [m/s, m/s, rad/s].
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Annotated, ClassVar, Self, TypeVar

import numpy as np
from annotated_types import Ge, Le
from pydantic import model_validator

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array
from vstestbed.core.planar import GroundPose, place_of, pose_on_ground, relative, wrapped
from vstestbed.core.quantity import AngleWidth, Distance, TighterBounds, Time
from vstestbed.core.spec import spec
from vstestbed.effects.base import Effect
from vstestbed.effects.floor import UnevenFloor
from vstestbed.effects.wheels import WheelSpread
from vstestbed.robots.base import Reading, RobotLog, RobotState, Supervisor, random_of
from vstestbed.robots.realism import Realistic

PLANE = np.zeros((6, 3))
"""Selection matrix (6, 3): a planar motion (vx, vy, wz) as a body twist (v, w); its transpose
projects a twist on the plane.
"""
PLANE[[0, 1, 5], [0, 1, 2]] = 1.0


@spec
class GroundBox:
    """The box round the nominal start from which random starts are drawn.

    Args:
        x, y: half widths along world axes [m].
        heading_deg: half width in heading [deg].
    """

    x: Distance = 0.0
    y: Distance = 0.0
    heading_deg: Annotated[AngleWidth, TighterBounds(le=180)] = 0.0


@spec
class GroundStart:
    """Where a vehicle starts: `nominal`, and the box round it from which `random` starts are drawn.

    Args:
        nominal: place and heading at the start of a run without a seed.
        random: the box; None: a seed cannot draw a start.
    """

    nominal: GroundPose = GroundPose()
    random: GroundBox | None = None

    def drawn(self, rng: np.random.Generator) -> GroundStart:
        """A start whose nominal pose is drawn from the box, uniformly. Raises ParameterError: there
        is no box.
        """
        at = self.nominal
        box = random_of(self, "{x: .5, y: .5, heading_deg: 20}")
        off = rng.uniform(-1, 1, 3) * (box.x, box.y, box.heading_deg)
        x, y, heading = (off + (at.x, at.y, at.heading_deg)).tolist()
        return GroundStart(nominal=GroundPose(x=x, y=y, heading_deg=heading), random=box)


class VehicleLog(RobotLog):
    """Columns of a vehicle: places (x, y [m], heading [rad]) in the world, and its slip.

    `base_` is the true place, `est_` the estimate from landmarks, compass and encoders, `odo_` dead
    reckoning by encoders alone from the true start; `slip_mps` and `slip_radps` are the rates at
    which odometry and truth diverge from frame to frame (wheels that slide or turn on the spot, a
    wrong wheel radius).

    supervisor: the vehicle's. start: the true start (x, y, heading), shape (3,) [m, m, rad].
    """

    columns = (
        *(f"{name}_{part}" for name in ("base", "est", "odo") for part in ("x", "y", "heading")),
        *("slip_mps", "slip_radps"),
        *RobotLog.columns,
    )

    def __init__(self, supervisor: Supervisor, start: Array):
        super().__init__(supervisor)
        self._start = start
        self._turn = (np.cos(start[2]), np.sin(start[2]))
        self._before: RobotState | None = None

    def row(self, state: RobotState) -> Array:
        # Odometry counts from (0, 0, 0) in the vehicle's own frame at the start.
        x, y, heading = state.odometry
        c, s = self._turn
        dead_reckoning = np.array([c * x - s * y, s * x + c * y, heading]) + self._start
        slip = _slip(self._before or state, state)
        self._before = state
        return np.concatenate(
            [place_of(state.T_world_base), state.place, dead_reckoning, slip, super().row(state)]
        )

    def proprioception(self, log: Mapping[str, Array]) -> dict[str, Array]:
        """Dead reckoning from the start: the inverse of what `row` does with it."""
        c, s = self._turn
        x = log["odo_x"] - self._start[0]
        y = log["odo_y"] - self._start[1]
        heading = log["odo_heading"] - self._start[2]
        return {"odo_x": c * x + s * y, "odo_y": c * y - s * x, "odo_heading": heading}


def _slip(before: RobotState, now: RobotState) -> tuple[float, float]:
    """Magnitudes of slip between two frames: linear [m/s] and angular [rad/s].

    The true step minus the one by odometry, both in the vehicle's frame at the earlier frame.
    """
    duration = now.t - before.t
    if duration <= 0:
        return 0.0, 0.0
    true = relative(place_of(before.T_world_base), place_of(now.T_world_base))
    ahead, left, turn = true - relative(before.odometry, now.odometry)
    return math.hypot(ahead, left) / duration, abs(float(wrapped(turn))) / duration


Rolling = Annotated[float, Ge(0), Le(0.5)]
Lag = Annotated[Time, TighterBounds(le=5)]

Value = TypeVar("Value", float, Array)


@spec
class Vehicle(Realistic):
    """A robot on wheels that starts on the floor. Its allocation and its odometry go by the nominal
    vehicle, and know no imperfection.

    Args:
        wheel_spread: unequal radii of its wheels; none: all have the nominal one; e.g.
            `{sigma: 0.003}`.
        rolling_resistance: torque on each wheel over its static load and radius [1]; none: that of
            its file; e.g. `0.02`.
        drive_lag_s: time constant with which the drive follows the speed it is told, of first order
            [s]; none: it follows at once; e.g. `0.1`.
        uneven_floor: heights of the floor that its wheels meet; none: a plane; e.g.
            `{rms_m: 0.002}`.
    """

    wheel_spread: WheelSpread | None = None
    rolling_resistance: Rolling | None = None
    drive_lag_s: Lag | None = None
    uneven_floor: UnevenFloor | None = None

    start: ClassVar[GroundStart]
    # Whether the class's model and drive follow the three fields of its wheels
    imperfect_wheels: ClassVar[bool] = False
    base = "planar"
    proprioception_names: ClassVar[tuple[str, ...]] = ("odo_x", "odo_y", "odo_heading")  # pyright: ignore[reportIncompatibleMethodOverride] - a constant
    # x of its rear and of its front end in the base frame [m]
    ends_m: ClassVar[tuple[float, float]] = (0.0, 0.0)
    turning_radius_m: ClassVar[float] = 0.0  # of its tightest circle [m]; 0: it turns on the spot
    top_speed_mps: ClassVar[float] = np.inf  # largest forward speed [m/s]
    # Whether its measured heading has noise drawn from the seed; this matters where the place is
    # estimated from landmarks.
    draws_heading: ClassVar[bool] = False

    @model_validator(mode="after")
    def _refuse_what_it_has_not(self) -> Self:
        if self.imperfect_wheels:
            return self
        for name in ("wheel_spread", "rolling_resistance", "drive_lag_s"):
            if getattr(self, name) is not None:
                able = "robots whose class says `imperfect_wheels`,"
                raise ParameterError.only_for(name, f"{able} and {type(self).__name__} does not")
        return self

    @property
    def acting(self) -> tuple[Effect, ...]:
        """The floor that its wheels meet, and further ones."""
        if self.uneven_floor is None:
            return self.effects
        return self.uneven_floor, *self.effects

    @property
    def draws(self) -> bool:
        """Wheels whose errors are not listed, a floor whose seed is not given."""
        wheels = self.wheel_spread
        floor = self.uneven_floor
        if wheels is not None and wheels.sigma > 0:
            return True
        return floor is not None and floor.seed is None

    def drawn(self, rng: np.random.Generator) -> Self:
        """The same vehicle with wheels and a floor of its own, drawn from `rng`: each the same with
        the other as without.
        """
        of_wheels, of_floor = rng.spawn(2)
        wheels = self.wheel_spread and self.wheel_spread.drawn(of_wheels)
        floor = self.uneven_floor and self.uneven_floor.drawn(of_floor)
        if wheels is self.wheel_spread and floor is self.uneven_floor:
            return self
        return dataclasses.replace(self, wheel_spread=wheels, uneven_floor=floor)

    def configuration(self) -> Array:
        """The nominal start (x, y, heading), shape (3,), [m, m, rad]."""
        return self.start.nominal.place

    def flange_pose(self, configuration: Array) -> Array:
        """T_world_base (4, 4) at (x, y, heading): a camera's mount is relative to the base's frame,
        on the floor.
        """
        return pose_on_ground(configuration)

    def proprioception(self, reading: Reading, odometry: Array | None) -> Array:
        """Its dead reckoning: (x, y, heading) from its start [m, m, rad]. Not its joints, which in
        a model without wheels are the place.
        """
        return np.zeros(3) if odometry is None else odometry

    def log(self, supervisor: Supervisor) -> RobotLog:
        return VehicleLog(supervisor, self.configuration())

    def randomised(self, rng: np.random.Generator) -> Self:
        """The same vehicle with a start drawn from the box. ParameterError without a box."""
        return dataclasses.replace(self, start=self.start.drawn(rng))

    def started_at(self, configuration: Array) -> Self:
        """The same vehicle from another place (x, y, heading)."""
        x, y, heading = configuration.tolist()
        nominal = GroundPose(x=x, y=y, heading_deg=math.degrees(heading))
        return dataclasses.replace(self, start=dataclasses.replace(self.start, nominal=nominal))

    def lagged(self, now: Value, order: Value, dt: float) -> Value:
        """What the drive follows after dt [s] of an order, from what it follows now, (n,) each:
        y' = (order - y) / drive_lag_s, exactly.
        """
        if not self.drive_lag_s:
            return order
        return order + (now - order) * math.exp(-dt / self.drive_lag_s)
