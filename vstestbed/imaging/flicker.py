"""Flicker of lamps on alternating current: its mean over an exposure in closed form."""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np
from annotated_types import Ge, Le

from vstestbed.core.geometry import Array
from vstestbed.core.quantity import Angle, Frequency
from vstestbed.core.spec import spec

# An exposure below which the light is that of its middle [s]: the integrals' differences would lose
# digits
INSTANT_S = 1e-6


@spec
class Flicker:
    """Flicker of all lamps, as on mains of 50 Hz: B(t) = 1 + depth cos(2 pi frequency_hz t +
    phase), in units of the mean brightness.

    A row of the picture has the mean of B over its own exposure of e seconds about t,

    B_e(t) = 1 + depth sinc(frequency_hz e) cos(2 pi frequency_hz t + phase), sinc(x) = sin(pi x) /
    (pi x),

    so that an exposure of whole periods shows nothing of it, a short one with a rolling shutter
    bands of H / (readout_s frequency_hz) rows, and one with a global shutter pictures of changing
    brightness, at the difference of frequency_hz from the next multiple of the camera's rate.

    Lamp and even light of `world.light` flicker; what is not lit does not: markers and pictures
    with `lit: false` (their colour is constant), and the sky. Films from outside and goal pictures
    show the mean light. With a rolling shutter each image is drawn twice, under the darkest and the
    brightest light; the mean of the two is exact where no colour is clipped.

    Args:
        frequency_hz: of the light, twice that of the mains [Hz]; e.g. `120`.
        depth: (brightest - darkest) / (brightest + darkest) [1]; 0: no flicker; e.g. `0.3`.
        phase_deg: at time 0 [deg]; e.g. `90`.

    Reference: IEEE Std 1789-2015, which calls `depth` percent flicker or modulation,
    doi:10.1109/IEEESTD.2015.7118618.
    """

    frequency_hz: Frequency = 100.0
    depth: Annotated[float, Ge(0), Le(1)] = 0.0
    phase_deg: Angle = 0.0

    def mean(self, t: Array | float, exposure_s: float) -> Array:
        """Mean brightness B_e over exposures about times t (...) [s]; at the times themselves for
        an exposure of 0.
        """
        w = 2 * math.pi * self.frequency_hz
        phase = math.radians(self.phase_deg)
        return 1 + self.depth * np.sinc(self.frequency_hz * exposure_s) * np.cos(
            w * np.asarray(t, dtype=float) + phase
        )

    def moments(self, since: float, begin: Array, end: Array) -> tuple[Array, Array]:
        """Integrals of B(t) [s] and of (t - since) B(t) [s^2] over intervals from `begin` to `end`
        (...) [s].
        """
        w = 2 * math.pi * self.frequency_hz
        phase = math.radians(self.phase_deg)

        def primitive(t: Array) -> tuple[Array, Array]:
            sine = np.sin(w * t + phase)
            cosine = np.cos(w * t + phase)
            after = t - since
            return t + self.depth * sine / w, after**2 / 2 + self.depth * (
                after * sine / w + cosine / w**2
            )

        (a, b) = primitive(begin)
        (c, d) = primitive(end)
        return c - a, d - b


STEADY = Flicker()  # light that does not flicker
