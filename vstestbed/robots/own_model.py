"""What a controller knows of its robot: the velocities that it can order, their limits, and the
camera twist that they make.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array

NONE = np.zeros(0)
CAMERA = ("vx", "vy", "vz", "wx", "wy", "wz")  # the motions of a camera that flies freely


@dataclass(frozen=True, slots=True, kw_only=True)
class OwnModel:
    """A robot's n own velocities, by its own sensors and its own model, errors of calibration
    included; nothing of the truth.

    They are the joints' of an arm, and the motions of `Robot.motion_basis` for all others: the
    twist of an ideal camera, (vx, vy, wz) or (v, w) of a vehicle, (vx, vy, vz, wz) of a level
    craft. A law orders them by `Command.rates`.

    Attributes:
        names: of the velocities.
        J: camera twist (6,) = J @ rates, (6, n), now.
        jacobian: the same at other positions q (n,).
        q, qd: positions and measured velocities (n,) [rad, m; per s]; 0 where only the velocities
            are known (all but arms).
        low, high: lowest and highest position (n,); infinite without one.
        nominal: positions at the nominal start (n,).
        speed, acceleration: largest of each (n,) [rad/s, m/s; per s^2]; infinite where the robot
            has no such limit.
        sums, most: |sums @ rates| <= most, (k, n) and (k,), for limits that several velocities
            share (a wheel's speed).
        turning_radius_m: of the tightest circle: |w| <= |v| / radius for the last and the first
            velocity; 0: on the spot.
        tilt, most_tilt_rad: roll and pitch (2,) of a craft, and the largest it may order; its
            acceleration needs them.
        unit_m: length that makes metres and radians comparable [m].
        slides: which positions are lengths (n,); empty for none.
        lag_s: time constant with which velocities follow their orders [s].
        moved: displacement (n,) between the exposures of the last picture and this one.
        since_s: time between these exposures [s].
        underway: displacement (n,) from the exposure until this frame's command takes effect:
            measured until now, as ordered from then.
        underway_s: time from the exposure until then [s].
        coming: the part of `underway` from now on (n,).
        ordered: the velocities ordered last (n,).
        period_s: time between pictures [s].
    """

    names: tuple[str, ...]
    J: Array
    jacobian: Callable[[Array], Array]
    q: Array
    qd: Array
    low: Array
    high: Array
    nominal: Array
    speed: Array
    acceleration: Array
    sums: Array
    most: Array
    turning_radius_m: float = 0.0
    tilt: Array | None = None
    most_tilt_rad: float = np.inf
    lag_s: float = 0.0
    unit_m: float = 1.0
    slides: NDArray[np.bool_] = field(default_factory=lambda: NONE.astype(bool))
    moved: Array = field(default_factory=lambda: NONE)
    since_s: float = 0.0
    underway: Array = field(default_factory=lambda: NONE)
    underway_s: float = 0.0
    coming: Array = field(default_factory=lambda: NONE)
    ordered: Array = field(default_factory=lambda: NONE)
    period_s: float = 0.04

    @classmethod
    def of_motions(
        cls, names: tuple[str, ...], J: Array, speed: Array, acceleration: Array, **more: object
    ) -> OwnModel:
        """Of a robot whose positions along its motions, J (6, n), are unknown or without limits."""
        n = J.shape[1]
        zero = np.zeros(n)
        endless = np.full(n, np.inf)
        values: Any = {"sums": np.zeros((0, n)), "most": NONE, **more}  # fields by name
        return cls(
            names=names,
            J=J,
            jacobian=lambda q: J,
            q=zero,
            qd=zero,
            low=-endless,
            high=endless,
            nominal=zero,
            speed=speed,
            acceleration=acceleration,
            **values,
        )

    @classmethod
    def of_ideal_camera(cls, period_s: float, moved: Array | None = None) -> OwnModel:
        """A camera that follows every twist at once and without limit; moved: displacement since
        the last picture (6,).
        """
        zero = np.zeros(6)
        endless = np.full(6, np.inf)
        return cls.of_motions(
            CAMERA,
            np.eye(6),
            endless,
            endless,
            underway=zero,
            coming=zero,
            ordered=zero,
            period_s=period_s,
            moved=zero if moved is None else moved,
            since_s=0.0 if moved is None else period_s,
        )

    @property
    def q_then(self) -> Array:
        """Positions (n,) when this frame's command takes effect."""
        return self.q + self.coming

    @property
    def way(self) -> Array:
        """The camera's own displacement (6,) from the exposure until this frame's command takes
        effect [m, rad], by J halfway.
        """
        return self.jacobian(self.q_then - self.underway / 2) @ self.underway

    def positions(self, given: tuple[float, ...]) -> Array:
        """Positions (n,) given in degrees, in metres where a joint slides. Raises ParameterError:
        another number of them.
        """
        n = len(self.names)
        if len(given) != n:
            what = f"positions, of {', '.join(self.names)}"
            raise ParameterError.count("law.secondary.q_deg", n, what, list(given))
        if not len(self.slides):
            return np.radians(given)
        return np.where(self.slides, given, np.radians(given))
