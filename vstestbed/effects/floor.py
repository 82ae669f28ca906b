"""An uneven floor: a random field of heights of given size and correlation length.

Its heights are Gaussian, with the autocorrelation R(d) = rms^2 exp(-d^2 / l^2): white noise through
the filter whose transfer function is rms sqrt(pi) l exp(-k^2 l^2 / 8), k the wave number [rad/m].
The slopes along an axis have the standard deviation sqrt(2) rms / l.

Reference: Thorsos 1988, "The validity of the Kirchhoff approximation for rough surface scattering
using a Gaussian roughness spectrum", doi:10.1121/1.396188 (the spectrum and its generation in one
dimension; here in two).
"""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated

import numpy as np
from annotated_types import Ge, Le

from vstestbed.core.geometry import Array
from vstestbed.core.quantity import PositiveLength, TighterBounds
from vstestbed.core.spec import spec
from vstestbed.effects.base import ASSETS, RANGE_GROUP, Effect, RobotModel

MOST_SEED = 2**31 - 1
FloorSeed = Annotated[int, Ge(0), Le(MOST_SEED)]
CELLS = 5  # cells of the field in a correlation length
RELIEF = "floor_relief"
HALF_M = 20.0  # half the edge of the height field, as far as the floor is drawn [m]


@spec
class UnevenFloor(Effect):
    """Heights of the floor under a vehicle, for 20 m around the origin of the world; the wheels
    alone meet them.

    No picture shows them: heights of millimetres are below what a pixel of the camera or of a film
    shows, and lines and targets lie on the drawn plane.

    Args:
        rms_m: standard deviation of the heights [m].
        correlation_m: l, the distance over which heights are alike [m]; e.g. `0.3`.
        seed: of the heights; none: one is drawn with the scenario's seed [1]; e.g. `3`.
    """

    uneven = True
    rms_m: Annotated[PositiveLength, TighterBounds(le=0.05)] = 0.002
    correlation_m: Annotated[PositiveLength, TighterBounds(ge=0.1, le=10)] = 0.3
    seed: FloorSeed | None = None

    def drawn(self, rng: np.random.Generator) -> UnevenFloor:
        """With a seed drawn from `rng`; itself where it is given."""
        if self.seed is not None:
            return self
        return replace(self, seed=int(rng.integers(MOST_SEED)))

    def heights(self, half_m: float) -> Array:
        """The heights (n, n) [m] of a square of 2 half_m from edge to edge, rows along y, columns
        along x.

        Before a seed is drawn they are those of seed 0.
        """
        cells = round(2 * half_m * CELLS / self.correlation_m)
        n = cells + 1
        cell = 2 * half_m / cells
        # For rfft2 the last axis has the non-negative wave numbers alone.
        along = np.fft.rfftfreq(n, cell) * 2 * np.pi
        across = np.fft.fftfreq(n, cell) * 2 * np.pi
        pass_along = np.exp(-(along**2) * self.correlation_m**2 / 8)
        pass_across = np.exp(-(across**2) * self.correlation_m**2 / 8)
        size = self.rms_m * np.sqrt(np.pi) * self.correlation_m / cell
        noise = np.fft.rfft2(np.random.default_rng(self.seed or 0).standard_normal((n, n)))
        filtered = noise * pass_across[:, None] * pass_along * size
        return np.asarray(np.fft.irfft2(filtered, (n, n)), dtype=np.float64)

    def edit(self, robot: RobotModel) -> None:
        """The height field in place of the floor's contacts. Beyond its edge a plane at its lowest
        height takes over; neither is drawn.
        """
        import mujoco

        scene = robot.scene
        heights = self.heights(HALF_M)
        low = float(heights.min())
        high = float(heights.max())
        n = len(heights)
        scene.meshdir = ASSETS
        extent = [HALF_M, HALF_M, high - low, 0.1]  # the last: thickness under the lowest [m]
        scene.add_hfield(
            name=RELIEF, file=f"{RELIEF}.bin", content_type="image/vnd.mujoco.hfield", size=extent
        )
        floor = scene.geom("floor")
        # As the plane has them, also where the scenario has its friction.
        alike = {
            "friction": floor.friction,
            "contype": floor.contype,
            "conaffinity": floor.conaffinity,
            "group": RANGE_GROUP,
        }
        at = [0, 0, floor.pos[2] + low]
        scene.worldbody.add_geom(
            name=RELIEF, type=mujoco.mjtGeom.mjGEOM_HFIELD, hfieldname=RELIEF, pos=at, **alike
        )
        scene.worldbody.add_geom(
            name=f"{RELIEF}_around",
            type=mujoco.mjtGeom.mjGEOM_PLANE,
            size=[0, 0, 5],
            pos=at,
            **alike,
        )
        floor.contype = floor.conaffinity = 0
        # MuJoCo's binary format: numbers of rows and columns, then the heights, which it stretches
        # to [0, 1].
        size = np.array([n, n], dtype=np.int32)
        stretched = ((heights - low) / (high - low)).astype(np.float32)
        robot.assets[f"{ASSETS}/{RELIEF}.bin"] = size.tobytes() + stretched.tobytes()
