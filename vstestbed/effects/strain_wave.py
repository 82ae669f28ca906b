"""Strain wave gears by the sizes of their catalogue: stiffness in three stages, and the rotors before them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, NamedTuple

import numpy as np
from annotated_types import Ge, Le, Len
from numpy.typing import NDArray

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array
from vstestbed.core.quantity import OneForAll
from vstestbed.core.spec import spec
from vstestbed.effects.joints import each

Sizes = Annotated[tuple[Annotated[int, Ge(0), Le(100)], ...], Len(1, 7), OneForAll()]
Rotors = Annotated[tuple[Annotated[float, Ge(0), Le(1e3)], ...], Len(0, 7), OneForAll()]


class Torsion(NamedTuple):
    """Torque over torsion: k1 up to t1, k2 up to t2, k3 beyond [Nm, Nm/rad]."""

    t1: float
    t2: float
    k1: float
    k2: float
    k3: float

    @property
    def bends(self) -> tuple[float, float]:
        """Torsion at t1 and t2 [rad]."""
        first = self.t1 / self.k1
        return first, first + (self.t2 - self.t1) / self.k2


CURVES: Mapping[int, Torsion] = {
    8: Torsion(0.29, 0.75, 0.09e4, 0.10e4, 0.12e4),
    11: Torsion(0.80, 2.0, 0.27e4, 0.34e4, 0.44e4),
    14: Torsion(2.0, 6.9, 0.47e4, 0.61e4, 0.71e4),
    17: Torsion(3.9, 12.0, 1.0e4, 1.4e4, 1.6e4),
    20: Torsion(7.0, 25.0, 1.6e4, 2.5e4, 2.9e4),
    25: Torsion(14.0, 48.0, 3.1e4, 5.0e4, 5.7e4),
    32: Torsion(29.0, 108.0, 6.7e4, 11.0e4, 12.0e4),
    40: Torsion(54.0, 196.0, 13.0e4, 20.0e4, 23.0e4),
}
"""Of each size, at ratios of 80 and more. Source: Harmonic Drive LLC, catalogue of the cup type gears CSF and CSG, engineering data,
torsional stiffness."""


@spec
class StrainWave:
    """Strain wave gears, one in each joint, of ratios of 80 and more, as most light arms have them.

    Their torsional stiffness is the catalogue's, in three stages: k1 up to a torque t1, k2 up to t2, k3 beyond. Of size 20: 16000, 25000
    and 29000 Nm/rad with t1 = 7 and t2 = 25 Nm. A gear whose size is not known is taken as the least whose limit for repeated peak torque
    carries the joint's largest torque: at a ratio of 100 that is 11 Nm of CSF-11, 36 of CSG-14, 70 of CSG-17, 107 of CSG-20, 204 of
    CSG-25, 433 of CSG-32.

    It changes nothing by itself: `realism`, and `gears` without a stiffness, take their springs and rotors from it.

    Reference: Harmonic Drive LLC, catalogue of the cup type gears CSF and CSG: rating table and torsional stiffness.

    Args:
        sizes: of the catalogue, 8 to 40, one for all joints or one for each; 0: a joint that stays rigid, such as one before a link so
            light that it would vibrate at more than some 100 Hz [1]; e.g. `[20, 20, 20, 20, 14, 14, 0]`.
        rotor_kgm2: inertia of each rotor times the squared gear ratio, one for all or one for each; default: the `armature` of the file
            [kg m^2]; e.g. `[0.606, 0.606, 0.462, 0.462, 0.206, 0.206, 0.206]`.
    """

    sizes: Sizes
    rotor_kgm2: Rotors = ()

    def curves(self, slides: NDArray[np.bool_]) -> tuple[Array, Array]:
        """Stiffness at rest (n,) [Nm/rad], and the stages (n, 2, 2): beyond which torsion [rad] it grows by how much [Nm/rad].

        Raises ParameterError: another number of sizes, or one that the catalogue has not.
        """
        sizes = each("strain_wave.sizes", self.sizes, slides)
        k, stages = np.zeros(len(slides)), np.zeros((len(slides), 2, 2))
        for i, size in enumerate(sizes.astype(int).tolist()):
            if size == 0:
                continue
            if size not in CURVES:
                raise ParameterError("strain_wave.sizes", f"must be 0 or of {', '.join(map(str, CURVES))}", size)
            curve = CURVES[size]
            first, second = curve.bends
            k[i], stages[i] = curve.k1, ((first, curve.k2 - curve.k1), (second, curve.k3 - curve.k2))
        return k, stages

    def rotors(self, slides: NDArray[np.bool_]) -> Array | None:
        """J (n,) [kg m^2]; None for those of the file."""
        return each("strain_wave.rotor_kgm2", self.rotor_kgm2, slides, turns=False) if self.rotor_kgm2 else None
