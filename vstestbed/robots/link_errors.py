"""What an arm does not know of its own body: errors of its geometry, and a load at its flange."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated

import numpy as np
from annotated_types import Ge, Le, Len

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array, Pose
from vstestbed.core.quantity import Mass, Position, PositiveLength
from vstestbed.core.spec import spec

Offsets = Annotated[tuple[Pose, ...], Len(0, 7)]


@spec
class GeometryError:
    """The true geometry of the arm differs from the one that it computes with: the next joint, or the flange, is displaced on its link.

    T_i = A_i(q_i) D_i, with the nominal motion A_i of joint i and the displacement D_i in the frame of its link (of the Puma, standard
    Denavit-Hartenberg frame i: errors of a and alpha are those along and about x, those of d and theta along and about z of frame
    i - 1, D_i = A_i(0)^-1 Tz(dd) Rz(dtheta) A_i(0)). To first order the flange's twist error is sum Ad(T_i,flange^-1) d_i, with
    T_i,flange from behind link i's displacement to the flange.

    Reference: Hayati & Mirmirani 1985, Improving the absolute positioning accuracy of robot manipulators, Journal of Robotic
    Systems 2(4), 397-413.

    Args:
        sigma_m: standard deviation of each link's displacement along each of its axes [m]; drawn with the scenario's seed.
        sigma_deg: the same about each axis [deg].
        offsets: the displacement of each link, x, y, z and roll, pitch, yaw, where it is not drawn; e.g.
            `[{xyz: [0.001, 0, 0]}, {}, {}, {}, {}, {rpy_deg: [0, 0, 0.1]}]`.
        drawn_offsets: those that a run has drawn, as its scenario states them; the seed gives them, so leave them out.
    """

    sigma_m: Annotated[float, Ge(0), Le(0.1)] = 0.0
    sigma_deg: Annotated[float, Ge(0), Le(10)] = 0.0
    offsets: Offsets = ()
    drawn_offsets: Offsets = ()

    def __post_init__(self) -> None:
        """Refuse offsets that are listed and drawn."""
        if self.draws and self.offsets:
            words = "must be empty with sigma_m or sigma_deg > 0, which draw them, also those of a preset; works: both 0 beside the list"
            raise ParameterError("offsets", words)

    @property
    def draws(self) -> bool:
        """Whether displacements are drawn."""
        return self.sigma_m > 0 or self.sigma_deg > 0

    def drawn(self, n: int, rng: np.random.Generator) -> GeometryError:
        """The same with displacements of n links drawn from `rng`; without drawn ones where both sigmas are 0."""
        if not self.draws:
            return self if not self.drawn_offsets else replace(self, drawn_offsets=())
        xyz, rpy = (np.round(scale * rng.standard_normal((n, 3)), 9).tolist() for scale in (self.sigma_m, self.sigma_deg))
        return replace(self, drawn_offsets=tuple(Pose(xyz=tuple(p), rpy_deg=tuple(a)) for p, a in zip(xyz, rpy, strict=True)))

    def displacements(self, n: int) -> Array | None:
        """D_i (n, 4, 4); None without any.

        Raises:
            ParameterError: another number of links.
        """
        offsets = self.offsets or self.drawn_offsets
        if not offsets:
            return None
        if len(offsets) != n:
            raise ParameterError("geometry_error.offsets", f"must be {n}, one for each link", len(offsets))
        return np.array([pose.T for pose in offsets])


@spec
class Payload:
    """A load at the flange: a cube of uniform density that touches nothing.

    A start at which the weight asks more of a joint than its motor and friction hold is refused.

    Args:
        mass_kg: its mass [kg]; e.g. `1.5`.
        com_m: its centre in the flange's frame [m].
        edge_m: length of its edges [m]; its moments of inertia are mass_kg edge_m^2 / 6.
        declared: whether the gravity compensation of the drives, where they have one, carries it.
    """

    mass_kg: Mass
    com_m: Position = (0.0, 0.0, 0.1)
    edge_m: PositiveLength = 0.1
    declared: bool = True
